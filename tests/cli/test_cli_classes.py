"""Classes on the command line: which are tracked, where they are named, and scores of each."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from cli_runner import phdtrack, refused

from phdtrack.formats import read_tracks_named

# Tests look at pages.
pytestmark = pytest.mark.usefixtures("paged")

SIZE = ("--frame-size", "320x240", "--fps", 25)


@pytest.fixture
def crossing(tmp_path: Path) -> Path:
    """A car and a person who cross, as detections and truth in one file."""
    rows = [
        f"{k},1,car,{20 + 6 * k},100,40,40,0.9\n{k},2,person,{260 - 6 * k},100,40,40,0.8"
        for k in range(1, 41)
    ]
    path = tmp_path / "both.csv"
    path.write_text("\n".join(["frame,identity,class,left,top,width,height,confidence", *rows]))
    return path


def test_a_run_tracks_the_classes_of_the_option(crossing: Path, tmp_path: Path) -> None:
    run = ("track", "--detections", crossing, *SIZE, "--out")
    out = tmp_path / "run"
    assert "2 objects (car 1, person 1) in 40 frames" in phdtrack(*run, out).out
    for name in ("tracks.csv", "tracks_online.csv"):
        rows, names = read_tracks_named(out / name)
        pairs = zip(rows.identity.tolist(), rows.class_id.tolist(), strict=True)
        assert {(identity, names[label]) for identity, label in pairs} == {
            (1, "car"), (2, "person")
        }  # fmt: skip
    assert {line.split(",")[10] for line in (out / "detections.csv").read_text().splitlines()} == {
        "car",
        "person",
    }
    assert "car 1, person 1" in (out / "report.html").read_text()
    said = phdtrack(*run, tmp_path / "person", "--classes", "Person")
    assert "1 object (person 1)" in said.out
    assert re.search(r"^40 boxes left out: class not chosen.*, as asked\.$", said.out, re.MULTILINE)
    # Nobody is warned of what was asked for.
    assert "left out" not in said.err
    sentence = refused(*run, tmp_path / "none", "--classes", "truck")
    assert "there is no class truck in these detections. There are car, person." in sentence


def test_settings_of_one_class_are_printed_and_read_back(crossing: Path, tmp_path: Path) -> None:
    run = ("track", "--detections", crossing, *SIZE, "--out")
    file = tmp_path / "mine.toml"
    printed = tmp_path / "all.toml"
    assert (
        "1 object (person 1)"
        in phdtrack(*run, tmp_path / "a", "--set", "classes.car.min_score=0.95").out
    )
    file.write_text(
        '[classes]\nonly = ["car"]\n[classes.car]\nmin_size = 41\n[classes.truck.sensor]\nbox_noise'
        " = 0.1\n"
    )
    printed.write_text(phdtrack("settings", "--config", file, "--all").out)
    for one in (file, printed):
        assert "0 objects in 40 frames" in phdtrack(*run, tmp_path / one.stem, "--config", one).out


def test_scores_of_each_class(crossing: Path, tmp_path: Path) -> None:
    swapped = tmp_path / "swapped.csv"
    kitti = tmp_path / "0001.txt"
    swapped.write_text(
        crossing.read_text()
        .replace("car", "PERSON")
        .replace("person", "car")
        .replace("PERSON", "person")
    )
    row = "{0} {1} {2} 0 0 -10 {3} 100 {3}9 150 -1 -1 -1 -1000 -1000 -1000 -10\n"
    kitti.write_text(
        "".join(
            row.format(k, *one)
            for k in range(10)
            for one in ((1, "Car", 10), (2, "Pedestrian", 20))
        )
    )
    for truth, tracks, scores in (
        (crossing, crossing, {"car": 1, "person": 1}), (kitti, kitti, {"Car": 1, "Pedestrian": 1})
    ):  # fmt: skip
        found = phdtrack(
            "evaluate", "--truth", truth, "--tracks", tracks, "--per-class", "--json"
        ).object["classes"]
        assert {name: one["MOTA"] for name, one in found.items()} == scores
    ask = ("evaluate", "--truth", crossing, "--tracks", swapped, "--json")
    assert all(one["MOTA"] < 0 for one in phdtrack(*ask, "--per-class").object["classes"].values())
    # Without asking, classes are not looked at.
    assert phdtrack(*ask).object["MOTA"] == 1
    assert "does not go with" in refused(*ask, "--per-class", "--kitti", "Car")
