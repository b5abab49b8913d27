"""The particle PHD filter: against a dense definition, and what holds whatever the intensity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from phd_cases import crowd, seen_by, with_births, world

from composed import gaussian_view
from phdtrack.arrays import reused
from phdtrack.filters import ParticleCPHD, ParticlePHD
from phdtrack.filters.particle_blocks import in_blocks
from phdtrack.kernels.particle_models import SensorNumbers
from phdtrack.models import (
    BoxMotion,
    BoxSensor,
    PlaneBirth,
    PlaneMotion,
    PlaneSensor,
    PointBirth,
    PointMotion,
    PointSensor,
    UniformClutter,
)
from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture, ParticleBlocks, Particles

seeds = st.integers(0, 2**32 - 1)
NOTHING = Particles(np.zeros((6, 0)), np.zeros(0))
NO_BOXES = np.zeros((4, 0))
SINGLE = np.dtype(np.float32)


def dense(state: Particles, z: np.ndarray, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Weights and evidence after the update [M07 (5)], every particle with every measurement."""
    seen = state.weight * model.sensor.p_detect(state.state)
    table = (len(state), z.shape[1])
    i, j = np.indices(table).reshape(2, -1)
    likelihood = np.exp(gaussian_view(model.sensor, z[:, j], state.state[:, i])[1].reshape(table))
    evidence = seen @ likelihood
    total = evidence + model.clutter.intensity(z)
    return state.weight - seen + seen * (likelihood / total).sum(axis=1), evidence


def unseen(state: Particles):
    """The intensity after a frame that changes nothing."""
    return ParticlePHD(skip_empty_frames=True).update(
        state, NO_BOXES, world(), 1.0, np.random.default_rng(0)
    )[0]


def check(state: ParticleBlocks) -> None:
    """What blocks of particles must be."""
    assert state.state.flags.c_contiguous
    assert state.start[0] == 0
    sizes = np.diff(state.start)
    assert ((sizes > 0) & (sizes <= 256)).all()
    assert state.start[-1] == state.state.shape[1] == len(state)
    assert np.isfinite(state.state).all()


def identical(a: ParticleBlocks, b: ParticleBlocks) -> None:
    np.testing.assert_array_equal(a.state, b.state)
    np.testing.assert_array_equal(a.start, b.start)
    np.testing.assert_array_equal(a.weight, b.weight)


