"""Columns of tracks and truth that benchmarks and programs use in different ways."""

from pathlib import Path

import pytest
from format_cases import put, refused

from phdtrack.errors import InputError
from phdtrack.formats import Conventions, ignoring, read_detections, read_tracks, read_truth
from phdtrack.formats import read_truth_by_class as by_class
from phdtrack.types import Truth


def rows(*ends: str) -> str:
    """A row a frame, of identities from 1, with these columns after the box."""
    return "".join(f"{k},{k},{9 * k},0,5,5,{end}\n" for k, end in enumerate(ends, start=1))


def identities(table: Truth) -> list[int]:
    return list(table.identity.tolist())


@pytest.mark.parametrize(
    ("content", "labels"),
    [
        (rows("0,0,-1", "0,0,-1", "0,2,-1"), [0, 0, 2]),
        (rows("1,0,-1", "0,0,-1"), [0, 0]),
        (rows("1,1,4", "0,1,5"), [1, 1]),
        (rows("0,1", "1,1"), [1, 1]),
        (rows("0,car,-1", "0,bus,-1"), [2, 1]),
        (rows("0,-1,-1,-1", "1,-1,-1,-1"), [0, 0]),
        (rows("0.5,4,-1,-1", "0,10,-1,-1"), [4, 10]),
        (rows("0,1.5,2.5", "1,3.5,2.5"), [0, 0]),
        ("frame,id,x1,y1,x2,y2,conf,class\n1,1,0,0,5,5,0,0\n2,2,0,0,5,5,0,1\n", [0, 1]),
    ],
)
def test_no_row_of_tracks_is_lost_for_a_score_of_0(
    tmp_path: Path, content: str, labels: list[int]
) -> None:
    tracks = read_tracks(put(tmp_path, content))
    assert tracks.identity.tolist() == list(range(1, len(labels) + 1))
    assert tracks.class_id.tolist() == labels


def test_rows_of_truth_left_out_of_tracks_are_told(tmp_path: Path) -> None:
    notices = list[str]()
    path = put(tmp_path, rows("1,1,0.9", "0,8,0.2"))
    assert read_tracks(path, notices=notices).identity.tolist() == [1]
    assert "1 of 2 rows are no objects by their flag or class" in notices[0]
    # By its name alone, if the flags leave a doubt.
    path = put(tmp_path, rows("1,1,0.9", "0,1,0.2"), "gt.txt")
    assert len(read_tracks(path, notices=notices)) == 1


@pytest.mark.parametrize(
    "ends",
    [
        ("1,1,1.0", "1,2,1.0", "1,3,1.0"),
        ("1,3,1.0", "1,3,1.0", "1,3,1.0"),
        ("1,0,1", "1,0,1", "1,0,1"),
        ("1,0", "1,1", "1,80"),
        ("1,person,1", "1,person,1", "1,car,1"),
    ],
)
def test_own_classes_with_flag_1_are_objects(tmp_path: Path, ends: tuple[str, ...]) -> None:
    notices = list[str]()
    path = put(tmp_path, rows(*ends, ends[0].replace("1,", "0,", 1)))
    truth = read_truth(path, notices=notices)
    assert identities(truth) == [1, 2, 3]
    assert not truth.distractor.any()
    if "person" not in ends[0]:
        assert "class numbers of your own" in notices[0]


def test_an_option_goes_before_the_evidence(tmp_path: Path) -> None:
    path = put(tmp_path, rows("1,1,1", "1,3,1", "1,8,1"))
    assert identities(read_truth(path, notices=[])) == [1, 2, 3]
    notices = list[str]()
    truth = read_truth(path, conventions=Conventions(format="mot17"), notices=notices)
    assert (identities(truth), truth.distractor.tolist()) == ([1, 3], [False, True])
    assert not notices
    # A folder of the benchmark has its classes.
    benchmark = put(tmp_path, path.read_text(), "MOT17-02/gt/gt.txt")
    assert identities(read_truth(benchmark, notices=notices)) == [1, 3]
    assert "2 rows with flag 1 are of other classes than 1 and are not scored" in notices[0]
    assert identities(read_truth(path, conventions=Conventions(format="mot15"))) == [1, 2, 3]
    with pytest.raises(InputError, match="expected mot15, mot17"):
        Conventions(format="mot16")


