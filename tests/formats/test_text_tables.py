"""Text tables: accepted forms, and the errors for all others."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
from format_cases import put, refused
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.detect.convert import within_frame
from phdtrack.errors import InputError
from phdtrack.formats import read_detections, read_tracks, read_truth
from phdtrack.formats.text import numbers, scan
from phdtrack.types import F8, DetectionTable, SequenceInfo

GOOD = "1,-1,10,20,30,40,0.5,-1,-1,-1\n"


@pytest.mark.parametrize(
    "content",
    [
        GOOD,
        GOOD.replace("\n", "\r\n"),
        GOOD.replace("\n", "\r"),
        "\ufeff" + GOOD,
        "\n# a comment\n\n" + GOOD + "\n\n",
        GOOD.replace(",", ", "),
        GOOD.replace(",", ";"),
        GOOD.replace(",", "\t"),
        "  " + GOOD.replace(",", " "),
        GOOD.replace("\n", ",\n"),
        "1.0,-1,1e1,20.0,3e1,40,.5\n",
        '"1","-1","10","20","30","40","0.5"\n',
        "frame,id,left,top,width,height,conf\n1,-1,10,20,30,40,0.5\n",
        "Frame Number;X1;Y1;X2;Y2;Score\n1;10;20;40;60;0.5\n",
        "conf cx cy w h frame_idx\n0.5 25 40 30 40 1\n",
        "frame,name,x,y,w,h,score\n1,somebody,10,20,30,40,0.5\n",
        'frame,name,x,y,w,h,score\n1,"some,body",10,20,30,40,0.5\n',
        "frame,id,bb_left,bb_top,bb_width,bb_height,conf,x,y,z\n1,-1,10,20,30,40,0.5,7,8,9\n",
        "x_min,y_min,x_max,y_max,class_id,confidence,tracker_id,frame_number\n10,20,40,60,0,0.5,,1\n",
        "frame,left,top,right,bottom,score,note,\n1,10,20,40,60,0.5,,\n",
        "image,score,xmin,ymin,xmax,ymax\na/img_00001.jpg,.5,10,20,40,60\n",
        "x1,y1,x2,y2,conf,filename\n10,20,40,60,.5,f1_jpg.rf.0a1b2c.jpg\n",
        "frame;x;y;w;h;conf\nC:\\clips\\000001.png;10;20;30;40;0.5\n",
        # The width and the height are the image's.
        "filename,width,height,xmin,ymin,xmax,ymax,prob\n1.jpg,640,480,10,20,40,60,0.5\n",
    ],
)
def test_usual_notations_of_a_row_are_read(tmp_path: Path, content: str) -> None:
    table = read_detections(put(tmp_path, content))
    assert table.frame.tolist() == [1]
    np.testing.assert_allclose(table.detections.xyxy, [[10, 20, 40, 60]])
    assert table.detections.confidence.tolist() == [0.5]
    assert table.detections.class_id.tolist() == [0]


def test_names_of_images_number_frames(tmp_path: Path) -> None:
    """The guess is told, and images of several videos are refused."""
    rows = [
        "image,label,score,x1,y1,x2,y2",
        "a/f_0010.jpg,car,.9,1,2,3,4",
        "a/f_9.jpg,dog,.8,5,6,7,8",
    ]
    notices: list[str] = []
    table = read_detections(put(tmp_path, "\n".join(rows)), notices=notices)
    assert table.frame.tolist() == [9, 10]
    assert table.detections.xyxy.tolist() == [[5, 6, 7, 8], [1, 2, 3, 4]]
    assert len(notices) == 1
    assert notices[0].endswith("the column image numbers the frames: a/f_0010.jpg is frame 10")
    with pytest.raises(InputError, match=r"of several videos: a/f_0010.jpg, b/f_9.jpg"):
        read_detections(put(tmp_path, "\n".join(rows).replace("a/f_9", "b/f_9")))
    with pytest.raises(InputError, match=r"line 3: expected a number for the frame .* got 'x.jpg'"):
        read_detections(put(tmp_path, "\n".join(rows).replace("a/f_9", "x")))
    with pytest.raises(InputError, match=r"no column for the frame.* a column called image"):
        read_detections(put(tmp_path, "\n".join(rows).replace("image", "when")))


@pytest.mark.parametrize(
    "content", ["", "\n\n", "# nothing\n", "\ufeff", "frame,id,left,top,width,height\n"]
)
def test_an_empty_file_has_no_rows(tmp_path: Path, content: str) -> None:
    path = put(tmp_path, content)
    assert len(read_detections(path)) == len(read_truth(path)) == len(read_tracks(path)) == 0


@pytest.mark.parametrize(
    ("content", "line", "words"),
    [
        (
            GOOD + "2,-1,abc,20,30,40,0.5,-1,-1,-1\n",
            2,
            "number for the left (column 3), got 'abc'",
        ),
        (
            GOOD + "\n# c\n2,-1,,20,30,40,0.5,-1,-1,-1\n",
            4,
            "number for the left (column 3), got nothing",
        ),
        (GOOD + "2,-1,nan,20,30,40,0.5,-1,-1,-1\n", 2, "finite numbers for the box, got left nan"),
        (GOOD + "2,-1,10,20,1e999,40,0.5,-1,-1,-1\n", 2, "finite numbers for the box"),
        (GOOD + "2,-1,10,20,30,40,nan,-1,-1,-1\n", 2, "finite confidence, got nan"),
        (GOOD + "2,-1,10,20,-3,40,0.5,-1,-1,-1\n", 2, "above 0, got width -3, height 40"),
        (
            GOOD + "nan,-1,10,20,30,40,0.5,-1,-1,-1\n",
            2,
            "whole number for the frame number, got nan",
        ),
        (
            GOOD + "1e30,-1,10,20,30,40,0.5,-1,-1,-1\n",
            2,
            "whole number for the frame number, got 1e+30",
        ),
        (GOOD + "0,-1,10,20,30,40,0.5,-1,-1,-1\n", 2, "expected frame 1 or later, got 0"),
        (
            GOOD + "2,-1,10,20,30,40,0.5,-1,-1,-1,7\n",
            2,
            "expected 10 values as in the first line, got 11",
        ),
        ("1,-1,1,2,3\n", 1, "at least 6 columns (frame, id, left, top, width, height), got 5"),
        ("1 -1 1_0 2 3 4\n", 1, "got '1_0'"),
        (
            "frame,left,top,width,height\n1,2,3,4,5,6\n",
            2,
            "expected 5 values as in the header, got 6",
        ),
        (
            "frame,left,top,width,height,class\n1,2,3,4,5,1\n2,2,3,4,5,\n",
            3,
            "number for the class (column 6), got nothing",
        ),
        ("frame,left,top,width,height,class\n1,2,3,4,5,1.5\n", 2, "whole number for the class"),
        (
            'frame,left,top,width,height,class\n1,2,3,4,5,car\n"\n',
            3,
            "expected 6 values as in the header, got 0",
        ),
    ],
)
def test_the_message_names_file_and_line(
    tmp_path: Path, content: str, line: int, words: str
) -> None:
    refused(read_detections, put(tmp_path, content), f", line {line}", words)


def test_first_bad_line_is_named_and_others_counted(tmp_path: Path) -> None:
    path = put(tmp_path, GOOD + "0,-1,1,2,3,4,1,-1,-1,-1\n" * 3 + "1,-1,1,2,0,4,1,-1,-1,-1\n")
    with pytest.raises(InputError, match=r"line 2: .*got 0 \(2 more like it\)"):
        read_detections(path)


def test_missing_column_is_reported_with_accepted_names(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"det.txt: no column for the frame; the columns are time, left.*frame_idx"
    ):
        read_detections(put(tmp_path, "time,left,top,width,height\n1,2,3,4,5\n"))
    with pytest.raises(InputError, match="no column for the box"):
        read_detections(put(tmp_path, "frame,id,left,top,width\n1,1,2,3,4\n"))
    for reader in (read_truth, read_tracks):
        with pytest.raises(InputError, match="no column for the identity"):
            reader(put(tmp_path, "frame,left,top,width,height\n1,2,3,4,5\n"))
        with pytest.raises(
            InputError, match=r"det.txt, line 1: .*identity, got -1.*file of detections"
        ):
            reader(put(tmp_path, GOOD))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"1,-1,10\0", "line 1: .*not UTF-8 text"),
        (b"\xff\xd8\xff\xe0", "line 1: .*not UTF-8 text"),
        (GOOD.encode() + b"\xe9", "line 2: .*not UTF-8 text"),
        (GOOD.encode("utf-16"), "got UTF-16. Save it as UTF-8"),
    ],
)
def test_bytes_that_are_not_text_are_refused(tmp_path: Path, content: bytes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_detections(put(tmp_path, content))


def test_missing_file_or_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such file") as caught:
        read_detections(tmp_path / "nowhere" / "det.txt")
    assert str(tmp_path) in caught.value.cure
    (tmp_path / "det").mkdir()
    path = put(tmp_path / "det", GOOD)
    with pytest.raises(InputError, match="expected a file, got a folder") as caught:
        read_detections(tmp_path)
    assert str(path) in caught.value.cure


def test_rows_are_sorted_stably_by_frame(tmp_path: Path) -> None:
    frames = [3, 1, 3, 2, 1]
    lefts = [1, 2, 3, 4, 5]
    lines = "".join(f"{f},-1,{x},0,1,1\n" for f, x in zip(frames, lefts, strict=True))
    table = read_detections(put(tmp_path, lines))
    assert table.frame.tolist() == [1, 1, 2, 3, 3]
    assert table.detections.xyxy[:, 0].tolist() == [2, 5, 4, 1, 3]
    assert table.detections.confidence.tolist() == [1] * 5


def test_files_that_count_from_zero(tmp_path: Path) -> None:
    path = put(tmp_path, "0,5,0,0,1,1\n1,5,0,0,1,1\n")
    with pytest.raises(InputError, match="first_frame=0"):
        read_tracks(path)
    for reader in (read_tracks, read_truth, read_detections):
        assert reader(path, first_frame=0).frame.tolist() == [1, 2]


@given(
    st.lists(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3), min_size=1),
    st.sampled_from([",", ";", "\t", " "]),
)
def test_both_number_parsers_agree(rows: list[tuple[float, float, float]], delimiter: str) -> None:
    """The fast way and, forced by one pair of quotes, the careful one."""
    plain = [[repr(value) for value in row] for row in rows]
    quoted = [[f'"{plain[0][0]}"', *plain[0][1:]], *plain[1:]]
    got = []
    for cells in (plain, quoted):
        text = scan(Path("t"), "\n".join(delimiter.join(row) for row in cells).encode())
        got.append(numbers(text, {2: "a", 0: "b"}))
    np.testing.assert_array_equal(got[0], np.array(rows)[:, [2, 0]])
    np.testing.assert_array_equal(got[1], got[0])


@given(
    st.binary(max_size=200)
    | st.text(alphabet="0123456789.,;-\n\t \"'#eEinfa<[{", max_size=120).map(str.encode)
)
@settings(max_examples=200)
def test_any_content_gives_rows_or_an_input_error(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path = put(tmp_path_factory.getbasetemp(), content, "anything")
    for reader in (read_detections, read_truth, read_tracks):
        with contextlib.suppress(InputError):
            reader(path)


def test_empty_boxes_are_skipped_and_counted(tmp_path: Path) -> None:
    """Only in detections: in truth and tracks they are errors."""
    path = put(tmp_path, GOOD + "2,-1,10,20,0,40,0.5,-1,-1,-1\n" + "1,-1,10,20,4,0,0.5,-1,-1,-1\n")
    table = read_detections(path)
    plain = read_detections(put(tmp_path, GOOD, "good.txt"))
    assert (table.empty, plain.empty) == (2, 0)
    assert table.frame.tolist() == plain.frame.tolist()
    np.testing.assert_array_equal(table.detections.xyxy, plain.detections.xyxy)
    (said,) = within_frame(table, SequenceInfo(10_000, 10_000, 25.0), path)[1]
    assert said == f"{path}: 2 of the boxes have width or height 0 and are left out"


def test_missing_identity_column_is_reported(tmp_path: Path) -> None:
    """The columns after it would be taken for each other."""
    path = put(tmp_path, "1,281.9,187,80.2,207,0.998,-1\n")
    with pytest.raises(InputError, match=r"column 2 is the identity.*281\.9"):
        read_detections(path)


def test_tracks_read_as_detections_keep_their_class(tmp_path: Path) -> None:
    """Their eleventh column says which detection a row used."""
    path = put(
        tmp_path, "1,3,10,20,30,40,0.9,-1,-1,-1,5,1,2\n2,3,11,20,30,40,0.9,-1,-1,-1,-1,1,2\n"
    )
    assert read_detections(path).detections.class_id.tolist() == [2, 2]
    path = put(tmp_path, "1,-1,10,20,30,40,0.9,-1,-1,-1,5\n")
    assert read_detections(path).detections.class_id.tolist() == [5]


def test_corners_that_stay_in_the_frame_as_sizes_are_refused(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """Their widths are the larger the further right they are; those of large objects are not."""
    info = SequenceInfo(1280, 720, 25.0)
    left = rng.uniform(20, 500, 60)
    top = rng.uniform(20, 250, 60)

    def read(width: F8, height: F8) -> DetectionTable:
        columns = [np.arange(1, 61), np.full(60, -1), left, top, width, height, np.ones(60)]
        rows = [",".join(f"{value:.2f}" for value in row) for row in zip(*columns, strict=True)]
        return read_detections(put(tmp_path, "\n".join(rows)))

    corners = read(left + rng.uniform(30, 70, 60), top + rng.uniform(60, 140, 60))
    with pytest.raises(InputError, match=r"the wider it is.*--box ltrb.*say --box ltwh"):
        within_frame(corners, info, tmp_path)
    assert len(within_frame(corners, info, tmp_path, box="ltwh")[0]) == 60
    large = read(rng.uniform(510, 700, 60), rng.uniform(260, 400, 60))
    assert len(within_frame(large, info, tmp_path)[0]) == 60


@pytest.mark.parametrize(
    ("scale", "corners", "words"),
    [(1 / 640, False, "not in shares of its size"), (1, True, "corners were read as sizes")],
)
def test_boxes_in_other_units_are_reported(
    tmp_path: Path, rng: np.random.Generator, scale: float, corners: bool, words: str
) -> None:
    left = rng.uniform(150, 560, 60)
    top = rng.uniform(150, 340, 60)
    width, height = rng.uniform(30, 70, (2, 60))
    last = np.stack([left + width, top + height] if corners else [width, height])
    rows = np.stack(
        [np.arange(1, 61), np.full(60, -1.0), *(scale * np.stack([left, top, *last])), np.ones(60)],
        axis=1,
    )
    path = put(tmp_path, "".join(",".join(f"{value:.4f}" for value in row) + "\n" for row in rows))
    with pytest.raises(InputError, match=words):
        within_frame(read_detections(path), SequenceInfo(640, 480, 25.0), path)
    scored = put(tmp_path, "".join(f"{k},{10 + k},20,30,40,{k / 90:.3f}\n" for k in range(1, 61)))
    with pytest.raises(InputError, match="a score was read as the height"):
        within_frame(read_detections(scored), SequenceInfo(640, 480, 25.0), scored)
