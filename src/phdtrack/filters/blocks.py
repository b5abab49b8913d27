"""Plain particles to blocks of neighbours, and back."""

from __future__ import annotations

import numpy as np

from phdtrack.kernels.comb import by_cells, cut
from phdtrack.kernels.resample import systematic
from phdtrack.types import ParticleBlocks, Particles

# Blocks are put together up to this extent, in boxes.
REACH = 1.0


def plain(state: Particles | ParticleBlocks) -> Particles:
    """The intensity as plain particles."""
    return state.particles() if isinstance(state, ParticleBlocks) else state


def blocked(state: Particles | ParticleBlocks, particles_per_target: int, rng: np.random.Generator) -> ParticleBlocks:
    """The intensity in blocks; resampled where its weights are not equal."""
    if isinstance(state, ParticleBlocks):
        return state
    if len(state) == 0:
        return ParticleBlocks.empty(len(state.state))
    unit, x = float(state.weight[0]), state.state
    if not (state.weight == unit).all():
        count = round(particles_per_target * state.mass)
        x = x[:, systematic(state.weight, count, rng.random())]
        unit = state.mass / max(1, count)
    points = np.stack([x[0], x[1], x[0], x[1], x[4], x[5]], axis=1).astype(np.float32)
    order = by_cells(points)
    start, _ = cut(points, order, np.ones(x.shape[1], np.int64), REACH)
    return ParticleBlocks(np.ascontiguousarray(x[:, order], np.float32), start, unit)
