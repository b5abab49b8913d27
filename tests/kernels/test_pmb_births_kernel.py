"""First states of new targets where births are given or learned: the fused step against the general one."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.filters import PMB
from phdtrack.filters.composed import composed_step
from phdtrack.filters.gm_box import box_model
from phdtrack.models import BoxMotion, BoxSensor, FixedBirth, LocalClutter, UniformClutter
from phdtrack.models.learned_scene import ContextBirth
from phdtrack.protocols import Model
from phdtrack.scene import ContextDensity
from phdtrack.types import GaussianMixture

SIZE = (640.0, 480.0)
LOW, HIGH = np.array([0.0, 0, -40, -40, 5, 5]), np.array([*SIZE, 40, 40, 300, 400])
CLUTTER = {"everywhere": UniformClutter(3.0, (SIZE[0] * SIZE[1]) ** 2), "local": LocalClutter(0.4)}


def spreads(rng: np.random.Generator, count: int, mixed: bool) -> np.ndarray:
    """(count, 6, 6) covariances of births; where not ``mixed``, of what the fused step keeps alone."""
    deviation = rng.uniform([10, 10, 1, 1, 4, 8], [60, 60, 8, 8, 15, 30], (count, 6))
    correlation = np.tile(np.eye(6), (count, 1, 1))
    correlation[:, (0, 1), (2, 3)] = correlation[:, (2, 3), (0, 1)] = rng.uniform(-0.7, 0.7, (count, 2))
    if mixed:
        root = rng.normal(0, 1, (count, 6, 6)) + 2 * np.eye(6)
        whole = root @ root.transpose(0, 2, 1)
        scale = np.sqrt(np.diagonal(whole, axis1=1, axis2=2))
        correlation = whole / scale[:, :, None] / scale[:, None, :]
    return correlation * deviation[:, :, None] * deviation[:, None, :]


def births(kind: str, seed: int, mixed: bool):
    rng = np.random.default_rng(seed)
    mean = rng.uniform([100, 100, -6, -6, 25, 50], [540, 380, 6, 6, 50, 110], (8, 6)).T.copy()
    cov = spreads(rng, 8, mixed)
    if kind == "fixed":
        return FixedBirth(GaussianMixture(rng.uniform(0.01, 0.1, 8), mean, cov))
    return ContextBirth(0.3, ContextDensity(LOW, HIGH, 0.4, np.full(8, 1 / 8), mean, cov))


def measured(seed: int, count: int) -> np.ndarray:
    """(4, N) boxes: some where births are, some elsewhere, two that share one place."""
    rng = np.random.default_rng(seed + 100)
    z = rng.uniform([20, 20, 15, 30], [620, 460, 70, 140], (count, 4)).T
    return np.ascontiguousarray(np.hstack([z, z[:, :2] + 3]))


@pytest.mark.parametrize("clutter", CLUTTER)
@pytest.mark.parametrize("kind", ["fixed", "learned"])
@pytest.mark.parametrize("mixed", [False, True])
def test_first_states_and_evidence_are_those_of_the_definition(kind: str, clutter: str, mixed: bool):
    """Where the axes do not mix in births, all of it; where they do, what stands in the rows that are kept."""
    for seed in range(4):
        sensor = BoxSensor(scaling=("particle", "detection", "fixed", "particle")[seed])
        model = Model(BoxMotion(frame_size=SIZE), sensor, births(kind, seed, mixed), CLUTTER[clutter])
        assert len(box_model(model, 1.0).births) == 8, "the fused path is tested"
        settings, rng = PMB(existence_threshold=1e-12), np.random.default_rng(0)
        state, z = settings.start(model, rng), measured(seed, 12)
        fused, info = settings.step(state, z, model, 1.0, rng)
        general, expected = composed_step(settings, state, z, model, 1.0, rng)
        a, b = fused.present, general.present
        assert a.label.tolist() == b.label.tolist()
        assert len(a) > 4
        np.testing.assert_allclose(info.evidence, expected.evidence, rtol=1e-8)
        np.testing.assert_allclose(info.clutter, expected.clutter, rtol=1e-8)
        np.testing.assert_allclose(a.exist, b.exist, rtol=1e-8)
        np.testing.assert_allclose(a.mean, b.mean, rtol=1e-9, atol=1e-9)
        kept = np.eye(6, dtype=bool)
        kept[(0, 1, 2, 3), (2, 3, 0, 1)] = True
        np.testing.assert_allclose(a.covariance[:, kept], b.covariance[:, kept], rtol=1e-8, atol=1e-8)
        assert (a.covariance[:, ~kept] == 0).all()
        assert mixed or np.abs(b.covariance[:, ~kept]).max() < np.abs(b.covariance[:, kept]).max()


def test_targets_of_a_learned_scene_are_followed_alike():
    """Somebody comes in where births were learned: who is there, and where, soon to a hundredth of a deviation."""
    model = Model(BoxMotion(frame_size=SIZE), BoxSensor(), births("learned", 1, mixed=False), CLUTTER["everywhere"])
    settings, rng = PMB(), np.random.default_rng(0)
    fused = general = settings.start(model, rng)
    at = births("learned", 1, mixed=False).density.mean[:, 3]
    for k in range(15):
        box = np.array([at[0] + k * at[2], at[1] + k * at[3], at[4], at[5]])
        z = (box * (1 + 0.03 * rng.standard_normal((3, 4))) + np.array([[0.0, 0, 0, 0], [60, 60, 0, 0], [-90, -90, 0, 0]])).T
        fused, _ = settings.step(fused, np.ascontiguousarray(z), model, 1.0, rng)
        general, _ = composed_step(settings, general, np.ascontiguousarray(z), model, 1.0, rng)
        assert fused.present.label.tolist() == general.present.label.tolist()
        np.testing.assert_allclose(fused.present.exist, general.present.exist, atol=0.01)
        there = general.present.presence > 0.5
        one, other = fused.present.best[there], general.present.best[there]
        step = fused.present.mean[:, one] - general.present.mean[:, other]
        deviation = np.sqrt(np.diagonal(general.present.covariance[other], axis1=1, axis2=2).T)
        assert (np.abs(step) < (0.2 if k < 10 else 0.01) * deviation).all()
    assert (general.present.presence > 0.5).sum() >= 1


def test_nobody_begins_where_no_birth_is_near(rng):
    far = GaussianMixture(np.array([0.1]), np.array([[5000.0], [5000], [0], [0], [40], [80]]), np.eye(6)[None])
    model = Model(BoxMotion(), BoxSensor(), FixedBirth(far), UniformClutter(0.0, 1.0))
    z = measured(3, 5)
    for step in (PMB().step, lambda *given: composed_step(PMB(), *given)):
        state, info = step(PMB().start(model, rng), z, model, 1.0, rng)
        assert len(state) == 0
        assert info.vanished == z.shape[1]
