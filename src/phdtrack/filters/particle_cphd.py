"""The particle (SMC) cardinalised PHD filter [V07].

The particles go the way of `particle_phd`, for any model that keeps the protocols, and the distribution of the number of
targets beside them (`cardinality`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from phdtrack.checks import Count, PositiveCount, check
from phdtrack.errors import InputError
from phdtrack.filters.cardinality import nobody, poisson, survived, weigh
from phdtrack.filters.composed import composed_step
from phdtrack.filters.intensities import Cardinalised
from phdtrack.filters.particle_phd import ParticlePHD, weighed
from phdtrack.protocols import Model
from phdtrack.types import F8, GaussianMixture, Particles, UpdateInfo

State = Cardinalised[Particles]


@dataclass(frozen=True, slots=True)
class ParticleCPHD:
    """Settings of the particle CPHD filter; those of `ParticlePHD`.

    Parameters
    ----------
    particles_per_target : ρ, particles per expected target after resampling.
    min_particles, max_particles : bounds on the number of particles, 0 for none.
    initial : the intensity before the first frame; its number is Poisson distributed.
    """

    particles_per_target: PositiveCount = 1500
    min_particles: Count = 0
    max_particles: Count = 0
    initial: Particles | GaussianMixture | None = None

    def __post_init__(self) -> None:
        check(self)

    def start(self, model: Model, rng: np.random.Generator) -> State:
        """The initial intensity and a Poisson distributed number; nothing where none was given."""
        particles = _intensity(self).start(model, rng)
        return Cardinalised(particles, poisson(particles.mass))

    def predict(self, state: State, model: Model, dt: float, rng: np.random.Generator) -> State:
        """Move every particle through f, weigh it with p_S; the number thinned by the mean of p_S [V07].

        Raises `InputError` where the motion spawns: the recursion of the number has no spawning.
        """
        if len(state) == 0:
            return state
        if len(model.motion.spawn(state.intensity, dt, rng)):
            raise InputError(
                "the cardinalised PHD filter has no spawning",
                where="motion.births",
                cure="Use NoSpawn, or the particle PHD filter",
            )
        particles = _intensity(self).predict(state.intensity, model, dt, rng)
        return Cardinalised(particles, survived(state.cardinality, particles.mass / state.mass))

    def update(self, state: State, z: F8, model: Model, dt: float, rng: np.random.Generator) -> tuple[State, UpdateInfo]:
        """Draw the newborn, then update the number and every particle [V07]."""
        meeting = _intensity(self).meet(state.intensity, z, model, dt, rng)
        births = model.birth.expected(z, dt / model.rate)
        weighing = weigh(
            state.cardinality, meeting.intensity.mass, float(meeting.missed.sum()), births, max(births - meeting.born, 0.0),
            meeting.evidence, meeting.clutter,
        )  # fmt: skip
        particles = weighed(meeting, weighing.missed, weighing.detected)
        info = replace(meeting.info(particles.mass), cardinality=weighing.cardinality)
        return Cardinalised(particles, weighing.cardinality), info

    def reduce(self, state: State, rng: np.random.Generator) -> State:
        """Systematic resampling to ρ particles per expected target; the number stays, unless nothing is left."""
        particles = _intensity(self).reduce(state.intensity, rng)
        return Cardinalised(particles, state.cardinality if len(particles) else nobody())

    def step(self, state: State, z: F8, model: Model, dt: float, rng: np.random.Generator) -> tuple[State, UpdateInfo]:
        """Predict, update and reduce."""
        return composed_step(self, state, z, model, dt, rng)


@lru_cache(maxsize=8)
def _intensity(settings: ParticleCPHD) -> ParticlePHD:
    """The recursion of the particles."""
    s = settings
    return ParticlePHD(
        particles_per_target=s.particles_per_target,
        min_particles=s.min_particles,
        max_particles=s.max_particles,
        initial=s.initial,
    )
