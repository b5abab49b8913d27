"""Weights in descending order, in linear time."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

BITS = 8
SIZE = 1 << BITS
DIGITS = 8


@njit(cache=True)
def descending(weight: F8) -> I8:
    """(J,) indices by descending weight (each ≥ 0, no NaN), the lower index first where equal.

    The bits of positive floats sort like integers: a radix sort by bytes. A digit in which all agree, as of the
    exponents of most mixtures, is skipped.
    """
    n = weight.size
    key = np.empty(n, np.int64)
    bits = weight.view(np.int64)
    count = np.zeros((DIGITS, SIZE), np.int64)
    for i in range(n):
        key[i] = 0x7FFFFFFFFFFFFFFF - bits[i]
        for digit in range(DIGITS):
            count[digit, (key[i] >> (BITS * digit)) & (SIZE - 1)] += 1
    order, spare = np.arange(n), np.empty(n, np.int64)
    for digit in range(DIGITS):
        shift = BITS * digit
        if n == 0 or count[digit, (key[0] >> shift) & (SIZE - 1)] == n:
            continue
        place = 0
        for b in range(SIZE):
            here = count[digit, b]
            count[digit, b] = place
            place += here
        for k in range(n):
            b = (key[order[k]] >> shift) & (SIZE - 1)
            spare[count[digit, b]] = order[k]
            count[digit, b] += 1
        order, spare = spare, order
    return order
