"""What every camera must do."""

from __future__ import annotations

import numpy as np
import pytest
from shipped import fixed, keeps

from camera_cases import CAMERAS, pixels
from phdtrack.devices import Camera
from phdtrack.ground import PosedCamera

pytestmark = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
NEAR = 60.0  # metres of depth: beyond, a pixel is several metres, and rounding too grows


@pytest.fixture
def shown(camera, rng):
    """Pixels that show ground not too far away."""
    pixel = pixels(rng, 800)
    near = camera.depth(camera.ground(pixel)) < NEAR
    assert 100 < near.sum() < 800, "some show ground, some the sky"
    return fixed(pixel[:, near])


def test_signatures(camera):
    keeps(Camera, camera)


def test_there_and_back(camera, shown):
    ground = fixed(camera.ground(shown))
    assert ground.shape == shown.shape
    back = camera.pixels(ground)
    np.testing.assert_allclose(back, shown, atol=1e-8, rtol=0)
    np.testing.assert_allclose(camera.ground(back), ground, atol=1e-9, rtol=0)


def test_depth_is_positive_on_ground_and_grows_upwards(camera, shown):
    depth = camera.depth(camera.ground(shown))
    assert depth.shape == (shown.shape[1],)
    assert (depth > 0).all()
    middle = np.stack([np.full(5, 380.0), np.linspace(560, 260, 5)])
    assert (np.diff(camera.depth(camera.ground(middle))) > 0).all()


def test_the_jacobian_is_the_derivative(camera, shown):
    """By central differences; where a step leaves the patch of an elevation map, there is a kink,
    and the median decides.
    """
    step = 1e-3
    jacobian = camera.jacobian(shown)
    assert jacobian.shape == (shown.shape[1], 2, 2)
    for axis in range(2):
        shift = np.zeros((2, 1))
        shift[axis] = step
        slope = (camera.ground(shown + shift) - camera.ground(shown - shift)) / (2 * step)
        error = np.abs(jacobian[:, :, axis].T - slope).max(axis=0) / np.abs(slope).max(axis=0)
        assert np.median(error) < 1e-6
        assert (error < 1e-4).mean() > 0.98


def test_a_point_that_is_not_there_spoils_no_other(camera, shown):
    """The horizon, the sky and NaN give NaN in their own columns."""
    bad = np.array([[300.0, np.nan, 380.0], [-1e5, 100.0, np.nan]])
    mixed = np.hstack([shown[:, :3], bad, shown[:, 3:5]])
    good = np.array([0, 1, 2, 6, 7])
    for values in (camera.ground(mixed).T, camera.jacobian(mixed)):
        assert np.isfinite(values[good]).all()
        assert (
            np.isnan(np.delete(values, good, axis=0)).any(axis=tuple(range(1, values.ndim))).all()
        )
    np.testing.assert_array_equal(camera.ground(mixed)[:, good], camera.ground(shown[:, :5]))


def test_what_is_behind_the_camera_has_no_pixel(camera, shown):
    seen = camera.ground(shown)[:, :4]
    behind = np.array([[-40.0], [-50.0]])
    both = np.hstack([seen, behind])
    assert np.isfinite(camera.pixels(both)[:, :4]).all()
    assert np.isnan(camera.pixels(both)[:, 4]).all()
    assert camera.depth(both)[4] < 0


def test_ground_points_with_their_height_are_the_same_points(camera, shown):
    ground = camera.ground(shown)
    height = (
        camera.surface.height(ground)
        if isinstance(camera, PosedCamera)
        else np.zeros(ground.shape[1])
    )
    world = np.vstack([ground, height])
    np.testing.assert_allclose(camera.pixels(world), camera.pixels(ground))
    np.testing.assert_allclose(camera.depth(world), camera.depth(ground))


def test_nothing_of_nothing(camera):
    none = np.zeros((2, 0))
    assert camera.ground(none).shape == camera.pixels(none).shape == (2, 0)
    assert camera.depth(none).shape == (0,)
    assert camera.jacobian(none).shape == (0, 2, 2)
