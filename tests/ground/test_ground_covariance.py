"""Covariances of ground points: the transforms against sampling, and a Kalman filter that believes them is consistent."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from camera_cases import CAMERAS, posed, tsai
from phdtrack.errors import InputError
from phdtrack.ground import ground_covariance

DISTANCES = (12.0, 25.0, 40.0, 60.0)


def ahead(distance: float) -> np.ndarray:
    """(2,) the ground point ``distance`` metres from the camera, in the middle of the picture."""
    camera = posed(tsai(5e-3))
    direction = camera.rotation[2, :2] / np.linalg.norm(camera.rotation[2, :2])
    return camera.position[:2] + distance * direction


def repeated(cov: np.ndarray, n: int) -> np.ndarray:
    return np.tile(cov, (n, 1, 1))


@pytest.mark.parametrize("name", ["tsai", "opencv, five", "homography"])
def test_it_is_the_covariance_of_sampled_pixels(name: str, rng: np.random.Generator) -> None:
    camera, cov = CAMERAS[name], np.array([[4.0, 1.5], [1.5, 9.0]])
    pixel = np.array([[100.0, 400, 700], [350, 420, 560]])
    found = ground_covariance(camera, pixel, repeated(cov, 3))
    for i in range(3):
        cloud = pixel[:, i, None] + np.linalg.cholesky(cov) @ rng.standard_normal((2, 40_000))
        sampled = np.cov(camera.ground(cloud))
        np.testing.assert_allclose(found[i], sampled, atol=0.05 * np.trace(sampled))


def nees(distance: float, rng: np.random.Generator, n: int, fixed: np.ndarray | None = None) -> np.ndarray:
    """(n,) normalised squared errors of one Kalman update each, on a person near ``distance``, 2 pixels of noise."""
    camera, deviation, prior = posed(tsai(5e-3)), 2.0, 0.5**2 * np.eye(2)
    expected = ahead(distance)[:, None]
    true = expected + 0.5 * rng.standard_normal((2, n))
    pixel = camera.pixels(true) + deviation * rng.standard_normal((2, n))
    z, noise = camera.ground(pixel), ground_covariance(camera, pixel, repeated(deviation**2 * np.eye(2), n))
    if fixed is not None:
        noise = repeated(fixed, n)
    gain = prior @ np.linalg.inv(prior + noise)
    error = expected + np.einsum("nij,jn->in", gain, z - expected) - true
    return np.einsum("in,nij,jn->n", error, np.linalg.inv(prior - gain @ prior), error)


def test_a_kalman_filter_that_believes_it_is_consistent() -> None:
    """NEES of 8000 updates, 12 to 60 m away, within its 95 % band; and near and far apart within 99.9 %."""
    rng, n = np.random.default_rng(13), 2000
    each = [nees(distance, rng, n) for distance in DISTANCES]
    low, high = chi2.ppf([0.025, 0.975], 2 * n * len(each)) / (n * len(each))
    assert low < np.mean(each) < high
    low, high = chi2.ppf([0.0005, 0.9995], 2 * n) / n
    assert all(low < values.mean() < high for values in each)


def test_one_covariance_for_all_distances_is_not_consistent(rng: np.random.Generator) -> None:
    """E13's R = 0.5 I: far too careful near by, too bold far away. The test above can tell."""
    low, high = chi2.ppf([0.0005, 0.9995], 4000) / 2000
    values = [nees(distance, rng, 2000, 0.5 * np.eye(2)).mean() for distance in (12.0, 100.0)]
    assert values[0] < low
    assert values[1] > high


def test_the_sky_has_no_covariance_and_spoils_no_other() -> None:
    camera, pixel = posed(tsai(5e-3)), np.array([[380.0, 380.0], [500.0, -500.0]])
    cov = ground_covariance(camera, pixel, repeated(4 * np.eye(2), 2))
    assert np.isfinite(cov[0]).all()
    assert np.isnan(cov[1]).all()


def test_mistakes_and_nothing() -> None:
    camera = posed(tsai(5e-3))
    with pytest.raises(InputError, match=r"each of 1 pixels, came shape \(2, 2\)"):
        ground_covariance(camera, np.array([[380.0], [500.0]]), np.eye(2))
    assert ground_covariance(camera, np.zeros((2, 0)), np.zeros((0, 2, 2))).shape == (0, 2, 2)
