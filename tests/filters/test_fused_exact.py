"""The fused step is predict, update and reduce: without noises and births the two agree to single precision.

Shared are the particles, the detections and the start of the comb. The order of the particles on the comb is another, so
that each particle's offspring are compared with its share: the whole number below or above.
"""

from __future__ import annotations

import numpy as np
import pytest
from fused_cases import Fixed, check, check_info, level, seen_by, still
from scipy.spatial import cKDTree

from phdtrack.filters import ParticlePHD
from phdtrack.models import BoxMotion
from phdtrack.types import ParticleBlocks, Particles

SCALINGS = ("particle", "detection", "fixed")
PHD = ParticlePHD(particles_per_target=400)


def scene(seed: int = 1, targets: int = 9) -> tuple[ParticleBlocks, np.ndarray]:
    """Targets of which some have left the frame, and detections, some of them of nothing, some twice."""
    rng = np.random.default_rng(seed)
    state = level(rng, targets, 150, mass=0.8, width=700.0)
    z = seen_by(rng, state, 2 * targets, 0.05)
    z = np.hstack([z, z[:, :2], [[30.0, 600], [400, 20], [25, 40], [70, 80]]])
    return state, np.ascontiguousarray(z)


def definition(state: ParticleBlocks, z, model, dt: float, recursion=PHD):
    """Predicted and updated particles and the info, by the definition."""
    rng = np.random.default_rng(0)
    predicted = recursion.predict(state, model, dt, rng)
    return predicted, *recursion.update(predicted, z, model, dt, rng)


def offspring(state: ParticleBlocks, wanted: Particles) -> np.ndarray:
    """How often each particle of ``wanted`` is among the columns of ``state``."""
    distance, index = cKDTree(wanted.state.T).query(state.state.T.astype(np.float64))
    assert distance.max(initial=0.0) < 1e-3, "an offspring is one of the particles"
    return np.bincount(index, minlength=len(wanted))


