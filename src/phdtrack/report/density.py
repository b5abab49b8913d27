"""The intensity as a picture: how many objects the filter expects in each small cell of the frame.

A particle set describes the intensity D over states; its weights sum to the expected count. Binning the weights by the
position rows of the state (rows 0 and 1, pixels) integrates velocity and size away and leaves D over position, as M07
shows it in its Fig. 1. A few thousand particles over some ten thousand cells make a grainy picture; a short binomial
smoothing removes the grain. Borders reflect, so that smoothing moves mass between cells and never loses any: the grid
sums to the mass of the particles inside the frame.
"""

from __future__ import annotations

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8, Particles, SequenceInfo

_CELLS_ACROSS = 128


def default_cell(info: SequenceInfo) -> float:
    """Side of a cell in pixels that gives about 128 cells across the longer side of the frame; at least one pixel."""
    return max(1.0, round(max(info.width, info.height) / _CELLS_ACROSS))


def density_map(particles: Particles, info: SequenceInfo, cell: float, *, smooth: int = 2) -> F8:
    """(gh, gw) expected number of objects in each cell of ``cell`` × ``cell`` pixels; row 0 is the top of the frame.

    ``smooth`` is the number of passes with the kernel (1, 2, 1)/4 along both axes. The sum is the mass of the particles
    whose position lies inside the frame [M07 Fig. 1]. The last row and column may reach beyond the frame's edge.

    Raises `InputError` where the cell or the frame has no size.
    """
    if not (cell > 0 and info.width > 0 and info.height > 0):
        raise InputError(
            f"expected a cell and a frame of positive size, got a cell of {cell} and a frame of {info.width}×{info.height}",
            cure="Give the frame size of the sequence.",
        )
    shape = (int(np.ceil(info.height / cell)), int(np.ceil(info.width / cell)))
    x, y = particles.state[0], particles.state[1]
    inside = (x >= 0) & (y >= 0) & (x < info.width) & (y < info.height)
    column = (x[inside] / cell).astype(np.int64)
    row = (y[inside] / cell).astype(np.int64)
    flat = np.bincount(row * shape[1] + column, weights=particles.weight[inside], minlength=shape[0] * shape[1])
    grid: F8 = flat.astype(np.float64).reshape(shape)
    for _ in range(smooth):
        grid = _binomial(_binomial(grid).T).T
    return np.ascontiguousarray(grid)


def _binomial(grid: F8) -> F8:
    """One pass of (1, 2, 1)/4 down the columns; the edge row stands in for its missing neighbour, which keeps the sum."""
    above = np.concatenate([grid[:1], grid[:-1]])
    below = np.concatenate([grid[1:], grid[-1:]])
    blurred: F8 = (above + 2 * grid + below) / 4
    return blurred
