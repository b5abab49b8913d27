"""Blocks of neighbouring particles: how they are cut, and what is known of one without looking at its particles again.

A block is a run of columns of the state, ``start[b]`` … ``start[b + 1]`` − 1. Its particles are close together, so that what
is near one of them is found once for all, and inner loops run over its particles without branches. Sums inside a block are
taken in the state's own precision about a point of the block; everything beyond a block is float64.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import FAST

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
# float32 from the fused filter, float64 from any other.
Real = NDArray[np.floating[Any]]
Bits = NDArray[np.signedinteger[Any]]


@njit(nogil=True, fastmath=FAST)
def widest(start: I8) -> int:
    """Particles in the largest block, at least 1."""
    most = 1
    for b in range(start.size - 1):
        most = max(most, start[b + 1] - start[b])
    return most


@njit(nogil=True, fastmath=FAST)
def even(d: int) -> int:
    """Rows of scratch for ``d`` components: sums are taken two rows at a time."""
    return d + d % 2


@njit(nogil=True, fastmath=FAST)
def load_steps(state: Real, begin: int, n: int, origin: Real, step: Real) -> None:
    """Write the block's states, relative to ``origin`` (d,), into ``step`` (≥ d, ≥ n)."""
    for r in range(state.shape[0]):
        row, out, zero = state[r, begin : begin + n], step[r], origin[r]
        for i in range(n):
            out[i] = row[i] - zero


@njit(nogil=True, fastmath=FAST)
def load_weight(weight: Real, begin: int, n: int, out: Real) -> None:
    """Write the block's weights into ``out``; a single weight is that of every particle."""
    # A slice assignment would cost two seconds of compilation.
    if weight.size == 1:
        for i in range(n):
            out[i] = weight[0]
    else:
        part = weight[begin : begin + n]
        for i in range(n):
            out[i] = part[i]


@njit(nogil=True, fastmath=FAST)
def weigh(weight: Real, step: Real, n: int, d: int, weighted: Real) -> float:
    """Σw of n particles; their w·s go into the first ``d`` rows of ``weighted``."""
    mass = step.dtype.type(0)
    for i in range(n):
        mass += weight[i]
    for r in range(d):
        source, out = step[r], weighted[r]
        for i in range(n):
            out[i] = weight[i] * source[i]
    return float(mass)


@njit(nogil=True, fastmath=FAST)
def gather(weighted: Real, step: Real, n: int, unit: float, first: F8, second: F8) -> None:
    """Write ``unit`` times Σw·s into ``first`` (d,) and the lower triangle of Σw·s·sᵀ into ``second`` (even d, even d).

    ``step`` and ``weighted`` have an even number of rows, the last of them 0 where d is odd.
    """
    zero = step.dtype.type(0)
    for r in range(first.size):
        a, total = weighted[r], zero
        for i in range(n):
            total += a[i]
        first[r] = unit * total
    # Two rows by two: each number that is read serves two products.
    for r in range(0, step.shape[0], 2):
        a, b = weighted[r], weighted[r + 1]
        for s in range(0, r + 1, 2):
            e, f = step[s], step[s + 1]
            ae, af, be, bf = zero, zero, zero, zero
            for i in range(n):
                ae += a[i] * e[i]
                af += a[i] * f[i]
                be += b[i] * e[i]
                bf += b[i] * f[i]
            second[r, s], second[r, s + 1] = unit * ae, unit * af
            second[r + 1, s], second[r + 1, s + 1] = unit * be, unit * bf


@njit(nogil=True, fastmath=FAST)
def extent(row: Bits) -> tuple[np.signedinteger[Any], np.signedinteger[Any]]:
    """The smallest and the largest of the numbers whose bits are given, as integers in the same order.

    Minima of floats do not vectorise as long as NaN counts. The bits of floats compare like integers once those of
    negative numbers are turned over; turning twice gives the bits back.
    """
    integer = row.dtype.type
    sign = integer(8 * row.itemsize - 1)
    turn = integer(~(integer(1) << sign))
    low, high = turn, integer(~turn)
    for i in range(row.size):
        value = integer(row[i] ^ ((row[i] >> sign) & turn))
        low, high = min(low, value), max(high, value)
    return integer(low ^ ((low >> sign) & turn)), integer(high ^ ((high >> sign) & turn))


