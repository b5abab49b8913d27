"""Noises of boxes and motion from series of detections: exact moments of the model, drawn tracks, wrong links, limits."""

import numpy as np
import pytest

from phdtrack.arrays import to_xyxy
from phdtrack.models import BoxMotion
from phdtrack.scene.rates import Moments, Noise
from phdtrack.scene.rates.noise import LIMIT
from phdtrack.scene.verdict import Look
from phdtrack.types import Tracks

SETTINGS = Noise(0.15, 0.005, 0.07)


def looks(rng, noise, interval, tracks=30, frames=60):
    """Frames of tracks that move and are measured with this noise, ``interval`` time units apart, 25 a second."""
    motion = BoxMotion(noise.acceleration, noise.resize)
    x = np.tile([[500.0], [400], [0], [0], [40], [90]], (1, tracks))
    out = []
    for number in range(1, frames + 1):
        deviation = noise.spread * np.concatenate([x[4:6] / 2, x[4:6]])
        box = to_xyxy(np.concatenate([x[:2], x[4:6]]) + deviation * rng.normal(size=(4, tracks)))
        own = np.arange(tracks)
        rows = Tracks(np.full(tracks, number), own + 1, box, np.ones(tracks), own, np.ones(tracks, np.bool_))
        out.append(Look(number, (number - 1) * interval / 25, box, np.zeros(tracks), rows))
        x = motion.sample(x, interval, rng)
    return tuple(out)


@pytest.mark.parametrize("interval", [0.5, 1.0, 3.5])
@pytest.mark.parametrize("noise", [Noise(0.05, 0.02, 0.03), Noise(0.1, 0.01, 0.02)])
def test_noises_that_were_drawn_are_found(noise, interval):
    found = Moments().joined(looks(np.random.default_rng(0), noise, interval, frames=80), 80, 25.0).noise(SETTINGS)
    assert found.spread == pytest.approx(noise.spread, rel=0.12)
    # What the measurement's noise drowns is not told exactly.
    assert found.acceleration == pytest.approx(noise.acceleration, rel=0.25, abs=0.25 * noise.spread / interval**1.5)
    assert found.resize == pytest.approx(noise.resize, rel=0.25, abs=0.25 * noise.spread / interval**0.5)


def test_series_are_the_same_whether_frames_are_judged_at_once_or_a_few_at_a_time():
    every = looks(np.random.default_rng(1), SETTINGS, 1.0, tracks=4, frames=30)
    at_once, bit_by_bit = Moments().joined(every, 20, 25.0), Moments()
    for start in range(0, 20, 4):
        bit_by_bit = bit_by_bit.joined(every[start : start + 10], 4, 25.0)
    assert at_once.products.shape == (5, 4 * 20)
    assert np.sort(bit_by_bit.products, axis=1) == pytest.approx(np.sort(at_once.products, axis=1))


def test_without_series_the_settings_hold():
    assert Moments().noise(SETTINGS) == SETTINGS
    assert Moments().joined((), 0, 25.0).noise(SETTINGS) == SETTINGS
    some = Moments().joined(looks(np.random.default_rng(2), SETTINGS, 1.0), 50, 25.0)
    assert some.noise(Noise()) == Noise()


def test_a_gap_breaks_a_series():
    every = looks(np.random.default_rng(3), SETTINGS, 1.0, tracks=1, frames=9)
    missed = (*every[:4], Look(5, every[4].time, every[4].xyxy[:0], every[4].chance[:0], Tracks.empty()), *every[5:])
    assert Moments().joined(missed, 9, 25.0).products.shape == (5, 0)


def test_a_few_wrong_links_change_little():
    rng, noise = np.random.default_rng(4), Noise(0.08, 0.01, 0.03)
    plain = Moments().joined(looks(rng, noise, 1.0, frames=70), 70, 25.0)
    wrong = plain.products.copy()
    wrong[:, :: len(wrong[0]) // 30] *= 300
    found = Moments(wrong, plain.interval).noise(SETTINGS)
    assert found.spread == pytest.approx(plain.noise(SETTINGS).spread, rel=0.1)


def test_estimates_stay_within_limits():
    still = Moments(np.zeros((5, 2000)), np.ones(2000)).noise(SETTINGS)
    wild = Moments(np.tile([[900.0], [-300], [900], [-300], [100]], 2000), np.ones(2000)).noise(SETTINGS)
    assert still.spread >= SETTINGS.spread / LIMIT
    assert wild.spread == pytest.approx(SETTINGS.spread * LIMIT)
