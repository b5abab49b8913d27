"""From particles to states: targets are found, not split, not joined, not invented."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from extract_cases import (
    EXTRACTORS,
    HERE,
    MODEL,
    NAMES,
    ROWS,
    THERE,
    cloud,
    moved,
    nearest_state,
    seen,
    together,
    world,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from composed import drawn
from phdtrack.filters import Mixture, ParticlePHD, Raw
from phdtrack.filters.extract import finish
from phdtrack.kernels.mixtures import Gaussians
from phdtrack.types import Estimates, Particles

both = pytest.mark.parametrize("extractor", EXTRACTORS, ids=NAMES)


@both
@pytest.mark.parametrize("p_detect", [0.7, 0.8, 0.9, 0.98])
def test_one_target_is_always_one_state(extractor, p_detect: float):
    """Filtered through misses, at the masses it then has: up to 1/(1 − p_M p_S), which is 1.42 at
    p_D = 0.7.
    """
    model = world(p_detect)
    recursion = ParticlePHD(300)
    heaviest = 0.0
    believed = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        state = recursion.start(model, rng)
        x = np.append([2000.0, 2000, 2, 1], HERE[4:])[:, None]
        for _ in range(30):
            x = drawn(model.motion, x, 1.0, rng)
            x[4:6] = np.clip(x[4:6], [[25], [60]], [[60], [150]])
            z = x[ROWS] + model.sensor.noise(x)[ROWS] * rng.standard_normal((4, 1))
            z = z[:, : int(rng.random() < p_detect)]
            state, _ = recursion.update(
                recursion.predict(state, model, 1.0, rng), z, model, 1.0, rng
            )
            state = recursion.reduce(state, rng)
            heaviest = max(heaviest, state.mass)
            found = extractor.extract(state, z, model)
            assert len(found) == (state.mass >= extractor.min_weight)
            believed += len(found)
    assert believed > 100
    assert heaviest <= 1 / (1 - (1 - p_detect) * 0.99) + 0.01
    assert heaviest > 0.97 / (1 - (1 - p_detect) * 0.99)


@both
@pytest.mark.parametrize("mass", [0.62, 1.0, 1.42, 1.49])
@pytest.mark.parametrize("spread", [0.2, 0.5, 1.0, 1.5])
def test_a_single_cloud_is_never_split(extractor, mass: float, spread: float):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        state = cloud(rng, HERE, mass, spread=spread)
        for z in (seen(), seen(HERE), seen(THERE)):
            found = extractor.extract(state, z, MODEL)
            assert len(found) == 1
            assert found.weight[0] == pytest.approx(mass, rel=0.06)


@both
@pytest.mark.parametrize("mass", [1.52, 1.8, 2.1])
@pytest.mark.parametrize("number_seen", [0, 1, 2])
def test_two_targets_a_box_apart_are_two(extractor, mass: float, number_seen: int):
    for seed in range(12):
        rng = np.random.default_rng(seed)
        beside = moved(40) if seed % 2 else moved(0, 100)
        share = rng.uniform(0.45, 0.55)
        state = together(cloud(rng, HERE, mass * share), cloud(rng, beside, mass * (1 - share)))
        z = seen(HERE, beside)[:, :number_seen]
        found = extractor.extract(state, z + 1.0, MODEL)
        assert len(found) == 2
        assert {nearest_state(found, HERE), nearest_state(found, beside)} == {0, 1}
        # Where it was not seen the split decides alone, and may cut a little of the neighbour off.
        np.testing.assert_allclose(
            found.weight[nearest_state(found, HERE)], mass * share, rtol=0.15
        )


@both
def test_a_missed_target_is_found_and_does_not_move_another(extractor, rng):
    state = together(cloud(rng, HERE, 1.0), cloud(rng, THERE, 0.7))
    found = extractor.extract(state, seen(HERE), MODEL)
    alone = extractor.extract(cloud(np.random.default_rng(20090706), HERE, 1.0), seen(HERE), MODEL)
    assert len(found) == 2
    a = nearest_state(found, HERE)
    b = nearest_state(found, THERE)
    np.testing.assert_allclose(found.state[:, a], alone.state[:, 0], rtol=1e-9)
    assert found.weight[b] == pytest.approx(0.7)
    np.testing.assert_allclose(found.state[:2, b], THERE[:2], atol=2)
    assert found.detection[a] == 0
    assert found.detection[b] == -1


@both
def test_missed_targets_are_found_behind_the_scraps_of_clutter(extractor):
    """Each false alarm leaves a few particles; they must not use up the search for a target that
    was missed.
    """
    for seed in range(10):
        rng = np.random.default_rng(seed)
        scraps = [cloud(rng, [*rng.uniform(0, 4000, 2), 0, 0, 30, 70], 0.02, 10) for _ in range(25)]
        missed = [np.array([x, 3500.0, 0, 0, 40, 100]) for x in (500, 1500, 2500)]
        parts = [*scraps, cloud(rng, HERE, 1.05, 500), *(cloud(rng, m, 0.8, 400) for m in missed)]
        if seed % 2:
            parts.reverse()
        found = extractor.extract(together(*parts), seen(HERE), MODEL)
        assert len(found) == 4
        for at in missed:
            assert np.abs(found.state[:2, nearest_state(found, at)] - at[:2]).max() < 3


@both
def test_missed_target_with_scattered_particles_is_found(extractor, rng):
    state = together(
        cloud(rng, HERE, 1.0),
        cloud(rng, THERE, 0.7),
        *(cloud(rng, [x, 3000, 0, 0, 30, 60], 0.03, 20) for x in range(0, 4000, 200)),
    )
    order = rng.permutation(len(state))
    found = extractor.extract(
        Particles(state.state[:, order].copy(), state.weight[order]), seen(HERE), MODEL
    )
    assert len(found) == 2


@both
def test_a_far_light_remnant_does_not_bias_a_target(extractor, rng):
    remnant = cloud(rng, moved(120), 0.2, 80)
    found = extractor.extract(together(cloud(rng, HERE, 1.0), remnant), seen(HERE), MODEL)
    assert len(found) == 1
    assert found.weight[0] == pytest.approx(1.0)
    assert abs(found.state[0, 0] - HERE[0]) < 1


@both
def test_detected_twice_and_joined_by_overlap(extractor):
    """The filter takes two detections for two targets; the extractor with overlap for one
    object.
    """
    for seed in range(8):
        rng = np.random.default_rng(seed)
        beside = moved(5, 8, 0, 0, 3, -6)
        state = together(cloud(rng, HERE, 1.0), cloud(rng, beside, 1.0))
        z = seen(HERE, beside)
        joined = replace(extractor, merge_iou=0.4).extract(state, z, MODEL)
        assert len(joined) == 1
        assert joined.weight[0] == pytest.approx(2.0)
        np.testing.assert_allclose(joined.state[:, 0], state.state.mean(1), rtol=1e-6)
        assert joined.detection[0] in (0, 1)
        apart = replace(extractor, merge_iou=0.4).extract(
            together(cloud(rng, HERE, 1.0), cloud(rng, THERE, 1.0)), z, MODEL
        )
        assert len(apart) == 2


@both
def test_identical_detections_start_one_cluster(extractor, rng):
    found = extractor.extract(cloud(rng, HERE, 1.0), seen(HERE, HERE, HERE), MODEL)
    assert len(found) == 1
    assert found.detection[0] == 0


@both
def test_nothing_to_find(extractor, rng):
    nothing = Particles(np.zeros((6, 0)), np.zeros(0))
    for state in (nothing, cloud(rng, HERE, 1e-9), cloud(rng, HERE, 0.45), cloud(rng, HERE, 0.0)):
        for z in (seen(), seen(HERE)):
            found = extractor.extract(state, z, MODEL)
            assert len(found) == 0
            assert found.state.shape == (6, 0)
            assert found.covariance.shape == (0, 6, 6)
            assert found.xyxy.shape == (0, 4)
    # Enough mass, but nowhere enough in one place.
    dust = together(*(cloud(rng, [x, 500, 0, 0, 20, 20], 0.1, 5) for x in range(0, 4000, 200)))
    assert len(extractor.extract(dust, seen(), MODEL)) == 0


@both
def test_covariances_are_positive_definite(extractor, rng):
    """Also where resampling has left copies of a single particle."""
    copies = Particles(np.repeat(HERE[:, None], 50, axis=1), np.full(50, 0.02))
    state = together(copies, cloud(rng, THERE, 1.0), cloud(rng, THERE + 500, 2.2, 3))
    found = extractor.extract(state, seen(HERE), MODEL)
    assert len(found) >= 2
    for cov in found.covariance:
        np.testing.assert_allclose(cov, cov.T)
        assert np.linalg.eigvalsh(cov).min() > 0
    spread = found.covariance[nearest_state(found, THERE)]
    own = np.cov(state.state[:, 50:450])
    assert np.diag(spread) == pytest.approx(np.diag(own), rel=0.1)


@both
@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.integers(0, 6))
@settings(max_examples=40, deadline=None)
def test_the_order_of_detections_does_not_matter(extractor, seed: int, targets: int, alarms: int):
    """The set of states is the same, and each names the same detection."""
    rng = np.random.default_rng(seed)
    at = np.array(
        [
            [200.0 + 400 * i, 500, 0, 0, rng.uniform(20, 60), rng.uniform(50, 120)]
            for i in range(targets)
        ]
    )
    state = together(*(cloud(rng, x, rng.uniform(0.5, 1.4), 120) for x in at))
    z = seen(*at)[:, rng.random(targets) < 0.8] + rng.normal(0, 1, 1)
    z = np.hstack(
        [
            z,
            np.vstack(
                [
                    rng.uniform(0, 2600, (1, alarms)),
                    np.full((1, alarms), 1500),
                    np.full((2, alarms), 50),
                ]
            ),
        ]
    )
    order = rng.permutation(z.shape[1])
    a = extractor.extract(state, z, MODEL)
    b = extractor.extract(state, np.ascontiguousarray(z[:, order]), MODEL)
    assert len(a) == len(b)
    into = [nearest_state(b, x) for x in a.state.T]
    assert sorted(into) == list(range(len(b)))
    np.testing.assert_allclose(a.state, b.state[:, into], rtol=1e-9)
    np.testing.assert_allclose(a.weight, b.weight[into], rtol=1e-9)
    back = np.append(order, -1)
    np.testing.assert_array_equal(a.detection, back[b.detection[into]])


@both
def test_states_name_the_detection_that_they_rest_on(extractor, rng):
    """The closest within the 99 % region; one detection serves one state."""
    far = moved(25)
    near = moved(2)
    found = extractor.extract(cloud(rng, HERE, 1.0), seen(THERE, far, near), MODEL)
    assert list(found.detection) == [2]
    found = extractor.extract(cloud(rng, HERE, 1.0), seen(THERE, moved(0, 0, 0, 0, 40)), MODEL)
    assert list(found.detection) == [-1]
    beside = moved(30)
    found = extractor.extract(
        together(cloud(rng, HERE, 1.0), cloud(rng, beside, 1.0)), seen(HERE), MODEL
    )
    assert sorted(found.detection) == [-1, 0]
    assert found.detection[nearest_state(found, HERE)] == 0


def test_a_detection_serves_the_closest_state_only():
    """Two states share one detection; and, the other way round, one state between two."""
    beside = moved(4)
    peaks = Gaussians(np.ones(2), np.array([beside, HERE]).T.copy(), np.stack([np.eye(6)] * 2))
    assert list(finish(peaks, seen(moved(1)), MODEL).detection) == [-1, 0]
    assert list(finish(peaks, seen(moved(1), moved(6)), MODEL).detection) == [1, 0]
    # The closest pair goes first: the second detection is nearer to both, and the first is left to
    # the other.
    assert list(finish(peaks, seen(moved(-3), moved(2.5)), MODEL).detection) == [1, 0]
    assert list(finish(peaks, seen(), MODEL).detection) == [-1, -1]


def test_mixture_finds_means_and_weights_of_overlapping_targets(rng):
    """Two clouds that touch: K-means cuts between them and pushes the means apart, EM does not."""
    beside = moved(14)
    state = together(
        cloud(rng, HERE, 1.2, 4000, spread=1.0), cloud(rng, beside, 0.8, 4000, spread=1.0)
    )
    found = Mixture(merge_iou=1.0, iterations=60).extract(state, seen(HERE, beside), MODEL)
    assert len(found) == 2
    order = np.argsort(found.state[0])
    np.testing.assert_allclose(found.weight[order], [1.2, 0.8], atol=0.1)
    np.testing.assert_allclose(found.state[0, order], [HERE[0], beside[0]], atol=0.7)


def test_raw_detections_are_states():
    found = Raw().extract(Particles(np.zeros((6, 0)), np.zeros(0)), seen(HERE, THERE), MODEL)
    assert isinstance(found, Estimates)
    np.testing.assert_array_equal(found.state[ROWS], seen(HERE, THERE))
    assert list(found.detection) == [0, 1]
    assert list(found.weight) == [1, 1]
