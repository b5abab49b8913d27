"""Covariances of ground points: the transforms against sampling, and a Kalman filter that uses them is consistent."""

import numpy as np
import pytest
from scipy.stats import chi2

from camera_cases import CAMERAS, posed, tsai
from phdtrack.ground import ground_covariance


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


def nees(distance: float, rng: np.random.Generator, n: int) -> np.ndarray:
    """(n,) normalised squared errors of one Kalman update each, on a person ``distance`` m ahead, 2 pixels of noise."""
    camera, deviation, prior = posed(tsai(5e-3)), 2.0, 0.5**2 * np.eye(2)
    direction = camera.rotation[2, :2] / np.linalg.norm(camera.rotation[2, :2])
    expected = (camera.position[:2] + distance * direction)[:, None]
    true = expected + 0.5 * rng.standard_normal((2, n))
    pixel = camera.pixels(true) + deviation * rng.standard_normal((2, n))
    z, noise = camera.ground(pixel), ground_covariance(camera, pixel, repeated(deviation**2 * np.eye(2), n))
    gain = prior @ np.linalg.inv(prior + noise)
    error = expected + np.einsum("nij,jn->in", gain, z - expected) - true
    return np.einsum("in,nij,jn->n", error, np.linalg.inv(prior - gain @ prior), error)


def test_a_kalman_filter_that_uses_it_is_consistent() -> None:
    """NEES of 8000 updates, 12 to 60 m away, within its 95 % band; and near and far apart within 99.9 %."""
    rng, n = np.random.default_rng(13), 2000
    each = [nees(distance, rng, n) for distance in (12.0, 25.0, 40.0, 60.0)]
    low, high = chi2.ppf([0.025, 0.975], 2 * n * len(each)) / (n * len(each))
    assert low < np.mean(each) < high
    low, high = chi2.ppf([0.0005, 0.9995], 2 * n) / n
    assert all(low < values.mean() < high for values in each)
