"""The field of view on the ground; covariances of ground points against sampling, and in a Kalman
filter.
"""

import numpy as np
import pytest
from matplotlib.path import Path as Outline
from scipy.stats import chi2

from camera_cases import CAMERAS, MATRIX, PLANE, SIZE, looking, posed, tsai
from phdtrack.errors import InputError
from phdtrack.ground import (
    HomographyCamera,
    OpenCVLens,
    PosedCamera,
    Terrain,
    footprint,
    ground_covariance,
)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_footprint_contains_the_visible_ground(
    camera: PosedCamera, rng: np.random.Generator
) -> None:
    """But for points within 0.3 m of the outline, which is a polygon and no curve."""
    polygon = footprint(camera, SIZE, 50.0)
    assert np.isfinite(polygon).all()
    assert camera.depth(polygon).max() == pytest.approx(50)
    low = polygon.min(axis=1, keepdims=True) - 10
    high = polygon.max(axis=1, keepdims=True) + 10
    world = rng.uniform(low, high, (2, 1500))
    pixel = camera.pixels(world)
    size = np.array(SIZE)[:, None]
    shown = ((pixel >= 0) & (pixel <= size)).all(axis=0) & (camera.depth(world) <= 50)
    outline = Outline(polygon.T)
    inside = outline.contains_points(world.T)
    closed = np.hstack([polygon, polygon[:, :1]])
    dense = np.concatenate(
        [np.linspace(a, b, 20) for a, b in zip(closed.T[:-1], closed.T[1:], strict=True)]
    )
    clear = np.array([np.hypot(*(dense - point).T).min() > 0.3 for point in world.T])
    assert 80 < shown.sum() < 1400
    # Terrain may hide ground within the outline; what is shown lies inside of it all the same.
    terrain = isinstance(camera, PosedCamera) and isinstance(camera.surface, Terrain)
    wrong = (shown & ~inside if terrain else shown != inside) & clear
    assert wrong.sum() <= (15 if terrain else 0)


def test_footprint_without_a_horizon_is_the_frame() -> None:
    rotation, translation = looking((0.0, -6.0, 8.0), (0.0, 0.0))
    camera = PosedCamera(OpenCVLens(MATRIX), rotation, translation)
    polygon = footprint(camera, SIZE)
    corners = camera.ground(np.array([[0, SIZE[0], SIZE[0], 0], [0, 0, SIZE[1], SIZE[1]]]))
    np.testing.assert_allclose(polygon[:, ::64], corners, atol=1e-9)


def test_frame_of_sky_has_an_empty_footprint() -> None:
    sky = HomographyCamera(PLANE @ np.array([[1.0, 0, 0], [0, 1, -3000], [0, 0, 1]]))
    assert footprint(sky, SIZE).shape == (2, 0)
    with pytest.raises(InputError, match="above 0"):
        footprint(sky, SIZE, 0.0)


def repeated(cov: np.ndarray, n: int) -> np.ndarray:
    return np.tile(cov, (n, 1, 1))


@pytest.mark.parametrize("name", ["tsai", "opencv, five", "homography"])
def test_ground_noise_agrees_with_sampled_pixels(name: str, rng: np.random.Generator) -> None:
    camera = CAMERAS[name]
    cov = np.array([[4.0, 1.5], [1.5, 9.0]])
    pixel = np.array([[100.0, 400, 700], [350, 420, 560]])
    found = ground_covariance(camera, pixel, repeated(cov, 3))
    for i in range(3):
        cloud = pixel[:, i, None] + np.linalg.cholesky(cov) @ rng.standard_normal((2, 40_000))
        sampled = np.cov(camera.ground(cloud))
        np.testing.assert_allclose(found[i], sampled, atol=0.05 * np.trace(sampled))


def nees(distance: float, rng: np.random.Generator, n: int) -> np.ndarray:
    """(n,) normalised squared errors of one Kalman update each, on a person ``distance`` m ahead, 2
    pixels of noise.
    """
    camera = posed(tsai(5e-3))
    deviation = 2.0
    prior = 0.5**2 * np.eye(2)
    direction = camera.rotation[2, :2] / np.linalg.norm(camera.rotation[2, :2])
    expected = (camera.position[:2] + distance * direction)[:, None]
    true = expected + 0.5 * rng.standard_normal((2, n))
    pixel = camera.pixels(true) + deviation * rng.standard_normal((2, n))
    z = camera.ground(pixel)
    noise = ground_covariance(camera, pixel, repeated(deviation**2 * np.eye(2), n))
    gain = prior @ np.linalg.inv(prior + noise)
    error = expected + np.einsum("nij,jn->in", gain, z - expected) - true
    return np.einsum("in,nij,jn->n", error, np.linalg.inv(prior - gain @ prior), error)


def test_kalman_filter_with_ground_noise_is_consistent() -> None:
    """NEES of 8000 updates, 12 to 60 m away, within its 95 % band; and near and far apart within
    99.9 %.
    """
    rng = np.random.default_rng(13)
    n = 2000
    each = [nees(distance, rng, n) for distance in (12.0, 25.0, 40.0, 60.0)]
    low, high = chi2.ppf([0.025, 0.975], 2 * n * len(each)) / (n * len(each))
    assert low < np.mean(each) < high
    low, high = chi2.ppf([0.0005, 0.9995], 2 * n) / n
    assert all(low < values.mean() < high for values in each)
