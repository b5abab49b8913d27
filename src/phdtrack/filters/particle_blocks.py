"""Particles in blocks of neighbours: how they are cut, joined, and carried along; and threads for
ranges of them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from phdtrack.kernels.particle_models import BLOCK, SensorNumbers, kernel_for
from phdtrack.kernels.particles import Part, Sums, masses, weigh
from phdtrack.types import F8, I8, ParticleBlocks, Particles, Real

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class UpdatedParticles:
    """The updated intensity before it is resampled; weights are computed when they are asked for.

    Attributes
    ----------
    blocks : the particles that were there, and the newborn, with their weights before the update.
    parts, sums : these as the kernels take them, with the detections near each block and sums over
        it.
    numbers : the sensor's.
    missed, detected : factors of the terms of missed targets and of each detection, see
        `particles.weigh`.
    threads : that share the work.
    """

    blocks: tuple[ParticleBlocks, ...]
    parts: tuple[Part, ...]
    sums: tuple[Sums, ...]
    numbers: SensorNumbers
    missed: float
    detected: F8
    threads: int = 1

    def __len__(self) -> int:
        return sum(len(blocks) for blocks in self.blocks)

    @property
    def masses(self) -> F8:
        """(B,) of all blocks."""
        pairs = zip(self.blocks, self.sums, strict=True)
        return np.concatenate(
            [blocks.unit * masses(sums, self.missed, self.detected) for blocks, sums in pairs]
        )

    @property
    def mass(self) -> float:
        """The integral of the intensity: the expected number of targets."""
        return float(self.masses.sum())

    @property
    def state(self) -> Real:
        """(d, L) states."""
        return np.concatenate([blocks.state for blocks in self.blocks], axis=1)

    @property
    def weight(self) -> F8:
        """(L,) weights."""
        out = []
        for blocks, part, sums in zip(self.blocks, self.parts, self.sums, strict=True):
            share = np.empty(len(blocks), blocks.state.dtype)
            arguments = (
                part,
                sums,
                self.numbers.model,
                self.numbers.table,
                self.missed,
                self.detected,
                share,
            )
            kernel = kernel_for(weigh, self.numbers.model)
            in_ranges(kernel, arguments, len(part.start) - 1, self.threads)
            out.append(blocks.unit * share.astype(np.float64))
        return np.concatenate(out)


Intensity = Particles | ParticleBlocks | UpdatedParticles


def cut(state: F8, most: int = BLOCK) -> tuple[I8, I8]:
    """The order (L,) that puts neighbours together, and ``start`` (B + 1,) of blocks of them.

    Parameters
    ----------
    state : (d, L) particles, L > 0; rows 0 and 1 are positions, finite.
    most : particles of a block, which lie in neighbouring cells of one row of a grid.
    """
    x, y = state[:2] - state[:2].min(axis=1, keepdims=True)
    wide = float(x.max()) + 1e-9
    high = float(y.max()) + 1e-9
    n = len(x)
    # About four particles to a cell if they lay everywhere; they do not, and so a cloud of them
    # fills some cells.
    side = np.sqrt(wide * high / (0.25 * n + 1.0))
    columns = int(min(wide / side, 0.25 * n)) + 1
    rows = int(min(high / side, 0.25 * n)) + 1
    column = np.minimum((x / wide * columns).astype(np.int64), columns - 1)
    # A column more than there are, so that the last cell of a row is no neighbour of the next row's
    # first.
    cell = np.minimum((y / high * rows).astype(np.int64), rows - 1) * (columns + 1) + column
    order = cell.argsort(kind="stable")
    apart = np.flatnonzero(np.diff(cell[order]) > 1) + 1
    return order, divided(np.concatenate([[0], apart, [n]]), most)


def divided(start: I8, most: int = BLOCK) -> I8:
    """(B + 1,) where blocks of at most ``most`` particles begin, into which the runs ``start`` (R +
    1,) are divided.
    """
    blocks = -(-np.diff(start) // most)
    before = np.concatenate([[0], np.cumsum(blocks)])
    rank = np.arange(before[-1]) - np.repeat(before[:-1], blocks)
    return np.append(np.repeat(start[:-1], blocks) + most * rank, start[-1])


def in_blocks(state: Intensity, dtype: np.dtype[np.floating]) -> ParticleBlocks:
    """The intensity in blocks of neighbours, its states as numbers of this type."""
    if isinstance(state, ParticleBlocks):
        return state
    if isinstance(state, UpdatedParticles):
        state = Particles(state.state.astype(np.float64), state.weight)
    if len(state) == 0:
        return ParticleBlocks.empty(len(state.state), dtype)
    x = state.state
    weight = state.weight
    if len(state.start):
        start = divided(state.start)
    else:
        order, start = cut(x)
        x = x[:, order]
        weight = weight[order]
    x = np.ascontiguousarray(x, dtype)
    if weight.dtype == dtype:
        return ParticleBlocks(x, start, 1.0, weight)
    unit = float(weight.max())
    equal = bool((weight == unit).all())
    return ParticleBlocks(
        x, start, unit, np.zeros(0, dtype) if equal else (weight / (unit or 1.0)).astype(dtype)
    )


@lru_cache(maxsize=4)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="phdtrack")


def in_ranges(
    work: Callable[..., T], arguments: tuple[Any, ...], count: int, threads: int
) -> list[T]:
    """The results of ``work(lo, hi, *arguments)`` for ranges that cover 0 … count, in their order.

    Kernels release the interpreter's lock, and their results do not depend on the ranges.

    Parameters
    ----------
    work : called from several threads.
    arguments : its arguments after the range.
    count : the end of the last range.
    threads : how many share the work; 0: one per core.
    """
    threads = threads or os.cpu_count() or 1
    if threads == 1 or count < 2 * threads:
        return [work(0, count, *arguments)]
    # More ranges than threads, because blocks differ in what they cost.
    edges = [count * i // (4 * threads) for i in range(4 * threads + 1)]
    return list(_pool(threads).map(lambda lo, hi: work(lo, hi, *arguments), edges[:-1], edges[1:]))
