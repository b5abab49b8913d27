"""Particles as extraction sees them: in blocks, with what is known of each block (see `kernels.blocks`).

What the fused filter gives is in blocks already and stays in float32. Any other particles are sorted into a grid's cells
first, in float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phdtrack.extract.rectangles import Rectangles
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
    known : (B, 1 + 4d) mass, box, middle and sum of states of each block, as `kernels.blocks.summarise` writes them.
    most : particles in the largest block.
    grid : the blocks' boxes in position.
    """

    state: Real
    weight: Real
    start: I8
    known: F8
    most: int
    grid: Rectangles

    @classmethod
    def of(cls, intensity: Particles | ParticleBlocks) -> Cloud:
        """The blocks of an intensity that is not empty. ValueError: a state is NaN or infinite."""
        state: Real
        weight: Real
        if isinstance(intensity, ParticleBlocks):
            state, start, weight = intensity.state, intensity.start, np.array([intensity.unit], intensity.state.dtype)
        else:
            state, weight, start = cut(intensity.state, intensity.weight, MOST)
        d = len(state)
        known, box = np.empty((len(start) - 1, 1 + 4 * d)), np.empty(2, state.dtype)
        integer = np.int32 if state.itemsize == 4 else np.int64
        most = summarise(state, state.view(integer), weight, start, known, box, box.view(integer))
        if most < 0:
            raise ValueError("states must be finite")
        # An empty block has no box; it stands where the box of its zeros is, and nobody asks for its particles.
        grid = Rectangles.of(known[:, 1:3].T.copy(), known[:, 1 + d : 3 + d].T.copy())
        return cls(state, weight, start, known, most, grid)

    def mass_of(self, index: I8) -> float:
        """Σw of the particles at ``index``."""
        return float(self.weight[0]) * len(index) if self.weight.size == 1 else float(self.weight[index].sum())

    def take(self, index: I8) -> Particles:
        """The particles at ``index``."""
        weight = np.full(len(index), self.weight[0]) if self.weight.size == 1 else self.weight[index]
        return Particles(self.state.take(index, axis=1).astype(np.float64), weight.astype(np.float64))

    def scratch(self) -> Real:
        """(2·even d + 2, most) zeros: working memory for moments of a block (see `kernels.blocks.weigh`)."""
        return np.zeros((2 * even(len(self.state)) + 2, self.most), self.state.dtype)


def even(d: int) -> int:
    """The rows in which ``d`` components are summed, two at a time."""
    return d + d % 2
