"""Arrays of one value, and a place in an ordered array, for kernels.

Numba compiles `numpy.zeros`, `numpy.ones`, `numpy.full` and `numpy.searchsorted` anew for each way
to call them, with the texts of errors and broadcasting, which takes several times as long as these
loops.
"""

from __future__ import annotations

import numpy as np

from phdtrack.kernels import F8, I8, Bool
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import INNER


@njit(**INNER)
def floats(n: int, value: float) -> F8:
    """(n,) floats of one value."""
    out = np.empty(n)
    for i in range(n):
        out[i] = value
    return out


# Each literal integer is a type of its own, for which a function would be compiled anew.
@njit(**INNER)
def zeros(n: int) -> I8:
    """(n,) integers 0."""
    out = np.empty(n, np.int64)
    for i in range(n):
        out[i] = 0
    return out


@njit(**INNER)
def minus_ones(n: int) -> I8:
    """(n,) integers −1."""
    out = np.empty(n, np.int64)
    for i in range(n):
        out[i] = -1
    return out


@njit(**INNER)
def flags(n: int, value: bool) -> Bool:
    """(n,) truth values that are all the same."""
    out = np.empty(n, np.bool_)
    for i in range(n):
        out[i] = value
    return out


@njit(**INNER)
def first_not_below(ascending: I8, value: int) -> int:
    """The first place in an ascending array (n,) whose number is not below a value, or n."""
    low = 0 * ascending.size
    high = ascending.size
    while low < high:
        middle = (low + high) // 2
        if ascending[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low
