"""Points, velocities and sizes under a camera that moves: laws, derivatives, and what is
refused.
"""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.models import warp as warp_of

STEEP = np.array([[1.02, 0.03, 5.0], [-0.02, 0.97, -3.0], [2e-4, -1e-4, 1.0]])


def some(rng: np.random.Generator, n: int = 20) -> np.ndarray:
    """(6, n) states of boxes in an image of 640 x 480."""
    return np.vstack(
        [
            rng.uniform(0, 640, n),
            rng.uniform(0, 480, n),
            rng.normal(0, 4, (2, n)),
            rng.uniform(10, 90, (2, n)),
        ]
    )


def similarity(scale: float, angle: float, x: float, y: float) -> np.ndarray:
    c = scale * np.cos(angle)
    s = scale * np.sin(angle)
    return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])


def test_there_and_back(rng):
    x = some(rng)
    home = warp_of.warp_states(warp_of.warp_states(x, STEEP), warp_of.back(STEEP))
    np.testing.assert_allclose(home, x, rtol=1e-9, atol=1e-9)


def test_two_motions_are_one_after_the_other(rng):
    x = some(rng)
    second = similarity(0.9, 0.1, 12.0, 4.0)
    one = warp_of.warp_states(warp_of.warp_states(x, STEEP), second)
    np.testing.assert_allclose(
        warp_of.warp_states(x, warp_of.after([STEEP, second])), one, rtol=1e-9
    )
    np.testing.assert_array_equal(warp_of.after([]), np.eye(3))


def test_velocity_warps_like_points_and_size_like_areas(rng):
    """By moving the point on, and by the area of a small square about it."""
    x = some(rng)
    h = 1e-4
    moved = warp_of.warp_states(x, STEEP)

    def place(p):
        return warp_of.warp_states(np.vstack([p, np.zeros((4, 20))]), STEEP)[:2]

    later = place(x[:2] + h * x[2:4])
    np.testing.assert_allclose(moved[2:4], (later - moved[:2]) / h, rtol=1e-3, atol=1e-5)
    aside, below = h * np.eye(2)[:, :, None].repeat(20, axis=2)
    a, b = ((place(x[:2] + step) - moved[:2]) / h for step in (aside, below))
    np.testing.assert_allclose(
        moved[4:6] / x[4:6], np.tile(np.sqrt(a[0] * b[1] - a[1] * b[0]), (2, 1)), rtol=1e-5
    )


@pytest.mark.parametrize(
    "warp", [STEEP, similarity(1.3, 0.4, 5.0, 9.0)], ids=["homography", "similarity"]
)
def test_the_slope_is_the_derivative(warp, rng):
    x = some(rng)
    slope = warp_of.warp_jacobian(x, warp)
    for row in range(6):
        ahead = x.copy()
        behind = x.copy()
        ahead[row] += 1e-4
        behind[row] -= 1e-4
        differences = (warp_of.warp_states(ahead, warp) - warp_of.warp_states(behind, warp)) / 2e-4
        np.testing.assert_allclose(differences.T, slope[:, :, row], atol=1e-6)


def test_beyond_the_horizon_of_the_map_is_far_away_and_finite():
    x = np.array(
        [[2000.0, 20000.0], [0.0, 0.0], [1.0, 1.0], [0.0, 0.0], [10.0, 10.0], [10.0, 10.0]]
    )
    tilted = np.array([[1.0, 0, 0], [0, 1.0, 0], [-4e-4, 0, 1.0]])
    moved = warp_of.warp_states(x, tilted)
    assert np.isfinite(moved).all()
    assert (moved[0] > x[0]).all()
    assert np.isfinite(warp_of.warp_jacobian(x, tilted)).all()


def test_scale_and_form_of_a_given_matrix_do_not_matter():
    np.testing.assert_allclose(warp_of.as_warp(-3.0 * STEEP, "here"), STEEP, rtol=1e-12)
    np.testing.assert_array_equal(
        warp_of.as_warp([[1, 0, 4], [0, 1, 5]], "here"), similarity(1.0, 0.0, 4.0, 5.0)
    )


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(4),
        [[1, 0], [0, 1]],
        [1, 2, 3],
        "pan",
        [[1, 0, 0], [0, 1, 0], [0, 0, 0]],
        [[1, 0, np.nan], [0, 1, 0], [0, 0, 1]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0.001, 0, 0], [0, 0.001, 0], [0, 0, 1]],
        [[1, 1e19, 3], [1e308, 1, 4], [0, 0, 1]],
        [[1, 0, 3], [0, 1, 4], [0, 0, 5e-324]],
    ],
    ids=[
        "4 x 4",
        "2 x 2",
        "numbers",
        "text",
        "corner 0",
        "nan",
        "mirror",
        "small",
        "large",
        "corner tiny",
    ],
)
def test_what_is_no_motion_of_a_camera_is_refused(matrix):
    with pytest.raises(InputError, match=r"^frame 7: expected"):
        warp_of.as_warp(matrix, "frame 7")
