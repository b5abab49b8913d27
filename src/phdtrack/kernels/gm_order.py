"""Weights in descending order, in linear time."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# Up to this many, insertion is faster than counting.
FEW = 48
BITS = 8
SIZE = 1 << BITS
DIGITS = 8


@njit(**INNER)
def descending(weight: F8) -> I8:
    """(J,) indices by descending weight (each ≥ 0, no NaN), the lower index first where equal.

    The bits of positive floats sort like integers: a radix sort by bytes. A digit in which all agree, as of the
    exponents of most mixtures, is skipped.
    """
    n = weight.size
    order = np.empty(n, np.int64)
    if n <= FEW:
        for i in range(n):
            k = i
            while k > 0 and weight[order[k - 1]] < weight[i]:
                order[k] = order[k - 1]
                k -= 1
            order[k] = i
        return order
    bits = weight.view(np.int64)
    key, spare_key, spare = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    count = np.empty(DIGITS * SIZE, np.int64)
    for b in range(DIGITS * SIZE):
        count[b] = 0
    for i in range(n):
        key[i] = 0x7FFFFFFFFFFFFFFF - bits[i]
        order[i] = i
        for digit in range(DIGITS):
            count[digit * SIZE + ((key[i] >> (BITS * digit)) & (SIZE - 1))] += 1
    for digit in range(DIGITS):
        shift, first = BITS * digit, digit * SIZE
        if count[first + ((key[0] >> shift) & (SIZE - 1))] == n:
            continue
        place = 0
        for b in range(first, first + SIZE):
            here = count[b]
            count[b] = place
            place += here
        for k in range(n):
            b = first + ((key[k] >> shift) & (SIZE - 1))
            spare[count[b]], spare_key[count[b]] = order[k], key[k]
            count[b] += 1
        order, spare, key, spare_key = spare, order, spare_key, key
    return order
