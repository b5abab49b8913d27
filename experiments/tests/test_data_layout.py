"""Downloads become the files that the experiments expect, or it is said why not."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments import data as listed_data
from experiments.__main__ import main
from experiments.data_layout import (
    INFOS,
    POINTRCNN_COLUMNS,
    RECIPES,
    RRC_COLUMNS,
    bring,
    camera_motion,
    detections,
    everybody,
    kitti_truth,
    later_half,
)
from phdtrack.errors import InputError
from phdtrack.formats import read_seqinfo

FOLDER = "more/MOT17-09"
# Frame 264 is the first of the later half.
MOT17 = (
    "263,1,5,5,9,9,1,1,1\n"
    "265,2,10,20,30,40,1,1,0.5\n"
    "264,2,11,21,31,41,1,1,0.5\n"
    "264,1,1,2,3,4,1,1,1\n"
    "264,7,1,2,3,4,0,8,1\n"
    "264,8,1,2,3,4,0,9,1\n"
)
KITTI = (
    "0 -1 DontCare -1 -1 -10 1.00 2.00 4.50 8.25 0 0 0 0 0 0 0\n"
    "0 0 Car 0 2 -1.5 10.00 20.00 40.10 60.00 1 2 3 4 5 6 7\n"
    "0 1 Car 1 0 -1.5 11.00 20.00 40.00 60.00 1 2 3 4 5 6 7\n"
    "0 2 Van 0 0 -1.5 12.00 20.00 40.00 60.00 1 2 3 4 5 6 7\n"
    "1 3 Cyclist 0 0 -1.5 13.00 20.00 40.00 60.00 1 2 3 4 5 6 7\n"
)


def put(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def downloads(tmp_path: Path) -> Path:
    put(tmp_path / "downloads", "MOT17/train/MOT17-09-DPM/gt/gt.txt", MOT17)
    put(tmp_path / "downloads", "plan.xml", "<plan/>")
    return tmp_path / "downloads"


def expected(tmp_path: Path, files: dict[str, str]) -> dict[str, str]:
    """The list of checksums of these files."""
    made = {name: put(tmp_path / "as listed", name, text) for name, text in files.items()}
    return {name: listed_data.checksum(path) for name, path in made.items()}


def test_the_later_half_of_mot17_begins_with_frame_one() -> None:
    made = later_half(MOT17, 263)
    assert made["gt/gt.txt"].splitlines() == [
        "1,1,1,2,3,4,1,-1,-1,-1",
        "1,2,11,21,31,41,1,-1,-1,-1",
        "2,2,10,20,30,40,1,-1,-1,-1",
    ]
    assert made["gt/ignore.txt"] == "1,7,1,2,3,4,0,-1,-1,-1\n"
    with pytest.raises(InputError, match="expected frames after 300, got none"):
        later_half(MOT17, 300)


def test_identities_of_dancers_count_from_one() -> None:
    made = everybody("2, 0, 7, 8, 9, 10, 1, 1, 1\n1,1,3,4,5,6,1,1,1\n")
    assert made["gt/gt.txt"] == "1,2,3,4,5,6,1,-1,-1,-1\n2,1,7,8,9,10,1,-1,-1,-1\n"
    assert made["gt/ignore.txt"] == ""


def test_cars_of_kitti_count_and_what_resembles_them_does_not() -> None:
    made = kitti_truth(KITTI, ("Car", "Van"))
    assert made["gt/gt.txt"] == "1,1,10,20,30.1,40,1,-1,-1,-1\n"
    assert made["gt/ignore.txt"].splitlines() == [
        "1,-1,1,2,3.5,6.25,0,-1,-1,-1",
        "1,2,11,20,29,40,0,-1,-1,-1",
        "1,3,12,20,28,40,0,-1,-1,-1",
    ]


def test_detections_have_the_highest_score_first() -> None:
    rrc = "0,1,2,4.5,8,0.25\n0,10,20,40,60,0.92345\n"
    assert detections(rrc, "rrc", RRC_COLUMNS)["det_rrc/det.txt"].splitlines() == [
        "1,-1,10,20,30,40,0.9234,-1,-1,-1",
        "1,-1,1,2,3.5,6,0.25,-1,-1,-1",
    ]
    pointrcnn = "3,2,10,20,40,60,8.29811,1,2,3\n4,2,10,20,40,60,-0.5,1,2,3\n"
    made = detections(pointrcnn, "x", POINTRCNN_COLUMNS, before=3, least=0.0)
    assert made == {"det_x/det.txt": "1,-1,10,20,30,40,8.298,-1,-1,-1\n"}


def test_camera_motion_is_cut_and_numbered_like_the_frames() -> None:
    made = camera_motion("0\t1.0\t0.0\t0.5\t0.0\t1.0\t0.25\t\n1 1.00024711 0 -1 0 1 2\n", 1)
    assert made == {"gmc.txt": "1,1.00025,0,-1,0,1,2\n"}


def test_files_are_made_copied_and_described(tmp_path: Path, downloads: Path) -> None:
    files = {
        "pets2009/View_001.xml": "<plan/>",
        **{f"{FOLDER}/{name}": text for name, text in later_half(MOT17, 263).items()},
        f"{FOLDER}/seqinfo.ini": INFOS[FOLDER],
        f"{FOLDER}/det_yolox/det.txt": "never downloaded",
    }
    sums = expected(tmp_path, files)
    place = tmp_path / "data"
    done = bring(downloads, place, sums, listed_data.checksum)
    assert set(done.source) == set(files) - {f"{FOLDER}/det_yolox/det.txt"}
    for name in done.source:
        assert (place / name).read_text(encoding="utf-8") == files[name]
    assert read_seqinfo(place / FOLDER).frames == 262
    # A second time there is nothing to do.
    assert bring(downloads, place, sums, listed_data.checksum).source == {}


def test_files_that_are_there_stay_as_they_are(tmp_path: Path, downloads: Path) -> None:
    place = tmp_path / "data"
    own = put(place, f"{FOLDER}/gt/gt.txt", "my own")
    sums = expected(tmp_path, {f"{FOLDER}/gt/gt.txt": later_half(MOT17, 263)["gt/gt.txt"]})
    done = bring(downloads, place, sums, listed_data.checksum)
    assert own.read_text(encoding="utf-8") == "my own"
    assert f"{FOLDER}/gt/gt.txt" not in done.source


def test_of_several_versions_the_one_of_the_list_counts(tmp_path: Path, downloads: Path) -> None:
    put(downloads, "other/MOT17-09-FRCNN/gt/gt.txt", MOT17.replace("0.5", "0.25"))
    put(downloads, "MOT17/train/MOT17-09-DPM/gt/gt.txt", MOT17.replace("10,20", "10,21"))
    sums = expected(tmp_path, {f"{FOLDER}/gt/gt.txt": later_half(MOT17, 263)["gt/gt.txt"]})
    done = bring(downloads, tmp_path / "data", sums, listed_data.checksum)
    assert "MOT17-09-FRCNN" in done.source[f"{FOLDER}/gt/gt.txt"]


def test_files_that_cannot_be_used_are_named(tmp_path: Path, downloads: Path) -> None:
    put(downloads, "kitti/training/label_02/0000.txt", "frame,identity\n")
    put(downloads, "MOT17/train/MOT17-09-DPM/gt/gt.txt", "1,1,5,5,9,9,1,1,1\n")
    sums = expected(tmp_path, {"more/KITTI-0000-car/gt/gt.txt": "x"})
    done = bring(downloads, tmp_path / "data", sums, listed_data.checksum)
    assert done.source == {}
    assert done.problems["more/KITTI-0000-car"][0].endswith("the columns are not as published")
    assert done.problems[FOLDER][0].endswith("expected frames after 263, got none")


def test_every_recipe_is_of_a_sequence_of_the_list() -> None:
    folders = {name.rsplit("/", 2)[0] for name in listed_data.listed()}
    assert {recipe.folder for recipe in RECIPES} <= folders
    assert {f"{folder}/seqinfo.ini" for folder in INFOS} <= set(listed_data.listed())


def test_data_is_a_command_of_the_experiments(
    tmp_path: Path,
    downloads: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("PHDTRACK_DATA", str(tmp_path / "data"))
    assert main(["data", "--from", str(downloads)]) == 0
    said = capsys.readouterr().out
    assert "more/MOT17-09: 3 of 6 files, 3 of them new" in said
    assert "  gt/gt.txt of " in said
    assert "not the file that the pages were made with" in said
    assert "  missing: det_yolov10/det.txt" in said
    assert "mot15/KITTI-17: 0 of 4 files, 0 of them new" in said
    assert main(["data"]) == 1
    assert "from https://motchallenge.net/data/MOT17/" in capsys.readouterr().out


def test_downloads_that_are_no_folder_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "data").mkdir()
    monkeypatch.setenv("PHDTRACK_DATA", str(tmp_path / "data"))
    assert main(["data", "--from", str(tmp_path / "none")]) == 2
    assert "expected a folder of unpacked downloads" in capsys.readouterr().err
    assert main(["data", "--from", str(tmp_path / "data")]) == 2
    assert "another folder than that of the data" in capsys.readouterr().err


@pytest.mark.data
def test_the_sizes_and_lengths_are_those_of_the_sequences(data: Path) -> None:
    for folder, text in INFOS.items():
        assert (data / folder / "seqinfo.ini").read_text(encoding="utf-8") == text
