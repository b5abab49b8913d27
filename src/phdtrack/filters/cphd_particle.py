"""The particle (SMC) cardinalised PHD filter [V07].

The particles go the way of `phd_particle`; beside them goes the distribution of the number of targets (`cardinality`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.errors import Count, PositiveCount, check
from phdtrack.filters.cardinality import no_targets, poisson, survived, weigh
from phdtrack.filters.intensities import Cardinalised, UpdatedParticles
from phdtrack.filters.phd_particle import ParticlePHD
from phdtrack.protocols import Model
from phdtrack.types import F8, GaussianMixture, ParticleBlocks, Particles, UpdateInfo

State = Cardinalised[Particles] | Cardinalised[ParticleBlocks] | Cardinalised[UpdatedParticles]


@dataclass(frozen=True, slots=True)
class ParticleCPHD:
    """Settings of the particle CPHD filter; those of `ParticlePHD`.

    Parameters
    ----------
    particles_per_target : ρ, particles per expected target after resampling.
    min_particles, max_particles : bounds on the number of particles, 0 for none.
    threads : threads that share a frame's work, 0 for one per core; the result is the same to the bit.
    initial : the intensity before the first frame; its number is Poisson distributed.
    """

    particles_per_target: PositiveCount = 1500
    min_particles: Count = 0
    max_particles: Count = 0
    threads: Count = 1
    initial: Particles | GaussianMixture | None = None

    def __post_init__(self) -> None:
        check(self)

    @property
    def _phd(self) -> ParticlePHD:
        """The recursion of the particles."""
        s = self
        return ParticlePHD(s.particles_per_target, s.min_particles, s.max_particles, threads=s.threads, initial=s.initial)

    def start(self, model: Model, rng: np.random.Generator) -> Cardinalised[Particles]:
        """The initial intensity and a Poisson distributed number; nothing where none was given."""
        particles = self._phd.start(model, rng)
        return Cardinalised(particles, poisson(particles.mass))

    def predict(self, state: State, model: Model, dt: float, rng: np.random.Generator) -> State:
        """The particles moved and weighed with p_S; the number thinned by the mean of p_S [V07].

        Raises
        ------
        InputError : the motion spawns; the recursion of the number has no spawning.
        """
        if len(state) == 0:
            return state
        model.refuse_spawning("cardinalised PHD filter")
        particles = self._phd.predict(state.intensity, model, dt, rng)
        return Cardinalised(particles, survived(state.cardinality, particles.mass / state.mass))

    def update(self, state: State, z: F8, model: Model, dt: float, rng: np.random.Generator) -> tuple[State, UpdateInfo]:
        """Draw the newborn, then update the number and every particle [V07]; arguments as in `ParticlePHD.update`."""
        terms = self._phd.terms(state.intensity, z, model, dt, rng)
        births = model.birth.expected(z, dt / model.rate)
        weighing = weigh(
            state.cardinality, terms.mass, float(terms.missed.sum()), births, max(births - terms.born, 0.0),
            terms.evidence, terms.clutter,
        )  # fmt: skip
        particles = terms.weighed(weighing.missed, weighing.detected, self.threads)
        info = replace(terms.info(particles.mass), cardinality=weighing.cardinality)
        return Cardinalised(particles, weighing.cardinality), info

    def reduce(self, state: State, rng: np.random.Generator) -> State:
        """Systematic resampling to ρ particles per expected target; the number stays, unless nothing is left."""
        particles = self._phd.reduce(state.intensity, rng)
        return Cardinalised(particles, state.cardinality if len(particles) else no_targets())

    def step(self, state: State, z: F8, model: Model, dt: float, rng: np.random.Generator) -> tuple[State, UpdateInfo]:
        """Predict, update and reduce."""
        updated, info = self.update(self.predict(state, model, dt, rng), z, model, dt, rng)
        return self.reduce(updated, rng), info
