"""Particles as extraction sees them: in blocks, with what is known of each block (see `kernels.blocks`).

What the fused filter gives is in blocks already and stays in float32. Any other particles are sorted into a grid's cells
first, in float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phdtrack.filters.extract.rectangles import Rectangles
from phdtrack.filters.threads import in_ranges
from phdtrack.kernels.blocks import cut, summarise
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
    known, second : (B, 1 + 4d) mass, box, middle and sum of states of each block, and (B, even d, even d) sums of their
        products, as `kernels.blocks.summarise` writes them; (0, even d, even d) where they have not been taken.
    mass : of all particles.
    most : particles in the largest block.
    grid : the blocks' boxes in position.
    threads : that share the work on the blocks, 0 for one per core; results are the same to the bit.
    """

    state: Real
    weight: Real
    start: I8
    known: F8
    second: F8
    mass: float
    most: int
    grid: Rectangles
    threads: int

    @classmethod
    def of(cls, intensity: Particles | ParticleBlocks, threads: int = 1, few: int = 0) -> Cloud:
        """The blocks of an intensity that is not empty; sums of products are taken of more than ``few``.

        ValueError: a state is NaN or infinite.
        """
        state: Real
        weight: Real
        if isinstance(intensity, ParticleBlocks):
            state, start, weight = intensity.state, intensity.start, np.array([intensity.unit], intensity.state.dtype)
        else:
            state, weight, start = cut(intensity.state, intensity.weight, MOST)
        d, blocks = len(state), len(start) - 1
        known, second = np.empty((blocks, 1 + 4 * d)), np.empty((blocks if blocks > few else 0, even(d), even(d)))
        bits = state.view(np.int32 if state.itemsize == 4 else np.int64)

        def summary(lo: int, hi: int) -> int:
            most: int = summarise(lo, hi, state, bits, weight, start, known, second)
            return most

        largest = in_ranges(summary, blocks, threads)
        if min(largest) < 0:
            raise ValueError("states must be finite")
        # An empty block has no box; it stands where the box of its zeros is, and nobody asks for its particles.
        grid = Rectangles.of(known[:, 1:3].T.copy(), known[:, 1 + d : 3 + d].T.copy())
        return cls(state, weight, start, known, second, intensity.mass, max(largest), grid, threads)

    def mass_of(self, index: I8) -> float:
        """Σw of the particles at ``index``."""
        return float(self.weight[0]) * len(index) if self.weight.size == 1 else float(self.weight[index].sum())

    def take(self, index: I8) -> Particles:
        """The particles at ``index``."""
        weight = np.full(len(index), self.weight[0]) if self.weight.size == 1 else self.weight[index]
        return Particles(self.state.take(index, axis=1).astype(np.float64), weight.astype(np.float64))


def even(d: int) -> int:
    """The rows in which ``d`` components are summed, two at a time."""
    return d + d % 2
