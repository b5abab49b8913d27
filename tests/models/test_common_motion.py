"""The camera's motion from the detections: what is estimated against what it was, and a still
camera loses nothing.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from moving_cases import handheld, moving, step
from phdtrack import Tracker
from phdtrack.kernels.common_motion import (
    DENSITY,
    FREEDOM,
    PRIOR_FREEDOM,
    differences,
    fitted,
    voted,
)
from phdtrack.metrics import evaluate
from phdtrack.models import warp as warp_of
from phdtrack.models.common_motion import motion_of, similarity
from phdtrack.simulate import DetectorModel, make_scene
from phdtrack.types import Tracks

FRAME = np.array([320.0, 240.0, 320.0])


def crowd(
    rng,
    n: int = 12,
    missed: float = 0.1,
    false: int = 3,
    motion=(0.0, 0.0, 0.0, 0.0),
    noise: float = 1.5,
):
    """Targets' means and covariances, and the detections of a frame in which all were shifted,
    zoomed and turned.
    """
    place = rng.uniform([40, 40], [600, 440], (n, 2))
    size = rng.uniform([20, 50], [40, 90], (n, 2))
    mean = np.hstack([place, np.zeros((n, 2)), size])
    covariance = np.tile(np.diag([1.0, 1, 1, 1, 1, 1]), (n, 1, 1))
    u, v = (place - FRAME[:2]).T / FRAME[2]
    x, y, zoom, turn = motion
    there = (
        place
        + np.stack([x + u * zoom - v * turn, y + v * zoom + u * turn], axis=1)
        + rng.normal(0, np.hypot(1, noise), (n, 2))
    )
    z = np.hstack(
        [there, size * np.exp(zoom / FRAME[2] + rng.normal(0, np.hypot(1, noise), (n, 2)) / size)]
    )
    z = np.vstack(
        [
            z[rng.random(n) > missed],
            np.hstack([rng.uniform([0, 0], [640, 480], (false, 2)), np.full((false, 2), 50.0)]),
        ]
    )
    return mean, covariance, np.tile(np.diag(np.full(4, noise**2)), (1, 1, 1)), z


def fit(case, scale):
    """What `fitted` says of a crowd, and the pairs that it was given."""
    mean, covariance, noise, z = case
    boxes = differences(mean, covariance, noise, z, np.ones(4))
    detected = np.full(len(mean), 0.9)
    return (
        fitted(*boxes, detected, len(z) / (640 * 480), FRAME, np.asarray(scale), np.zeros(3)),
        boxes,
        detected,
    )


def test_motion_is_estimated_within_its_error(rng):
    """Of 200 frames with motions from the prior: squared errors in variances have the mean 1 of a
    χ² of each component.
    """
    scale = np.full(4, 9.0)
    errors = []
    for _ in range(200):
        motion = rng.normal(0, np.sqrt(scale))
        (_, seen, variance, _, _), _, _ = fit(crowd(rng, motion=motion), -scale)
        errors.append((seen - motion) ** 2 / variance)
    # 800 squares of variance 2. Precisions that make a t-distribution are taken as known, by which
    # its information, with 4 degrees of freedom in 4 dimensions, is 10/8 of what it is.
    assert 1 - 5 * np.sqrt(2 / 800) < np.mean(errors) < 10 / 8 * (1 + 5 * np.sqrt(2 / 800))


@pytest.mark.parametrize("seed", range(4))
def test_motion_is_the_most_probable_one(seed: int):
    rng = np.random.default_rng(seed)
    scale = np.array([30.0, 30.0, 10.0, 10.0])
    case = crowd(rng, motion=rng.normal(0, 3, 4))
    (motion, *_), (expected, variance, z), detected = fit(case, scale)
    u, v = ((expected[:, :2] - FRAME[:2]) / FRAME[2]).T
    density = len(z) / (640 * 480)

    def posterior(theta: np.ndarray) -> float:
        x, y, zoom, turn = theta
        shift = np.stack(
            [
                x + u * zoom - v * turn,
                y + v * zoom + u * turn,
                *np.full((2, len(u)), zoom / FRAME[2]),
            ],
            axis=1,
        )
        e = z[None] - expected[:, None] - shift[:, None]
        tail = 1 + (e**2 / variance[:, None]).sum(axis=2) / FREEDOM
        p = DENSITY / (np.sqrt(variance.prod(axis=1))[:, None] * tail**4)
        total = np.log(1 - detected + detected / density * p.sum(axis=1)).sum()
        return -float(
            total - 0.5 * (PRIOR_FREEDOM + 1) * np.log(1 + theta**2 / scale / PRIOR_FREEDOM).sum()
        )

    best = minimize(
        posterior,
        motion,
        method="Nelder-Mead",
        options={"xatol": 1e-3, "fatol": 1e-6, "maxiter": 4000},
    )
    np.testing.assert_allclose(motion, best.x, atol=0.1)


def test_a_sudden_shift_is_voted_for(rng):
    mean, covariance, noise, z = crowd(rng, motion=(60.0, -25.0, 0.0, 0.0))
    expected, _, found = differences(mean, covariance, noise, z, np.ones(4))
    right, down, cell, votes = voted(expected, found, FRAME[2])
    assert votes >= 6
    assert np.abs([right - 60, down + 25]).max() <= 1.5 * cell


def street(path: np.ndarray | None = None, seed: int = 3):
    """A street as a camera sees it that stands still, or moves on this path."""
    made = make_scene("street", seed, DetectorModel(clutter_rate=1), frames=100, lead_in=-4.0)
    return made if path is None else moving(made, path)


def tracked(scene, kind: str, warps=None) -> tuple[Tracks, Tracker]:
    """Online rows."""
    tracker = Tracker(
        (640, 480),
        fps=25,
        preset="default",
        common_motion={"kind": kind},
        camera_motion={"kind": "none"},
    )
    given = [None] * 101 if warps is None else warps
    rows = [tracker.update(scene.detections.at(k), warp=given[k]) for k in range(1, 101)]
    return Tracks.concatenate(rows), tracker


def idf1(scene, rows: Tracks) -> float:
    return evaluate(scene.truth, rows).IDF1


def test_moving_camera_is_followed_and_a_still_one_costs_nothing():
    rng = np.random.default_rng(2)
    still = street()
    moved = street(handheld(100, rng))
    scores = {
        (scene, kind): idf1(made, tracked(made, kind)[0])
        for scene, made in (("still", still), ("moved", moved))
        for kind in ("none", "estimated")
    }
    assert scores["moved", "estimated"] > scores["moved", "none"] + 0.05
    assert scores["still", "estimated"] > scores["still", "none"] - 0.01


def test_given_motion_is_followed_only_if_it_fits():
    """The right matrices, and those of the other direction, of five frames later and of another
    walk.
    """
    rng = np.random.default_rng(4)
    path = handheld(106, rng)
    scene = street(path[:101])
    other = handheld(106, rng)
    right = [None, None, *(step(path, k) for k in range(2, 101))]
    alone = idf1(scene, tracked(scene, "estimated")[0])
    rows, tracker = tracked(scene, "estimated", right)
    assert tracker.state.camera.followed
    assert idf1(scene, rows) >= alone - 0.01
    wrong = {
        "inverse": [None, None, *(warp_of.back(step(path, k)) for k in range(2, 101))],
        "late": [None, None, *(step(path, k + 5) for k in range(2, 101))],
        "other": [None, None, *(step(other, k) for k in range(2, 101))],
    }
    for name, given in wrong.items():
        rows, tracker = tracked(scene, "estimated", given)
        assert not tracker.state.camera.followed, name
        assert idf1(scene, rows) >= alone - 0.03, name


def test_a_motion_is_a_similarity_about_the_middle(rng):
    for motion in rng.normal(0, 8, (20, 4)):
        np.testing.assert_allclose(motion_of(similarity(motion, FRAME), FRAME), motion, atol=1e-9)
    assert len(similarity(np.zeros(4), FRAME)) == 0
    # A damaged state with a huge zoom does not overflow.
    assert np.isfinite(similarity(np.array([0.0, 0.0, 1e7, 0.0]), FRAME)).all()
    np.testing.assert_array_equal(motion_of(np.zeros((0, 3)), FRAME), 0)
