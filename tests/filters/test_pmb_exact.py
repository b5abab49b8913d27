"""Where the Poisson multi-Bernoulli filter is exact: one target; the first doubt between several;
numbers on average.
"""

from __future__ import annotations

from dataclasses import replace

import mht_cases
import numpy as np
import pytest
import test_mht_enumeration
from mht_cases import RNG, boxes, run, told, walk
from pmb_cases import (
    EVERYTHING,
    PLAIN,
    One,
    bernoulli,
    kalman,
    moved_on,
    pasts,
    without_births,
    world,
)

from phdtrack.filters import PMB, pmb
from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture
from reference.mht_twin import enumerate_histories, summed


@pytest.mark.parametrize("transform", ["linear", "unscented"])
@pytest.mark.parametrize("dt", [1.0, 2.5])
def test_on_clean_data_it_is_a_kalman_filter(transform: str, dt: float):
    """Always seen, nothing else: states and covariances of every frame, also as told later."""
    model = world(detection=1.0, clutter=0.0, survival=1.0)
    path = walk((200, 150), (3, 1), 25, np.random.default_rng(3))
    scans = [boxes(here) for here in path]
    state, info = run(replace(PLAIN, transform=transform), scans, model, dt)
    found = told(state, model)
    assert found.tag.tolist() == [0]
    assert info.mass == found.weight[0] == pytest.approx(1, abs=1e-12)
    (mean,), (cov,) = (x.T if x.ndim == 2 else x for x in model.sensor.states(scans[0]))
    means = [mean]
    for z in scans[1:]:
        mean, cov = kalman(model, mean, cov, z[:, 0], dt)
        means.append(mean)
    np.testing.assert_allclose(found.state[:, 0], mean, rtol=0, atol=1e-9 * 640)
    np.testing.assert_allclose(found.covariance[0], cov, rtol=1e-9, atol=1e-9)
    for layer, mean in zip(state.layers, means[-11:], strict=True):
        np.testing.assert_allclose(layer.mean[0], mean, rtol=0, atol=1e-9 * 640)


def turns(filter_: PMB, seconds: float) -> np.ndarray:
    """(2, 2) the exponential of the chain's generator, summed as its series."""
    rates = np.array(
        [
            [-1 / filter_.mean_visible_time, 1 / filter_.mean_visible_time],
            [1 / filter_.mean_occluded_time, -1 / filter_.mean_occluded_time],
        ]
    )
    out = term = np.eye(2)
    for k in range(1, 60):
        term = term @ rates * (seconds / k)
        out = out + term
    return out


SCANS = {
    "alone": [(300, 200), [(302, 203)], [], [(309, 204)], []],
    "doubts": [
        (300, 200),
        [(302, 203), (295, 197)],
        [(305, 200)],
        [(308, 203), (310, 196), (299, 199)],
    ],
    "standing": [(300, 200), [], [(300, 201)], [(301, 199)], [], [(300, 200)]],
    "lost": [(300, 200), [], [(420, 300)], [], []],
}


