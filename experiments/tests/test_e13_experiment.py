"""The simulated detections of the E13 experiment: coverage, detection rate, position of clutter."""

from __future__ import annotations

import numpy as np
import pytest

from experiments import e13
from experiments.claims import MENDED, OURS, WORDS
from experiments.e13 import CrowdCounts


def test_the_nearer_box_covers_and_the_farther_does_not():
    boxes = np.array([[0.0, 0, 10, 20], [5, 5, 15, 30], [100, 0, 110, 20]])
    np.testing.assert_allclose(e13.covered(boxes), [5 * 15 / 200, 0, 0])
    assert len(e13.covered(np.zeros((0, 4)))) == 0


@pytest.fixture
def sequence(data, monkeypatch):
    """The real sequence of the fixture ``data``."""
    monkeypatch.setattr(e13, "need_data", lambda: data)
    e13.truth.cache_clear()
    return e13.truth()


def test_seven_of_ten_are_detected_as_e13_says(sequence):
    """The mean of the drop model over the sequence, and the number of detections drawn by it."""
    assert e13.recall() == pytest.approx(0.69, abs=0.01)
    expected = e13.recall() * len(sequence)
    rng = np.random.default_rng(2)
    found = sum(len(e13.detected(number, 1.0, rng)) for number in range(1, e13.INFO.frames + 1))
    # Bernoulli people and Poisson clutter: the variance is below the mean.
    assert found == pytest.approx(expected + e13.INFO.frames, abs=4 * expected**0.5)


def test_the_truth_changes_by_a_third_of_a_person_a_frame(sequence):
    """The page compares the filters' jumps with this."""
    people = np.bincount(sequence.frame, minlength=e13.INFO.frames + 1)[1:]
    assert np.abs(np.diff(people)).mean() == pytest.approx(0.31, abs=0.01)


def test_every_filter_of_the_table_counts_and_groups(sequence, monkeypatch):
    """Five frames: a number for each of them, and fewer groups than people."""
    monkeypatch.setattr(e13, "INFO", e13.SequenceInfo(768, 576, 7.0, 5, e13.INFO.name))
    for name in e13.FILTERS:
        counts = e13.work(e13.CrowdRun(name, 1.0, 0))
        assert all(
            each.shape == (5,)
            for each in (counts.mass, counts.rounded, counts.states, counts.raw, *counts.groups)
        )
        assert len(counts.groups) == len(e13.WEIGHTS)
        assert (counts.rounded >= counts.states).all() or "CPHD" in name
        assert (counts.mass > 0).all()
        assert (counts.groups[e13.USUAL_WEIGHT] <= np.maximum(counts.mass, 1) * 2).all()


def counts(mass: float, rounded: float, raw: float, groups: tuple[int, int, int]) -> CrowdCounts:
    """The same counts in four frames."""
    four = np.ones(4)
    return CrowdCounts(
        mass * four, rounded * four, 9 * four, raw * four, np.outer(np.array(groups), four)
    )


def test_claims_of_e13_for_made_up_counts() -> None:
    """Ten people in three groups, and counts that do not jump."""
    results = {
        e13.CrowdRun(name, 0.1, 0): counts(
            9.5 if "occlusion" in name else 8.0, 12.0, 7.0, (5, 3, 3)
        )
        for name in e13.FILTERS
    }
    found = e13.CrowdResults(results, np.full(4, 10.0), np.full(4, 3.0), (0.1,), 1)
    words = [one for one in e13.claims_of(found) if one.form == WORDS]
    mass, rounded, groups, jumps, hidden = words
    assert (mass.ours, mass.verdict) == ("error 2.00, raw 3.00; 1 seed", "holds")
    assert (rounded.ours, rounded.verdict) == ("error 2.00, raw 3.00; 1 seed", "holds")
    assert groups.ours == "error 0.00, right in 100 % of the frames; 1 seed"
    assert groups.verdict == "holds on 2 of 3, not on from weight 0.1"
    assert jumps.verdict == "does not hold"
    (mended,) = [
        one for one in e13.claims_of(found) if one.claim == "a cardinalised filter mends the jumps"
    ]
    assert (mended.form, mended.verdict) == (OURS, "does not hold")
    jumping = results[e13.CrowdRun(e13.FORMS[MENDED], 0.1, 0)]
    jumping.mass[::2] += 3.0
    (mended,) = [
        one for one in e13.claims_of(found) if one.claim == "a cardinalised filter mends the jumps"
    ]
    assert mended.verdict == "holds"
    jumping.mass[::2] -= 3.0
    assert (hidden.ours, hidden.verdict) == ("error 0.50 with, 2.00 without; 1 seed", "holds")
    assert "With the true people as hiders it is 2.00 (bias -2.00)" in e13.hidden_sentence(found)
    assert "with the people found lowers the error" in e13.hidden_sentence(found)
    assert "| 0.1 | GM-PHD | word by word | 2.00 (0 %) | 0.00 (100 %) |" in e13.weights_table(found)


def test_claims_of_e13_have_errors_from_three_seeds_on() -> None:
    """The count is off by two, but with p_D(x) by 0.5 to 3.9; the raw number by three."""
    results = {
        e13.CrowdRun(name, 0.1, seed): counts(
            10.0 - off if "occlusion" in name else 8.0, 12.0, 7.0, (3, 3, 3)
        )
        for name in e13.FILTERS
        for seed, off in enumerate((0.5, 1.0, 3.9))
    }
    found = e13.CrowdResults(results, np.full(4, 10.0), np.full(4, 3.0), (0.1,), 3)
    words = [one for one in e13.claims_of(found) if one.form == WORDS]
    assert (words[0].ours, words[0].verdict) == ("error 2.00, raw 3.00", "holds")
    assert (words[-1].ours, words[-1].verdict) == (
        "error 1.80 with, 2.00 without",
        "within its error",
    )
    assert "changes the error by no more than its own error" in e13.hidden_sentence(found)
