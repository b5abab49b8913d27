"""The particle PHD filter for the shipped box model, in two sweeps over blocks of particles (see `kernels.sweeps`).

It computes what `ParticlePHD`'s predict, update and reduce compute, which remain the definition: the same intensities, the
same births, the same evidence, the same comb. Different are the number format (float32 states), the order of the particles,
and the random numbers: those here belong to a counter (the frame's key, block, particle) and not to a place in a stream, so
that newborn particles can be drawn twice instead of being stored, and threads cannot change the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from phdtrack.arrays import region_radius2
from phdtrack.filters.blocks import REACH, blocked
from phdtrack.filters.box_tables import BoxModel, Seen, motion_numbers, seen
from phdtrack.filters.memory import empty
from phdtrack.filters.threads import in_ranges
from phdtrack.kernels.account import account, births
from phdtrack.kernels.box_blocks import LANES
from phdtrack.kernels.comb import by_cells, comb, cut
from phdtrack.kernels.newborn import standard_points
from phdtrack.kernels.offspring import sweep_offspring
from phdtrack.kernels.sweeps import EXTENTS, sweep_born, sweep_old
from phdtrack.models.births import KEPT, region
from phdtrack.protocols import Model
from phdtrack.types import F4, F8, I8, ParticleBlocks, Particles, UpdateInfo

if TYPE_CHECKING:
    from phdtrack.filters.particle_phd import ParticlePHD


@dataclass(frozen=True, slots=True, eq=False)
class Draws:
    """A frame's random numbers: the key (2,) of the generator of all particles, and where the comb starts."""

    key: I8
    offset: float


@dataclass(frozen=True, slots=True, eq=False)
class _Old:
    """What the first sweep leaves of the particles that were there: states moved, and sums by block and detection."""

    moved: F4
    extents: F4
    alive: F8
    first: I8
    which: I8
    sums: F4
    unit: float


@dataclass(frozen=True, slots=True, eq=False)
class _Born:
    """The newborn of each detection: how many, sums by batch and detection, and the points that they are placed from."""

    many: I8
    batch_start: I8
    gain_start: I8
    base: F4
    gains: F4
    points: F4


def fused_step(
    settings: ParticlePHD,
    parts: BoxModel,
    state: Particles | ParticleBlocks,
    z: F8,
    model: Model,
    dt: float,
    rng: np.random.Generator,
) -> tuple[ParticleBlocks, UpdateInfo]:
    """Predict, update and resample [M07 (5), (6); M09 (6)]."""
    blocks = blocked(state, settings.particles_per_target, rng)
    # Words of 32 bits from `random`: `integers` takes ten times as long for so few.
    drawn = rng.random(3)
    draws = Draws((drawn[:2] * 2.0**32).astype(np.int64), float(drawn[2]))
    frame = seen(parts, z, region_radius2(4), dt / model.rate)
    stay = parts.motion.survival_probability ** (dt / model.rate)
    old = _sweep_old(settings, parts, blocks, frame, dt, stay, draws)
    born = _sweep_born(settings, parts, old, frame, dt, draws)
    kappa = model.clutter.intensity(z)
    p_detect = 0.0 if settings.skip_empty_frames and z.shape[1] == 0 else parts.sensor.detection_probability
    evidence, weight, mass, batch_mass, vanished, (before, newborn, after) = account(
        old.first, old.which, old.sums, old.alive, old.unit, born.batch_start, frame.near_start, frame.near, frame.touching,
        born.gain_start, born.base, born.gains, kappa, p_detect,
    )  # fmt: skip
    info = UpdateInfo(before + newborn, newborn, after, evidence, kappa, vanished)
    count = settings.particles(after)
    if count == 0:
        return ParticleBlocks.empty(6), info
    extents = np.concatenate([old.extents, frame.extents])
    order = by_cells(extents)
    teeth, place, phase, width = comb(mass, order, count, draws.offset)
    start, divided = cut(extents, order, teeth, REACH)
    out = empty(6, count)
    factor, missed = weight.astype(np.float32), np.float32(1.0 - p_detect)

    def offspring(lo: int, hi: int) -> None:
        sweep_offspring(
            lo, hi, order, teeth, place, phase, width, divided, old.moved, blocks.start, old.first, old.which,
            factor, missed, frame.table, parts.own, frame.numbers, draws.key, born.many, born.batch_start, born.points,
            parts.birth.particles, parts.local, frame.flat, frame.near_start, frame.near, frame.touching, batch_mass,
            frame.velocity, out,
        )  # fmt: skip

    in_ranges(offspring, len(order), settings.threads)
    return ParticleBlocks(out, start, after / count), info


def _sweep_old(
    settings: ParticlePHD, parts: BoxModel, blocks: ParticleBlocks, frame: Seen, dt: float, stay: float, draws: Draws
) -> _Old:
    """Move the particles and sum what the detections near them say."""
    count = len(blocks.start) - 1
    moved, extents, alive = empty(*blocks.state.shape), np.empty((count, EXTENTS), np.float32), np.empty(count)
    motion = motion_numbers(parts.motion, dt)

    def sweep(lo: int, hi: int) -> tuple[I8, I8, F4]:
        out: tuple[I8, I8, F4] = sweep_old(
            lo, hi, blocks.state, blocks.start, motion, draws.key, frame.table, parts.own, frame.numbers,
            frame.lower, frame.upper, *frame.grid, moved, extents, alive,
        )  # fmt: skip
        return out

    found = in_ranges(sweep, count, settings.threads)
    first, which, sums = found[0]
    if len(found) > 1:
        ends = np.cumsum([0, *(len(part[1]) for part in found)])
        first = np.concatenate([[0], *(part[0][1:] + end for part, end in zip(found, ends[:-1], strict=True))])
        which = np.concatenate([part[1] for part in found])
        sums = np.concatenate([part[2][:, : len(part[1])] for part in found], axis=1)
    return _Old(moved, extents, alive, first, which, sums, blocks.unit * stay)


def _sweep_born(settings: ParticlePHD, parts: BoxModel, old: _Old, frame: Seen, dt: float, draws: Draws) -> _Born:
    """Draw J_j = ⌈Jmax·max(0, 1 − M_j)⌉ newborn around each detection and sum what the detections near them say [M07 §2]."""
    most = parts.birth.particles
    # Twice as many points as one detection needs, so that detections have different ones.
    points = standard_points(2 * most + LANES, region()[1], draws.key)
    many, batch_start, gain_start = births(old.which, old.sums, old.unit, most, KEPT, frame.touching, frame.table)
    base, gains = np.empty(batch_start[-1], np.float32), np.empty(gain_start[-1], np.float32)

    def sweep(lo: int, hi: int) -> None:
        sweep_born(
            lo, hi, many, batch_start, points, most, draws.key, frame.table, parts.own, frame.numbers, parts.local,
            frame.flat, frame.near_start, frame.near, frame.touching, gain_start, base, gains,
        )  # fmt: skip

    in_ranges(sweep, len(many), settings.threads)
    return _Born(many, batch_start, gain_start, base, gains, points)
