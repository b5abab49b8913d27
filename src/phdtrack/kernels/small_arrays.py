"""Arrays of one value, copies into arrays, and places in ordered arrays, for kernels.

Numba compiles `numpy.zeros`, `numpy.ones`, `numpy.full`, `numpy.searchsorted`, `numpy.sort` and
``out[:n] = values`` anew for each way to call them, with the texts of errors and broadcasting,
which takes many times as long as these loops.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

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
def copy_into(values: NDArray[Any], out: NDArray[Any]) -> None:
    """Write the values (n,) into the first n places of ``out``."""
    for i in range(values.size):
        out[i] = values[i]


@njit(**INNER)
def copy_rows(values: NDArray[Any], out: NDArray[Any]) -> None:
    """Write the values (m, n) into ``out`` (m, n)."""
    for i in range(values.shape[0]):
        for k in range(values.shape[1]):
            out[i, k] = values[i, k]


@njit(**INNER)
def ascending_at(values: F8, place: int) -> float:
    """The value that would be at this place, from 0, if the values (n,), no NaN, were sorted."""
    part = np.empty(values.size)
    copy_into(values, part)
    found: float = select(part, place)
    return found


@njit(**INNER)
def select(values: F8, place: int) -> float:
    """`ascending_at` of values whose order changes: none before the place is above it then.

    Hoare's selection: those on the wrong side of a pivot change sides, until it is in its place.
    """
    low = 0 * place
    high = values.size - 1
    while low < high:
        pivot = values[place]
        i = low
        k = high
        while i <= k:
            while values[i] < pivot:
                i += 1
            while values[k] > pivot:
                k -= 1
            if i <= k:
                values[i], values[k] = values[k], values[i]
                i += 1
                k -= 1
        if k < place:
            low = i
        if place < i:
            high = k
    return float(values[place])


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
