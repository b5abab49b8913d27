import numpy as np
import pytest

from phdtrack.arrays import to_cxcywh
from phdtrack.models.volume import image_volume
from phdtrack.scene.training import births_in, distance_gone, first_states, measurement_volume, state_volume
from phdtrack.types import Tracks


def track(identity, first, count, start, velocity, size=(40.0, 80.0)):
    """A track at constant velocity, pixels a frame."""
    frame = first + np.arange(count)
    centre = np.array(start) + np.arange(count)[:, None] * np.array(velocity)
    xyxy = np.hstack([centre - np.array(size) / 2, centre + np.array(size) / 2])
    none = np.zeros(count, np.int64)
    return Tracks(frame, none + identity, xyxy, np.ones(count), none, np.ones(count, bool))


def test_first_states_of_straight_tracks():
    tracks = Tracks.concatenate([track(1, 3, 20, (50, 60), (2, -1)), track(2, 10, 8, (300, 100), (-4, 0.5), (20, 50))])
    # At 10 frames a second and 25 time units a second a frame is 2.5 time units.
    everything = Tracks.concatenate([tracks, track(3, 1, 30, (200, 200), (0, 0))])
    states = first_states(everything, fps=10, rate=25)
    np.testing.assert_allclose(states[:, 0], [50, 60, 0.8, -0.4, 40, 80])
    np.testing.assert_allclose(states[:, 1], [300, 100, -1.6, 0.2, 20, 50])
    assert states.shape == (6, 2)


def test_who_is_there_from_the_start_and_short_tracks_are_no_births():
    tracks = Tracks.concatenate([track(1, 1, 20, (50, 60), (2, -1)), track(2, 10, 4, (300, 100), (1, 1))])
    assert first_states(tracks, 25, 25).shape == (6, 0)
    assert first_states(Tracks.empty(), 25, 25).shape == (6, 0)


def test_noise_on_single_boxes_is_averaged():
    rng = np.random.default_rng(0)
    parts = []
    for k in range(200):
        one = track(k + 1, 2, 12, (100, 100), (3, 0))
        parts.append(
            Tracks(
                one.frame, one.identity, one.xyxy + rng.normal(size=(12, 1)), one.confidence, one.detection, one.confirmed
            )
        )
    # Somebody has to be there first.
    states = first_states(Tracks.concatenate([*parts, track(999, 1, 3, (0, 0), (0, 0))]), 25, 25)
    # A slope through eleven points, steps of one: deviation 1/√110.
    assert states[2].std() == pytest.approx(1 / np.sqrt(110), rel=0.2)
    assert states[2].mean() == pytest.approx(3, abs=4 / np.sqrt(110 * 200))


def test_volumes_are_those_that_uniform_models_use():
    low, high = measurement_volume(640, 480)
    assert np.prod(high - low) == image_volume((640.0, 480.0))
    low, high = state_volume(640, 480, 30)
    assert np.prod(high - low) == image_volume((640.0, 480.0)) * 60**2


def test_rows_may_show_less_than_a_box():
    tracks = Tracks.concatenate([track(1, 1, 9, (0, 0), (0, 0)), track(2, 3, 20, (50, 60), (2, -1))])
    metres = 0.1 * (tracks.xyxy[:, :2] + tracks.xyxy[:, 2:]).T / 2
    states = first_states(tracks, fps=10, rate=1, shown=metres)
    np.testing.assert_allclose(states[:, 0], [5, 6, 2, -1])
    assert states.shape == (4, 1)


def test_how_far_a_track_has_gone_is_told_in_sizes():
    """40 frames of 3 pixels, between the middles of the first and of the last fifth 32 of them; √(30 · 120) = 60."""
    one = track(1, 2, 40, (50, 60), (3, 0), (30, 120))
    assert distance_gone(to_cxcywh(one.xyxy)) == pytest.approx(32 * 3 / 60)


def test_light_that_trembles_teaches_no_births():
    """In one place for long, and one that moves but is distance_gone within a second: nobody has entered."""
    rng = np.random.default_rng(1)
    light = track(1, 5, 200, (300, 200), (0, 0))
    shaken = light.xyxy + np.tile(rng.normal(size=(200, 2)) * 8, 2)
    light = Tracks(light.frame, light.identity, shaken, light.confidence, light.detection, light.confirmed)
    there, brief = track(9, 1, 300, (10, 10), (0, 0)), track(2, 30, 20, (100, 100), (9, 0))
    walker = track(3, 40, 60, (50, 60), (2, -1))
    states = births_in(Tracks.concatenate([light, there, brief, walker]), fps=25, rate=25)
    assert states.shape == (6, 1)
    np.testing.assert_allclose(states[:2, 0], [50, 60])
