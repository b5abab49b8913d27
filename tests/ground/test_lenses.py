"""Tsai's lens against the two linear equations of the paper; OpenCV's against OpenCV."""

import cv2
import numpy as np
import pytest

from camera_cases import BARREL, MATRIX, PRISM, RATIONAL, ROTATION, TRANSLATION, posed, tsai
from phdtrack.errors import InputError
from phdtrack.ground import OpenCVLens, PosedCamera, TsaiLens


def test_tsai_solves_the_two_linear_equations(rng: np.random.Generator) -> None:
    """E13 (6), (7), pixel by pixel in millimetres, as the calibration files have it."""
    camera = posed(tsai(5e-3))
    lens = tsai(5e-3)
    translation = 1000 * TRANSLATION
    for xf, yf in rng.uniform([0, 300], [768, 576], (40, 2)):
        xd = 5.1e-3 * (xf - lens.cx) / lens.sx
        yd = 4.6e-3 * (yf - lens.cy)
        factor = (1 + 5e-3 * (xd**2 + yd**2)) / 5.5
        u = xd * factor
        v = yd * factor
        equations = np.array(
            [ROTATION[0, :2] - u * ROTATION[2, :2], ROTATION[1, :2] - v * ROTATION[2, :2]]
        )
        right = np.array([u * translation[2] - translation[0], v * translation[2] - translation[1]])
        place = np.linalg.solve(equations, right) / 1000
        np.testing.assert_allclose(camera.ground(np.array([[xf], [yf]]))[:, 0], place, atol=1e-9)


def test_distortion_cubic_is_solved_for_strong_distortion(rng: np.random.Generator) -> None:
    pixel = rng.uniform([[0], [0]], [[768], [576]], (2, 500))
    for kappa in (1e-9, 1e-4, 0.3, 40.0, -1e-9, -1e-4, -2e-2):
        lens = tsai(kappa)
        ray = lens.rays(pixel)
        assert np.isfinite(ray).all()
        np.testing.assert_allclose(lens.project(ray), pixel, atol=1e-9)


def test_points_beyond_the_fold_are_outside() -> None:
    """κ = −0.05: the fold is 2.58 mm from the axis, and the undistorted radius there is two thirds
    of that.
    """
    lens = tsai(-0.05)
    fold = 1e-3 / np.sqrt(3 * 0.05)
    edge = 2 / 3 * fold / lens.focal
    ray = np.array([[0.999 * edge, 1.001 * edge, 0.0], [0, 0, 0.5 * edge]])
    pixel = lens.project(ray)
    assert np.isnan(pixel[:, 1]).all()
    np.testing.assert_allclose(lens.rays(pixel)[:, [0, 2]], ray[:, [0, 2]], rtol=1e-9)
    across = lens.cy + np.array([0.999, 1.001]) * fold / lens.dy
    seen = lens.rays(np.stack([np.full(2, lens.cx), across]))
    assert np.isfinite(seen[:, 0]).all()
    assert np.isnan(seen[:, 1]).all()


@pytest.mark.parametrize(
    "distortion", [np.zeros(0), BARREL[:4], BARREL, RATIONAL, PRISM], ids=["0", "4", "5", "8", "12"]
)
def test_pixels_agree_with_opencv(distortion: np.ndarray, rng: np.random.Generator) -> None:
    camera = PosedCamera(OpenCVLens(MATRIX, distortion), ROTATION, TRANSLATION)
    world = np.vstack([rng.uniform(-12, 12, (2, 300)), rng.uniform(0, 2, 300)])
    theirs, _ = cv2.projectPoints(
        world.T, cv2.Rodrigues(ROTATION)[0], TRANSLATION, MATRIX, distortion
    )
    ours = camera.pixels(world)
    seen = np.isfinite(ours).all(axis=0)
    assert seen.mean() > 0.9
    np.testing.assert_allclose(ours[:, seen], theirs[:, 0].T[:, seen], atol=1e-9)


def test_fold_of_the_opencv_lens_is_outside() -> None:
    """r(1 + k1 r²) grows up to r = (−3 k1)^(−1/2)."""
    lens = OpenCVLens(MATRIX, np.array([-0.3, 0, 0, 0]))
    fold = (3 * 0.3) ** -0.5
    assert lens.fold == pytest.approx(fold)
    assert OpenCVLens(MATRIX, np.array([0.3, 0.1, 0, 0])).fold == np.inf
    pixel = lens.project(np.array([[0.999 * fold, 1.001 * fold, 1.7 * fold], [0, 0, 0]]))
    assert np.isfinite(pixel[:, 0]).all()
    assert np.isnan(pixel[:, 1:]).all()
    beyond = MATRIX[0, 2] + MATRIX[0, 0] * fold * 2 / 3 * np.array([0.999, 1.001])
    ray = lens.rays(np.stack([beyond, np.full(2, MATRIX[1, 2])]))
    assert ray[0, 0] < fold
    assert np.isnan(ray[:, 1]).all()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: OpenCVLens(np.eye(2)), "camera matrix"),
        (lambda: OpenCVLens(np.diag([800.0, -800, 1])), "focal lengths above 0"),
        (
            lambda: OpenCVLens(MATRIX + np.array([[0, 0.3, 0], [0, 0, 0], [0, 0, 0]])),
            "other entries",
        ),
        (lambda: OpenCVLens(MATRIX, np.zeros(3)), "0, 4, 5, 8 or 12"),
        (lambda: OpenCVLens(MATRIX, np.zeros(14)), "tilted sensor"),
        (lambda: OpenCVLens(MATRIX, np.array([0, 0, np.nan, 0])), "finite"),
        (lambda: PosedCamera(tsai(0), 2 * np.eye(3), np.zeros(3)), "stretches or mirrors"),
        (lambda: PosedCamera(tsai(0), np.diag([1.0, 1, -1]), np.zeros(3)), "stretches or mirrors"),
        (lambda: PosedCamera(tsai(0), np.eye(2), np.zeros(3)), r"rotation matrix \(3, 3\)"),
        (lambda: TsaiLens(0.0, 1e-6, 1e-6, 0, 0, 0), r"TsaiLens\.focal: expected a value above 0"),
    ],
)
def test_bad_lenses_and_poses_are_refused(make, words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()
