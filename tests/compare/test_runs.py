"""A comparison in a folder: what is kept is taken up, what has changed runs again, and no number of
jobs matters.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compare_cases import FRAMES, planned, sequence, small

import phdtrack
from phdtrack.compare import run, runs, steps
from phdtrack.compare.plans import Run
from phdtrack.compare.runs import ComparedRun, read_about, run_input
from phdtrack.formats import read_detections, read_tracks, read_truth
from phdtrack.metrics import evaluate
from phdtrack.parallel import Failed
from phdtrack.run.environment import sources_digest


def deciding(folder: Path) -> dict[str, object]:
    return {
        str(path.parent.relative_to(folder)): read_about(path.parent)["decided_by"]
        for path in folder.rglob("run.json")
    }


def tracks(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("tracks.csv")}


def plain(outcomes: Mapping[Path, ComparedRun | Failed]) -> dict[Path, object]:
    """Everything but the times."""
    return {
        place: (one.detections, one.rows, one.drawn, scores(one))
        for place, one in outcomes.items()
        if isinstance(one, ComparedRun)
    }


def scores(one: ComparedRun | Failed) -> dict[str, float | int | None]:
    assert isinstance(one, ComparedRun)
    assert one.scores is not None
    return one.scores.as_dict()


def test_outcomes_are_those_of_the_tracks_that_are_kept(tmp_path: Path) -> None:
    made = small(tmp_path, clutter=[3.0])
    found = run(made, tmp_path / "out")
    assert len(found.results) == len(made.runs) == 8
    assert (found.reused, found.failed) == (0, [])
    for one, outcome in found.runs:
        truth = read_truth(tmp_path / one.case.sequence / "gt" / "gt.txt")
        written = read_tracks(tmp_path / "out" / one.place / "tracks.csv")
        again = evaluate(truth, written, frames=FRAMES).as_dict()
        # Boxes are written with seven digits.
        assert {
            name: -1 if value is None else value for name, value in scores(outcome).items()
        } == pytest.approx(
            {name: -1 if value is None else value for name, value in again.items()}, rel=1e-5
        )
        assert isinstance(outcome, ComparedRun)
        assert (outcome.frames, outcome.rows) == (FRAMES, len(written))


def test_the_same_plan_again_runs_nothing_and_gives_the_same(tmp_path: Path) -> None:
    made = small(tmp_path, clutter=[0.0, 3.0])
    first = run(made, tmp_path / "out")
    before = {
        path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*") if path.is_file()
    }
    told: list[int] = []
    second = run(small(tmp_path, clutter=[0.0, 3.0]), tmp_path / "out", advance=told.append)
    assert (first.reused, second.reused) == (0, len(second.results))
    assert plain(first.results) == plain(second.results)
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert told[-1] == steps(made) == len(made.runs)
    assert told == sorted(told)
    assert run(made, tmp_path / "out", anew=True).reused == 0


@pytest.mark.slow
def test_any_number_of_jobs_gives_the_same(tmp_path: Path) -> None:
    made = small(
        tmp_path,
        filters=["particle-phd", "none"],
        clutter=[0.0, 3.0],
        sets=["filter.particles_per_target=60"],
    )
    one = run(made, tmp_path / "one")
    two = run(made, tmp_path / "two", 2)
    assert tracks(tmp_path / "one") == tracks(tmp_path / "two")
    assert deciding(tmp_path / "one") == deciding(tmp_path / "two")
    assert plain(one.results) == plain(two.results)
    assert list(one.results) != []


def test_where_nothing_is_random_one_run_stands_for_all_seeds(tmp_path: Path) -> None:
    made = small(
        tmp_path,
        filters=["particle-phd", "gm-phd", "none"],
        seeds=3,
        sets=["filter.particles_per_target=60"],
    )
    found = run(made, tmp_path / "out")
    drawn = {
        (one.method.name, one.seed): outcome.drawn
        for one, outcome in found.runs
        if isinstance(outcome, ComparedRun)
    }
    assert drawn == {
        **{("particle-phd", seed): True for seed in (1, 2, 3)},
        ("gm-phd", 1): False,
        ("none", 1): False,
    }
    last = made.runs[5]
    assert (last.method.name, last.seed) == ("gm-phd", 3)
    assert found.result(last) is found.results[replace(last, seed=1).place]


@pytest.mark.parametrize(
    "change", ["setting", "unrelated", "detections", "truth", "seqinfo", "iou"]
)
def test_only_what_a_change_decides_runs_again(tmp_path: Path, change: str) -> None:
    made = small(tmp_path)
    run(made, tmp_path / "out")
    before = deciding(tmp_path / "out")
    more: dict[str, object] = {}
    if change in ("detections", "truth"):
        file = tmp_path / "a" / ("det/det.txt" if change == "detections" else "gt/gt.txt")
        file.write_text(file.read_text().replace(",24,60,", ",24,61,", 1))
    elif change == "seqinfo":
        file = tmp_path / "a" / "seqinfo.ini"
        file.write_text(file.read_text().replace("=25", "=30"))
    else:
        sets = {"setting": "filter.max_components=9", "unrelated": "groups.prior_odds=2"}
        more = {"sets": [sets[change]]} if change in sets else {"iou": 0.4}
    found = run(small(tmp_path, **more), tmp_path / "out")
    after = deciding(tmp_path / "out")
    changed = {place for place, values in after.items() if before[place] != values}
    expected = {
        "setting": {place for place in before if "gm-phd" in place},
        "unrelated": set(),
        "iou": set(before),
    }.get(change, {place for place in before if place.startswith("runs/a/")})
    assert changed == expected
    assert found.outdated == (
        [{"setting": "settings", "seqinfo": "sequence"}.get(change, change)] if expected else []
    )
    assert found.reused == len(before) - len(expected)


@pytest.mark.parametrize(
    ("part", "decides"), [("filters/none.py", True), ("report/pages.py", False)]
)
def test_a_change_of_what_makes_results_is_another_digest(
    tmp_path: Path, part: str, decides: bool
) -> None:
    home = tmp_path / "phdtrack"
    shutil.copytree(
        Path(phdtrack.__file__).parent, home, ignore=shutil.ignore_patterns("__pycache__")
    )
    before = sources_digest(home)
    sources_digest.cache_clear()
    with (tmp_path / "phdtrack" / part).open("a") as file:
        file.write("\n")
    assert (sources_digest(home) != before) == decides
    sources_digest.cache_clear()


def test_a_damaged_folder_is_run_again(tmp_path: Path) -> None:
    made = small(tmp_path)
    first = run(made, tmp_path / "out")
    place = tmp_path / "out" / made.runs[0].place
    (place / "run.json").write_text((place / "run.json").read_text()[:200])
    second = run(made, tmp_path / "out")
    assert second.reused == len(first.results) - 1
    assert plain(second.results) == plain(first.results)


def test_clutter_depends_on_the_seed_and_not_on_the_method(tmp_path: Path) -> None:
    made = small(tmp_path, clutter=[3.0])
    given = {
        (one.case.name, one.method.name, one.seed): run_input(one, tmp_path).table
        for one in made.runs
    }
    for case in ("a det", "b det"):
        for seed in (1, 2):
            boxes = [given[case, method, seed].detections.xyxy for method in ("gm-phd", "none")]
            np.testing.assert_array_equal(*boxes)
    seeds = [given["a det", "none", seed].detections.xyxy for seed in (1, 2)]
    assert not np.array_equal(*seeds)
    own = read_detections(tmp_path / "a" / "det" / "det.txt")
    added = len(given["a det", "none", 1]) - len(own)
    # Four deviations of a Poisson number.
    assert abs(added - 3 * FRAMES) < 4 * (3 * FRAMES) ** 0.5


def test_without_truth_there_are_no_scores(tmp_path: Path) -> None:
    folder = sequence(tmp_path / "a", truth=False)
    found = run(planned([folder], filters=["none"], seeds=1), tmp_path / "out")
    (outcome,) = found.results.values()
    assert isinstance(outcome, ComparedRun)
    assert outcome.scores is None
    assert outcome.tracks > 0
    assert run(found.plan, tmp_path / "out").reused == 1


@pytest.mark.parametrize("error", [RuntimeError("out of luck"), KeyboardInterrupt()])
def test_a_run_that_fails_or_is_stopped_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    """The runs before are kept, and those behind a failed one."""
    made = small(tmp_path, seeds=1)
    tracked = runs.tracked

    def broken(one: Run, given: runs.RunInput) -> object:
        if one.method.name == "none" and one.case is made.cases[0]:
            raise error
        return tracked(one, given)

    with monkeypatch.context() as patched:
        patched.setattr(runs, "tracked", broken)
        if isinstance(error, KeyboardInterrupt):
            with pytest.raises(KeyboardInterrupt):
                run(made, tmp_path / "out")
        else:
            failed = run(made, tmp_path / "out").failed
            assert [(str(one), reason) for one, reason in failed] == [
                ("none on a det, seed 1", "RuntimeError: out of luck")
            ]
    kept = 1 if isinstance(error, KeyboardInterrupt) else 3
    assert len(tracks(tmp_path / "out")) == kept
    assert list((tmp_path / "out").rglob(".*")) == []
    again = run(made, tmp_path / "out")
    assert (again.reused, again.failed) == (kept, [])
