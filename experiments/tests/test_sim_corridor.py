"""The corridor of D14's kind: the people in it, and their measurements."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.corridor import PATHS, centroids, measured, paths, wandering
from phdtrack.models import PointMotion


def test_four_people_three_at_a_time_in_475_frames():
    truth = paths()
    assert (PATHS.frames, PATHS.width, PATHS.height, PATHS.fps) == (475, 384, 288, 25.0)
    assert set(truth.identity) == {1, 2, 3, 4}
    there = np.bincount(truth.frame, minlength=476)[1:]
    assert (there.min(), there.max()) == (1, 3)
    corners = truth.xyxy.reshape(-1, 2)
    assert (corners >= 0).all()
    assert (corners <= [384, 288]).all()


def test_they_enter_cross_and_leave():
    """Everybody comes and goes once; two pairs pass within 16 pixels; nobody moves by more than
    three pixels a frame.
    """
    truth = paths()
    place = centroids(paths())
    near = []
    for a in range(1, 5):
        mine = truth.identity == a
        assert np.ptp(truth.frame[mine]) + 1 == mine.sum() > 200
        assert np.hypot(*np.diff(place[:, mine])).max() < 3
        for b in range(a + 1, 5):
            frames, i, j = np.intersect1d(
                truth.frame[mine], truth.frame[truth.identity == b], return_indices=True
            )
            if len(frames):
                apart = np.hypot(*(place[:, mine][:, i] - place[:, truth.identity == b][:, j]))
                near.append(apart.min())
    assert sum(distance < 16 for distance in near) >= 2
    assert sorted(np.unique(truth.frame[truth.identity == k])[0] for k in range(1, 5))[0] == 1


def test_everybody_is_measured_with_the_set_noise():
    truth = paths()
    place = centroids(paths())
    scans = measured(truth, 475, 2.0, np.random.default_rng(1))
    assert len(scans) == 475
    error = np.hstack(scans)[:2] - place[:, np.argsort(truth.frame, kind="stable")]
    np.testing.assert_array_equal(
        np.hstack(scans)[2], truth.identity[np.argsort(truth.frame, kind="stable")]
    )
    # 1048 people in frames: five standard errors.
    assert error.var() == pytest.approx(2.0, abs=5 * 2 * (2 / error.size) ** 0.5)
    assert abs(error.mean()) < 5 * (2 / error.size) ** 0.5
    clean = measured(truth, 475, 0.0, np.random.default_rng(1))
    np.testing.assert_array_equal(
        np.hstack(clean)[:2], place[:, np.argsort(truth.frame, kind="stable")]
    )


def test_wandering_points_follow_the_model():
    """With p' = p + v + n and v' = v + m a second difference of positions is n' − n + m: its
    variance is 3 q.
    """
    truth = wandering(PointMotion(noise_variance=2.0), 1.5, np.random.default_rng(4))
    known = paths()
    np.testing.assert_array_equal(truth.frame, known.frame)
    np.testing.assert_array_equal(truth.identity, known.identity)
    place = centroids(truth)
    bends = []
    for one in range(1, 5):
        mine = truth.identity == one
        np.testing.assert_allclose(
            place[:, mine][:, 0], centroids(known)[:, known.identity == one][:, 0]
        )
        bends.append(np.diff(place[:, mine], n=2))
    bend = np.hstack(bends)
    assert bend.var() == pytest.approx(3 * 2.0, rel=0.12)
    again = wandering(PointMotion(noise_variance=2.0), 1.5, np.random.default_rng(4))
    np.testing.assert_array_equal(again.xyxy, truth.xyxy)
