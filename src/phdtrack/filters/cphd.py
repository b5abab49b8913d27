"""The cardinalised PHD filters [V07], of Gaussians and of particles.

The intensity goes the way of `phd_gaussian` or `phd_particle`, and with it the distribution of the
number of targets (`cardinality`). What a scan says of the number bears on all weights at once: the
count hardly jumps when a target is missed or a false alarm appears. The price is that a missed
target's weight goes to the others for that scan, wherever they are.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np

from phdtrack.arrays import GATE
from phdtrack.errors import Checked, Count, NonNegative, PositiveCount, Share
from phdtrack.filters.cardinality import Cardinalised, poisson, trimmed, weigh
from phdtrack.filters.phd_gaussian import GMPHD
from phdtrack.filters.phd_particle import ParticlePHD
from phdtrack.kernels.esf import thinned
from phdtrack.models.gaussian import Transform
from phdtrack.protocols import Filter, Model
from phdtrack.types import F8, GaussianMixture, Particles, UpdateInfo


class _CPHD(Checked, Filter[Cardinalised]):
    """The recursion, with the settings of a PHD filter."""

    __slots__ = ()

    def start(self, model: Model, rng: np.random.Generator) -> Cardinalised:
        """The initial intensity and a Poisson distributed number; nothing without one."""
        intensity = _intensity(self).start(model, rng)
        return Cardinalised(intensity, trimmed(poisson(intensity.mass)))

    def predict(
        self, state: Cardinalised, model: Model, dt: float, rng: np.random.Generator
    ) -> Cardinalised:
        """The intensity moved and weighed with p_S; the number thinned by the mean of p_S [V07]."""
        if len(state) == 0:
            return state
        intensity = _intensity(self).predict(state.intensity, model, dt, rng)
        return Cardinalised(
            intensity, thinned(state.cardinality, min(max(intensity.mass / state.mass, 0.0), 1.0))
        )

    def update(
        self, state: Cardinalised, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Cardinalised, UpdateInfo]:
        """Add the births, then update the number and the intensity [V07]."""
        # Births, and C(z) and κ(z) of the measurements
        terms = _intensity(self).terms(state.intensity, z, model, dt, rng)
        # Update the distribution of the number of targets
        weighing = weigh(
            state.cardinality, terms, model.birth.expected_count(z, model.birth_seconds(dt))
        )
        # Update the intensity with the factors that follow from it
        intensity = terms.weighed(weighing.missed, weighing.detected)
        info = replace(terms.info(intensity.mass), cardinality=weighing.cardinality)
        return Cardinalised(intensity, weighing.cardinality), info

    def reduce(self, state: Cardinalised, rng: np.random.Generator) -> Cardinalised:
        """The intensity reduced; the number stays, unless nothing is left."""
        intensity = _intensity(self).reduce(state.intensity, rng)
        return Cardinalised(intensity, state.cardinality if len(intensity) else np.ones(1))


@dataclass(frozen=True, slots=True)
class GMCPHD(_CPHD):
    """Settings of the GM-CPHD filter; those of `GMPHD` and with its defaults.

    Parameters
    ----------
    weight_threshold : Gaussians that weigh less are dropped.
    merge_distance : Mahalanobis distance (not squared) up to which a Gaussian is united with a
        stronger one, in its own covariance.
    max_components : J_max, Gaussians kept, the heaviest; 0: 3000.
    gate_probability : part of the measurements of a Gaussian inside its gate; those beyond do not
        touch it; 1: no gate.
    transform : ``linear`` by Jacobians, or ``unscented`` by sigma points.
    initial : the intensity before the first frame; its number is Poisson distributed.
    """

    weight_threshold: NonNegative = 1e-5
    merge_distance: NonNegative = 2.0
    max_components: Count = 0
    gate_probability: Share = GATE
    transform: Transform = "linear"
    initial: GaussianMixture | None = None


@dataclass(frozen=True, slots=True)
class ParticleCPHD(_CPHD):
    """Settings of the particle CPHD filter; those of `ParticlePHD`.

    Parameters
    ----------
    particles_per_target : ρ, particles per expected target after resampling.
    min_particles, max_particles : bounds on the number of particles; 0 stands for none and for 300
        000.
    threads : threads that share a frame's work, 0 for one per core; the result is the same to the
        bit.
    initial : the intensity before the first frame; its number is Poisson distributed.
    """

    particles_per_target: PositiveCount = 1500
    min_particles: Count = 0
    max_particles: Count = 0
    threads: Count = 1
    initial: Particles | GaussianMixture | None = None


@lru_cache(maxsize=8)
def _intensity(settings: Any) -> Any:
    """The recursion of the intensity: the PHD filter with these settings."""
    recursion = GMPHD if isinstance(settings, GMCPHD) else ParticlePHD
    return recursion(**{field.name: getattr(settings, field.name) for field in fields(settings)})
