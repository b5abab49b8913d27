"""Settings are chosen on sequences, and judged on the one that was left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phdtrack import config
from phdtrack.compare.tuning import CANDIDATES, Tuning, candidates, inputs, of_scores
from phdtrack.config.registry import SECTIONS
from phdtrack.errors import InputError

SEQUENCES = ("a", "b", "c", "d")


def tuned(**scores: list[float]) -> Tuning:
    """Scores of each candidate on each sequence; the first one is the default."""
    values = {
        (name, sequence): value
        for name, each in scores.items()
        for sequence, value in zip(SEQUENCES, each, strict=True)
    }
    return of_scores("HOTA", SEQUENCES, tuple(scores), values)


def test_what_wins_everywhere_is_chosen_and_keeps_its_gain() -> None:
    found = tuned(default=[0.5, 0.6, 0.7, 0.8], other=[0.55, 0.64, 0.75, 0.86])
    assert (found.best, found.chosen) == ("other", "other")
    assert [fold.chosen for fold in found.folds] == ["other"] * 4
    assert found.gain.mean == pytest.approx(0.05)
    assert found.gain.clear
    assert found.apparent == pytest.approx(0.05)
    assert found.worst.sequence == "b"
    assert found.times("other") == 4
    assert found.mean("default").mean == pytest.approx(0.65)


def test_what_wins_by_one_sequence_alone_is_not_chosen() -> None:
    """It is the best on all, and without that one sequence it is not."""
    found = tuned(default=[0.5, 0.5, 0.5, 0.5], lucky=[0.8, 0.48, 0.48, 0.48])
    assert found.best == "lucky"
    assert found.apparent == pytest.approx(0.06)
    left_out = {fold.sequence: fold for fold in found.folds}
    # Left out, it is not chosen where it would have won, and chosen where it loses.
    assert left_out["a"].chosen == "default"
    assert {left_out[name].chosen for name in "bcd"} == {"lucky"}
    assert found.gain.mean == pytest.approx(-0.015)
    assert found.chosen == "default"
    assert found.worst.gain == pytest.approx(-0.02)


def test_equal_candidates_leave_the_default() -> None:
    found = tuned(default=[0.5] * 4, same=[0.5] * 4)
    assert (found.best, found.chosen) == ("default", "default")
    assert found.gain.mean == found.apparent == 0


def test_choosing_among_noise_gains_nothing_though_it_seems_to() -> None:
    rng = np.random.default_rng(4)
    gains = []
    for _ in range(200):
        noise = rng.normal(0.5, 0.02, (9, 4)).tolist()
        scores = {f"c{k}": row for k, row in enumerate(noise)}
        found = tuned(**scores)
        gains.append((found.gain.mean, found.apparent))
    left_out, apparent = np.mean(gains, axis=0)
    assert apparent > 0.01
    assert abs(left_out) < 0.003


def test_candidates_differ() -> None:
    assert len({one.name for one in CANDIDATES}) == len({one.sets for one in CANDIDATES}) > 5


@pytest.mark.parametrize("name", sorted({*SECTIONS["filter"]} - {"none"}))
def test_every_candidate_changes_the_settings_of_its_filter(name: str) -> None:
    default = config.load(sets=[f"filter.kind={name}"])
    tried = candidates(name)
    assert len(tried) == len({one.name for one in tried}) > 3
    for one in tried:
        preset = one.sets.removeprefix("preset=") if one.sets.startswith("preset=") else ""
        sets = [f"filter.kind={name}", *([] if preset else [one.sets])]
        assert config.load(sets=sets, preset=preset).as_dict() != default.as_dict(), one


def test_candidates_that_lose_on_real_sequences_are_not_tried() -> None:
    """With filters besides the default one."""
    losing = {"agile", "exact-boxes"}
    for name in ("gm-phd", "gm-cphd", "mht", "particle-phd"):
        sets = " ".join(one.sets for one in candidates(name))
        assert not losing & {one.name for one in candidates(name)}
        assert "detection_probability=0.6" not in sets
        assert "clutter_per_detection=0.1" not in sets


def test_no_filter_has_nothing_to_choose() -> None:
    with pytest.raises(InputError, match="the filter none has no settings to choose"):
        candidates("none")


def test_files_come_in_turns_and_folders_are_paired_by_name(tmp_path: Path) -> None:
    for name in ("truths/a.txt", "truths/b.txt", "found/a.csv", "found/b.txt", "one/gt/gt.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    files = [str(tmp_path / name) for name in ("truths/a.txt", "found/a.csv")]
    assert inputs(files) == ([], [(Path(files[0]), Path(files[1]))])
    folders = [str(tmp_path / "truths"), str(tmp_path / "found")]
    found = [(one.name, other.name) for one, other in inputs(folders)[1]]
    assert found == [("a.txt", "a.csv"), ("b.txt", "b.txt")]
    # A folder that is a sequence is not one of truths.
    sequences = [str(tmp_path / "one"), str(tmp_path / "one")]
    assert inputs(sequences) == (sequences, [])


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("t/a.txt",), "expected a file of detections for each file of truth, got 1 in all"),
        (("t/a.txt", "d"), "expected either files or folders, got both"),
        (("t", "d"), r"c\.txt has no partner of the same name"),
        (("t", "none"), "there are no files in it, nor is it a sequence"),
        (("t/a.txt", "d/x.txt"), "no such file or folder"),
    ],
)
def test_inputs_without_partner_are_errors(
    words: tuple[str, ...], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("t/a.txt", "d/a.txt", "d/c.txt", "none/x/y.txt"):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text("")
    with pytest.raises(InputError, match=sentence):
        inputs(words)
