"""`phdtrack tune` chooses settings, says what that is worth elsewhere, and writes them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli_runner import phdtrack, refused, walkers

from phdtrack import config
from phdtrack.compare.tuning import CANDIDATES


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


def test_what_cannot_be_tuned_on_is_said(folders: list[Path], tmp_path: Path) -> None:
    sentence = refused("tune", folders[0], "--out", tmp_path / "a")
    assert "one sequence is not enough to choose settings" in sentence
    assert "Name two or more" in sentence
    assert not (tmp_path / "a").exists()
    bare = walkers(tmp_path / "bare", 20)
    (bare / "gt" / "gt.txt").unlink()
    sentence = refused("tune", folders[0], bare, "--out", tmp_path / "b", "--jobs", 1)
    assert "there are no annotated objects" in sentence
    assert "gt/gt.txt in its folder, or --truth" in sentence
    assert not (tmp_path / "b").exists()
