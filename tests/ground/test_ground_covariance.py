"""Covariances of ground points: a Kalman filter that uses them is consistent."""

import numpy as np
from scipy.stats import chi2

from camera_cases import posed, tsai
from phdtrack.ground import ground_covariance


def nees(distance: float, rng: np.random.Generator, n: int) -> np.ndarray:
    """(n,) normalised squared errors of one Kalman update each, on a person ``distance`` m ahead, 2 pixels of noise."""
    camera, deviation, prior = posed(tsai(5e-3)), 2.0, 0.5**2 * np.eye(2)
    direction = camera.rotation[2, :2] / np.linalg.norm(camera.rotation[2, :2])
    expected = (camera.position[:2] + distance * direction)[:, None]
    true = expected + 0.5 * rng.standard_normal((2, n))
    pixel = camera.pixels(true) + deviation * rng.standard_normal((2, n))
    z, noise = camera.ground(pixel), ground_covariance(camera, pixel, np.tile(deviation**2 * np.eye(2), (n, 1, 1)))
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
