"""The particle (SMC) PHD filter: weighted particles carry the intensity [M07 §2, (4), (5); M09
§III, (10)].

Equations: docs/methods.md, PHD. Particles lie in blocks of neighbours. A detection touches only the
blocks that its gate overlaps, so that the cost grows linearly with the number of targets; what the
gate drops is bounded by the sensor's gate. The compiled sweeps over blocks (`kernels.particles`)
call the functions of the model (`kernels.particle_models`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.arrays import chi2_quantile, draw, reused, sum_by
from phdtrack.errors import Checked, Count, PositiveCount
from phdtrack.filters.cardinality import TINY, UpdateTerms
from phdtrack.filters.particle_blocks import Intensity, UpdatedParticles, in_blocks, in_ranges
from phdtrack.kernels import particles as sweeps
from phdtrack.kernels.grid import Grid, make_grid
from phdtrack.kernels.particle_models import SensorNumbers, kernel_for, precision
from phdtrack.kernels.resampling import Comb, comb, pick
from phdtrack.protocols import Filter, Model
from phdtrack.types import F8, GaussianMixture, ParticleBlocks, Particles, UpdateInfo

# κ + C below this counts as 0 where likelihoods are in single precision: they have no tail below
# 1e-38.
FAINT = 1e-30
# Particles at most, unless the settings say otherwise.
MOST = 300_000


@dataclass(frozen=True, slots=True)
class ParticleSettings(Checked):
    """Settings of the particle PHD and the particle CPHD filter.

    Parameters
    ----------
    particles_per_target : ρ, particles per expected target after resampling.
    min_particles : lower bound on the number of particles while there are any. At first, when
        hardly any target is expected, ρ would leave a handful to each that has just begun, too few
        to hold its velocity.
    max_particles : upper bound on the number of particles; 0: 300 000, of which each target has
        fewer than it should where there are very many.
    threads : threads that share a frame's work, 0 for one per core; the result is the same to the
        bit.
    initial : the intensity before the first frame.
    """

    particles_per_target: PositiveCount = 1500
    min_particles: Count = 0
    max_particles: Count = 0
    threads: Count = 1
    initial: Particles | GaussianMixture | None = None


@dataclass(frozen=True, slots=True)
class ParticlePHD(ParticleSettings, Filter[Intensity]):
    """The particle PHD filter.

    Parameters
    ----------
    skip_empty_frames : leave the intensity as predicted when a frame brings no detection, as D14
        does. The default is the filter's update, (1 − p_D) D⁺.
    """

    skip_empty_frames: bool = False

    def start(self, model: Model, rng: np.random.Generator) -> Particles:
        """The initial intensity, a mixture as ρ particles per component; empty without one."""
        if isinstance(self.initial, GaussianMixture):
            return draw(self.initial, self.particles_per_target, 1.0, rng)
        if self.initial is not None:
            return self.initial
        return Particles(np.zeros((model.motion.dim, 0)), np.zeros(0))

    def predict(
        self, state: Intensity, model: Model, dt: float, rng: np.random.Generator
    ) -> ParticleBlocks:
        """The particles moved by f and weighed with p_S [M07 (4), D14 Alg. 2].

        A frame takes two words of ``rng`` for the key of all draws.
        """
        motion = model.motion.particle_model(dt, dt / model.rate)
        blocks = in_blocks(state, precision(motion))
        if len(model.warp) and len(blocks):
            warped = model.warp_states(blocks.state.astype(np.float64))
            blocks = replace(blocks, state=np.ascontiguousarray(warped, blocks.state.dtype))
        # Words of 32 bits from `random`: `integers` takes ten times as long for so few.
        key = (rng.random(2) * 2.0**32).astype(np.int64)
        if len(blocks) == 0:
            return blocks
        moved = reused(blocks.state.shape, blocks.state.dtype)
        share = reused((len(blocks),), blocks.state.dtype)
        arguments = (motion, blocks.state, blocks.share, blocks.start, key, moved, share)
        kernel = kernel_for(sweeps.predict, motion)
        in_ranges(kernel, arguments, len(blocks.start) - 1, self.threads)
        return ParticleBlocks(moved, blocks.start, blocks.unit, share)

    def update(
        self, state: Intensity, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[UpdatedParticles, UpdateInfo]:
        """The intensity after births and the measurements [M07 (5), M09 (10)].

        Where κ(z) + C(z) = 0 (no clutter and nothing to explain the detection), the detection's
        term is 0 and counted in ``info.vanished``. The intensity is not resampled.
        """
        return self.terms(state, z, model, dt, rng).phd()

    def terms(
        self, state: Intensity, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> UpdateTerms:
        """The terms of the update: newborn particles are drawn, and all likelihoods computed.

        Parameters
        ----------
        state, model, dt, rng : as in `update`.
        z : (m, N) measurements.
        """
        # Likelihoods g(z|x) and p_D of the predicted particles
        numbers = model.sensor.particle_model(z)
        region = chi2_quantile(len(model.sensor.observed), 0.99)
        dtype = precision(numbers.model)
        count = z.shape[1]
        if count == 0 and self.skip_empty_frames:
            numbers = numbers._replace(detection=np.zeros(1, dtype))
        gates = make_grid(*model.sensor.gate(z), 0.0, 0.0)
        old = self._part(in_blocks(state, dtype), numbers, gates, region, model)
        # Births, where no predicted mass covers a measurement [M09 (10)]
        covered: F8 = old[0].unit * sum_by(old[2].which, old[2].near, count)
        newborn = in_blocks(
            model.birth.sample(z, covered, model.sensor, model.birth_seconds(dt), rng), dtype
        )
        new = self._part(newborn, numbers, gates, region, model)
        # C(z) = ∫ p_D g(z|x) D⁺(x) dx [M07 (5)]
        blocks = (old[0], new[0])
        parts = (old[1], new[1])
        sums = (old[2], new[2])
        unit = np.array([of.unit for of in blocks])
        evidence = np.zeros(count)
        for of, known in zip(blocks, sums, strict=True):
            evidence += of.unit * sum_by(known.which, known.evidence, count)
        mass = unit * np.array([known.mass.sum() for known in sums])
        missed = unit * np.array([known.missed.sum() for known in sums])

        def weighed(missed: float, detected: F8) -> UpdatedParticles:
            return UpdatedParticles(blocks, parts, sums, numbers, missed, detected, self.threads)

        return UpdateTerms(
            float(mass.sum()),
            float(mass[1]),
            float(missed.sum()),
            evidence,
            model.clutter.intensity(z),
            weighed,
            FAINT if dtype == np.float32 else TINY,
        )

    def _part(
        self,
        blocks: ParticleBlocks,
        numbers: SensorNumbers,
        gates: Grid,
        region: float,
        model: Model,
    ) -> tuple[ParticleBlocks, sweeps.Part, sweeps.Sums]:
        """Blocks, as the kernels take them, and what the detections say of them."""
        detect = numbers.detection
        if len(detect) == 0:
            detect = model.sensor.p_detect(blocks.state.astype(np.float64))
        part = sweeps.Part(
            blocks.state, blocks.share, np.asarray(detect, blocks.state.dtype), blocks.start
        )
        arguments = (part, numbers.model, numbers.table, gates, region)
        kernel = kernel_for(sweeps.likelihoods, numbers.model)
        found = in_ranges(kernel, arguments, len(blocks.start) - 1, self.threads)
        sums = found[0]
        if len(found) > 1:
            before = np.cumsum([0, *(len(one.which) for one in found)])
            first = [one.first[:-1] + begin for one, begin in zip(found, before, strict=False)]
            sums = sweeps.Sums(*(np.concatenate(column) for column in zip(*found, strict=True)))
            sums = sums._replace(first=np.concatenate([*first, before[-1:]]))
        return blocks, part, sums

    def reduce(self, state: Intensity, rng: np.random.Generator) -> ParticleBlocks:
        """Systematic resampling to round(ρ·M̂) particles within the bounds, which keeps the mass
        exactly [M07 §2].

        An intensity that was not updated stays as it is.
        """
        if not isinstance(state, UpdatedParticles):
            return in_blocks(state, np.dtype(np.float64))
        first = state.blocks[0].state
        model, table, _ = state.numbers
        masses = state.masses
        offset = rng.random()
        mass = float(masses.sum())
        count = round(self.particles_per_target * mass)
        if count == 0:
            return ParticleBlocks.empty(len(first), first.dtype)
        count = min(max(count, self.min_particles), self.max_particles or MOST)
        teeth, start = comb(
            masses, np.concatenate([sums.extents for sums in state.sums]), count, offset
        )
        out = reused((len(first), count), first.dtype)
        begin = 0
        for part, sums in zip(state.parts, state.sums, strict=True):
            end = begin + len(part.start) - 1
            own = Comb(*(column[begin:end] for column in teeth))
            arguments = (part, sums, model, table, state.missed, state.detected, own, out)
            in_ranges(kernel_for(pick, model), arguments, end - begin, self.threads)
            begin = end
        return ParticleBlocks(out, start, mass / count)
