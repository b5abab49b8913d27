"""`phdtrack tune` chooses settings, says what that is worth elsewhere, and writes them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack, refused, walkers

from phdtrack import config, evaluate
from phdtrack.compare.tuning import CANDIDATES, candidates
from phdtrack.formats import read_tracks, read_truth
from phdtrack.metrics.labelled import in_frames


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    home = tmp_path_factory.mktemp("tuned")
    return [walkers(home / name, 40, clutter=k) for k, name in enumerate(("one", "two", "three"))]


def test_it_chooses_reports_the_risk_and_goes_on(folders: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "tune"
    given = (*folders, "--out", out, "--jobs", 1, "--variant", "blind=extract.min_weight=0.999")
    said = phdtrack("tune", *given, "--json")
    assert said.status == 0, said.err
    found = said.object
    assert found == {**json.loads((out / "tune.json").read_text()), "directory": str(out)}
    assert set(found["scores"]) == {"default", "blind", *(one.name for one in CANDIDATES)}
    assert found["sequences"] == ["one", "two", "three"]
    assert [fold["sequence"] for fold in found["folds"]] == found["sequences"]
    for fold in found["folds"]:
        k = found["sequences"].index(fold["sequence"])
        assert fold["score"] == found["scores"][fold["chosen"]][k]
        others = {
            name: sum(values[:k] + values[k + 1 :]) for name, values in found["scores"].items()
        }
        assert others[fold["chosen"]] == max(others.values())
    text = " ".join(said.err.split())
    assert "On sequences that were left out, the choice has HOTA" in text
    assert "Risk: on" in text
    assert "3 sequences tell little: use 5 or more." in text
    # Everything is kept: the second time nothing is tracked, also for another score.
    times = {path: path.stat().st_mtime_ns for path in out.rglob("seed-1/run.json")}
    assert len(times) == 3 * (2 + len(CANDIDATES))
    assert phdtrack("tune", *given, "--score", "MOTA").status == 0
    assert {path: path.stat().st_mtime_ns for path in times} == times


def test_the_settings_are_read_back(folders: list[Path], tmp_path: Path) -> None:
    """On these sequences one of the candidates is better than the default."""
    out = tmp_path / "tune"
    said = phdtrack("tune", *folders, "--out", out, "--jobs", 1, "--json")
    assert said.status == 0, said.err
    assert said.object["chosen"] == said.object["best"]
    (chosen,) = (one for one in CANDIDATES if one.name == said.object["chosen"])
    settings = config.load(out / "tuned.toml")
    place, _, value = chosen.sets.partition("=")
    section, _, name = place.partition(".")
    found = settings.given[section][name] if name else settings.named
    assert str(found) == value
    assert (out / "tuned.toml").read_text().startswith("# On sequences that were left out")
    boxes = folders[0] / "det" / "det.txt"
    tracked = phdtrack(
        "track", "--detections", boxes, "--config", out / "tuned.toml", "--out", tmp_path / "run"
    )
    assert tracked.status == 0, tracked.err


def test_one_sequence_is_divided_in_time(tmp_path: Path) -> None:
    """It is tracked once for each candidate, and each part has the score of the whole run's tracks
    there.
    """
    folder = walkers(tmp_path / "alone", 60, clutter=2)
    out = tmp_path / "tune"
    files = (folder / "gt" / "gt.txt", folder / "det" / "det.txt")
    said = phdtrack("tune", *files, "--out", out, "--jobs", 1, "--score", "MOTA", "--json")
    assert said.status == 0, said.err
    found = said.object
    assert found["parts_of"] == "alone"
    parts = ["1-12", "13-24", "25-36", "37-48", "49-60"]
    assert found["sequences"] == [f"frames {part}" for part in parts]
    text = " ".join(said.err.split())
    assert (
        "alone is one sequence, so no other can be left out: it was divided in time into 5 parts"
    ) in text
    assert "Parts of one sequence resemble each other: 5 or more sequences tell more." in text
    runs = list(out.rglob("seed-1/run.json"))
    assert len(runs) == 1 + len(CANDIDATES)
    (kept,) = out.rglob("default/seed-1")
    tracks = read_tracks(kept / "tracks.csv")
    truth = read_truth(files[0])
    for k, part in enumerate(parts):
        first, last = map(int, part.split("-"))
        numbers = np.arange(first, last + 1)
        own = evaluate(*in_frames(truth, tracks, numbers), frames=len(numbers))
        assert found["scores"]["default"][k] == pytest.approx(own.MOTA)


def test_other_filters_are_tuned_by_settings_of_theirs(tmp_path: Path) -> None:
    """Folders of truths and of detections are paired by the names of their files."""
    for name in ("a", "b"):
        folder = walkers(tmp_path / name, 20, clutter=1)
        for kind, file in (("truths", "gt/gt.txt"), ("found", "det/det.txt")):
            (tmp_path / kind).mkdir(exist_ok=True)
            (folder / file).rename(tmp_path / kind / f"{name}.txt")
    out = tmp_path / "tune"
    given = ("tune", tmp_path / "truths", tmp_path / "found", "--filter", "gm-phd")
    sentence = refused(*given, "--out", out, "--jobs", 1)
    assert "size and rate of the frames are unknown" in sentence
    assert "Say --frame-size WxH and --fps F" in sentence
    assert not out.exists()
    stated = ("--frame-size", "320x240", "--fps", 25, "--out", out, "--jobs", 1, "--json")
    said = phdtrack(*given, *stated)
    assert said.status == 0, said.err
    assert said.object["sequences"] == ["a", "b"]
    tried = {one.name for one in candidates("gm-phd")}
    assert set(said.object["scores"]) == {"default", *tried}
    assert config.load(out / "tuned.toml").kind("filter") == "gm-phd"


def test_what_cannot_be_tuned_on_is_said(folders: list[Path], tmp_path: Path) -> None:
    short = walkers(tmp_path / "short", 20)
    sentence = refused("tune", short, "--out", tmp_path / "a", "--jobs", 1)
    assert "expected at least 25 annotated frames to divide one sequence into 5 parts" in sentence
    assert "got 20" in sentence
    assert not (tmp_path / "a").exists()
    bare = walkers(tmp_path / "bare", 20)
    (bare / "gt" / "gt.txt").unlink()
    sentence = refused("tune", folders[0], bare, "--out", tmp_path / "b", "--jobs", 1)
    assert "there are no annotated objects" in sentence
    assert "gt/gt.txt in its folder, or --truth" in sentence
    assert not (tmp_path / "b").exists()
    files = (folders[0] / "gt" / "gt.txt", folders[0] / "det" / "det.txt")
    sentence = refused("tune", *files, "--truth", files[0], "--out", tmp_path / "c")
    assert "the files of truth and detections are named already" in sentence
