"""Particles as extraction sees them: in blocks, with what is known of each block (see `kernels.blocks`).

What the fused filter gives is in blocks already and stays in float32. Any other particles are sorted into a grid's cells
first, in float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.blocks import cut, summarise
from phdtrack.kernels.clustering import block_grid
from phdtrack.types import F8, I8, ParticleBlocks, Particles

Real = NDArray[np.floating[Any]]
# Particles of a block: few enough that most blocks lie near one target, enough for what is done once for each.
MOST = 256


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Particles in B blocks.

    Attributes
    ----------
    state : (d, L), ``weight`` (L,) or (1,) of each or of all, ``start`` (B + 1,): the blocks.
    low, high : (B, d) corners of the box that holds a block's particles.
    origin : (B, d) a point in the middle of each block.
    mass : (B,) of each block; ``first`` (B, d), ``second`` (B, ≥ d, ≥ d): its moments about the origin.
    grid : over the blocks' boxes, as `kernels.clustering.block_grid` makes it.
    """

    state: Real
    weight: Real
    start: I8
    low: Real
    high: Real
    origin: Real
    mass: F8
    first: F8
    second: F8
    grid: tuple[F8, F8, F8, I8, I8, I8]

    @classmethod
    def of(cls, intensity: Particles | ParticleBlocks) -> Cloud:
        """The blocks of an intensity that is not empty."""
        state: Real
        weight: Real
        if isinstance(intensity, ParticleBlocks):
            state, start, weight = intensity.state, intensity.start, np.array([intensity.unit], intensity.state.dtype)
        else:
            state, weight, start = cut(intensity.state, intensity.weight, MOST)
        bits = state.view(np.int32 if state.itemsize == 4 else np.int64)
        low, high, origin, mass, first, second = summarise(state, bits, weight, start)
        low, high = low.view(state.dtype), high.view(state.dtype)
        return cls(state, weight, start, low, high, origin, mass, first, second, block_grid(low, high))

    def take(self, index: I8) -> Particles:
        """The particles at ``index``."""
        weight = np.full(len(index), self.weight[0]) if self.weight.size == 1 else self.weight[index]
        return Particles(self.state.take(index, axis=1).astype(np.float64), weight.astype(np.float64))
