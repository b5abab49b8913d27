"""Blocks of neighbouring particles: summary statistics of each, and the windows that reach it.

A block is a run of columns of the state whose particles lie close together, so that neighbours are
searched once for all of them. Sums inside a block are in the state's own precision about a point of
the block, everything beyond in float64. A window is a closed rectangle of positions about a
cluster's centre.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Bool, Real
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, FAST, INNER, LANES, VECTOR, extent, whole
from phdtrack.kernels.grid import Grid, make_grid, overlapping, overlapping_pairs, sorted_by_cell
from phdtrack.kernels.mixtures import Candidates, Gaussians

# Column indices are unsigned: an index that might be negative is checked, and the check keeps loops
# from being vectorised.
U = np.uint64
TINY = 1e-300


class Blocks(NamedTuple):
    """Particles in B blocks.

    ``state`` (d, L), ``weight`` (L,) of each or (1,) of all; ``start`` (B + 1,): block b holds the
    columns start[b] … start[b + 1] − 1. ``mass`` (B,) Σw; ``low``, ``high`` (B, d) corners of the
    box that holds the particles; ``middle`` (B, d) of that box, exact in the state's precision;
    ``first`` (B, d), ``second`` (B, d, d) Σw·(x − middle) and Σw·(x − middle)(x − middle)ᵀ, its
    lower triangle; zeros for an empty block. ``grid`` over the boxes of positions.
    """

    state: Real
    weight: Real
    start: I8
    mass: F8
    low: F8
    high: F8
    middle: F8
    first: F8
    second: F8
    grid: Grid


@njit(**(ENTRY | {"fastmath": FAST}))
def summarise(state: Real, weight: Real, start: I8) -> Blocks:
    """The blocks of particles ``state`` (d, L), ``weight`` (L,) or (1,), ``start`` (B + 1,), with
    their summary statistics.

    ValueError if a state is not finite.
    """
    d = state.shape[0]
    blocks = start.size - 1
    unit = 1.0
    if weight.size == 1:
        unit = float(weight[0])
    mass = np.zeros(blocks)
    low = np.zeros((blocks, d))
    high = np.zeros((blocks, d))
    middle = np.zeros((blocks, d))
    first = np.zeros((blocks, d))
    second = np.zeros((blocks, d, d))
    even = d + d % 2
    widest = LANES
    if blocks > 0:
        widest = whole(max(np.max(np.diff(start)), 1))
    row = np.zeros((2 * even + 1, widest), state.dtype)
    zero = np.zeros(d)
    for b in range(blocks):
        n = start[b + 1] - start[b]
        if n == 0:
            continue
        full = load_steps(state, start[b], n, zero, row)
        _centre(row, n, full, low[b], high[b], middle[b])
        mass[b] = n * unit
        by = 0
        if weight.size > 1:
            by = even + 1
            load_row(row, even, n, weight, start[b])
            mass[b] = row_sum(row, even, full)
            weigh(row, even, full, d)
        for r in range(d):
            first[b, r] = unit * row_sum(row, by + r, full)
        add_products(row, by, full, second[b])
        for r in range(d):
            for q in range(r + 1):
                second[b, r, q] *= unit
    if not np.isfinite(middle).all():
        raise ValueError("states must be finite")
    grid = make_grid(low[:, :2].T.copy(), high[:, :2].T.copy(), 0.0, 0.0)
    return Blocks(state, weight, start, mass, low, high, middle, first, second, grid)


@njit(**VECTOR)
def _centre(row: Real, n: int, full: int, low: F8, high: F8, middle: F8) -> None:
    """Write the box of n particles and its middle (d,), and subtract the middle from them."""
    real = row.dtype.type
    for r in range(low.size):
        low[r], high[r] = extent(row, r, 0, full)
        middle[r] = real(0.5 * (low[r] + high[r]))
        shift(row, r, n, full, real(middle[r]))


@njit(**VECTOR)
def shift(row: Real, r: int, n: int, full: int, by: Real) -> None:
    """Subtract a number from the first n of a row; zeros follow."""
    for i in range(U(full)):
        row[r, i] -= by
    for i in range(U(n), U(full)):
        row[r, i] = row.dtype.type(0)


@njit(**VECTOR)
def load_row(row: Real, r: int, n: int, values: Real, begin: int) -> None:
    """Write n of the values, from number ``begin`` on, into a row, and zeros behind them to fill
    the vector registers.
    """
    at = U(begin)
    for i in range(U(min(whole(n), values.size - begin))):
        row[r, i] = values[at + i]
    for i in range(U(n), U(whole(n))):
        row[r, i] = row.dtype.type(0)


@njit(**VECTOR)
def row_sum(row: Real, r: int, n: int) -> float:
    """The sum of the first n numbers of a row."""
    total = row.dtype.type(0)
    for i in range(U(n)):
        total += row[r, i]
    return float(total)


@njit(**VECTOR)
def load_steps(state: Real, begin: int, n: int, middle: F8, row: Real) -> int:
    """Write n states, from column ``begin`` on, minus ``middle`` (d,) into the first rows of
    ``row``.

    Copies of the last one fill the vector registers; returns how many there are with them.
    """
    at = U(begin)
    full: int = whole(n)
    for r in range(state.shape[0]):
        zero = state.dtype.type(middle[r])
        for i in range(U(min(full, state.shape[1] - begin))):
            row[r, i] = state[r, at + i] - zero
        for i in range(U(n), U(full)):
            row[r, i] = row[r, U(n - 1)]
    return full


@njit(**VECTOR)
def add_products(row: Real, weighted: int, n: int, second: F8) -> None:
    """Add the lower triangle of Σ w·s·sᵀ to ``second`` (d, d); steps s in the first rows, w·s from
    row ``weighted`` on.

    Two rows by two, so that each number that is read serves two products; if d is odd, a row of
    zeros follows.
    """
    d = second.shape[0]
    zero = row.dtype.type(0)
    for r in range(0, d, 2):
        for q in range(0, r + 1, 2):
            ae = zero
            af = zero
            be = zero
            bf = zero
            for i in range(U(n)):
                a = row[weighted + r, i]
                b = row[weighted + r + 1, i]
                e = row[q, i]
                f = row[q + 1, i]
                ae += a * e
                af += a * f
                be += b * e
                bf += b * f
            second[r, q] += ae
            if q + 1 < d:
                second[r, q + 1] += af
            if r + 1 < d:
                second[r + 1, q] += be
            if r + 1 < d and q + 1 < d:
                second[r + 1, q + 1] += bf


@njit(**VECTOR)
def weigh(row: Real, weight: int, n: int, d: int) -> None:
    """Write w·s into the rows behind row ``weight``, which holds w."""
    for r in range(d):
        for i in range(U(n)):
            row[weight + 1 + r, i] = row[weight, i] * row[r, i]


def block_moments(blocks: Blocks) -> Gaussians:
    """Masses, means and covariances of the blocks."""
    mass = np.maximum(blocks.mass, TINY)[:, None]
    step = blocks.first / mass
    lower = np.tril(blocks.second)
    second = (lower + np.tril(lower, -1).transpose(0, 2, 1)) / mass[:, :, None]
    return Gaussians(
        blocks.mass, (blocks.middle + step).T.copy(), second - step[:, :, None] * step[:, None, :]
    )


@njit(**ENTRY)
def reaching(blocks: Blocks, low: F8, high: F8) -> Candidates:
    """The windows ``low``, ``high`` (2, k) that overlap each block, ascending."""
    window, block = overlapping_pairs(low, high, blocks.grid)
    first, order = sorted_by_cell(block, blocks.start.size - 1)
    return Candidates(blocks.start, first, window[order])


@njit(**ENTRY)
def unreached(blocks: Blocks, low: F8, high: F8) -> Bool:
    """(L,) true for the particles that lie in none of the windows ``low``, ``high`` (2, k)."""
    x = blocks.state[0]
    y = blocks.state[1]
    near = reaching(blocks, low, high)
    free = np.empty(x.size, np.bool_)
    for b in range(blocks.start.size - 1):
        covered = False
        begin = blocks.start[b]
        end = blocks.start[b + 1]
        windows = near.component[near.first[b] : near.first[b + 1]]
        for j in windows:
            across = low[0, j] <= blocks.low[b, 0] and blocks.high[b, 0] <= high[0, j]
            covered |= across and low[1, j] <= blocks.low[b, 1] and blocks.high[b, 1] <= high[1, j]
        for i in range(begin, end):
            free[i] = not covered
        if covered:
            continue
        for j in windows:
            for i in range(begin, end):
                across = (x[i] >= low[0, j]) & (x[i] <= high[0, j])
                free[i] &= not (across & (y[i] >= low[1, j]) & (y[i] <= high[1, j]))
    return free


@njit(**INNER)
def _inside(state: Real, i: int, low: F8, high: F8, a: int) -> bool:
    """True if particle i lies in window a."""
    across: bool = low[0, a] <= state[0, i] <= high[0, a]
    along: bool = low[1, a] <= state[1, i] <= high[1, a]
    return across and along


@njit(**ENTRY)
def claim(blocks: Blocks, free: Bool, seeds: I8, low: F8, high: F8) -> tuple[F8, Bool]:
    """Centres (d, m) among the particles that are ``free`` (L,), and (L,) those still free after.

    Each of the particles ``seeds`` (k,) that is still free claims the free ones in its window (2,
    k): their mean is a centre.
    """
    d = blocks.state.shape[0]
    state = blocks.state
    left = free.copy()
    count = 0
    near = np.empty(blocks.start.size, np.int64)
    centre = np.empty((d, seeds.size))
    total = np.empty(d)
    for a in range(seeds.size):
        own = seeds[a]
        mass = 0.0
        if not left[own]:
            continue
        for r in range(d):
            total[r] = 0.0
        some = overlapping(low[0, a], low[1, a], high[0, a], high[1, a], blocks.grid, near)
        for m in range(some):
            b = near[m]
            for i in range(blocks.start[b], blocks.start[b + 1]):
                if not (left[i] and _inside(state, i, low, high, a)):
                    continue
                left[i] = False
                weight = blocks.weight[i if blocks.weight.size > 1 else 0]
                mass += weight
                for r in range(d):
                    # About the seed: sums far from the origin lose their digits.
                    total[r] += weight * (state[r, i] - state[r, own])
        if mass > 0.0:
            for r in range(d):
                centre[r, count] = state[r, own] + total[r] / mass
            count += 1
    return centre[:, :count].copy(), left
