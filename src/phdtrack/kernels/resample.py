"""Systematic resampling: a comb with equal teeth over the cumulative weights."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]


@njit(cache=True)
def systematic(weight: F8, count: int, offset: float) -> I8:
    """(count,) indices of the offspring of systematic resampling.

    Tooth n stands at (n + offset)/count of the total weight, 0 ≤ offset < 1, so that a point of weight w has between
    ⌊count·w/Σ⌋ and ⌈count·w/Σ⌉ offspring. The running sum is float64: in float32 a million weights lose the small ones.
    """
    out = np.empty(count, np.int64)
    if count == 0:
        return out
    step = weight.sum() / count
    target = offset * step
    reached = 0.0
    n = 0
    for i in range(weight.size):
        reached += weight[i]
        while n < count and target < reached:
            out[n] = i
            n += 1
            target = (n + offset) * step
    # Rounding can leave the last teeth beyond the last sum; they belong to the last point that has weight.
    last = weight.size - 1
    while last > 0 and weight[last] == 0.0:
        last -= 1
    while n < count:
        out[n] = last
        n += 1
    return out
