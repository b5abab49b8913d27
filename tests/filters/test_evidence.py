"""The log evidence of a frame: that of PHD filters is log p(Z) but for ∫ κ, by enumeration of who
caused what.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from mht_cases import RNG, boxes, scene
from phd_cases import world as phd_world
from pmb_cases import PLAIN, world
from scipy.stats import multivariate_normal

from phdtrack.filters import GMCPHD, GMPHD, MHT, PMB, NoFilter, ParticlePHD
from phdtrack.types import GaussianMixture

H = np.eye(6)[[0, 1, 4, 5]]
P_DETECT = 0.8


def prior() -> GaussianMixture:
    """1.7 targets around two places that overlap."""
    mean = np.array([[200.0, 150, 0, 0, 30, 60], [212.0, 155, 0, 0, 32, 58]]).T
    cov = np.stack([np.diag([9.0, 9, 1, 1, 4, 4]), np.diag([16.0, 9, 1, 1, 4, 6])])
    return GaussianMixture(np.array([1.1, 0.6]), mean, cov)


SCANS = [
    np.zeros((4, 0)),
    np.array([[202.0, 151, 31, 60]]).T,
    np.array([[202.0, 151, 31, 60], [211.0, 154, 31, 59], [215.0, 150, 30, 62]]).T,
]


@pytest.mark.parametrize("z", SCANS, ids=lambda z: f"{z.shape[1]} detections")
def test_log_evidence_of_poisson_targets_equals_enumeration(z):
    """Σ over the number of targets, over which detections are theirs, and over which of them each
    is of.
    """
    model = phd_world(detection_probability=P_DETECT)
    state = prior()
    # The world has one false alarm a frame.
    kappa = model.clutter.intensity(z)
    noise = model.sensor.covariance
    density = [
        sum(
            state.weight[i]
            / state.mass
            * multivariate_normal.pdf(
                z[:, j],
                H @ state.mean[:, i],
                H @ state.covariance[i] @ H.T + noise(z[:, j : j + 1], state.mean[:, i : i + 1])[0],
            )
            for i in range(2)
        )
        for j in range(z.shape[1])
    ]
    total = 0.0
    for n in range(60):
        number = math.exp(-state.mass) * state.mass**n / math.factorial(n)
        for k in range(min(n, z.shape[1]) + 1):
            ways = math.perm(n, k) * (1 - P_DETECT) ** (n - k)
            for own in combinations(range(z.shape[1]), k):
                terms = [P_DETECT * density[j] if j in own else kappa[j] for j in range(z.shape[1])]
                total += number * ways * math.prod(terms)
    _, info = GMPHD(gate_probability=1.0).update(state, z, model, 1.0, RNG)
    assert info.detected == pytest.approx(P_DETECT * state.mass)
    assert info.log_evidence - 1.0 == pytest.approx(
        math.log(math.exp(-1.0) * total), rel=1e-9, abs=1e-9
    )


def test_of_a_step_it_is_that_of_its_update():
    model = phd_world(detection_probability=P_DETECT)
    for filter_ in (GMPHD(), GMCPHD()):
        state = replace(filter_, initial=prior()).start(model, RNG)
        predicted = filter_.predict(state, model, 1.0, RNG)
        _, updated = filter_.update(predicted, SCANS[2], model, 1.0, RNG)
        _, stepped = filter_.step(state, SCANS[2], model, 1.0, RNG)
        assert stepped.detected == pytest.approx(updated.detected)
        assert stepped.log_evidence == pytest.approx(updated.log_evidence)


def test_particles_come_near_to_the_gaussians():
    model = phd_world(detection_probability=P_DETECT)
    z = SCANS[2]
    _, exact = GMPHD(gate_probability=1.0).update(prior(), z, model, 1.0, RNG)
    found = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        filter_ = ParticlePHD(particles_per_target=3000, initial=prior())
        _, info = filter_.update(filter_.start(model, rng), z, model, 1.0, rng)
        found.append(info.log_evidence)
    error = np.std(found, ddof=1) / math.sqrt(len(found))
    assert abs(np.mean(found) - exact.log_evidence) < 4 * error + 0.01


@pytest.mark.parametrize("filter_", [PMB(), PLAIN, MHT()], ids=["pmb", "without sources", "mht"])
def test_of_targets_it_counts_what_each_lets_expect(filter_):
    """With one hypothesis per target that cannot hide: Σ log(κ + C) − p_D Σ r."""
    model = world(detection=P_DETECT, clutter=1e-8, birth=1e-9)
    state = filter_.start(model, RNG)
    for z in scene(np.random.default_rng(3), 12, targets=3, clutter=2):
        predicted = filter_.predict(state, model, 1.0, RNG)
        _, info = filter_.update(predicted, z, model, 1.0, RNG)
        total = info.evidence + info.clutter
        assert info.log_evidence == pytest.approx(
            sum(math.log(x) for x in total if x > 0) - info.detected
        )
        if filter_ is PLAIN:
            assert info.detected == pytest.approx(P_DETECT * predicted.present.targets["r"].sum())
        assert 0 <= info.detected <= 20
        state, _ = filter_.step(state, z, model, 1.0, RNG)
    assert info.detected > 1


def test_what_was_foretold_has_more_of_it_than_what_surprises():
    model = world(detection=0.95, clutter=1e-9, birth=1e-9)
    state = PLAIN.start(model, RNG)
    for k in range(8):
        state, _ = PLAIN.step(state, boxes((200 + 2 * k, 200)), model, 1.0, RNG)
    foretold, aside, none = (
        PLAIN.step(state, z, model, 1.0, RNG)[1].log_evidence
        for z in (boxes((216, 200)), boxes((260, 260)), boxes())
    )
    assert foretold > aside
    assert none == pytest.approx(-0.95, abs=0.03)


def test_without_a_filter_there_is_none():
    model = world()
    _, info = NoFilter().step(NoFilter().start(model, RNG), boxes((200, 200)), model, 1.0, RNG)
    assert math.isnan(info.log_evidence)
