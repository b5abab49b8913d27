"""The particle (SMC) PHD filter [M07 §2, M09 §III].

The intensity D(x), whose integral over a region is the expected number of targets there, is carried by weighted particles:

    predict   D⁺(x) = ∫ [p_S(ξ) f(x|ξ) + β(x|ξ)] D(ξ) dξ + γ(x)
    update    D(x)  = [1 − p_D(x) + Σ_z p_D(x) g(z|x) / (κ(z) + C(z))] D⁺(x),   C(z) = ∫ p_D g(z|x) D⁺(x) dx

This file is the definition, for any model that keeps the protocols; `fused` does the same faster for the shipped model of
boxes. A detection touches only the particles inside its gate, found through a grid, so that the cost grows linearly with
the number of targets; what the gate drops is bounded by the sensor's gate and tested against the ungated filter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import draw, region_radius2, sum_by
from phdtrack.checks import Count, PositiveCount, check
from phdtrack.filters.blocks import plain
from phdtrack.filters.box_tables import box_model
from phdtrack.filters.carrying import carried_particles
from phdtrack.filters.composed import composed_step
from phdtrack.filters.fused import fused_step
from phdtrack.filters.meeting import Meeting, explained
from phdtrack.kernels.grid import points_in_rectangles
from phdtrack.kernels.resample import systematic
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, GaussianMixture, ParticleBlocks, Particles, UpdateInfo

# Plain particles, or the blocks of the fused form.
Intensity = Particles | ParticleBlocks


@dataclass(frozen=True, slots=True)
class ParticlePHD:
    """Settings of the particle PHD filter.

    Parameters
    ----------
    particles_per_target : ρ, particles per expected target after resampling.
    min_particles : lower bound on the number of particles while there are any. At first, when hardly any target is
        expected, ρ would leave a handful to each that has just begun, too few to hold its velocity.
    max_particles : upper bound on the number of particles; 0 for none.
        the 99 % region of a Gaussian in four dimensions.
    skip_empty_frames : leave the intensity as predicted when a frame brings no detection, as D14 does. The default is the
        filter's own update, (1 − p_D) D⁺.
    threads : threads that share a frame's work in `step`, 0 for one per core; the result is the same to the bit.
    initial : the intensity before the first frame.
    """

    particles_per_target: PositiveCount = 1500
    min_particles: Count = 0
    max_particles: Count = 0
    skip_empty_frames: bool = False
    threads: Count = 1
    initial: Particles | GaussianMixture | None = None

    def __post_init__(self) -> None:
        check(self)

    def start(self, model: Model, rng: np.random.Generator) -> Particles:
        """The initial intensity, a mixture as ρ particles per component; empty where none was given."""
        if isinstance(self.initial, GaussianMixture):
            return draw(self.initial, self.particles_per_target, 1.0, rng)
        if self.initial is not None:
            return self.initial
        return Particles(np.zeros((model.motion.dim, 0)), np.zeros(0))

    def predict(self, state: Intensity, model: Model, dt: float, rng: np.random.Generator) -> Particles:
        """Move every particle through f, weigh it with p_S, add what is spawned [M07 (5), D14 Alg. 2]."""
        state = plain(carried_particles(state, model))
        if len(state) == 0:
            return state
        weight = state.weight * model.motion.p_survive(state.state, dt / model.rate)
        moved = model.motion.sample(state.state, dt, rng)
        spawned = model.motion.spawn(state, dt, rng)
        alive = weight > 0
        if not alive.all():
            moved, weight = moved[:, alive], weight[alive]
        if len(spawned) == 0:
            return Particles(moved, weight)
        return join(Particles(moved, weight), spawned)

    def update(
        self, state: Intensity, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Particles, UpdateInfo]:
        """Draw the newborn, then weigh everything with the measurements [M07 (6), M09 (6)].

        Where κ(z) + C(z) = 0 (no clutter and nothing to explain the detection, to the smallest normal number), the
        detection's term is 0 and counted in ``info.vanished``.
        """
        meeting = self.meet(state, z, model, dt, rng)
        if z.shape[1] == 0 and self.skip_empty_frames:
            return meeting.intensity, meeting.info(meeting.intensity.mass)
        factor, vanished = explained(meeting.evidence, meeting.clutter)
        result = weighed(meeting, 1.0, factor)
        return result, meeting.info(result.mass, vanished)

    def meet(self, state: Intensity, z: F8, model: Model, dt: float, rng: np.random.Generator) -> Meeting[Particles]:
        """Draw the newborn, and find what they and ``state`` say about the measurements."""
        state = plain(state)
        covered = self._covered(state, z, model)
        born = model.birth.sample(z, covered, model.sensor, dt / model.rate, rng)
        everything = join(state, born)
        point, which = self._gated(everything, z, model)
        seen = everything.weight * model.sensor.p_detect(everything.state)
        likelihood = np.exp(model.sensor.log_likelihood(z[:, which], everything.state[:, point]))
        share = seen[point] * likelihood
        evidence = sum_by(which, share, z.shape[1])
        missed = everything.weight - seen
        return Meeting(everything, born.mass, missed, point, which, share, evidence, model.clutter.intensity(z))

    def reduce(self, state: Intensity, rng: np.random.Generator) -> Particles:
        """Systematic resampling to ρ particles per expected target, which keeps the mass exactly [M07 §2]."""
        state = plain(state)
        mass = state.mass
        count = self.particles(mass)
        if count == 0:
            return Particles(state.state[:, :0], np.zeros(0))
        chosen = systematic(state.weight, count, rng.random())
        return Particles(np.ascontiguousarray(state.state[:, chosen]), np.full(count, mass / count))

    def particles(self, mass: float) -> int:
        """How many particles carry this mass: round(ρ·M̂) [M07 §2] within the bounds, 0 where that is 0."""
        count = round(self.particles_per_target * mass)
        if count == 0:
            return 0
        count = max(count, self.min_particles)
        return min(count, self.max_particles) if self.max_particles else count

    def step(
        self, state: Intensity, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Intensity, UpdateInfo]:
        """Predict, update and reduce; fused for the shipped model of boxes (see `filters.fused`)."""
        parts = box_model(model)
        if parts is not None:
            return fused_step(self, parts, carried_particles(state, model), z, model, dt, rng)
        return composed_step(self, state, z, model, dt, rng)

    def _gated(self, state: Particles, z: F8, model: Model) -> tuple[I8, I8]:
        """Pairs (particle, detection) inside the sensor's gates."""
        pairs: tuple[I8, I8] = points_in_rectangles(state.state[0], state.state[1], *model.sensor.gate(z))
        return pairs

    def _covered(self, state: Particles, z: F8, model: Model) -> F8:
        """(N,) M(z): the predicted mass in the region around each detection [M07 §2]."""
        point, which = self._gated(state, z, model)
        near = model.sensor.distance2(z[:, which], state.state[:, point]) <= region_radius2(len(model.sensor.observed))
        return sum_by(which[near], state.weight[point[near]], z.shape[1])


def weighed(meeting: Meeting[Particles], missed: float, detected: F8) -> Particles:
    """The updated particles: missed terms weighed with ``missed``, those of each measurement with ``detected`` (N,)."""
    before = meeting.intensity
    seen = sum_by(meeting.point, meeting.share * detected[meeting.which], len(before))
    return Particles(before.state, missed * meeting.missed + seen)


def join(a: Particles, b: Particles) -> Particles:
    """The sum of two intensities."""
    if len(b) == 0:
        return a
    if len(a) == 0:
        return b
    return Particles(np.hstack([a.state, b.state]), np.concatenate([a.weight, b.weight]))
