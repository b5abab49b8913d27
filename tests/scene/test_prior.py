"""What stands beside little that was learned."""

import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.scene import LearnedDensity, SceneDensity
from phdtrack.scene.training import PRIOR, WIDENING, detected_sizes, with_prior

SIZES = np.array([20.0, 40.0]), np.array([60.0, 120.0])


def learned(samples: int, uniform: float) -> LearnedDensity:
    """One place in a frame of 640x480."""
    cov = np.diag([25.0, 25, 4, 4])[None]
    p = SceneDensity(
        np.zeros(4), np.array([640.0, 480, 640, 480]), uniform, np.ones(1), np.array([[100.0, 100, 30, 60]]).T, cov
    )
    return LearnedDensity(2.0, p, samples)


def test_sizes_are_those_detected_and_somewhat_more():
    size = np.vstack([np.linspace(20, 40, 1001), np.linspace(50, 100, 1001)])
    low, high = detected_sizes(size)
    np.testing.assert_allclose(low * WIDENING, [20.2, 50.5])
    np.testing.assert_allclose(high / WIDENING, [39.8, 99.5])
    with pytest.raises(InputError, match="no detections"):
        detected_sizes(np.zeros((2, 0)))


def test_one_detection_of_an_odd_size_does_not_count():
    size = np.full((2, 1000), 30.0)
    size[:, 0] = 400
    assert detected_sizes(size)[1].max() == pytest.approx(30 * WIDENING)


@pytest.mark.parametrize("samples", [10, 30, 1000])
def test_few_samples_are_sure_of_little(samples: int):
    """Of n samples the uniform part is that of PRIOR more that might be anywhere; one that is larger stays."""
    assert with_prior(learned(samples, 1e-3), SIZES).density.uniform == pytest.approx(max(1e-3, PRIOR / (samples + PRIOR)))
    assert with_prior(learned(samples, 0.7), SIZES).density.uniform == pytest.approx(0.7)


def test_a_humbled_density_integrates_to_one_over_its_sizes():
    p = with_prior(learned(90, 1e-3), SIZES).density
    np.testing.assert_array_equal(p.low, [0, 0, 20, 40])
    np.testing.assert_array_equal(p.high, [640, 480, 60, 120])
    rng = np.random.default_rng(0)
    x = rng.uniform(p.low[:, None], p.high[:, None], (4, 400_000))
    values = p(x) * p.volume
    assert values.mean() == pytest.approx(1, abs=5 * values.std() / np.sqrt(x.shape[1]))