@pytest.mark.parametrize("dt", [1.0, 4.0])
@pytest.mark.parametrize(
    "settings",
    [
        {"static_clutter_prior": 0.0},
        {"static_clutter_prior": 0.3, "static_clutter_detection_probability": 0.4},
        {"mean_visible_time": 0.5, "mean_occluded_time": 1.0},
    ],
)
@pytest.mark.parametrize("name", SCANS)
def test_one_target_is_followed_exactly(name: str, settings: dict, dt: float, monkeypatch):
    """Every past, what the target is, and whether it is hidden, enumerated: existence, weights,
    states, hidden chain. What stands still stays so for good, which is the exact case.
    """
    monkeypatch.setattr(pmb, "MEAN_STANDING_TIME", np.inf)
    filter_ = replace(EVERYTHING, **settings)
    model = world(clutter=3e-8, birth=2e-8, detection=0.8, survival=0.95)
    first, *rest = SCANS[name]
    state, info = run(filter_, [boxes(first)], model, dt)
    both = filter_.mean_visible_time + filter_.mean_occluded_time
    born = 0.8 * 2e-8 * dt * filter_.mean_visible_time / both
    r = born / (born + 3e-8)
    mean, cov = model.sensor.states(boxes(first))
    prior = filter_.static_clutter_prior
    standing = pmb.STANDING * (1 - prior) if prior else 0.0
    kinds = [
        (False, True, 1 - prior - standing),
        (True, True, standing),
        (True, False, prior),
    ]
    nobody = 1 - r
    ways = [
        One(r * w, (0,), static, genuine, False, mean[:, 0], cov[0])
        for static, genuine, w in kinds
        if w > 0
    ]
    assert info.mass == pytest.approx(r * (1 - prior))
    # Births so rare that they change nothing.
    model = world(clutter=3e-8, birth=1e-290, detection=0.8, survival=0.95)
    chain = turns(filter_, dt / 25)
    for points in rest:
        z = boxes(*points)
        before = sum(w.weight for w in ways)
        ways = moved_on(ways, model, dt, chain)
        nobody, ways = bernoulli(
            nobody + before - sum(w.weight for w in ways),
            ways,
            z,
            model,
            filter_.static_clutter_detection_probability,
        )
        state, info = filter_.step(state, z, model, dt, RNG)
    now = state.present
    assert now.targets["r"][0] == pytest.approx(1 - nobody, rel=1e-9)
    assert info.mass == pytest.approx(now.targets["presence"][0], rel=1e-12)
    assert now.targets["presence"][0] == pytest.approx(
        sum(w.weight for w in ways if w.genuine), rel=1e-9
    )
    keys = list(zip(pasts(state), now.hypotheses["static"].tolist(), strict=True))[
        : now.targets["end"][0]
    ]
    assert len(set(keys)) == len(keys)
    # But for what is next to impossible.
    assert set(keys) >= {(w.taken, w.static) for w in ways if w.weight > 1e-100}
    for i, key in enumerate(keys):
        mine = [w for w in ways if (w.taken, w.static) == key]
        weight = sum(w.weight for w in mine)
        assert now.targets["r"][0] * now.hypotheses["weight"][i] == pytest.approx(weight, rel=1e-8)
        genuine = sum(w.weight for w in mine if w.genuine)
        hidden = sum(w.weight for w in mine if w.hidden) / genuine
        assert now.hypotheses["occluded"][i] == pytest.approx(hidden, rel=1e-8, abs=1e-12)
        if key[1]:
            odds = np.log(genuine / (weight - genuine))
            assert now.hypotheses["genuine"][i] == pytest.approx(odds, rel=1e-8, abs=1e-10)
        np.testing.assert_allclose(now.mean[i], mine[0].mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(now.covariance[i], mine[0].cov, rtol=1e-8, atol=1e-8)


NOBODY = GaussianMixture.empty(6)
HISTORIES = {
    "one between two": [boxes((285, 200), (315, 205)), boxes((300, 203))],
    "none of two": [boxes((285, 200), (315, 205)), boxes()],
    "two of one": [boxes((300, 200)), boxes((303, 199), (293, 205))],
    "three after nobody": [boxes(), boxes((300, 200), (310, 210), (290, 204))],
}


@pytest.mark.parametrize("name", HISTORIES)
@pytest.mark.parametrize(
    "settings", [{}, {"detection": 0.99, "survival": 0.99}, {"clutter": 1e-7, "birth": 0.2}]
)
def test_several_targets_have_the_probabilities_of_all_histories(name: str, settings: dict):
    """As long as what can be confused forms no cycle: every target's existence, hypotheses, and the
    false alarms.
    """
    model = mht_cases.world(**settings)
    scans = HISTORIES[name]
    histories = enumerate_histories(scans, model, 1.0, NOBODY)
    total = sum(w for w, *_ in histories)
    state, info = run(
        replace(EVERYTHING, mean_visible_time=0.0, static_clutter_prior=0.0), scans, model
    )
    wanted: dict[tuple, float] = {}
    for w, _, tracks in histories:
        for track in tracks:
            if track.alive:
                wanted[track.taken] = wanted.get(track.taken, 0.0) + w / total
    found = {}
    now = state.present
    last = len(scans) - 1
    for i, past in enumerate(pasts(state)):
        taken = tuple((last - len(past) + 1 + k, j) for k, j in enumerate(past) if j >= 0)
        found[taken] = (
            found.get(taken, 0.0)
            + now.targets["r"][now.hypotheses["target"][i]] * now.hypotheses["weight"][i]
        )
    assert found.keys() == wanted.keys()
    for key, probability in wanted.items():
        assert found[key] == pytest.approx(probability, rel=1e-8), key
    assert info.mass == state.mass == pytest.approx(sum(wanted.values()), rel=1e-8)
    false = [
        sum(w for w, alarms, _ in histories if (last, j) in alarms) / total
        for j in range(scans[-1].shape[1])
    ]
    np.testing.assert_allclose(info.clutter_probability, false, rtol=1e-8)
    born = sum(w * sum(t.taken[0][0] == last for t in tracks) for w, _, tracks in histories) / total
    assert info.mass_born == pytest.approx(born, rel=1e-8)


@pytest.mark.parametrize("name", ["two and two", "a miss", "one more"])
def test_later_doubts_are_nearly_those_of_all_histories(name: str):
    """Three scans: targets are taken to be independent after each, and pairs form cycles."""
    model = mht_cases.world(detection=0.95)
    scans = test_mht_enumeration.SCANS[name]
    weight, there, _ = summed(enumerate_histories(scans, model, 1.0, NOBODY))
    expected = sum(weight[key] * p for (key, _), p in there.items())
    state, _ = run(
        replace(EVERYTHING, mean_visible_time=0.0, static_clutter_prior=0.0), scans, model
    )
    assert state.mass == pytest.approx(expected, rel=0.02)


def test_initial_targets_are_believed_as_given():
    model = without_births(world(detection=0.9, clutter=1e-9, survival=1.0))
    mean = np.array([[200.0, 100, 0, 0, 40, 80], [400, 100, 0, 0, 40, 80]]).T
    given = GaussianMixture(np.array([1.0, 0.4]), mean, np.tile(4 * np.eye(6), (2, 1, 1)))
    filter_ = replace(PLAIN, initial=given)
    assert filter_.start(model, RNG).mass == pytest.approx(1.4)
    state, _ = filter_.step(filter_.start(model, RNG), boxes(), model, 1.0, RNG)
    r = 0.4
    np.testing.assert_allclose(
        state.present.targets["presence"], [1, r * 0.1 / (1 - r * 0.9)], rtol=1e-9
    )
    state, _ = filter_.step(state, boxes((201, 100), (399, 101)), model, 1.0, RNG)
    assert told(state, model).tag.tolist() == [0, 1]


def simulated(
    rng, model: Model, frames: int, arrivals: float, alarms: float
) -> tuple[list, np.ndarray]:
    """Scans of a world that is as the model says, and how many were there in each frame."""
    p_s = model.motion.survival_probability ** (1 / model.rate)
    p_d = model.sensor.detection_probability
    x = np.zeros((6, 0))
    scans = []
    number = []
    low = np.array([0.0, 0, 30, 60])
    high = np.array([640.0, 480, 50, 100])
    for _ in range(frames):
        x = x[:, rng.random(x.shape[1]) < p_s]
        if x.shape[1]:
            mean, _, q = model.motion.transition(x, 1.0)
            x = (
                mean
                + np.stack([rng.multivariate_normal(np.zeros(6), c, method="eigh") for c in q]).T
            )
        new = rng.uniform(low, high, (rng.poisson(arrivals), 4)).T
        speed = rng.normal(0, model.sensor.birth_speed_pixels / np.sqrt(2), new[:2].shape)
        x = np.hstack([x, np.vstack([new[:2], speed, new[2:]])])
        seen = x[:, rng.random(x.shape[1]) < p_d][[0, 1, 4, 5]]
        seen = seen + 3 * rng.standard_normal(seen.shape)
        scans.append(
            np.ascontiguousarray(
                np.hstack([seen, rng.uniform(low, high, (rng.poisson(alarms), 4)).T])
            )
        )
        number.append(x.shape[1])
    return scans, np.array(number)


def test_the_expected_number_is_the_number_on_average():
    """Twenty runs of a world that is as the model says: the mean of mass − number is within three
    standard errors.

    Those who have not been detected yet are not in the mass: 0.25 a frame arrive and 0.1 of them
    wait a frame, 0.01 two.
    """
    volume = 640.0 * 480 * 20 * 40
    model = world(detection=0.9, survival=0.97, birth=0.25 / volume, clutter=2.0 / volume)
    error = []
    masses = []
    for seed in range(20):
        scans, number = simulated(np.random.default_rng(seed), model, 80, 0.25, 2.0)
        state = PLAIN.start(model, RNG)
        mass = []
        for z in scans:
            state, info = PLAIN.step(state, z, model, 1.0, RNG)
            mass.append(info.mass)
        error.append(np.mean(np.array(mass)[10:] - number[10:]))
        masses.append(np.mean(number[10:]))
    unseen = 0.25 * 0.1 / (1 - 0.1 * 0.97)
    bias = np.mean(error) + unseen
    standard = np.std(error, ddof=1) / np.sqrt(20)
    assert np.mean(masses) > 4
    assert abs(bias) < 3 * standard + 0.02