@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed", "given"])
def test_the_update_is_the_dense_one(scaling: str, rng):
    """A gate that lets everything in: the definition, to single precision."""
    model = world(detection_probability=0.9, scaling=scaling, gate_probability=1.0)
    state = crowd(rng, 4, 60, width=200.0)
    z = seen_by(rng, state, 6)
    if scaling == "given":
        z = np.vstack([z, np.full((4, 6), 16.0)])
    blocks = in_blocks(state, SINGLE)
    updated, info = ParticlePHD().update(blocks, z, model, 1.0, rng)
    weight, evidence = dense(blocks.particles(), z, model)
    # A position of 600 pixels is known to 6e-5 pixels in single precision, and g at d deviations to
    # d times that.
    np.testing.assert_allclose(info.evidence, evidence, rtol=1e-4, atol=1e-9 * evidence.max())
    np.testing.assert_allclose(updated.weight, weight, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("kind", ["plane", "point"])
def test_plane_and_point_update_equals_the_dense_one(kind: str, rng):
    clutter = UniformClutter(1.0, 400.0)
    plane = Model(
        PlaneMotion(),
        PlaneSensor(gate_probability=1.0, view=False),
        PlaneBirth(0.0, 0.0, borders=(0.0, 0.0, 20.0, 20.0)),
        clutter,
    )
    point = Model(
        PointMotion(),
        PointSensor(gate_probability=1.0),
        PointBirth(0.0, frame_size=(20, 20)),
        clutter,
    )
    model = plane if kind == "plane" else point
    at = rng.uniform(0, 20, (2, 5))
    x = np.repeat(np.vstack([at, np.zeros((2, 5))]), 80, axis=1) + rng.normal(0, 1, (4, 400))
    z = at if kind == "point" else np.vstack([at, np.repeat([[0.5], [0.1], [0.4]], 5, axis=1)])
    blocks = in_blocks(Particles(x, rng.uniform(0.5, 1.5, 400) / 80), np.dtype(np.float64))
    updated, info = ParticlePHD().update(blocks, z, model, 1.0, rng)
    weight, evidence = dense(blocks.particles(), z, model)
    np.testing.assert_allclose(info.evidence, evidence, rtol=1e-10)
    np.testing.assert_allclose(updated.weight, weight, rtol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_what_the_gate_drops_is_bounded(seed: int):
    """A dropped pair is outside of the gate: its likelihood is below that share of its peak."""
    rng = np.random.default_rng(seed)
    state = in_blocks(crowd(rng, 5, 60, spread=0.3, width=150.0), SINGLE)
    model = world(detection_probability=0.9)
    z = seen_by(rng, state.particles(), 8)
    updated, info = ParticlePHD().update(state, z, model, 1.0, rng)
    weight, evidence = dense(state.particles(), z, model)
    own = state.state[[0, 1, 4, 5]].astype(float)
    peak = np.exp(gaussian_view(model.sensor, own, state.state.astype(float))[1])
    dropped = evidence - info.evidence
    assert np.all(dropped >= -1e-4 * evidence)
    assert np.all(dropped <= 4e-6 * (0.9 * state.weight * peak).sum() + 1e-4 * evidence)
    share = np.abs(dropped) / (evidence + model.clutter.intensity(z))
    assert np.abs(updated.weight - weight).sum() <= 2 * share.sum() + 1e-4


class Falling(BoxSensor):
    """A sensor that is asked for p_D, which falls to the right."""

    def p_detect(self, x: np.ndarray) -> np.ndarray:
        return 0.1 + 0.8 * np.exp(-(np.clip(x[0], 0, None) / 100))

    def particle_model(self, z: np.ndarray) -> SensorNumbers:
        return super().particle_model(z)._replace(detection=np.zeros(0, np.float32))


def test_detection_probability_may_depend_on_the_state(rng):
    """p_D is a model: here it falls to the right."""
    model = world(gate_probability=1.0)
    state = in_blocks(crowd(rng, 4, 40, width=200.0), SINGLE)
    hidden = replace(model, sensor=Falling(gate_probability=1.0))
    z = seen_by(rng, state.particles(), 5)
    updated, info = ParticlePHD().update(state, z, hidden, 1.0, rng)
    weight, evidence = dense(state.particles(), z, hidden)
    assert np.ptp(hidden.sensor.p_detect(state.state.astype(float))) > 0.3
    np.testing.assert_allclose(info.evidence, evidence, rtol=1e-4)
    np.testing.assert_allclose(updated.weight, weight, rtol=1e-4, atol=1e-7)


@given(seeds, st.integers(0, 4), st.floats(0.01, 2), st.integers(1, 400))
@settings(max_examples=40, deadline=None)
def test_reducing_keeps_the_mass_in_equal_weights(
    seed: int, targets: int, mass: float, particles_per_target: int
):
    rng = np.random.default_rng(seed)
    state = crowd(rng, targets, 30, mass)
    updated = unseen(state)
    reduced = ParticlePHD(particles_per_target).reduce(updated, rng)
    check(reduced)
    assert updated.mass == pytest.approx(state.mass, rel=1e-6)
    assert len(reduced) == round(particles_per_target * updated.mass)
    if len(reduced):
        assert reduced.mass == pytest.approx(updated.mass, rel=1e-9)
        assert {tuple(x) for x in reduced.state.T} <= {
            tuple(x) for x in state.state.T.astype(np.float32)
        }


@pytest.mark.parametrize("offset", [0.0, 0.3, 0.5, 0.999])
def test_every_particle_has_its_share_of_offspring(offset: float, rng):
    """Systematic: within one of its share, wherever the comb starts; particles without weight have
    none.
    """
    state = crowd(rng, 3, 200)
    state.weight[::7] = 0.0

    class Comb:
        def random(self):
            return offset

    reduced = ParticlePHD(400).reduce(unseen(state), Comb())
    count = {tuple(x): 0 for x in state.state.T.astype(np.float32)}
    for x in reduced.state.T:
        count[tuple(x)] += 1
    found = np.array(list(count.values()))
    share = state.weight / state.mass * len(reduced)
    assert np.abs(found - share).max() < 1.01
    assert found[::7].max() == 0


def test_bounds_on_the_number_of_particles(rng):
    state = crowd(rng, 5, 100)
    for bounds, wanted in (
        ({"max_particles": 700}, 700), ({"min_particles": 6000}, 6000), ({"min_particles": 800,
        "max_particles": 600}, 600),
        ({"min_particles": 900}, 5000),
    ):  # fmt: skip
        few = ParticlePHD(1000, **bounds).reduce(unseen(state), rng)
        assert len(few) == wanted
        assert few.mass == pytest.approx(state.mass)
    nothing = replace(state, weight=1e-6 * state.weight)
    assert len(ParticlePHD(100, min_particles=700).reduce(unseen(nothing), rng)) == 0


@pytest.mark.parametrize("p_detect", [0.0, 0.7, 1.0])
def test_an_empty_scan_leaves_what_is_missed(p_detect: float, rng):
    state = crowd(rng, 3, 50)
    updated, info = ParticlePHD().update(
        state, NO_BOXES, world(detection_probability=p_detect), 1.0, rng
    )
    assert updated.mass == info.mass == pytest.approx((1 - p_detect) * state.mass, rel=1e-6)
    assert info.mass_predicted == pytest.approx(state.mass, rel=1e-6)
    assert info.mass_born == 0
    skipped, info = ParticlePHD(skip_empty_frames=True).update(state, NO_BOXES, world(), 1.0, rng)
    assert (info.mass, info.mass_predicted) == (pytest.approx(3, rel=1e-6),) * 2
    assert skipped.mass == pytest.approx(3, rel=1e-6)


@given(
    seeds, st.integers(0, 4), st.integers(0, 6), st.sampled_from(["particle", "detection", "fixed"])
)
@settings(max_examples=40, deadline=None)
def test_masses_add_up(seed: int, targets: int, n: int, scaling: str):
    """Every detection brings C/(κ + C), every target (1 − p_D) of itself, and the state holds
    it.
    """
    rng = np.random.default_rng(seed)
    model = with_births(world(scaling=scaling, detection_probability=0.9))
    state = crowd(rng, targets, 40) if targets else NOTHING
    z = seen_by(rng, state, n) if targets else rng.uniform(20, 90, (4, n))
    after, info = ParticlePHD(300).step(state, z, model, 1.0, rng)
    check(after)
    claimed = (info.evidence / (info.evidence + info.clutter)).sum()
    assert info.mass == pytest.approx(0.1 * info.mass_predicted + claimed, rel=2e-5, abs=1e-9)
    assert len(after) == round(300 * info.mass)
    assert after.mass == pytest.approx(info.mass if len(after) else 0.0)


def test_unexplained_detection_vanishes_and_is_counted(rng):
    """κ = 0 and C = 0: the term is 0, not NaN."""
    state = crowd(rng, 2, 60, width=200.0)
    near = seen_by(rng, state, 1)
    far = np.array([[5000.0], [5000], [20], [40]])
    model = world(clutter=UniformClutter(0.0, 1.0), detection_probability=1.0)
    updated, info = ParticlePHD().update(state, np.hstack([far, near, far + 50]), model, 1.0, rng)
    assert info.vanished == 2
    assert updated.mass == pytest.approx(1.0, rel=1e-5)
    np.testing.assert_array_equal(info.clutter_probability[[0, 2]], [1.0, 1.0])
    empty, info = ParticlePHD().update(NOTHING, far, model, 1.0, rng)
    assert (info.vanished, empty.mass) == (1, 0.0)


@pytest.mark.parametrize("deviations", [5.0, 12, 13.1, 14, 20, 38, 39.5, 1000])
def test_likelihood_far_in_its_tail_keeps_weights_finite(deviations: float, rng):
    """κ = 0 and a size so unlike all particles that single precision does not know g, or its
    reciprocal.
    """
    x = np.repeat(
        np.array([[100.0, 100, 0, 0, 20, 40], [100.0, 100, 0, 0, 20.3, 40]]).T, 100, axis=1
    )
    z = np.array([[100.0], [100], [20 + 20 * 0.15 * deviations], [40]])
    model = world(clutter=UniformClutter(0.0, 1.0), detection_probability=0.9)
    state = Particles(x, np.full(200, 0.01))
    for _ in range(2):
        state, info = ParticlePHD(300).step(state, z, model, 1.0, rng)
        assert info.mass == pytest.approx(0.1 * info.mass_predicted + 1 - info.vanished, rel=1e-4)
        check(state)


def test_covered_detections_have_no_births(rng):
    state = crowd(rng, 1, 300, mass=1.2, spread=0.03)
    z = np.average(state.state, axis=1, weights=state.weight)[[0, 1, 4, 5], None]
    _, info = ParticlePHD().update(state, z, with_births(world()), 1.0, rng)
    assert info.mass_born == 0
    _, info = ParticlePHD().update(
        Particles(state.state, state.weight / 2.4), z, with_births(world()), 1.0, rng
    )
    assert 0 < info.mass_born < 0.05


def test_with_births_the_order_does_not_matter_on_average(rng):
    state = crowd(rng, 2, 80)
    z = np.hstack([seen_by(rng, state, 2), [[50.0, 60], [400, 405], [20, 30], [50, 60]]])
    model = with_births(world())

    def evidence(order: list[int], first: int) -> np.ndarray:
        draws = (np.random.default_rng(first + k) for k in range(60))
        return np.array(
            [
                ParticlePHD().update(state, z[:, order].copy(), model, 1.0, own)[1].evidence
                for own in draws
            ]
        )

    a = evidence([0, 1, 2, 3], 0)
    b = evidence([3, 2, 1, 0], 100)[:, ::-1]
    error = np.sqrt((a.var(0) + b.var(0)) / 60)
    assert np.all(np.abs(a.mean(0) - b.mean(0)) <= 4.5 * error + 1e-12)


def test_boxes_of_any_size_and_far_outside_of_the_frame(rng):
    state = crowd(rng, 2, 200)
    far = np.array(
        [
            [-1e6, 1e6, 300, 3e7, 10],
            [200, 1e6, -1e5, -3e7, 10],
            [1, 50, 5000, 40, 1],
            [2, 80, 9000, 70, 1],
        ]
    )
    for _ in range(4):
        z = np.hstack(
            [
                seen_by(rng, state.particles() if isinstance(state, ParticleBlocks) else state, 2),
                far,
            ]
        )
        state, info = ParticlePHD(300).step(state, z, with_births(world()), 1.0, rng)
        check(state)
        assert np.isfinite(info.evidence).all()


def test_the_initial_intensity(rng):
    given_particles = crowd(rng, 2, 20)
    assert ParticlePHD(initial=given_particles).start(world(), rng) is given_particles
    cov = np.stack([np.diag([25.0, 9, 1, 1, 4, 16])] * 2)
    mean = np.array([[100.0, 50, 1, 0, 20, 40], [300, 60, 0, 1, 30, 50]]).T
    drawn = ParticlePHD(5000, initial=GaussianMixture(np.array([1.0, 0.5]), mean, cov)).start(
        world(), rng
    )
    first = drawn.state[0] < 200
    assert (drawn.weight[first].sum(), drawn.weight[~first].sum()) == (
        pytest.approx(1.0),
        pytest.approx(0.5),
    )
    np.testing.assert_allclose(drawn.state[0, first].mean(), 100, atol=4 * 5 / np.sqrt(5000))


@pytest.mark.parametrize("recursion", [ParticlePHD(300), ParticleCPHD(300)])
def test_same_seed_gives_same_bits_with_any_threads(recursion, rng):
    first = crowd(rng, 70, 300, width=4000.0)
    scans = [seen_by(rng, first, n) for n in (90, 0, 60)]
    for z in scans:
        z.flags.writeable = False
    model = with_births(replace(world(), motion=BoxMotion()), most=100)

    def run(threads: int, seed: int):
        own = np.random.default_rng(seed)
        filter_ = replace(recursion, threads=threads, initial=first)
        state = filter_.start(model, own)
        for z in scans:
            state, info = filter_.step(state, z, model, 1.5, own)
        return getattr(state, "intensity", state), info

    one, info = run(1, 5)
    for threads in (1, 2, 3, 0):
        state, other = run(threads, 5)
        identical(state, one)
        assert other.mass == info.mass
    assert not np.array_equal(run(1, 6)[0].state[:, :100], one.state[:, :100])


def test_memory_is_used_again_only_where_no_array_uses_it():
    shape = (2**19,)
    kind = np.dtype(np.float32)
    first = reused(shape, kind)
    first[:] = 1
    part = first[10:20]
    place = first.ctypes.data
    del first
    second = reused(shape, kind)
    second[:] = 2
    np.testing.assert_array_equal(part, 1)
    del part, second
    assert place in [array.ctypes.data for array in [reused(shape, kind) for _ in range(12)]]