def test_classes_of_truth_have_the_names_of_labels_txt(tmp_path: Path) -> None:
    path = put(tmp_path, rows("1,1,1", "1,2,1", "1,2,1"), "gt/gt.txt")
    put(tmp_path, "person\ncar\n", "gt/labels.txt")
    found = by_class(path, notices=[])
    assert {name: identities(truth) for name, truth in found.items()} == {
        "person": [1],
        "car": [2, 3],
    }
    put(tmp_path, "person\n", "gt/labels.txt")
    assert list(by_class(path, notices=[])) == ["1", "2"]


@pytest.mark.parametrize("name", ["M0101_gt_whole.txt", "UAVDT/gt.txt", "any.txt"])
def test_columns_of_uavdt(tmp_path: Path, name: str) -> None:
    second = "2,2,3" if name == "any.txt" else "1,2,1"
    path = put(tmp_path, rows("1,1,1", second, "1,4,1"), name)
    truth = read_truth(path, notices=[])
    assert identities(truth) == [1, 2, 3]
    assert not truth.distractor.any()


def test_regions_of_uavdt_have_numbers(tmp_path: Path) -> None:
    truth = read_truth(put(tmp_path, rows("1,-1,-1")))
    listed = put(tmp_path, "1,0,7,7,9,9,1,-1,-1\n2,1,7,7,9,9,1,-1,-1\n", "M0101_gt_ignore.txt")
    found = ignoring(truth, listed)
    assert (len(found), found.regions.tolist()[1]) == (1, [2, 7, 7, 16, 16])
    # In other lists, numbers are those of objects.
    assert len(ignoring(truth, put(tmp_path, listed.read_text(), "ignore.txt"))) == 3


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            "7,7,9,9\n",
            "line 1: expected frame,x,y,w,h, the columns of a list without a header, got 4",
        ),
        ("1,7,7,9,9\n2,7,7\n", "line 2: expected 5 values as in the first line, got 3"),
        ("frame,x,y,w,h\n1,7,7,9,9,3\n", "line 2: expected 5 values as in the header, got 6"),
    ],
)
def test_short_lists_to_ignore_are_refused(tmp_path: Path, content: str, words: str) -> None:
    """By the columns that the file has: a header that it lacks is not blamed."""
    truth = read_truth(put(tmp_path, rows("1,-1,-1")))
    with pytest.raises(InputError) as error:
        ignoring(truth, put(tmp_path, content, "ignore.csv"))
    assert words in str(error.value)


def test_regions_without_a_frame_hold_in_all(tmp_path: Path) -> None:
    truth = read_truth(put(tmp_path, rows("1,-1,-1")))
    for content in ("x,y,w,h\n7,7,9,9\n", ",7,7,9,9\n", "frame,x,y,w,h\n,7,7,9,9\n"):
        found = ignoring(truth, put(tmp_path, content, "ignore.csv"))
        assert found.regions.tolist() == [[0, 7, 7, 16, 16]]


def test_files_without_detections_are_told(tmp_path: Path) -> None:
    for content, words in (
        ("", "the file is empty"),
        ("frame,left,top,width,height\n", "the file holds no detection"),
        ("1,-1,7,7,0,9,1\n", "none of its 1 boxes has an area"),
    ):
        notices = list[str]()
        path = put(tmp_path, content, "det.txt")
        assert len(read_detections(path, notices=notices)) == 0
        assert notices == [
            f"{path}: {words}: it is read as that of a detector that found nothing, and nothing is"
            " tracked"
        ]
    notices.clear()
    read_detections(put(tmp_path, "1,-1,7,7,9,9,1\n", "det.txt"), notices=notices)
    assert notices == []


def test_columns_of_visdrone(tmp_path: Path) -> None:
    notices = list[str]()
    path = put(tmp_path, rows("1,4,0,1", "0,0,0,0", "0,11,0,0", "1,1,1,2"))
    truth = read_truth(path, notices=notices)
    assert "VisDrone: category 0 is a region" in notices[0]
    assert (identities(truth), truth.distractor.tolist()) == ([1, 3, 4], [False, True, False])
    assert truth.regions.tolist() == [[2, 18, 0, 23, 5]]
    assert list(by_class(path, notices=[])) == ["1", "4", "11"]
    assert read_tracks(path, notices=[]).identity.tolist() == [1, 4]
    assert read_detections(path).detections.class_id.tolist() == [4, 11, 1]
    results = put(tmp_path, "1,-1,0,0,5,5,0.4,4,-1,-1\n1,-1,9,0,5,5,0,9,-1,-1\n")
    assert read_detections(results).detections.class_id.tolist() == [4, 9]


