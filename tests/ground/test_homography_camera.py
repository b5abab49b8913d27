"""The homography camera: the same as the pinhole that it stands for, horizon, depth, mistakes."""

import numpy as np
import pytest

from camera_cases import MATRIX, PLANE, pixels, posed
from phdtrack.errors import InputError
from phdtrack.ground import HomographyCamera, OpenCVLens


def test_homography_equals_undistorted_camera_on_flat_ground(rng: np.random.Generator) -> None:
    pinhole = posed(OpenCVLens(MATRIX))
    camera = HomographyCamera(PLANE)
    pixel = pixels(rng, 500)
    theirs = pinhole.ground(pixel)
    ours = camera.ground(pixel)
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
    np.testing.assert_allclose(ours, theirs, rtol=1e-8)
    np.testing.assert_allclose(camera.jacobian(pixel), pinhole.jacobian(pixel), rtol=1e-7)


def test_depth_is_the_distance_along_the_ground() -> None:
    """The depth equals the pinhole camera's horizontal distance along its viewing direction, from
    the point below it.
    """
    pinhole = posed(OpenCVLens(MATRIX))
    camera = HomographyCamera(PLANE)
    world = np.array([[0.0, 10, -5, -40], [0, -8, 30, -50]])
    ahead = pinhole.rotation[2, :2] / np.linalg.norm(pinhole.rotation[2, :2])
    # The line on which the camera's own plane meets the ground lies behind the point below it.
    origin = pinhole.translation[2] / np.linalg.norm(pinhole.rotation[2, :2])
    np.testing.assert_allclose(camera.depth(world), ahead @ world + origin, rtol=1e-9)


def test_overhead_camera_has_equal_depths() -> None:
    camera = HomographyCamera(np.array([[0.02, 0, 1], [0, 0.03, 2], [0, 0, 1]]))
    world = np.array([[0.0, 500], [3, -200]])
    np.testing.assert_array_equal(camera.depth(world), [1, 1])
    np.testing.assert_allclose(camera.ground(camera.pixels(world)), world)


def test_homography_has_no_heights() -> None:
    pixel = HomographyCamera(PLANE).pixels(np.array([[0.0, 0], [5, 5], [0, 1.8]]))
    assert np.isnan(pixel).tolist() == [[False, True]] * 2


def test_side_of_the_horizon_can_be_given() -> None:
    """An upside-down image: its upper part shows ground."""
    turned = PLANE @ np.array([[-1.0, 0, 768], [0, -1, 576], [0, 0, 1]])
    pixel = np.array([[380.0], [40]])
    assert np.isnan(HomographyCamera(turned).ground(pixel)).all()
    seen = HomographyCamera(turned, inside=(380.0, 40.0))
    np.testing.assert_allclose(
        seen.ground(pixel), HomographyCamera(PLANE).ground(np.array([[388.0], [536]]))
    )


@pytest.mark.parametrize(
    ("matrix", "inside", "words"),
    [
        (np.eye(2), None, "3 x 3"),
        (np.full((3, 3), np.nan), None, "finite"),
        (np.diag([1.0, 1, 0]), None, "can be inverted"),
        (np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), None, "horizon stands upright"),
        (np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, -100]]), (50.0, 100.0), "on the horizon"),
    ],
)
def test_malformed_cameras_are_refused(
    matrix: np.ndarray, inside: tuple[float, float] | None, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        HomographyCamera(matrix, inside)


@pytest.mark.parametrize("points", [np.zeros((4, 2)), np.zeros(2), np.zeros((1, 4))])
def test_transposed_points_are_refused(points: np.ndarray) -> None:
    for camera in (HomographyCamera(PLANE), posed(OpenCVLens(MATRIX))):
        for ask in (camera.ground, camera.pixels, camera.depth):
            with pytest.raises(InputError, match="expected points as columns"):
                ask(points)
