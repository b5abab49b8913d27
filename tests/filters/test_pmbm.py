"""The Poisson multi-Bernoulli mixture: targets that have not been detected yet, trajectories, what
is given back.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mht_cases import EVERYTHING, RNG, boxes, chain, partitions, run, scene, world
from phd_cases import NoBirth

from phdtrack.filters import MHT, PMB, PMBM, BestHypothesis
from phdtrack.filters.undetected import recycled, still_undetected, survived, with_births
from phdtrack.models import FixedBirth, MeasurementBirth
from phdtrack.types import GaussianMixture
from reference.mht_twin import enumerate_histories, lived, summed

SCANS = {
    "two": [boxes((300, 200), (330, 210)), boxes((305, 203), (325, 212)), boxes((310, 205))],
    "late": [boxes(), boxes((305, 203)), boxes((309, 205), (250, 190))],
    "gone": [boxes((300, 200)), boxes((303, 202)), boxes(), boxes()],
    "back": [boxes((300, 200)), boxes(), boxes((309, 205)), boxes()],
}
PLACE = GaussianMixture(
    np.array([0.7]),
    np.array([[300.0], [200], [1], [0], [40], [80]]),
    np.diag([2000.0, 2000, 18, 18, 60, 60])[None],
)
SETTINGS = [{}, {"detection": 0.5, "survival": 0.95}, {"clutter": 1e-7}]
EXACT = PMBM(
    max_hypotheses=20000,
    hypothesis_threshold=1e-290,
    history=30,
    existence_threshold=1e-290,
    gate_probability=1.0,
)


@pytest.mark.parametrize("name", SCANS)
@pytest.mark.parametrize("settings", SETTINGS)
def test_probability_of_undetected_targets_equals_enumeration(name: str, settings: dict):
    """A Poisson process of targets before the first frame, each first detected in whatever
    frame.
    """
    model = replace(world(**settings), birth=NoBirth())
    scans = SCANS[name]
    wanted, there, states = summed(enumerate_histories(scans, model, 1.0, PLACE))
    state, _ = run(replace(EXACT, initial=PLACE), scans, model)
    found = partitions(state, scans)
    assert found.keys() == wanted.keys()
    for key, (weight, leaves) in found.items():
        assert weight == pytest.approx(wanted[key], rel=1e-8), key
        for sequence, leaf in leaves.items():
            assert state.leaves.r[leaf] == pytest.approx(there.get((key, sequence), 0.0), rel=1e-8)
            mean, cov = states[key, sequence]
            np.testing.assert_allclose(state.leaves.mean[leaf], mean, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(state.leaves.covariance[leaf], cov, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", SCANS)
@pytest.mark.parametrize("settings", SETTINGS)
def test_past_of_best_hypothesis_is_the_trajectory_posterior(name: str, settings: dict):
    """States by the joint Gaussian of all frames; that a target was there, by all histories of the
    same partition.
    """
    model = replace(world(**settings), birth=NoBirth())
    scans = SCANS[name]
    histories = enumerate_histories(scans, model, 1.0, PLACE)
    state, _ = run(replace(EXACT, initial=PLACE), scans, model)
    key, (_, leaves) = max(partitions(state, scans).items(), key=lambda item: item[1][0])
    best = {
        int(state.leaves.label[leaf]): taken
        for taken, leaf in leaves.items()
        if leaf in state.best()
    }
    told = BestHypothesis(min_weight=1e-300, merge_iou=1.0, smoothed=True).extract(
        state, np.zeros((4, 0)), model
    )
    # The first of `past` is the layer before the first frame.
    frames = [*told.past[1:], told]
    checked = 0
    for k, here in enumerate(frames):
        for i, label in enumerate(here.tag.tolist()):
            if label not in best:
                continue
            taken = best[label]
            assert here.weight[i] == pytest.approx(lived(histories, key, taken, k), rel=1e-7)
            means, covs = chain(taken, scans, PLACE.mean[:, 0], PLACE.covariance[0], model)
            np.testing.assert_allclose(here.state[:, i], means[k], rtol=1e-7, atol=1e-7)
            np.testing.assert_allclose(here.covariance[i], covs[k], rtol=1e-6, atol=1e-6)
            checked += 1
    assert checked >= 2


def test_undetected_intensity_reaches_its_equilibrium():
    """One place, nothing moves: λ = γ (1 − p_D)/(1 − p_S (1 − p_D)), and λ⁺ = γ + p_S λ."""
    model = world(detection=0.3, survival=0.9, birth=0.05)
    model = replace(model, motion=replace(model.motion, acceleration=0.0, size_noise=0.0))
    still = GaussianMixture(
        np.array([1.25]), np.array([[300.0], [200], [0], [0], [40], [80]]), np.eye(6)[None] * 1e-9
    )
    model = replace(model, birth=FixedBirth(still))
    unseen = GaussianMixture.empty(6)
    z = np.zeros((4, 0))
    for _ in range(200):
        births = with_births(survived(unseen, model, 1.0, "linear"), model, z, 1.0)
        unseen = still_undetected(births, model)
    assert births.weight.sum() == pytest.approx(0.05 / (1 - 0.9 * 0.7), rel=1e-3)
    assert unseen.mass == pytest.approx(0.7 * births.weight.sum(), rel=1e-3)


@pytest.mark.parametrize(
    "filter_",
    [PMBM(existence_threshold=0.05), PMB(existence_threshold=0.05, mean_visible_time=0.0)],
)
def test_what_has_become_improbable_is_given_back(filter_):
    """A target is missed until it is given up: its mass goes to the undetected ones, at its place,
    and not to nothing.
    """
    model = world(detection=0.6, survival=0.999, birth=1e-3, clutter=1e-10)
    track = [boxes((300 + 3 * k, 200)) for k in range(6)]
    state, _ = run(filter_, track, model)
    assert state.mass > 0.9
    for _ in range(30):
        before = state.mass
        state, _ = filter_.step(state, boxes(), model, 1.0, RNG)
        if state.mass < 1e-9:
            break
    assert state.mass < 1e-9
    given = state.undetected.weight[np.abs(state.undetected.mean[0] - 330) < 60].sum()
    # Of the mass of the frame before p_S (1 − p_D) is left, in the mean; births at the same place
    # are 1e-4 a frame.
    assert 0.2 * before < given < before


def test_giving_back_keeps_mass_and_mean():
    rng = np.random.default_rng(3)
    weight = rng.uniform(1e-3, 0.1, 50)
    mean = rng.normal(0, 3, (50, 6))
    out = recycled(PLACE, weight, mean, np.tile(np.eye(6), (50, 1, 1)))
    assert out.mass == pytest.approx(0.7 + weight.sum(), rel=1e-12)
    np.testing.assert_allclose(
        out.mean @ out.weight, PLACE.mean @ PLACE.weight + weight @ mean, rtol=1e-10, atol=1e-10
    )


def test_pmbm_confirms_target_missed_at_birth_before_mht():
    """p_D is a half: who is first seen in the third frame may well have come in the first."""
    model = world(detection=0.5, survival=0.99, birth=0.01, clutter=2e-7)
    born = model.birth.places
    tight = GaussianMixture(born.weight, born.mean, np.diag([9.0, 9, 1, 1, 4, 4])[None])
    model = replace(model, birth=FixedBirth(tight))
    scans = [boxes(), boxes(), boxes((303, 200))]
    ours, theirs = (run(f, scans, model)[0].mass for f in (PMBM(), EVERYTHING))
    assert ours > 1.05 * theirs
    assert ours == pytest.approx(
        run(PMB(mean_visible_time=0.0, static_clutter_prior=0.0), scans, model)[0].mass, rel=1e-3
    )


def test_pmbm_without_undetected_targets_equals_mht():
    """Births around the detections have no memory: as long as nothing is decided or given back both
    say the same.
    """
    scans = scene(np.random.default_rng(4), 8, targets=3, clutter=2)
    model = replace(world(clutter=1e-9), birth=MeasurementBirth(births_per_detection=0.5))
    few = {"max_hypotheses": 300, "history": 30, "existence_threshold": 1e-12}
    ours, theirs = (run(kind(**few), scans, model)[0] for kind in (PMBM, MHT))
    assert ours.mass == pytest.approx(theirs.mass, rel=1e-9)