@pytest.mark.parametrize("dt", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("scaling", SCALINGS)
def test_evidence_and_masses(scaling: str, dt: float):
    state, z = scene()
    model = still(scaling=scaling, detection_probability=0.9)
    predicted, updated, wanted = definition(state, z, model, dt)
    assert len(predicted) < len(state), "the border takes some"
    after, info = PHD.step(state, z, model, dt, Fixed(0.3))
    check(after)
    check_info(info, z.shape[1])
    # A position of 600 pixels is known to 6e-5 pixels in single precision, and g at d deviations to d times that.
    np.testing.assert_allclose(info.evidence, wanted.evidence, rtol=1e-4, atol=1e-9 * wanted.evidence.max())
    np.testing.assert_array_equal(info.clutter, wanted.clutter)
    assert info.mass_predicted == pytest.approx(wanted.mass_predicted, rel=1e-6)
    assert info.mass == pytest.approx(wanted.mass, rel=1e-5)
    assert info.mass == pytest.approx(updated.mass, rel=1e-5)
    assert (info.mass_born, info.vanished) == (0.0, wanted.vanished)
    assert after.mass == pytest.approx(info.mass, rel=1e-9)
    assert len(after) == round(400 * info.mass)


@pytest.mark.parametrize("dt", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("scaling", SCALINGS)
def test_every_particle_has_its_share_of_offspring(scaling: str, dt: float):
    state, z = scene(2)
    model = still(scaling=scaling, detection_probability=0.8)
    _, updated, _ = definition(state, z, model, dt)
    share = None
    total = np.zeros(len(updated))
    offsets = (np.arange(32) + 0.5) / 32
    for offset in offsets:
        after, _ = PHD.step(state, z, model, dt, Fixed(float(offset)))
        count = offspring(after, updated)
        share = updated.weight / updated.mass * len(after)
        assert np.abs(count - share).max() < 1.02
        total += count
        # Weighted moments: what the comb cannot resolve is at most one particle a source.
        np.testing.assert_allclose(
            after.state[:2].mean(1), np.average(updated.state[:2], axis=1, weights=updated.weight), atol=2.0
        )
    # Averaged over the comb's starts it is the share itself, to the grid of the starts.
    assert np.abs(total / len(offsets) - share).max() < 1.2 / len(offsets)


@pytest.mark.parametrize("scaling", SCALINGS)
def test_targets_keep_their_mass_mean_and_covariance(scaling: str):
    """Far apart, one detection each: all moments of the resampled target, within what one comb tooth can shift them."""
    rng = np.random.default_rng(5)
    centre = np.array([[80.0, 100, 3, -2, 30, 60], [320, 120, 0, 1, 40, 90], [560, 380, -4, 0, 25, 50]]).T
    scale = np.array([3.0, 3, 1, 1, 3, 5])[:, None]
    x = np.hstack([c[:, None] + scale * rng.standard_normal((6, 700)) for c in centre.T])
    state = ParticleBlocks(x.astype(np.float32), np.array([0, 250, 500, 700, 950, 1200, 1400, 1650, 1900, 2100]), 1 / 700)
    z = np.ascontiguousarray((centre + 0.5 * scale)[[0, 1, 4, 5]])
    model, dense = still(scaling=scaling, detection_probability=0.9), ParticlePHD(particles_per_target=20_000)
    _, updated, _ = definition(state, z, model, 1.0)
    after, _ = dense.step(state, z, model, 1.0, Fixed(0.5))
    for c in centre.T:
        mine, theirs = np.abs(updated.state[0] - c[0]) < 60, np.abs(after.state[0] - c[0]) < 60
        assert theirs.sum() * after.unit == pytest.approx(updated.weight[mine].sum(), abs=4 * after.unit)
        mean = np.average(updated.state[:, mine], axis=1, weights=updated.weight[mine])
        cov = np.cov(updated.state[:, mine], aweights=updated.weight[mine], ddof=0)
        found = after.state[:, theirs].astype(np.float64)
        np.testing.assert_allclose(found.mean(1), mean, atol=0.02)
        size = np.sqrt(cov.diagonal())
        np.testing.assert_allclose(np.cov(found, ddof=0) / np.outer(size, size), cov / np.outer(size, size), atol=0.02)


def test_velocities_move_and_sizes_are_reflected():
    """The moved states themselves: every offspring is the definition's moved particle."""
    rng = np.random.default_rng(3)
    state = level(rng, 3, 200)
    x = state.state.copy()
    x[4, :40] = 0.4
    state = ParticleBlocks(x, state.start, state.unit)
    model = still(dt_border=False, scaling="fixed")
    predicted, _, _ = definition(state, np.zeros((4, 0)), model, 2.5)
    after, _ = ParticlePHD(particles_per_target=100_000).step(state, np.zeros((4, 0)), model, 2.5, Fixed(0.1))
    assert (offspring(after, predicted) > 0).all()
    assert after.state[4].min() == pytest.approx(1.6)


def test_the_gate_drops_no_more_than_its_tail():
    """At the default gate the evidence is that of everything, to 5.1e-5 of each target's."""
    state, z = scene(7)
    wide = still(detection_probability=0.9)
    sensor = type(wide.sensor)(detection=0.9)
    narrow = type(wide)(wide.motion, sensor, wide.birth, wide.clutter)
    _, everything = PHD.step(state, z, wide, 1.0, Fixed(0.5))
    _, gated = PHD.step(state, z, narrow, 1.0, Fixed(0.5))
    peak = everything.evidence.max()
    assert (gated.evidence <= everything.evidence * (1 + 1e-5)).all()
    assert np.abs(gated.evidence - everything.evidence).max() < 1e-5 * peak
    assert gated.mass == pytest.approx(everything.mass, rel=1e-4)


@pytest.mark.parametrize("kind", ["remembering", "spawning", "previous", "given"])
def test_other_models_take_the_general_path(kind: str, rng):
    from dataclasses import replace

    from phdtrack.models import SplitSpawn

    model = still()
    if kind == "spawning":
        model = replace(model, motion=BoxMotion(births=SplitSpawn(rate=0.1)))
    elif kind == "remembering":
        model = replace(model, motion=BoxMotion(remember_size=True))
    else:
        model = replace(model, motion=BoxMotion(remember_size=kind == "previous"), sensor=type(model.sensor)(scaling=kind))
    state, z = Particles(np.zeros((model.motion.dim, 0)), np.zeros(0)), np.ones((8 if kind == "given" else 4, 1))
    after, _ = PHD.step(state, z, model, 1.0, rng)
    assert isinstance(after, Particles)
    assert isinstance(PHD.step(state, z[:4], still(), 1.0, rng)[0], ParticleBlocks)
