"""Laws of the cardinalised PHD filters: the PHD filter from a Poisson number, mass and mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from phd_cases import crowd, seen_by, with_births, world

from phdtrack.filters import GMCPHD, GMPHD, ParticleCPHD, ParticlePHD
from phdtrack.filters.cardinality import Cardinalised, UpdateTerms, poisson, weigh
from phdtrack.types import GaussianMixture, Particles

NOTHING = np.zeros((4, 0))
KINDS = ("gm", "particle")


def mixture_of(particles: Particles, rng) -> GaussianMixture:
    """Gaussians about some of the particles."""
    chosen = rng.choice(len(particles), 12, replace=False)
    root = rng.normal(0, 1.5, (12, 6, 6))
    cov = root @ root.transpose(0, 2, 1) + np.eye(6)
    return GaussianMixture(
        rng.uniform(0.1, 1.2, 12), np.ascontiguousarray(particles.state[:, chosen]), cov
    )


def case(kind: str, rng, model, targets: int = 7):
    """The cardinalised filter, the plain one, an intensity of some targets and a scan that fits
    it.
    """
    particles = crowd(rng, targets, 80)
    z = np.hstack([seen_by(rng, particles, targets), [[900.0], [900], [30], [60]]])
    if kind == "gm":
        return GMCPHD(), GMPHD(), mixture_of(particles, rng), z
    return ParticleCPHD(particles_per_target=80), ParticlePHD(particles_per_target=80), particles, z


# Boxes as particles are in single precision.
NEAR = {"gm": 1e-9, "particle": 1e-5}


def mean(p: np.ndarray) -> float:
    return float(p @ np.arange(len(p)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("detection", [0.7, 1.0])
def test_a_poisson_number_gives_the_phd_update(kind: str, detection: float, rng):
    """Poisson births too: the intensity of one update is the PHD filter's to 1e-10."""
    model = with_births(world(detection_probability=detection), rate=0.05)
    ours, plain, intensity, z = case(kind, rng, model)
    state = Cardinalised(intensity, poisson(intensity.mass))
    (found, info), (wanted, plain_info) = (
        filter_.update(s, z, model, 1.0, np.random.default_rng(3))
        for filter_, s in ((ours, state), (plain, intensity))
    )
    np.testing.assert_allclose(found.intensity.weight, wanted.weight, rtol=NEAR[kind], atol=1e-8)
    assert len(wanted) > 30
    assert info.mass == pytest.approx(plain_info.mass, rel=NEAR[kind])
    np.testing.assert_array_equal(info.evidence, plain_info.evidence)
    assert plain_info.cardinality.shape == (0,)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("detection", [0.7, 0.98, 1.0])
def test_mean_cardinality_is_mass_with_undetected_births(kind: str, detection: float, rng):
    """Along a run with births, misses, clutter, empty scans and a gap.

    Births where nothing was detected are missed as all others are: after a scan so many of them are
    left.
    """
    model = with_births(world(detection_probability=detection), rate=0.05)
    recursion, _, _, _ = case(kind, rng, model)
    targets = crowd(rng, 5, 1)
    state = recursion.start(model, rng)
    most = 0.0
    for k in range(25):
        clutter = crowd(rng, 3, 1)
        z = (
            np.hstack([seen_by(rng, targets, 4), seen_by(rng, clutter, 2)])
            if k % 6 != 5
            else NOTHING
        )
        if k == 12:
            state = recursion.predict(state, model, 3.0, rng)
        before = recursion.predict(state, model, 1.0, rng)
        updated, info = recursion.update(before, z, model, 1.0, rng)
        state = recursion.reduce(updated, rng)
        births = model.birth.expected_count(z, 1 / model.rate)
        known = info.mass_predicted
        unseen = max(births - info.mass_born, 0.0)
        terms = UpdateTerms(
            known, info.mass_born, (1 - detection) * known, info.evidence, info.clutter, replace
        )
        left = unseen * (1 - detection) * weigh(before.cardinality, terms, births).missed
        for held in (updated, state):
            assert mean(held.cardinality) == pytest.approx(held.mass + left, rel=NEAR[kind])
        assert info.cardinality.sum() == pytest.approx(1, rel=1e-12)
        assert (info.cardinality >= 0).all()
        np.testing.assert_array_equal(info.cardinality, updated.cardinality)
        assert len(info.cardinality) < 60
        most = max(most, info.mass)
    assert 2 < most < 15


@pytest.mark.parametrize("kind", KINDS)
def test_a_known_number_outlives_a_miss(kind: str, rng):
    """Seven targets for certain, no detections: seven are still expected, where the PHD filter
    expects a tenth of them.
    """
    model = world(detection_probability=0.9)
    ours, plain, intensity, _ = case(kind, rng, model)
    number = np.eye(8)[7]
    scaled = replace(intensity, weight=intensity.weight * 7 / intensity.mass)
    found, info = ours.update(Cardinalised(scaled, number), NOTHING, model, 1.0, rng)
    assert (info.mass, found.mass) == (pytest.approx(7), pytest.approx(7))
    np.testing.assert_allclose(info.cardinality, number, atol=1e-15)
    assert plain.update(scaled, NOTHING, model, 1.0, rng)[1].mass == pytest.approx(0.7)
