"""The particle PHD filter for the shipped box model, in two sweeps over blocks of particles (see `kernels.sweeps`).

It computes what `ParticlePHD`'s predict, update and reduce compute, which remain the definition: the same intensities, the
same births, the same evidence, the same comb. Different are the number format (float32 states), the order of the particles,
and the random numbers: those here belong to a counter (the frame's key, block, particle) and not to a place in a stream, so
that newborn particles can be drawn twice instead of being stored, and threads cannot change the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from phdtrack.filters.blocks import REACH, blocked
from phdtrack.filters.box_tables import BoxModel, Seen, flat_density, motion_numbers, proposal_peaks, seen
from phdtrack.filters.threads import in_ranges
from phdtrack.kernels.birth_table import neighbours
from phdtrack.kernels.comb import block_masses, born_masses, by_cells, comb, cut, gains_by_detection
from phdtrack.kernels.sweeps import EXTENTS, GROUP, sweep_born, sweep_offspring, sweep_old
from phdtrack.models.births import region
from phdtrack.protocols import Model
from phdtrack.types import F4, F8, I8, ParticleBlocks, Particles, UpdateInfo


class Settings(Protocol):
    """What the two forms of the filter share; see `ParticlePHD`."""

    @property
    def per_target(self) -> int: ...  # noqa: D102
    @property
    def most(self) -> int: ...  # noqa: D102
    @property
    def region(self) -> float: ...  # noqa: D102
    @property
    def skip_empty(self) -> bool: ...  # noqa: D102
    @property
    def threads(self) -> int: ...  # noqa: D102


@dataclass(frozen=True, slots=True, eq=False)
class _Old:
    """What the first sweep leaves of the particles that were there: states moved, and sums by block and detection."""

    blocks: ParticleBlocks
    moved: F4
    extents: F4
    alive: F8
    first: I8
    which: I8
    sums: F4
    unit: float


@dataclass(frozen=True, slots=True, eq=False)
class _Born:
    """The newborn of each detection: how many, their neighbours, and sums by group and detection."""

    table: F4
    many: I8
    group_start: I8
    near_start: I8
    near: I8
    touching: I8
    gain_start: I8
    base: F4
    gains: F4
    flat: float


def fused_step(
    settings: Settings, parts: BoxModel, state: Particles | ParticleBlocks, z: F8, model: Model, dt: float, rng: np.random.Generator
) -> tuple[ParticleBlocks, UpdateInfo]:
    """Predict, update and resample [M07 (5), (6); M09 (6)]."""
    blocks = blocked(state, settings.per_target, rng)
    key = rng.integers(0, 2**32, 2)
    offset = rng.random()
    limit, radii = region()
    frame = seen(parts, z, dt, limit)
    old = _sweep_old(settings, parts, blocks, frame, dt, key)
    n = z.shape[1]
    near = np.bincount(old.which, old.sums[1], n) * old.unit
    born = _sweep_born(settings, parts, frame, near, dt, key)
    kappa = model.clutter.intensity(z)
    p_detect = parts.sensor.detection
    if n == 0 and settings.skip_empty:
        p_detect = 0.0
    evidence = p_detect * (np.bincount(old.which, old.sums[0], n) * old.unit + _evidence_of_born(born))
    total = kappa + evidence
    # A likelihood far out in its tail is a denormal number, whose reciprocal overflows.
    known = total >= np.finfo(np.float64).tiny
    weight = np.divide(p_detect, total, out=np.zeros(n), where=known)
    mass_old = block_masses(old.first, old.which, old.sums, old.alive, old.unit, weight, 1.0 - p_detect)
    mass_born, group_mass = born_masses(
        born.group_start, born.near_start, born.near, born.touching, born.gain_start, born.base, born.gains, weight, 1.0 - p_detect
    )
    mass = np.concatenate([mass_old, mass_born])
    count = round(settings.per_target * float(mass.sum()))
    if settings.most:
        count = min(count, settings.most)
    born_total = float(born.base.sum(dtype=np.float64))
    info = UpdateInfo(
        old.unit * float(old.alive.sum()) + born_total, born_total, float(mass.sum()), evidence, kappa, int(n - np.count_nonzero(known))
    )
    if count == 0:
        return ParticleBlocks.empty(6), info
    extents = np.concatenate([old.extents, _born_extents(frame)])
    order = by_cells(extents)
    teeth, place, phase, width = comb(mass, order, count, offset)
    start, divided = cut(extents, order, teeth, REACH)
    out = np.empty((6, count), np.float32)
    factor = weight.astype(np.float32)
    missed = np.array([1.0 - p_detect], np.float32)

    def offspring(lo: int, hi: int) -> None:
        sweep_offspring(
            lo, hi, order, teeth, place, phase, width, divided,
            old.moved, blocks.start, old.first, old.which, factor, missed,
            born.table, parts.own, _sensor_numbers(settings, parts), key,
            born.many, born.group_start, radii, np.float32(limit), parts.local, np.float32(born.flat),
            born.near_start, born.near, born.touching, group_mass, frame.speed, out,
        )  # fmt: skip

    in_ranges(offspring, len(order), settings.threads)
    return ParticleBlocks(out, start, float(mass.sum()) / count), info


def _sensor_numbers(settings: Settings, parts: BoxModel) -> F4:
    """What the kernels read of the sensor: spread, floor, and the squared radius of the region that counts as explained."""
    # A floor of zero would let the deviation of a vanishing box vanish.
    return np.array([parts.sensor.spread, max(parts.sensor.floor, 1e-3), settings.region], np.float32)


def _sweep_old(settings: Settings, parts: BoxModel, blocks: ParticleBlocks, frame: Seen, dt: float, key: I8) -> _Old:
    """Move the particles and sum what the detections near them say."""
    count = len(blocks.start) - 1
    moved, extents, alive = np.empty_like(blocks.state), np.empty((count, EXTENTS), np.float32), np.empty(count)
    motion, sensor = motion_numbers(parts.motion, dt), _sensor_numbers(settings, parts)

    def sweep(lo: int, hi: int) -> tuple[I8, I8, F4]:
        out: tuple[I8, I8, F4] = sweep_old(
            lo, hi, blocks.state, blocks.start, motion, key, frame.table, parts.own, sensor,
            frame.lower, frame.upper, *frame.grid, moved, extents, alive,
        )  # fmt: skip
        return out

    found = in_ranges(sweep, count, settings.threads)
    first, which, sums = found[0]
    if len(found) > 1:
        ends = np.cumsum([0, *(len(part[1]) for part in found)])
        first = np.concatenate([[0], *(part[0][1:] + end for part, end in zip(found, ends[:-1], strict=True))])
        which = np.concatenate([part[1] for part in found])
        sums = np.concatenate([part[2] for part in found], axis=1)
    unit = blocks.unit * parts.motion.survival**dt
    return _Old(blocks, moved, extents, alive, first, which, sums, unit)


def _sweep_born(settings: Settings, parts: BoxModel, frame: Seen, covered: F8, dt: float, key: I8) -> _Born:
    """Draw J_j = ⌈Jmax·max(0, 1 − M_j)⌉ newborn around each detection and sum what the detections near them say [M07 §2]."""
    limit, radii = region()
    many = np.ceil(parts.birth.most * np.clip(1.0 - covered, 0.0, 1.0)).astype(np.int64)
    flat = flat_density(parts.birth, dt)
    table = proposal_peaks(frame, many)
    near_start, near, touching = neighbours(frame.z, frame.reach, frame.lower, frame.upper, parts.local)
    groups = (many + GROUP - 1) // GROUP
    group_start, gain_start = _starts(groups), _starts(groups * touching)
    base, gains = np.empty(group_start[-1], np.float32), np.empty(gain_start[-1], np.float32)
    sensor = _sensor_numbers(settings, parts)

    def sweep(lo: int, hi: int) -> None:
        sweep_born(
            lo, hi, many, group_start, radii, key, table, parts.own, sensor,
            np.float32(limit), parts.local, np.float32(flat), near_start, near, touching, gain_start, base, gains,
        )  # fmt: skip

    in_ranges(sweep, len(many), settings.threads)
    return _Born(table, many, group_start, near_start, near, touching, gain_start, base, gains, flat)


def _starts(counts: I8) -> I8:
    """Where stretches of these lengths begin, and the end of the last."""
    out = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=out[1:])
    return out


def _evidence_of_born(born: _Born) -> F8:
    """(N,) Σ weight·g over the newborn, for each detection."""
    out: F8 = gains_by_detection(born.group_start, born.near_start, born.near, born.touching, born.gain_start, born.gains)
    return out


def _born_extents(frame: Seen) -> F4:
    """(N, 6) where the newborn of each detection lie, as the blocks' extents."""
    z, reach = frame.z, frame.reach
    return np.concatenate([z[:2] - reach, z[:2] + reach, z[2:4]]).T.astype(np.float32)
