"""Settings are chosen on sequences, and judged on the one that was left out."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.compare.tuning import CANDIDATES, Tuning, check_sequences, of_scores
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


def test_one_sequence_is_refused() -> None:
    with pytest.raises(InputError, match="one sequence is not enough to choose settings"):
        check_sequences(["a", "a"])
    check_sequences(["a", "b"])
