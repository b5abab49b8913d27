"""Blocks of neighbouring particles: how they are cut, and what is known of one without looking at its particles again.

A block is a run of columns of the state, ``start[b]`` … ``start[b + 1]`` − 1. Its particles are close together, so that what
is near one of them is found once for all, and inner loops run over its particles without branches. Sums inside a block are
taken in the state's own precision about a point of the block; everything beyond a block is float64.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, FAST, VECTOR

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
# float32 from the fused filter, float64 from any other.
Real = NDArray[np.floating[Any]]
Bits = NDArray[np.signedinteger[Any]]
# Places in a row are counted without a sign: one that might be negative is checked, and the check would keep the loop from
# being vectorised. Cutting the row out instead costs more than what is done with its few hundred numbers.
U = np.uint64


# Inner loops run over whole registers of this many numbers: what is left over would run one by one.
LANES = 16


@njit(**VECTOR)
def whole(n: int) -> int:
    """The least multiple of ``LANES`` that is not below n."""
    return (n + LANES - 1) // LANES * LANES


@njit(**VECTOR)
def working_memory(state: Real, most: int) -> Real:
    """(2·even d + 2, n) for blocks of up to ``most`` particles, n as `whole` has it; zeros where d is odd, to sum them."""
    even = state.shape[0] + state.shape[0] % 2
    scratch, zero = np.empty((2 * even + 2, whole(most)), state.dtype), state.dtype.type(0)
    for r in (even - 1, 2 * even - 1):
        for i in range(scratch.shape[1]):
            scratch[r, i] = zero
    return scratch


@njit(**VECTOR)
def load_steps(state: Real, begin: int, n: int, known: F8, b: int, scratch: Real) -> None:
    """Write the states of block b, relative to the point in its middle, into the first d rows of ``scratch``.

    Zeros follow up to the next multiple of ``LANES``.
    """
    d, at, full, nothing = state.shape[0], U(begin), whole(n), state.dtype.type(0)
    for r in range(d):
        zero = state.dtype.type(known[b, 1 + 2 * d + r])
        for i in range(U(n)):
            scratch[r, i] = state[r, at + i] - zero
        for i in range(U(n), U(full)):
            scratch[r, i] = nothing


@njit(**VECTOR)
def load_weight(weight: Real, begin: int, n: int, scratch: Real, row: int) -> None:
    """Write the weights of n particles into a row of ``scratch``; zeros follow up to the next multiple of ``LANES``."""
    at, one, full, nothing = U(begin), weight[0], whole(n), weight.dtype.type(0)
    if weight.size > 1:
        for i in range(U(n)):
            scratch[row, i] = weight[at + i]
    else:
        for i in range(U(n)):
            scratch[row, i] = one
    for i in range(U(n), U(full)):
        scratch[row, i] = nothing


@njit(**VECTOR)
def weigh(scratch: Real, n: int, d: int) -> float:
    """Σw of n particles: from rows s (d) and, behind an even number of them, w·s (d) and w; writes w·s."""
    even = d + d % 2
    mass = scratch.dtype.type(0)
    for i in range(U(n)):
        mass += scratch[2 * even, i]
    for r in range(d):
        for i in range(U(n)):
            scratch[even + r, i] = scratch[2 * even, i] * scratch[r, i]
    return float(mass)


@njit(**VECTOR)
def sums(scratch: Real, n: int, left: int, first: F8) -> None:
    """Write the sums of the rows of ``scratch`` from ``left`` on into ``first`` (d,)."""
    for r in range(first.size):
        total = scratch.dtype.type(0)
        for i in range(U(n)):
            total += scratch[left + r, i]
        first[r] = total


@njit(**VECTOR)
def products(scratch: Real, n: int, left: int, second: F8) -> None:
    """Write the lower triangle of Σw·s·sᵀ into ``second`` (even d, even d).

    Rows of ``scratch``: s, and from row ``left`` on w·s, an even number of each, the last of them 0 where d is odd; with
    ``left`` 0 all w are 1.
    """
    zero, even = scratch.dtype.type(0), second.shape[0]
    # Two rows by two: each number that is read serves two products.
    for r in range(0, even, 2):
        for s in range(0, r + 1, 2):
            ae, af, be, bf = zero, zero, zero, zero
            for i in range(U(n)):
                a, b, e, f = scratch[left + r, i], scratch[left + r + 1, i], scratch[s, i], scratch[s + 1, i]
                ae += a * e
                af += a * f
                be += b * e
                bf += b * f
            second[r, s], second[r, s + 1] = ae, af
            second[r + 1, s], second[r + 1, s + 1] = be, bf


@njit(**VECTOR)
def load(state: Real, weight: Real, begin: int, n: int, known: F8, b: int, scratch: Real) -> float:
    """Load the n particles of block b for `sums` and `spread`: s and, unless all weigh the same, w·s; Σw."""
    load_steps(state, begin, n, known, b, scratch)
    if weight.size == 1:
        return n * float(weight[0])
    d = state.shape[0]
    load_weight(weight, begin, n, scratch, 2 * (d + d % 2))
    return float(weigh(scratch, whole(n), d))


@njit(**VECTOR)
def spread(weight: Real, scratch: Real, n: int, second: F8) -> None:
    """Write the lower triangle of Σw·s·sᵀ of what `load` has loaded into ``second`` (even d, even d)."""
    even = second.shape[0]
    products(scratch, whole(n), even if weight.size > 1 else 0, second)
    if weight.size == 1:
        for r in range(even):
            for s in range(r + 1):
                second[r, s] *= float(weight[0])


@njit(**VECTOR)
def extent(bits: Bits, r: int, begin: int, n: int) -> tuple[np.signedinteger[Any], np.signedinteger[Any]]:
    """The smallest and the largest of n numbers in row r whose bits are given, as integers in the same order.

    Minima of floats do not vectorise as long as NaN counts. The bits of floats compare like integers once those of
    negative numbers are turned over; turning twice gives the bits back.
    """
    integer, at = bits.dtype.type, U(begin)
    sign = integer(8 * bits.itemsize - 1)
    turn = integer(~(integer(1) << sign))
    low, high = turn, integer(~turn)
    for i in range(U(n)):
        value = bits[r, at + i]
        value = integer(value ^ ((value >> sign) & turn))
        low, high = min(low, value), max(high, value)
    return integer(low ^ ((low >> sign) & turn)), integer(high ^ ((high >> sign) & turn))


@njit(**(ENTRY | {"fastmath": FAST}))
def summarise(lo: int, hi: int, state: Real, bits: Bits, weight: Real, start: I8, known: F8, second: F8) -> int:
    """What is known of the blocks lo … hi − 1; the particles in the largest of them, or −1 if a state is not finite.

    Parameters
    ----------
    state : (d, L) particles, ``bits`` the same memory seen as integers.
    weight : (L,) or (1,), of each or of all.
    start : (B + 1,) where blocks begin.
    known : (B, 1 + 4d) written: Σw; the low and the high corner of the box that holds the particles; a point in their
        middle, exact in the states' precision; Σw·x. Zeros for an empty block.
    second : (B, even d, even d) written: the lower triangle of Σw·s·sᵀ, where s is x less the point in the middle; nothing
        is where it is (0, even d, even d).
    """
    d, even, check, most = state.shape[0], second.shape[1], 0.0, 0
    for b in range(lo, hi):
        most = max(most, start[b + 1] - start[b])
    scratch, first, box_bits = working_memory(state, most), np.empty(d), np.empty(2, bits.dtype)
    box = box_bits.view(state.dtype)
    for b in range(lo, hi):
        begin, n = start[b], start[b + 1] - start[b]
        if n == 0:
            for c in range(known.shape[1]):
                known[b, c] = 0.0
            if second.shape[0] > 0:
                for r in range(even):
                    for s in range(even):
                        second[b, r, s] = 0.0
            continue
        for r in range(d):
            box_bits[0], box_bits[1] = extent(bits, r, begin, n)
            known[b, 1 + r], known[b, 1 + d + r] = box[0], box[1]
            at, one, total = U(begin), state[r, begin], state.dtype.type(0)
            for i in range(U(n)):
                total += state[r, at + i] - one
            known[b, 1 + 2 * d + r] = one + total / state.dtype.type(n)
            known[b, 1 + 3 * d + r] = float(total) + n * float(one)
            check += known[b, 1 + 2 * d + r]
        if not np.isfinite(check):
            return -1
        known[b, 0] = n * float(weight[0])
        if weight.size > 1 or second.shape[0] > 0:
            known[b, 0] = load(state, weight, begin, n, known, b, scratch)
        if second.shape[0] > 0:
            spread(weight, scratch, n, second[b])
        if weight.size > 1:
            sums(scratch, whole(n), even, first)
        for r in range(d):
            if weight.size > 1:
                known[b, 1 + 3 * d + r] = first[r] + known[b, 0] * known[b, 1 + 2 * d + r]
            else:
                known[b, 1 + 3 * d + r] *= float(weight[0])
    return most


@njit(**ENTRY)
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
