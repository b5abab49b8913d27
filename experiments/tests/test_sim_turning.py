"""The standard nonlinear scenario: its truth is the model's without noise, its measurements are
what it says.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from experiments.bearing import BearingSensor, TurningMotion
from experiments.standard_scenes import (
    TURNING_FIRST,
    TURNING_LAST,
    TURNING_START,
    Turning,
    turning,
    turning_states,
)
from phdtrack.errors import InputError


def test_targets_follow_the_model_without_its_noise():
    """Scan by scan one step of f(x|ξ)'s mean, which another formula computes."""
    motion = TurningMotion()
    before, known = turning_states(1)
    np.testing.assert_array_equal(before, TURNING_START[:1].T)
    for scan in range(2, 101):
        state, identity = turning_states(scan)
        moved, _, _ = motion.transition(before, 1.0)
        for who, x in zip(identity.tolist(), state.T, strict=True):
            expected = moved[:, list(known).index(who)] if who in known else TURNING_START[who - 1]
            np.testing.assert_allclose(x, expected, rtol=1e-9, atol=1e-9)
        before = state
        known = identity


def test_number_of_targets_and_where_they_are():
    number = {
        scan: turning_states(scan)[0].shape[1]
        for scan in (1, 9, 10, 20, 40, 60, 66, 67, 80, 81, 100)
    }
    assert number == {1: 1, 9: 1, 10: 4, 20: 5, 40: 8, 60: 10, 66: 10, 67: 9, 80: 9, 81: 7, 100: 7}
    assert ((TURNING_FIRST >= 1) & (TURNING_LAST <= 100)).all()
    for scan in range(1, 101):
        x, _ = turning_states(scan)
        assert (x[1] > 0).all()
        assert np.hypot(*x[:2]).max() < 2082


def test_measurements_scatter_as_the_sensor_says():
    """Over 20 realisations: bearings and ranges, the share that is seen, the number and extent of
    false ones.
    """
    model = replace(Turning(), p_detect=0.9, clutter_rate=7.0)
    sensor = BearingSensor(bearing=model.sd_bearing, reach=model.sd_range)
    steps = []
    seen = 0
    there = 0
    false = []
    for seed in range(20):
        scene = turning(np.random.default_rng(seed), model)
        assert scene.model == model
        for state, identity, z, source in zip(
            scene.state, scene.identity, scene.measurement, scene.source, strict=True
        ):
            own = source > 0
            x = state[:, np.searchsorted(identity, source[own])]
            steps.append(sensor.innovation(z[:, own], sensor.predicted_measurements(x)))
            false.append(z[:, ~own])
            seen = seen + int(own.sum())
            there = there + len(identity)
    step = np.concatenate(steps, axis=1) / np.array([[model.sd_bearing], [model.sd_range]])
    assert (np.abs(step.mean(axis=1)) < 4 / math.sqrt(seen)).all()
    assert (np.abs(step.std(axis=1) - 1) < 4 / math.sqrt(2 * seen)).all()
    assert abs(seen / there - 0.9) < 4 * math.sqrt(0.09 / there)
    clutter = np.concatenate(false, axis=1)
    n = clutter.shape[1]
    assert abs(n / 2000 - 7) < 4 * math.sqrt(7 / 2000)
    share = (clutter - [[-math.pi / 2], [0]]) / [[math.pi], [2000]]
    assert ((share >= 0) & (share <= 1)).all()
    assert (np.abs(share.mean(axis=1) - 0.5) < 4 / math.sqrt(12 * n)).all()
    assert (np.abs(share.std(axis=1) - 1 / math.sqrt(12)) < 0.01).all()


def test_far_targets_are_seen_less_where_the_detection_fades():
    """Share of those that are seen beyond and below 1500 m, against the sensor's own p_D."""
    model = replace(Turning(), fade=2000.0, clutter_rate=0.0)
    sensor = BearingSensor(detection_probability=model.p_detect, fade=2000.0)
    seen = []
    expected = []
    far = []
    for seed in range(20):
        scene = turning(np.random.default_rng(seed), model)
        for state, identity, source in zip(scene.state, scene.identity, scene.source, strict=True):
            seen.append(np.isin(identity, source))
            expected.append(sensor.p_detect(state))
            far.append(np.hypot(*state[:2]) > 1500)
    hit, p, away = (np.concatenate(part) for part in (seen, expected, far))
    for part in (away, ~away):
        assert abs(hit[part].mean() - p[part].mean()) < 4 * math.sqrt(0.25 / part.sum())
    assert p[away].max() <= 0.98 * math.exp(-0.5 * 0.75**2) <= p[~away].min()


def test_same_seed_same_measurements_whatever_the_clutter():
    one, again = (turning(np.random.default_rng(3)) for _ in range(2))
    clear = turning(np.random.default_rng(3), replace(Turning(), clutter_rate=0.0))
    for a, b, c, source in zip(
        one.measurement, again.measurement, clear.measurement, one.source, strict=True
    ):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(np.sort(a[:, source > 0]), np.sort(c))


@pytest.mark.parametrize("wrong", [{"p_detect": 1.5}, {"clutter_rate": -1.0}])
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(InputError):
        turning(np.random.default_rng(0), replace(Turning(), **wrong))
