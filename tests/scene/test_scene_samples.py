"""Training samples: first states of tracks, volumes, and the prior over detected sizes."""

import numpy as np
import pytest

from phdtrack.arrays import to_cxcywh
from phdtrack.errors import InputError
from phdtrack.models.volumes import image_volume
from phdtrack.scene import LearnedDensity, SceneDensity
from phdtrack.scene.training import (
    PRIOR,
    WIDENING,
    births_in,
    first_state,
    measurement_volume,
    state_volume,
    with_prior,
)
from phdtrack.types import Tracks


def track(identity, first, count, start, velocity, size=(40.0, 80.0)):
    """A track at constant velocity, pixels a frame."""
    frame = first + np.arange(count)
    centre = np.array(start) + np.arange(count)[:, None] * np.array(velocity)
    xyxy = np.hstack([centre - np.array(size) / 2, centre + np.array(size) / 2])
    none = np.zeros(count, np.int64)
    return Tracks(frame, none + identity, xyxy, np.ones(count), none, np.ones(count, bool))


def test_first_states_of_straight_tracks():
    """A frame is 2.5 time units; tracks of the first frame were not born then."""
    walkers = track(1, 3, 70, (50, 60), (2, -1)), track(2, 10, 18, (300, 100), (-4, 0.5), (20, 50))
    states = births_in(
        Tracks.concatenate([*walkers, track(3, 1, 30, (200, 200), (9, 0))]), fps=10, rate=25
    )
    np.testing.assert_allclose(
        states.T, [[50, 60, 0.8, -0.4, 40, 80], [300, 100, -1.6, 0.2, 20, 50]]
    )
    assert births_in(Tracks.empty(), 25, 25).shape == (6, 0)


def test_noise_of_single_boxes_is_averaged():
    rng = np.random.default_rng(0)
    box = to_cxcywh(track(1, 2, 12, (100, 100), (3, 0)).xyxy)
    seconds = np.arange(12) / 25
    found = np.array(
        [first_state(box + rng.normal(size=(1, 12)), seconds)[2] / 25 for _ in range(200)]
    )
    # A slope through eleven points, steps of one: deviation 1/√110.
    assert found.std() == pytest.approx(1 / np.sqrt(110), rel=0.2)
    assert found.mean() == pytest.approx(3, abs=4 / np.sqrt(110 * 200))


def test_volumes_equal_those_of_uniform_models():
    low, high = measurement_volume(640, 480)
    assert np.prod(high - low) == image_volume((640.0, 480.0))
    low, high = state_volume((640, 480), 30)
    assert np.prod(high - low) == image_volume((640.0, 480.0)) * 60**2


def test_flickering_light_gives_no_birth_samples():
    """A long track in one place, and a moving one that ends within a second, are not entries."""
    rng = np.random.default_rng(1)
    light = track(1, 5, 200, (300, 200), (0, 0))
    shaken = light.xyxy + np.tile(rng.normal(size=(200, 2)) * 8, 2)
    light = Tracks(
        light.frame, light.identity, shaken, light.confidence, light.detection, light.confirmed
    )
    there = track(9, 1, 300, (10, 10), (0, 0))
    brief = track(2, 30, 20, (100, 100), (9, 0))
    walker = track(3, 40, 60, (50, 60), (2, -1))
    states = births_in(Tracks.concatenate([light, there, brief, walker]), fps=25, rate=25)
    assert states.shape == (6, 1)
    np.testing.assert_allclose(states[:2, 0], [50, 60])


# The prior over detected sizes


def learned(samples: int, uniform: float) -> LearnedDensity:
    """One place in a frame of 640x480."""
    high = np.array([640.0, 480, 640, 480])
    mean = np.array([[100.0, 100, 30, 60]]).T
    p = SceneDensity(np.zeros(4), high, uniform, np.ones(1), mean, np.diag([25.0, 25, 4, 4])[None])
    return LearnedDensity(2.0, p, samples)


def test_size_range_is_slightly_wider_than_detected():
    p = with_prior(
        learned(90, 0.5), np.vstack([np.linspace(20, 40, 1001), np.linspace(50, 100, 1001)])
    ).density
    np.testing.assert_allclose(p.low, [0, 0, 20.2 / WIDENING, 50.5 / WIDENING])
    np.testing.assert_allclose(p.high, [640, 480, 39.8 * WIDENING, 99.5 * WIDENING])
    # One detection of an odd size does not count.
    odd = np.full((2, 1000), 30.0)
    odd[:, 0] = 400
    assert with_prior(learned(90, 0.5), odd).density.high[2] == pytest.approx(30 * WIDENING)
    with pytest.raises(InputError, match="no detections"):
        with_prior(learned(90, 0.5), np.zeros((2, 0)))


@pytest.mark.parametrize("samples", [10, 30, 1000])
def test_few_samples_keep_wide_components(samples: int):
    """With n samples the uniform part is at least that of PRIOR additional uniform ones; a larger
    one stays.
    """
    sizes = np.array([[20.0, 60], [40, 120]])
    small, large = (with_prior(learned(samples, uniform), sizes).density for uniform in (1e-3, 0.7))
    assert small.uniform == pytest.approx(max(1e-3, PRIOR / (samples + PRIOR)))
    assert large.uniform == pytest.approx(0.7)
    x = np.random.default_rng(0).uniform(small.low[:, None], small.high[:, None], (4, 400_000))
    values = small(x) * small.volume
    assert values.mean() == pytest.approx(1, abs=5 * values.std() / np.sqrt(x.shape[1]))
