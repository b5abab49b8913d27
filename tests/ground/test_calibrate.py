"""A homography from clicked points."""

import cv2
import numpy as np
import pytest

from camera_cases import MATRIX, PLANE, posed
from phdtrack.errors import InputError
from phdtrack.ground import HomographyCamera, OpenCVLens, fit_homography

WORLD = np.array([[0.0, 12, 10, -8, 3, -2, 7], [-8, -3, 10, 12, 2, -9, 4]])


def clicked(world: np.ndarray = WORLD) -> np.ndarray:
    return posed(OpenCVLens(MATRIX)).pixels(world)


@pytest.mark.parametrize("n", [4, 5, 7])
def test_exact_points_recover_the_camera(n: int) -> None:
    fitted = fit_homography(clicked()[:, :n], WORLD[:, :n])
    assert fitted.pixel_error.max() < 1e-8
    assert fitted.ground_error.max() < 1e-8
    pixel = clicked(np.array([[5.0, 30], [-12, 40]]))
    np.testing.assert_allclose(
        fitted.camera.ground(pixel), HomographyCamera(PLANE).ground(pixel), rtol=1e-6
    )


def test_noisy_points_give_the_least_squares_fit(rng: np.random.Generator) -> None:
    """The fit is no worse than OpenCV's own refinement, and no small change of the matrix improves
    it.
    """
    pixel = clicked() + rng.normal(0, 1.5, WORLD.shape)
    fitted = fit_homography(pixel, WORLD)
    theirs, _ = cv2.findHomography(WORLD.T, pixel.T)
    ours = (fitted.pixel_error**2).sum()
    back = HomographyCamera(np.linalg.inv(theirs), fitted.camera.inside).pixels(WORLD)
    assert ours <= ((back - pixel) ** 2).sum() * (1 + 1e-6)
    for _ in range(50):
        other = HomographyCamera(
            fitted.camera.matrix * (1 + 1e-5 * rng.standard_normal((3, 3))), fitted.camera.inside
        )
        assert ((other.pixels(WORLD) - pixel) ** 2).sum() > ours
    np.testing.assert_allclose(np.hypot(*(fitted.camera.pixels(WORLD) - pixel)), fitted.pixel_error)
    np.testing.assert_allclose(
        np.hypot(*(fitted.camera.ground(pixel) - WORLD)), fitted.ground_error
    )


def test_units_and_origins_do_not_matter(rng: np.random.Generator) -> None:
    """Coordinates of a national grid, half a million metres off: the same residuals."""
    pixel = clicked() + rng.normal(0, 1.5, WORLD.shape)
    here = fit_homography(pixel, WORLD)
    there = fit_homography(pixel, WORLD + np.array([[674_000.0], [6_580_000]]))
    np.testing.assert_allclose(there.pixel_error, here.pixel_error, atol=1e-3)
    np.testing.assert_allclose(there.ground_error, here.ground_error, atol=1e-4)


LINE = np.arange(5.0) * [[1], [2]] + [[0], [1]]
THREE_ON_A_LINE = np.array([[0.0, 1, 2, 5], [0, 1, 2, -3]])


@pytest.mark.parametrize(
    ("pixel", "world", "words"),
    [
        (clicked()[:, :3], WORLD[:, :3], "four points or more, got 3"),
        (clicked(LINE), LINE, "one line in the image"),
        (clicked()[:, :5], LINE, "one line on the ground"),
        (clicked(THREE_ON_A_LINE), THREE_ON_A_LINE, "no three lie on a line"),
        (np.repeat(clicked()[:, :2], 3, axis=1), np.repeat(WORLD[:, :2], 3, axis=1), "one line"),
        (clicked()[:, [0, 2, 1, 3]], WORLD[:, :4], "both sides of the horizon"),
        (clicked(), WORLD[:, :6], "two arrays"),
        (np.where(WORLD == 12, np.nan, clicked()), WORLD, "finite"),
    ],
)
def test_degenerate_layouts_are_refused(pixel: np.ndarray, world: np.ndarray, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        fit_homography(pixel, world)
    assert words == "two arrays" or words == "finite" or caught.value.cure
