"""Pairwise F1 and identity switches of groups, on cases that can be counted by hand and against a
loop over pairs.
"""

import math

import numpy as np
import pytest

from experiments.group_scores import LabelledFrame, nearest, score_groups


def frame(truth, output, off=0.0, found=None):
    """People a hundred metres apart, each where the truth has him, ``off`` metres aside; ``found``:
    those in the output.
    """
    place = np.stack([100.0 * np.arange(len(truth)), np.zeros(len(truth))])
    kept = np.arange(len(truth)) if found is None else np.array(found, np.int64)
    return LabelledFrame(np.array(truth), place, np.array(output, np.int64), place[:, kept] + off)


def test_pairs_with_nobody_are_false():
    seen = LabelledFrame(
        np.array([0]), np.zeros((2, 1)), np.array([4, 4]), np.array([[0.0, 50.0], [0.0, 0.0]])
    )
    scores = score_groups([seen])
    assert (scores.true_positives, scores.false_positives, scores.false_negatives) == (0, 1, 0)


def test_who_is_too_far_off_is_somebody_else():
    assert score_groups([frame([1, 1], [1, 1], off=0.6)]).f1() == 1.0
    assert score_groups([frame([1, 1], [1, 1], off=0.8)]).f1() == 0.0


def test_a_switch_is_a_change_of_the_name_that_most_carry():
    frames = [frame([1, 1, 1], o) for o in ([5, 5, 5], [5, 5, 6], [6, 6, 5], [6, 6, 6], [5, 6, 8])]
    assert score_groups(frames).switches == 1


def test_as_many_as_can_be_are_mapped():
    # Greedy would take the nearest pair and leave the other two alone.
    a = np.array([[0.0, 0.9], [0, 0]])
    b = np.array([[0.5, 1.6], [0, 0]])
    rows, columns = nearest(a, b, 1.0)
    assert list(zip(rows, columns, strict=True)) == [(0, 0), (1, 1)]


@pytest.mark.parametrize("seed", range(20))
def test_sums_agree_with_a_loop_over_pairs(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 12))
    truth = rng.integers(0, 4, n)
    output = rng.integers(0, 4, n)
    counts = [0, 0, 0]
    for i in range(n):
        for j in range(i):
            t = truth[i] == truth[j] > 0
            o = output[i] == output[j] > 0
            counts[0] += t and o
            counts[1] += o and not t
            counts[2] += t and not o
    scores = score_groups([frame(truth, output)])
    assert [scores.true_positives, scores.false_positives, scores.false_negatives] == counts
    share = counts[0] / (counts[0] + 0.5 * (counts[1] + counts[2])) if any(counts) else math.nan
    assert scores.f1() == pytest.approx(share, nan_ok=True)
