"""What holds for every intensity: masses, empty and unobserved frames, order, limits, seeds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from phd_cases import FRAME, crowd, freeze, same, seen_by, with_births, world

from phdtrack.errors import InputError
from phdtrack.filters import NoFilter, ParticlePHD
from phdtrack.models import BoxMotion, FixedBirth, SplitSpawn, UniformBirth, UniformClutter
from phdtrack.types import GaussianMixture, Particles

seeds = st.integers(0, 2**32 - 1)
NOTHING = Particles(np.zeros((6, 0)), np.zeros(0))
NO_BOXES = np.zeros((4, 0))


@given(seeds, st.integers(0, 4), st.floats(0.01, 2), st.integers(1, 400))
@settings(max_examples=60, deadline=None)
def test_reducing_keeps_the_mass_in_equal_weights(seed: int, targets: int, mass: float, particles_per_target: int):
    rng = np.random.default_rng(seed)
    state = crowd(rng, targets, 30, mass)
    reduced = ParticlePHD(particles_per_target).reduce(state, rng)
    assert len(reduced) == round(particles_per_target * state.mass)
    if len(reduced):
        np.testing.assert_array_equal(reduced.weight, np.full(len(reduced), state.mass / len(reduced)))
        assert reduced.mass == pytest.approx(state.mass, rel=1e-12)
        assert {tuple(x) for x in reduced.state.T} <= {tuple(x) for x in state.state.T}


def test_reducing_keeps_the_intensity_in_expectation(rng):
    state = crowd(rng, 3, 200)
    reduced = ParticlePHD(400).reduce(state, rng)
    # Systematic: each particle has its share of offspring within one.
    count = {tuple(x): 0 for x in state.state.T}
    for x in reduced.state.T:
        count[tuple(x)] += 1
    share = state.weight / state.mass * len(reduced)
    assert np.all(np.abs(np.array(list(count.values())) - share) < 1 + 1e-9)


def test_the_number_of_particles_can_be_capped(rng):
    state = crowd(rng, 5, 100)
    capped = ParticlePHD(1000, max_particles=700).reduce(state, rng)
    assert len(capped) == 700
    assert capped.mass == pytest.approx(state.mass)
    assert len(ParticlePHD(100, max_particles=700).reduce(state, rng)) == 500


@pytest.mark.parametrize("mass", [0.0, 1e-12, 1e-5])
def test_next_to_no_mass_becomes_an_empty_valid_state(mass: float, rng):
    state, recursion, model = crowd(rng, 1, 50, mass), ParticlePHD(), with_births(world())
    reduced = recursion.reduce(state, rng)
    assert reduced.state.shape == (6, 0)
    predicted = recursion.predict(reduced, model, 1.0, rng)
    updated, info = recursion.update(predicted, seen_by(rng, state, 2), model, 1.0, rng)
    assert np.isfinite(updated.weight).all()
    assert info.mass_predicted == info.mass_born


@given(seeds, st.floats(0.1, 5), st.floats(0, 1))
@settings(max_examples=40, deadline=None)
def test_predicting_multiplies_the_mass_with_survival(seed: int, dt: float, survival: float):
    rng = np.random.default_rng(seed)
    state = crowd(rng, 3, 40)
    model = replace(world(), motion=BoxMotion(survival_probability=survival**25))
    predicted = ParticlePHD().predict(state, model, dt, rng)
    assert predicted.mass == pytest.approx(state.mass * survival**dt, rel=1e-12)
    spawning = replace(model, motion=BoxMotion(survival_probability=survival**25, births=SplitSpawn(rate=0.1, fraction=0.5)))
    predicted = ParticlePHD().predict(state, spawning, dt, rng)
    assert predicted.mass == pytest.approx(state.mass * (survival**dt + 0.1 * dt), rel=1e-12)


def test_targets_that_left_the_frame_are_dropped(rng):
    state = crowd(rng, 6, 50)
    moved = state.state.copy()
    moved[0, :100] = -1e4
    predicted = ParticlePHD().predict(Particles(moved, state.weight), world(), 1.0, rng)
    assert len(predicted) == 200
    assert predicted.mass == pytest.approx(0.99 * state.weight[100:].sum())


@pytest.mark.parametrize("p_detect", [0.0, 0.7, 0.95, 1.0])
def test_an_empty_scan_leaves_what_is_missed(p_detect: float, rng):
    state = crowd(rng, 3, 50)
    model = world(detection_probability=p_detect)
    updated, info = ParticlePHD().update(state, NO_BOXES, model, 1.0, rng)
    np.testing.assert_array_equal(updated.state, state.state)
    np.testing.assert_allclose(updated.weight, (1 - p_detect) * state.weight, rtol=1e-14, atol=1e-18)
    assert info.mass == pytest.approx((1 - p_detect) * state.mass)
    assert info.mass_predicted == pytest.approx(state.mass)
    assert info.mass_born == 0
    assert info.evidence.shape == info.clutter.shape == (0,)
    if p_detect == 1:
        assert updated.mass == 0


def test_an_empty_scan_can_be_skipped(rng):
    state = crowd(rng, 3, 50)
    updated, info = ParticlePHD(skip_empty_frames=True).update(state, NO_BOXES, world(), 1.0, rng)
    same(updated, state)
    assert info.mass == info.mass_predicted == pytest.approx(3)


def test_births_come_in_an_empty_scan_too(rng):
    model = world(birth=UniformBirth(FRAME, births_per_second=25 * 0.2), detection_probability=0.9)
    updated, info = ParticlePHD().update(NOTHING, NO_BOXES, model, 2.0, rng)
    assert info.mass_born == pytest.approx(0.4)
    assert updated.mass == info.mass == pytest.approx(0.04)


@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed"])
def test_the_order_of_detections_does_not_matter(scaling: str, rng):
    """Exactly that of the weights and of C(z); births are switched off, since they are drawn detection by detection."""
    state = crowd(rng, 5, 80)
    z = seen_by(rng, state, 9)
    model, order = world(scaling=scaling), rng.permutation(9)
    a, about_a = ParticlePHD().update(state, z, model, 1.0, rng)
    b, about_b = ParticlePHD().update(state, np.ascontiguousarray(z[:, order]), model, 1.0, rng)
    np.testing.assert_allclose(a.weight, b.weight, rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(about_a.evidence[order], about_b.evidence, rtol=1e-12)
    np.testing.assert_allclose(about_a.clutter[order], about_b.clutter)


def test_with_births_the_order_does_not_matter_on_average(rng):
    state = crowd(rng, 2, 80)
    z = np.hstack([seen_by(rng, state, 2), [[50.0, 60], [400, 100], [20, 30], [50, 60]]])
    model = with_births(world())

    def masses(order):
        return [ParticlePHD().update(state, z[:, order].copy(), model, 1.0, rng)[1].evidence for _ in range(60)]

    forward, backward = np.array(masses([0, 1, 2, 3])), np.array(masses([3, 2, 1, 0]))[:, ::-1]
    error = np.sqrt((forward.var(0) + backward.var(0)) / 60)
    assert np.all(np.abs(forward.mean(0) - backward.mean(0)) <= 4 * error + 1e-12)


def test_a_well_explained_detection_brings_one_target_and_a_strange_one_what_the_rates_say(rng):
    """Mass of a detection: C/(κ + C). κ → 0 makes it one; κ above all evidence makes it nothing."""
    state = crowd(rng, 1, 200)
    z = state.state[[0, 1, 4, 5], :1].copy()
    for rate, low, high in ((1e-9, 1.0, 1.1), (1e12, 0.05, 0.0501)):
        clutter = UniformClutter(rate, (FRAME[0] * FRAME[1]) ** 2)
        _, info = ParticlePHD().update(state, z, world(clutter=clutter, detection_probability=0.95), 1.0, rng)
        assert low <= info.mass <= high
        expected = info.evidence / (info.evidence + info.clutter)
        np.testing.assert_allclose(1 - info.clutter_probability, expected)


def test_a_detection_that_nothing_explains_vanishes_and_is_counted(rng):
    """κ = 0 and C = 0: the term is 0, not NaN."""
    state = crowd(rng, 2, 60, width=200.0)
    far = np.array([[5000.0], [5000], [20], [40]])
    near = seen_by(rng, state, 1)
    model = world(clutter=UniformClutter(0.0, 1.0), detection_probability=1.0)
    updated, info = ParticlePHD().update(state, np.hstack([far, near, far + 50]), model, 1.0, rng)
    assert info.vanished == 2
    assert updated.mass == pytest.approx(1.0)
    assert np.isfinite(updated.weight).all()
    np.testing.assert_array_equal(info.clutter_probability[[0, 2]], [1.0, 1.0])
    # Particles of no weight explain nothing either.
    ghosts = Particles(np.repeat(model.sensor.states(far)[0], 5, axis=1), np.zeros(5))
    updated, info = ParticlePHD().update(ghosts, far, model, 1.0, rng)
    assert info.vanished == 1
    np.testing.assert_array_equal(updated.weight, np.zeros(5))
    empty, info = ParticlePHD().update(NOTHING, far, model, 1.0, rng)
    assert info.vanished == 1
    assert empty.mass == 0


@pytest.mark.parametrize("deviations", [38.0, 39.0, 39.06, 39.5, 60.0])
def test_a_likelihood_far_out_in_its_tail_does_not_poison_the_weights(deviations: float, rng):
    """κ = 0 and a size so unlike all particles that g is a denormal number: its reciprocal would be infinite."""
    x = np.array([[100.0, 100.0], [100, 100], [0, 0], [0, 0], [20, 20.3], [40, 40]])
    z = np.array([[100.0], [100], [20 + 20 * 0.15 * deviations], [40]])
    model = world(clutter=UniformClutter(0.0, 1.0), detection_probability=0.9)
    updated, _ = ParticlePHD().update(Particles(x, np.ones(2)), z, model, 1.0, rng)
    assert np.isfinite(updated.weight).all()
    assert updated.mass <= 1.2 + 1e-9


def test_mass_cannot_exceed_what_detections_and_misses_allow(rng):
    """After an update: at most one for each detection and (1 − p_D) of what was predicted."""
    model = with_births(world(detection_probability=0.9), rate=5.0)
    for _ in range(5):
        state = crowd(rng, 6, 40, mass=2.0)
        _, info = ParticlePHD().update(state, seen_by(rng, state, 4), model, 1.0, rng)
        assert info.mass <= 4 + 0.1 * info.mass_predicted + 1e-9


def test_covered_detections_have_no_births(rng):
    state = crowd(rng, 1, 300, mass=1.2, spread=0.03)
    z = np.average(state.state, axis=1, weights=state.weight)[[0, 1, 4, 5], None]
    _, info = ParticlePHD().update(state, z, with_births(world()), 1.0, rng)
    assert info.mass_born == 0
    half = Particles(state.state, state.weight / 2.4)
    _, info = ParticlePHD().update(half, z, with_births(world()), 1.0, rng)
    assert 0 < info.mass_born < 0.05


def test_the_initial_intensity(rng):
    model = world()
    assert len(ParticlePHD().start(model, rng)) == 0
    given_particles = crowd(rng, 2, 20)
    same(ParticlePHD(initial=given_particles).start(model, rng), given_particles)
    cov = np.stack([np.diag([25.0, 9, 1, 1, 4, 16])] * 2)
    mean = np.array([[100.0, 50, 1, 0, 20, 40], [300, 60, 0, 1, 30, 50]]).T
    drawn = ParticlePHD(5000, initial=GaussianMixture(np.array([1.0, 0.5]), mean, cov)).start(model, rng)
    assert len(drawn) == 10_000
    first = drawn.state[0] < 200
    assert drawn.weight[first].sum() == pytest.approx(1.0)
    assert drawn.weight[~first].sum() == pytest.approx(0.5)
    np.testing.assert_allclose(drawn.state[:, first].mean(1), mean[:, 0], atol=4 * 5 / math.sqrt(5000))
    np.testing.assert_allclose(np.cov(drawn.state[:, ~first]), cov[1], atol=1.5)


def test_the_same_seed_gives_the_same_intensity(rng):
    model, recursion = with_births(world()), ParticlePHD(300)
    scans = [seen_by(rng, crowd(rng, 3, 10), 4) for _ in range(4)]

    def run(seed: int) -> Particles:
        own = np.random.default_rng(seed)
        state = recursion.start(model, own)
        for z in scans:
            state, _ = recursion.update(recursion.predict(state, model, 1.0, own), z, model, 1.0, own)
            state = recursion.reduce(state, own)
        return state

    same(run(7), run(7))
    assert not np.array_equal(run(7).state, run(8).state)


@pytest.mark.parametrize("scaling", ["particle", "detection", "previous", "fixed"])
def test_nobody_writes_into_what_he_received(scaling: str, rng):
    model = with_births(world(scaling=scaling))
    model = replace(model, motion=replace(model.motion, births=SplitSpawn(rate=0.1)))
    recursion = ParticlePHD(200)
    state = crowd(rng, 2, 50)
    if scaling == "previous":
        state = Particles(np.vstack([state.state, state.state[4:6]]), state.weight)
    z = seen_by(rng, state, 3)
    z.flags.writeable = False
    predicted = freeze(recursion.predict(freeze(state), model, 1.0, rng))
    updated, info = recursion.update(predicted, z, model, 1.0, rng)
    recursion.reduce(freeze(updated), rng)
    assert info.evidence.shape == (3,)


def test_given_covariances_and_fixed_births_pass_through(rng):
    state = crowd(rng, 2, 100)
    z = np.vstack([seen_by(rng, state, 3), np.full((4, 3), 16.0)])
    mean, cov = np.array([[100.0, 50, 1, 0, 20, 40]]).T, np.eye(6)[None]
    model = world(birth=FixedBirth(GaussianMixture(np.array([0.02]), mean, cov), 50), scaling="given")
    updated, info = ParticlePHD().update(state, z, model, 1.5, rng)
    assert info.mass_born == pytest.approx(0.03)
    assert len(updated) == 250


def test_settings_out_of_bounds():
    for wrong in ({"particles_per_target": 0}, {"max_particles": -1}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            ParticlePHD(**wrong)


def test_no_filter_takes_each_detection_for_a_target(rng):
    model, z = world(), seen_by(rng, crowd(rng, 3, 10), 5)
    recursion = NoFilter()
    state = recursion.predict(recursion.start(model, rng), model, 1.0, rng)
    assert len(state) == 0
    state, info = recursion.update(state, z, model, 1.0, rng)
    np.testing.assert_array_equal(state.state[[0, 1, 4, 5]], z)
    assert info.mass == recursion.reduce(state, rng).mass == 5
    assert len(recursion.predict(state, model, 1.0, rng)) == 0
    np.testing.assert_array_equal(info.clutter_probability, np.zeros(5))
