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

from phdtrack.filters.cardinality import Cardinalised, poisson, trimmed, weigh
from phdtrack.filters.phd_gaussian import GMPHD, GaussianSettings
from phdtrack.filters.phd_particle import ParticlePHD, ParticleSettings
from phdtrack.kernels.esf import thinned
from phdtrack.protocols import Filter, Model
from phdtrack.types import F8, UpdateInfo


class _CPHD(Filter[Cardinalised]):
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
class GMCPHD(GaussianSettings, _CPHD):
    """The GM-CPHD filter; before the first frame the number is Poisson distributed."""


@dataclass(frozen=True, slots=True)
class ParticleCPHD(ParticleSettings, _CPHD):
    """The particle CPHD filter; before the first frame the number is Poisson distributed."""


@lru_cache(maxsize=8)
def _intensity(settings: Any) -> Any:
    """The recursion of the intensity: the PHD filter with these settings."""
    recursion = GMPHD if isinstance(settings, GMCPHD) else ParticlePHD
    return recursion(**{field.name: getattr(settings, field.name) for field in fields(settings)})
