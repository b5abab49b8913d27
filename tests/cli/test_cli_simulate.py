"""`phdtrack simulate`: files that the other commands read, options that are used, mistakes that are
named.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack, refused

from phdtrack.cli import simulate as demo
from phdtrack.formats import find_seqinfo, read_detections, read_truth
from phdtrack.run import directory as rundir
from phdtrack.video import open_source


def test_the_layout_is_that_of_motchallenge(tmp_path: Path) -> None:
    out = tmp_path / "scene"
    said = phdtrack(
        "simulate", "crossing", "--out", out, "--frames", 30, "--seed", 4, "--no-video", "--json"
    )
    assert said.status == 0
    assert said.object["frames"] == 30
    assert said.object["files"] == [
        str(out / name) for name in ("gt/gt.txt", "det/det.txt", "seqinfo.ini")
    ]
    info = find_seqinfo(out / "det" / "det.txt")
    assert info is not None
    assert (info.name, info.frames, info.width, info.height, info.fps) == (
        "crossing",
        30,
        640,
        360,
        25,
    )
    assert len(read_detections(out / "det" / "det.txt")) == said.object["detections"]
    assert len(np.unique(read_truth(out / "gt" / "gt.txt").identity)) == said.object["objects"]


def test_options_change_the_detector_and_nothing_else(tmp_path: Path) -> None:
    perfect = ["--p-detect", 1, "--clutter", 0, "--places", 0, "--jitter", 0]
    said = phdtrack(
        "simulate",
        "street",
        "--out",
        tmp_path / "s",
        "--frames",
        60,
        "--no-video",
        "--json",
        *perfect,
    )
    truth = read_truth(tmp_path / "s" / "gt" / "gt.txt")
    assert said.object["detections"] == len(truth)
    found = read_detections(tmp_path / "s" / "det" / "det.txt").detections.xyxy
    order = [np.lexsort((boxes[:, 1], boxes[:, 0])) for boxes in (found, truth.xyxy)]
    assert np.allclose(found[order[0]], truth.xyxy[order[1]], atol=0.01)


def test_the_look_of_a_scenes_video_can_be_changed(tmp_path: Path) -> None:
    from phdtrack.video import open_source

    sizes = {}
    for name, options in (
        ("own", ()),
        ("calm", ("--look", "wave=0", "--look", "lamps=0", "--look", "flicker=0")),
    ):
        assert (
            phdtrack(
                "simulate",
                "garden",
                "--out",
                tmp_path / name,
                "--frames",
                12,
                "--seed",
                1,
                *options,
            ).status
            == 0
        )
        frames = [
            frame.image.astype(np.int16) for frame in open_source(tmp_path / name / "scene.mp4")
        ]
        sizes[name] = np.mean(
            [np.abs(b - a).max(axis=2) > 25 for a, b in itertools.pairwise(frames)]
        )
    # A dozen plants that bend in the wind; without, people alone move.
    assert sizes["own"] > 3 * sizes["calm"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["streets"], "Did you mean street"),
        (["street", "--set", "arivals=2"], "Did you mean arrivals?"),
        (["street", "--set", "arrivals"], "NAME=VALUE"),
        (["street", "--set", "arrivals=many"], "expected a number, got 'many'"),
        (["street", "--set", "frames=2.5"], "expected a whole number"),
        (["street", "--set", "speed=-1"], "Scenario.speed: expected a value above 0, got -1"),
        (["street", "--look", "waves=1"], "Did you mean wave?"),
        (["street", "--look", "lamps=2.5"], "expected a whole number"),
        (["street", "--look", "shadow=2"], "Look.shadow: expected a value at most 1"),
        (
            ["street", "--p-detect", "1.5"],
            "DetectorModel.p_detect: expected a value at most 1, got 1.5",
        ),
        (["street", "--clutter", "-1"], "DetectorModel.clutter_rate: expected a value at least 0"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, arguments: list[str], words: str) -> None:
    assert words in refused("simulate", *arguments, "--out", tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_both_runs_and_where_to_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "FRAMES", 60)
    out = tmp_path / "demo"
    # With --json the words of the terminal are on stderr.
    said = phdtrack("demo", "--out", out, "--json")
    assert said.status == 0, said.err
    for folder in (out, out / demo.WITHOUT):
        assert {rundir.TRACKS, rundir.VIDEO, rundir.REPORT, rundir.RUN} <= {
            path.name for path in folder.iterdir()
        }
        assert str(folder) in said.err
    assert len(list(open_source(out / demo.VIDEO))) == 60
    lines = [line.split() for line in said.err.splitlines()]
    assert ["with", "filter", "without"] in lines
    assert next(line for line in lines if line[:1] == ["frames"])[1:3] == ["60", "60"]
    runs = [said.object["with_filter"], said.object["without_filter"]]
    assert [run["configuration"]["filter"]["kind"] for run in runs] == ["pmb", "none"]
    assert runs[0]["detections"] == runs[1]["detections"]
    assert "--overwrite" in refused("demo", "--out", out)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_the_filter_is_better_whatever_the_seed(seed: int, tmp_path: Path) -> None:
    said = phdtrack("demo", "--out", tmp_path / "demo", "--seed", seed, "--json")
    assert "warning" not in said.err
    with_filter = said.object["with_filter"]["scores"]
    without = said.object["without_filter"]["scores"]
    # MODA may fall: it counts no identities, and the filter waits before it reports.
    assert all(with_filter[key] > without[key] for key in ("MOTA", "IDF1"))
