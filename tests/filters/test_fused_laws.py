"""What holds for the fused step whatever the intensity: masses, empty scans, limits, odd input, order, seeds."""

from __future__ import annotations

import numpy as np
import pytest
from fused_cases import (
    NO_BOXES,
    NOTHING,
    Composed,
    Fixed,
    check,
    check_info,
    freeze,
    identical,
    level,
    model_of,
    same_info,
    seen_by,
    still,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from phd_cases import FRAME

from phdtrack.filters import ParticlePHD
from phdtrack.models import BoxMotion, MeasurementBirth, UniformClutter
from phdtrack.types import GaussianMixture, ParticleBlocks, Particles

PHD = ParticlePHD(particles_per_target=300)
seeds = st.integers(0, 2**32 - 1)
IMAGE = MeasurementBirth(25 * 0.05, 200, "image", FRAME)


@pytest.mark.parametrize("dt", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("p_detect", [0.0, 0.7, 1.0])
def test_an_empty_scan_leaves_what_survives_and_is_missed(p_detect: float, dt: float, rng):
    state = level(rng, 3, 200)
    after, info = PHD.step(state, NO_BOXES, model_of(BoxMotion(), detection_probability=p_detect), dt, rng)
    check_info(info, 0)
    assert info.mass_predicted == pytest.approx(state.mass * 0.99**dt, rel=1e-9)
    assert info.mass == pytest.approx((1 - p_detect) * info.mass_predicted, rel=1e-9)
    assert after.mass == pytest.approx(info.mass)
    assert len(after) == round(300 * info.mass)
    if p_detect == 1:
        identical(after, NOTHING)


def test_an_empty_scan_can_be_skipped(rng):
    state = level(rng, 3, 200)
    after, info = ParticlePHD(300, skip_empty_frames=True).step(state, NO_BOXES, model_of(BoxMotion()), 1.0, rng)
    assert info.mass == info.mass_predicted == pytest.approx(state.mass * 0.99)
    assert after.mass == pytest.approx(info.mass)
    # A scan that is not empty is updated.
    _, info = ParticlePHD(300, skip_empty_frames=True).step(state, np.array([[1e5], [1e5], [9], [9]]), model_of(), 1.0, rng)
    assert info.mass < 0.5


@given(seeds, st.integers(0, 4), st.integers(0, 6), st.sampled_from(["particle", "detection", "fixed"]))
@settings(max_examples=60, deadline=None)
def test_masses_add_up(seed: int, targets: int, n: int, scaling: str):
    """Every detection brings C/(κ + C), every target (1 − p_D) of itself, and the state holds it."""
    rng = np.random.default_rng(seed)
    model = model_of(
        scaling=scaling, detection_probability=0.9, **({"fixed_noise": (8.0, 9.0)} if scaling == "fixed" else {})
    )
    state = level(rng, targets, 40) if targets else NOTHING
    z = seen_by(rng, state, n) if targets else rng.uniform(20, 90, (4, n))
    after, info = PHD.step(state, z, model, 1.0, rng)
    check(after)
    check_info(info, n)
    claimed = (info.evidence / (info.evidence + info.clutter)).sum()
    assert info.mass == pytest.approx(0.1 * info.mass_predicted + claimed, rel=2e-5, abs=1e-9)
    assert len(after) == round(300 * info.mass)
    assert after.mass == pytest.approx(info.mass if len(after) else 0.0)


def test_the_number_of_particles_can_be_capped(rng):
    state = level(rng, 5, 200)
    z = seen_by(rng, state, 5)
    full, info = ParticlePHD(300).step(state, z, model_of(), 1.0, Fixed(0.5))
    capped, same = ParticlePHD(300, max_particles=700).step(state, z, model_of(), 1.0, Fixed(0.5))
    check(capped)
    assert len(capped) == 700 < len(full)
    assert capped.mass == pytest.approx(full.mass) == pytest.approx(info.mass) == pytest.approx(same.mass)


def test_without_clutter_what_nothing_explains_vanishes_and_is_counted(rng):
    """κ = 0 and C = 0: the term is 0, not NaN, and such a detection is clutter for sure."""
    state = level(rng, 2, 200, width=200.0)
    near, far = seen_by(rng, state, 1, 0.01), np.array([[5000.0], [5000], [20], [40]])
    model = model_of(BoxMotion(), MeasurementBirth(0.0, 50, "local"), UniformClutter(0.0, 1.0), detection_probability=1.0)
    after, info = PHD.step(state, np.hstack([far, near, far + 50]), model, 1.0, rng)
    check(after)
    assert info.vanished == 2
    assert info.mass == pytest.approx(1.0, rel=1e-5)
    assert after.mass == pytest.approx(1.0, rel=1e-5)
    np.testing.assert_array_equal(info.clutter_probability, [1.0, 0.0, 1.0])
    empty, info = PHD.step(NOTHING, far, model, 1.0, rng)
    identical(empty, NOTHING)
    assert info.vanished == 1


@pytest.mark.parametrize("births", [0.0, 0.05])
@pytest.mark.parametrize("deviations", [5.0, 8, 10, 12, 13, 13.1, 13.3, 14, 20, 38, 39.5, 60, 1000])
def test_a_likelihood_far_out_in_its_tail_does_not_poison_the_state(deviations: float, births: float, rng):
    """κ = 0 and a size so unlike all particles that single precision does not know g, or its reciprocal."""
    x = np.array([[100.0, 100, 0, 0, 20, 40], [100.0, 100, 0, 0, 20.3, 40]]).T
    state = ParticleBlocks(np.repeat(x, 100, axis=1).astype(np.float32), np.array([0, 200]), 1 / 100)
    z = np.array([[100.0], [100], [20 + 20 * 0.15 * deviations], [40]])
    model = model_of(
        BoxMotion(), MeasurementBirth(25 * births, 50, "local"), UniformClutter(0.0, 1.0), detection_probability=0.9
    )
    after, info = PHD.step(state, z, model, 1.0, rng)
    check(after)
    check_info(info, 1)
    assert info.mass == pytest.approx(0.1 * info.mass_predicted + 1 - info.vanished, rel=1e-4)
    assert len(after) == round(300 * info.mass)
    again, info = PHD.step(after, z, model, 1.0, rng)
    check(again)
    check_info(info, 1)


def test_a_frame_that_nobody_looked_at_comes_in_between(rng):
    """`predict` gives plain particles; the next `step` puts them into blocks again."""
    model, state = model_of(BoxMotion()), level(rng, 3, 250)
    z = seen_by(rng, state, 3, 0.02)
    predicted = PHD.predict(state, model, 1.0, rng)
    assert isinstance(predicted, Particles)
    assert predicted.mass == pytest.approx(state.mass * 0.99)
    after, info = PHD.step(predicted, z, model, 1.0, rng)
    check(after)
    assert info.mass_predicted - info.mass_born == pytest.approx(state.mass * 0.99**2)
    assert len(after.start) - 1 < 30, "in blocks"


def test_an_initial_intensity_of_any_kind(rng):
    model = model_of(BoxMotion(), MeasurementBirth(0.0, 50, "local"), detection_probability=0.5)
    x = level(rng, 2, 400).state.astype(np.float64)
    uneven = Particles(x, np.linspace(0.0, 2.0, 800) / 400)
    after, info = ParticlePHD(2000, initial=uneven).step(uneven, NO_BOXES, model, 1.0, rng)
    check(after)
    assert info.mass_predicted == pytest.approx(uneven.mass * 0.99)
    first = np.arange(800) < 400
    there = np.abs(x[0, first].mean() - after.state[0]) < np.abs(x[0, ~first].mean() - after.state[0])
    assert there.sum() * after.unit == pytest.approx(0.495 * uneven.weight[first].sum(), rel=0.05)
    cov = np.stack([np.diag([25.0, 9, 1, 1, 4, 16])] * 2)
    mean = np.array([[100.0, 50, 1, 0, 20, 40], [300, 60, 0, 1, 30, 50]]).T
    mixture = GaussianMixture(np.array([1.0, 0.5]), mean, cov)
    start = ParticlePHD(3000, initial=mixture).start(model, rng)
    after, info = ParticlePHD(3000).step(start, NO_BOXES, model, 1.0, rng)
    check(after)
    assert info.mass == pytest.approx(0.5 * 0.99 * 1.5)
    assert (after.state[0] < 200).sum() * after.unit == pytest.approx(0.495, rel=0.02)
    nothing = Particles(np.zeros((6, 5)), np.zeros(5))
    after, info = PHD.step(nothing, NO_BOXES, model, 1.0, rng)
    assert (len(after), info.mass) == (0, 0.0)


@pytest.mark.parametrize("births", ["local", "image"])
def test_nothing_and_one_detection(births: str, rng):
    birth = IMAGE if births == "image" else MeasurementBirth(25 * 0.05, 300, "local")
    after, info = PHD.step(NOTHING, NO_BOXES, model_of(birth=birth), 1.0, rng)
    identical(after, NOTHING)
    assert (info.mass_predicted, info.mass, info.vanished) == (0.0, 0.0, 0)
    z = np.array([[100.0], [100], [30], [60]])
    after, info = ParticlePHD(3000).step(NOTHING, z, model_of(birth=birth), 1.0, rng)
    check(after)
    check_info(info, 1)
    assert 0 < info.mass_born == info.mass_predicted
    claimed = info.evidence[0] / (info.evidence[0] + info.clutter[0])
    assert info.mass == pytest.approx(0.05 * info.mass_born + claimed, rel=1e-5)
    assert len(after) == round(3000 * info.mass)


@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed"])
@pytest.mark.parametrize("births", ["local", "image"])
@pytest.mark.parametrize("size", [1.0, 3.0, 5000.0])
def test_boxes_of_any_size(size: float, births: str, scaling: str, rng):
    """A pixel, and larger than the frame: finite, and on average as much believed as by the definition."""
    # The noise's region about a box larger than the frame holds many frames' births.
    flat = MeasurementBirth(25 * (0.05 if size < 100 else 1e-5), 200, "image", FRAME)
    birth = flat if births == "image" else MeasurementBirth(25 * 0.05, 200, "local")
    clutter = UniformClutter(1e-3, (FRAME[0] * FRAME[1]) ** 2) if births == "image" else None
    model = model_of(birth=birth, clutter=clutter, scaling=scaling)
    z = np.array([[300.0], [200], [size], [2 * size]])
    masses = np.zeros((2, 8))
    for row, form in zip(masses, (PHD, Composed(PHD)), strict=True):
        for seed in range(8):
            own, state = np.random.default_rng(seed), form.start(model, rng)
            for _ in range(8):
                state, info = form.step(state, z, model, 1.0, own)
                check_info(info, 1)
                if form is PHD:
                    check(state)
            row[seed] = info.mass
    error = np.sqrt(masses.var(1, ddof=1).sum() / 8)
    assert abs(masses[0].mean() - masses[1].mean()) < 4 * error + 0.02 * masses[1].mean()


def test_detections_far_outside_of_the_frame(rng):
    state, model = level(rng, 2, 200), model_of()
    near = seen_by(rng, state, 2, 0.02)
    far = np.array([[-1e6, 1e6, 300, 3e7], [200, 1e6, -1e5, -3e7], [20, 50, 30, 40], [40, 80, 60, 70]])
    z = np.hstack([near, far])
    for _ in range(8):
        state, info = PHD.step(state, z, model, 1.0, rng)
        check(state)
        check_info(info, 6)
    # What is born outside does not survive the next frame, and is never believed.
    assert info.mass < 2.6
    inside = (np.abs(state.state[:2]) < 2000).all(0)
    assert inside.sum() * state.unit > 1.2


def test_very_many_detections_at_one_place(rng):
    """Five hundred of the same box: their births share the density, their evidence the targets."""
    z = np.repeat(np.array([[100.0], [100], [30], [60]]), 500, axis=1)
    model, state = model_of(birth=MeasurementBirth(25 * 0.05, 20, "local")), NOTHING
    for _ in range(3):
        state, info = ParticlePHD(100).step(state, z, model, 1.0, rng)
        check(state)
        check_info(info, 500)
        np.testing.assert_allclose(info.evidence, info.evidence[0], rtol=1e-4)
    assert info.mass == pytest.approx(0.05 * info.mass_predicted + 500 / (1 + info.clutter[0] / info.evidence[0]), rel=1e-3)


@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed"])
def test_the_order_of_detections_does_not_matter(scaling: str, rng):
    state = level(rng, 5, 150)
    z = seen_by(rng, state, 9)
    order = rng.permutation(9)
    model = still(scaling=scaling, detection_probability=0.9)
    a, about_a = PHD.step(state, z, model, 1.0, Fixed(0.4))
    b, about_b = PHD.step(state, np.ascontiguousarray(z[:, order]), model, 1.0, Fixed(0.4))
    np.testing.assert_allclose(about_a.evidence[order], about_b.evidence, rtol=1e-6)
    assert about_a.mass == pytest.approx(about_b.mass, rel=1e-6)
    assert len(a) == len(b)
    # The same offspring, but for teeth that stand on an edge.
    same = (np.sort(a.state[0]) == np.sort(b.state[0])).mean()
    assert same > 0.98


def test_with_births_the_order_does_not_matter_on_average(rng):
    state = level(rng, 2, 150)
    z = np.hstack([seen_by(rng, state, 2), [[50.0, 60], [400, 405], [20, 30], [50, 60]]])
    model = model_of()

    def evidences(order, seeds_):
        found = (PHD.step(state, z[:, order].copy(), model, 1.0, np.random.default_rng(s))[1] for s in seeds_)
        return np.array([[*info.evidence, info.mass] for info in found])

    a = evidences([0, 1, 2, 3], range(100))
    b = evidences([3, 1, 0, 2], range(100, 200))[:, [2, 1, 3, 0, 4]]
    error = np.sqrt((a.var(0) + b.var(0)) / 100)
    assert (np.abs(a.mean(0) - b.mean(0)) < 4.5 * error).all()


def test_covered_detections_have_no_births(rng):
    state = level(rng, 1, 2000, mass=1.2, spread=0.02)
    z = np.ascontiguousarray(state.state.mean(1, dtype=np.float64)[[0, 1, 4, 5], None])
    model = model_of(BoxMotion(acceleration=0.0, size_noise=0.0))
    _, info = PHD.step(state, z, model, 1.0, rng)
    assert info.mass_born == 0
    half = ParticleBlocks(state.state, state.start, state.unit / 2.4)
    _, info = PHD.step(half, z, model, 1.0, rng)
    assert 0 < info.mass_born < 0.05


@pytest.mark.parametrize("births", ["local", "image"])
def test_the_same_seed_gives_the_same_and_nobody_writes_into_what_he_received(births: str):
    birth = IMAGE if births == "image" else None
    model = model_of(birth=birth, clutter=UniformClutter(1.0, 1e12))
    rng = np.random.default_rng(1)
    scans = [seen_by(rng, level(rng, 3, 30), 5) for _ in range(5)] + [NO_BOXES]
    for z in scans:
        z.flags.writeable = False

    def run(seed: int):
        own, state, infos = np.random.default_rng(seed), freeze(level(np.random.default_rng(2), 3, 200)), []
        for z in scans:
            state, info = PHD.step(state, z, model, 1.0, own)
            freeze(state)
            infos.append(info)
        return state, infos

    (a, infos_a), (b, infos_b), (c, _) = run(7), run(7), run(8)
    identical(a, b)
    for x, y in zip(infos_a, infos_b, strict=True):
        same_info(x, y)
    assert not np.array_equal(a.state, c.state)
    uneven = Particles(np.ones((6, 4)), np.array([0.1, 0.2, 0.3, 0.4]))
    uneven.state.flags.writeable = uneven.weight.flags.writeable = False
    PHD.step(uneven, scans[0], model, 1.0, rng)


def test_particles_that_left_the_frame_have_no_offspring(rng):
    """Also none by rounding: many small states whose last particles are dead, at every start of the comb."""
    x = np.repeat(np.array([[300.0, 200, 0, 0, 30, 60]]).T, 40, axis=1).astype(np.float32)
    x[0] += np.arange(40, dtype=np.float32) / 8
    x[0, 30:] = -500
    state = ParticleBlocks(x, np.array([0, 40]), 1 / 40)
    model = still(detection_probability=0.5)
    for offset in np.concatenate([np.linspace(0, 1, 40)[:-1], [np.nextafter(1.0, 0)]]):
        after, info = ParticlePHD(100).step(state, NO_BOXES, model, 1.0, Fixed(float(offset)))
        assert info.mass_predicted == pytest.approx(0.99 * 30 / 40)
        assert after.state[0].min() > 0
