"""The parts of the experiment on frame rates: omitted and interpolated frames."""

from __future__ import annotations

import numpy as np

from experiments.rates import RATES, drawn, interpolated, peers, renumbered

TRUTH = np.array(
    [
        [1, 7, 10, 20, 30, 40, 1, -1, -1],
        [2, 7, 14, 28, 34, 40, 1, -1, -1],
        [5, 7, 50, 28, 34, 40, 1, -1, -1],
        [2, 9, 99, 99, 10, 10, 1, -1, -1],
    ],
    dtype=float,
)


def test_frames_that_are_left_are_numbered_from_one():
    left = renumbered(TRUTH, np.array([2.0, 5.0]))
    np.testing.assert_array_equal(left[:, 0], [1, 2, 1])
    np.testing.assert_array_equal(left[:, 1:], TRUTH[1:, 1:])
    assert len(renumbered(TRUTH[:0], np.array([1.0]))) == 0


def test_truth_between_two_frames_is_in_between_and_gaps_stay():
    """Four times as many frames: 1 … 5 from the first two, 17 from the last; none in the gap
    between frames 2 and 5.
    """
    rows = interpolated(TRUTH, 4)
    one = rows[rows[:, 1] == 7]
    np.testing.assert_array_equal(one[:, 0], [1, 2, 3, 4, 5, 17])
    np.testing.assert_allclose(one[:5, 2:6], [[10 + k, 20 + 2 * k, 30 + k, 40] for k in range(5)])
    np.testing.assert_array_equal(rows[rows[:, 1] == 9][:, :6], [[5, 9, 99, 99, 10, 10]])


def test_nine_of_ten_boxes_are_detected_with_jitter():
    """Within five standard errors."""
    many = np.repeat(TRUTH[:1], 20_000, axis=0)
    found = drawn(many)
    assert abs(len(found) / 20_000 - 0.9) < 5 * np.sqrt(0.9 * 0.1 / 20_000)
    away = (found[:, 2:6] - many[0, 2:6]) / many[0, [4, 5, 4, 5]]
    assert (abs(away.std(axis=0) / 0.05 - 1) < 5 / np.sqrt(2 * len(found))).all()


def test_the_peers_have_every_case_at_every_rate():
    found = peers()
    cases = {key[1:] for key in found}
    assert len(cases) == 16
    assert set(found) == {(rate, *case) for rate in RATES for case in cases}