def test_world_coordinates_are_no_visdrone(tmp_path: Path) -> None:
    truth = read_truth(put(tmp_path, rows("1,0,0,0", "1,4,3,0", "0,7.5,1,2")))
    assert (identities(truth), len(truth.regions)) == ([1, 2], 0)


@pytest.mark.parametrize(
    "content",
    [
        rows("1,1,1") + "1,-1,50,50,20,20,0,1,0.5\n",
        rows("1,-1,-1,-1") + "1,-1,50,50,20,20,0,-1,-1,-1\n",
        "frame,id,left,top,width,height,conf\n1,1,9,0,5,5,1\n1,-1,50,50,20,20,0\n",
    ],
)
def test_identity_minus_1_with_flag_0_is_a_region(tmp_path: Path, content: str) -> None:
    notices = list[str]()
    truth = read_truth(put(tmp_path, content), notices=notices)
    assert (identities(truth), truth.regions.tolist()) == ([1], [[1, 50, 50, 70, 70]])
    assert "1 rows with identity −1 and flag 0 are regions" in notices[0]
    path = put(tmp_path, content.replace("20,20,0", "20,20,1"))
    with pytest.raises(InputError, match="identity, got -1"):
        read_truth(path, notices=[])


def test_boxes_as_stated(tmp_path: Path) -> None:
    corners = put(tmp_path, "1,1,10,20,40,60,1\n")
    stated = Conventions(box="ltrb")
    for reader in (read_tracks, read_truth):
        assert reader(corners, conventions=stated).xyxy.tolist() == [[10, 20, 40, 60]]
    named = put(tmp_path, "frame,id,x,y,w,h\n1,1,10,20,40,60\n")
    assert read_tracks(named, conventions=stated).xyxy.tolist() == [[10, 20, 40, 60]]
    sizes = put(tmp_path, "frame,id,x1,y1,x2,y2\n1,1,10,20,40,60\n")
    found = read_tracks(sizes, conventions=Conventions(box="ltwh"))
    assert found.xyxy.tolist() == [[10, 20, 50, 80]]


def test_shares_need_the_size_of_the_frames(tmp_path: Path) -> None:
    path = put(tmp_path, "frame,id,cx,cy,w,h\n1,1,0.5,0.5,0.1,0.2\n")
    stated = Conventions(units="shares")
    with pytest.raises(InputError, match=r"size of the frames.*--frame-size"):
        read_tracks(path, conventions=stated)
    sized = Conventions(units="shares", frame_size=(200, 100))
    assert read_tracks(path, conventions=sized).xyxy.tolist() == [[90, 40, 110, 60]]
    put(tmp_path, "[Sequence]\nframeRate=25\nimWidth=100\nimHeight=100\n", "seqinfo.ini")
    assert read_tracks(path, conventions=stated).xyxy.tolist() == [[45, 40, 55, 60]]


def test_scores_in_percent_are_told(tmp_path: Path) -> None:
    notices = list[str]()
    path = put(tmp_path, rows("87", "95.5", "12"))
    read_detections(path, notices=notices)
    read_tracks(path, notices=notices)
    assert len(notices) == 2
    assert all("scores go up to 95.5 and seem to be percent" in one for one in notices)
    for harmless in (("0.87", "0.5"), ("1", "1"), ("-3", "12"), ("250", "90")):
        notices.clear()
        read_detections(put(tmp_path, rows(*harmless)), notices=notices)
        assert not notices


@pytest.mark.parametrize(("step", "told"), [(40, True), (33.4, True), (1, False), (5, False)])
def test_times_for_frames_are_told(tmp_path: Path, step: float, told: bool) -> None:
    notices = list[str]()
    lines = [f"{1 + round(step * k)},1,0,0,5,5,1\n" for k in range(60)]
    path = put(tmp_path, "".join(lines))
    for reader in (read_detections, read_tracks):
        reader(path, notices=notices)
    assert sum("milliseconds" in one for one in notices) == 2 * told


def test_a_stated_format_must_fit(tmp_path: Path) -> None:
    path = put(tmp_path, "1,1,0,0,5,5,1\n")
    for name, words in (
        ("coco", "JSON"),
        ("cvat", "XML"),
        ("kitti", "17 columns"),
    ):
        with pytest.raises(InputError, match=words):
            read_truth(path, conventions=Conventions(format=name))
    stated = Conventions(format="visdrone")
    refused(lambda one: read_truth(one, conventions=stated), path, ", line 1", "8 columns")