@njit(nogil=True, cache=True, fastmath=FAST)
def summarise(state: Real, bits: Bits, weight: Real, start: I8) -> tuple[Bits, Bits, Real, F8, F8, F8]:
    """What is known of each block.

    Parameters
    ----------
    state : (d, L) particles, ``bits`` the same memory seen as integers.
    weight : (L,) or (1,), of each or of all.
    start : (B + 1,) where blocks begin.

    Returns
    -------
    lower, upper : (B, d) the box that holds the block's particles, as bits.
    origin : (B, d) a point in their middle.
    mass, first, second : (B,) Σw, (B, d) Σw·s and (B, even d, even d) the lower triangle of Σw·s·sᵀ, for s = x − origin.

    Raises
    ------
    ValueError : a state is NaN or infinite.
    """
    d, blocks, most = state.shape[0], start.size - 1, widest(start)
    lower, upper = np.zeros((blocks, d), bits.dtype), np.zeros((blocks, d), bits.dtype)
    origin = np.zeros((blocks, d), state.dtype)
    mass, first, second = np.zeros(blocks), np.zeros((blocks, d)), np.zeros((blocks, even(d), even(d)))
    step, weighted = np.zeros((even(d), most), state.dtype), np.zeros((even(d), most), state.dtype)
    w = np.empty(most, state.dtype)
    check = 0.0
    for b in range(blocks):
        begin, n = start[b], start[b + 1] - start[b]
        if n == 0:
            continue
        for r in range(d):
            lower[b, r], upper[b, r] = extent(bits[r, begin : begin + n])
            row = state[r, begin : begin + n]
            middle = state.dtype.type(0)
            for i in range(n):
                middle += row[i] - row[0]
            origin[b, r] = row[0] + middle / state.dtype.type(n)
            check += origin[b, r]
        load_steps(state, begin, n, origin[b], step)
        if weight.size == 1:
            mass[b] = n * float(weight[0])
            gather(step, step, n, float(weight[0]), first[b], second[b])
        else:
            load_weight(weight, begin, n, w)
            mass[b] = weigh(w, step, n, d, weighted)
            gather(weighted, step, n, 1.0, first[b], second[b])
    if not np.isfinite(check):
        raise ValueError("states must be finite")
    return lower, upper, origin, mass, first, second


@njit(nogil=True, cache=True)
def cut(state: F8, weight: F8, most: int) -> tuple[F8, F8, I8]:
    """Any particles as blocks: the particles (d, L) and weights (L,) in the order of a grid's cells, and ``start`` (B + 1,).

    Rows 0 and 1 are positions. A block holds at most ``most`` particles of one cell or of neighbours in its row.
    """
    d, n = state.shape
    x, y = state[0], state[1]
    x0, y0 = x.min(), y.min()
    wide, high = x.max() - x0 + 1e-9, y.max() - y0 + 1e-9
    # About four particles to a cell if they lay everywhere; they do not, and so a cloud of them fills some cells.
    side = np.sqrt(wide * high / (0.25 * n + 1.0))
    nx = int(min(wide / side, 0.25 * n)) + 1
    ny = int(min(high / side, 0.25 * n)) + 1
    cell = np.empty(n, np.int64)
    place = np.zeros(nx * ny + 1, np.int64)
    for i in range(n):
        column, line = int((x[i] - x0) / wide * nx), int((y[i] - y0) / high * ny)
        cell[i] = min(line, ny - 1) * nx + min(column, nx - 1)
        place[cell[i] + 1] += 1
    start = np.empty(n + 1, np.int64)
    blocks, before, began = 0, -2, -1
    for c in range(nx * ny):
        count = place[c + 1]
        if count > 0 and (c != before + 1 or c % nx == 0):
            began = -1
        # Cells are filled up in turn: a new block begins where the last is full or the cells part.
        at = place[c]
        while count > 0:
            if began < 0 or at - began == most:
                began = at
                start[blocks] = at
                blocks += 1
            taken = min(count, most - (at - began))
            at += taken
            count -= taken
        if at > place[c]:
            before = c
        place[c + 1] += place[c]
    start[blocks] = n
    sorted_state, sorted_weight = np.empty((d, n)), np.empty(n)
    for i in range(n):
        p = place[cell[i]]
        place[cell[i]] += 1
        sorted_weight[p] = weight[i]
        for r in range(d):
            sorted_state[r, p] = state[r, i]
    return sorted_state, sorted_weight, start[: blocks + 1].copy()
