"""Blocks of neighbouring particles: what is known of one without looking at its particles again, and which windows reach it.

A block is a run of columns of the state whose particles lie close together, so that what is near one of them is found once
for all. Sums inside a block are taken in the state's own precision about a point of the block, everything beyond in float64.
A window is a closed rectangle of positions, about a cluster's centre.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.em import Candidates
from phdtrack.kernels.fast32 import ENTRY, FAST, INNER, VECTOR, sortable, sorted_number
from phdtrack.kernels.grid import Grid, overlapping, overlapping_pairs
from phdtrack.kernels.mixtures import Gaussians

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]
Real = NDArray[np.floating[Any]]
# Columns are counted without a sign: one that might be negative is checked, and the check keeps loops from being vectorised.
U = np.uint64


class Blocks(NamedTuple):
    """Particles in B blocks.

    ``state`` (d, L), ``weight`` (L,) of each or (1,) of all; ``start`` (B + 1,): block b holds the columns start[b] …
    start[b + 1] − 1. ``mass`` (B,) Σw; ``low``, ``high`` (B, d) corners of the box that holds the particles; ``middle``
    (B, d) a point among them, exact in the state's precision; ``first`` (B, d) Σw·(x − middle). Zeros for an empty block.
    """

    state: Real
    weight: Real
    start: I8
    mass: F8
    low: F8
    high: F8
    middle: F8
    first: F8


@njit(**VECTOR)
def extent(state: Real, r: int, begin: int, n: int) -> tuple[float, float]:
    """The smallest and the largest of n > 0 numbers of a row, from column ``begin`` on."""
    at = U(begin)
    low = high = sortable(state[r, begin])
    for i in range(U(n)):
        key = sortable(state[r, at + i])
        low, high = min(low, key), max(high, key)
    return sorted_number(low), sorted_number(high)


@njit(**(ENTRY | {"fastmath": FAST}))
def summarise(state: Real, weight: Real, start: I8) -> Blocks:
    """The blocks of particles ``state`` (d, L), ``weight`` (L,) or (1,), ``start`` (B + 1,), with what is known of each."""
    d, blocks, real = state.shape[0], start.size - 1, state.dtype.type
    mass, low, high = np.zeros(blocks), np.zeros((blocks, d)), np.zeros((blocks, d))
    middle, first = np.zeros((blocks, d)), np.zeros((blocks, d))
    for b in range(blocks):
        begin, n = start[b], start[b + 1] - start[b]
        at, unit = U(begin), float(weight[0])
        if n == 0:
            continue
        for r in range(d):
            low[b, r], high[b, r] = extent(state, r, begin, n)
            one, total = state[r, begin], real(0)
            for i in range(U(n)):
                total += state[r, at + i] - one
            here = one + total / real(n)
            middle[b, r] = here
            first[b, r] = unit * (float(total) + n * (float(one) - float(here)))
        mass[b] = n * unit
        if weight.size == 1:
            continue
        total = real(0)
        for i in range(U(n)):
            total += weight[at + i]
        mass[b] = total
        for r in range(d):
            here, total = real(middle[b, r]), real(0)
            for i in range(U(n)):
                total += weight[at + i] * (state[r, at + i] - here)
            first[b, r] = total
    return Blocks(state, weight, start, mass, low, high, middle, first)


@njit(**VECTOR)
def load_steps(state: Real, begin: int, n: int, middle: F8, b: int, row: Real) -> None:
    """Write the n states of block b, from column ``begin`` on, less its middle into the first rows of ``row``."""
    at = U(begin)
    for r in range(state.shape[0]):
        zero = state.dtype.type(middle[b, r])
        for i in range(U(n)):
            row[r, i] = state[r, at + i] - zero


@njit(**VECTOR)
def add_products(row: Real, weighted: int, n: int, second: F8) -> None:
    """Add the lower triangle of Σ w·s·sᵀ to ``second`` (d, d); steps s in the first rows, w·s from row ``weighted`` on.

    The row behind each of them is zeros where d is odd: two rows by two, each number that is read serves two products.
    """
    d, zero = second.shape[0], row.dtype.type(0)
    for r in range(0, d, 2):
        for q in range(0, r + 1, 2):
            ae, af, be, bf = zero, zero, zero, zero
            for i in range(U(n)):
                a, b, e, f = row[weighted + r, i], row[weighted + r + 1, i], row[q, i], row[q + 1, i]
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


@njit(**(ENTRY | {"fastmath": FAST}))
def block_moments(blocks: Blocks) -> Gaussians:
    """Masses, means and covariances of the blocks."""
    count, d = blocks.middle.shape
    widest, even = max(np.max(np.diff(blocks.start)), 1), d + d % 2
    row, cov = np.zeros((2 * even + 1, widest), blocks.state.dtype), np.zeros((count, d, d))
    mean = blocks.middle.T.copy()
    for b in range(count):
        at, n, mass = blocks.start[b], blocks.start[b + 1] - blocks.start[b], blocks.mass[b]
        if not mass > 0.0:
            continue
        load_steps(blocks.state, at, n, blocks.middle, b, row)
        row[even, :n] = blocks.weight[0]
        if blocks.weight.size > 1:
            row[even, :n] = blocks.weight[at : at + n]
        weigh(row, even, n, d)
        add_products(row, even + 1, n, cov[b])
        for r in range(d):
            step = blocks.first[b, r] / mass
            mean[r, b] += step
            for q in range(r + 1):
                cov[b, r, q] = cov[b, r, q] / mass - step * blocks.first[b, q] / mass
                cov[b, q, r] = cov[b, r, q]
    return Gaussians(blocks.mass, mean, cov)


@njit(**INNER)
def holds(low: F8, high: F8, j: int, box_low: F8, box_high: F8, b: int) -> bool:
    """Whether window j (2, k) holds the whole box b (B, d)."""
    across: bool = low[0, j] <= box_low[b, 0] and box_high[b, 0] <= high[0, j]
    along: bool = low[1, j] <= box_low[b, 1] and box_high[b, 1] <= high[1, j]
    return across and along


@njit(**ENTRY)
def reaching(blocks: Blocks, grid: Grid, low: F8, high: F8) -> Candidates:
    """The windows ``low``, ``high`` (2, k) that overlap each block, ascending; ``grid`` is over the blocks' boxes."""
    window, block = overlapping_pairs(low, high, grid)
    first, which = np.zeros(blocks.start.size, np.int64), np.empty(window.size, np.int64)
    for p in range(block.size):
        first[block[p] + 1] += 1
    for b in range(first.size - 1):
        first[b + 1] += first[b]
    place = first.copy()
    for p in range(block.size):
        which[place[block[p]]] = window[p]
        place[block[p]] += 1
    return Candidates(blocks.start, first, which)


@njit(**ENTRY)
def unreached(blocks: Blocks, near: Candidates, low: F8, high: F8) -> Bool:
    """(L,) which particles lie in none of the windows that are ``near`` their block."""
    x, y = blocks.state[0], blocks.state[1]
    free = np.empty(x.size, np.bool_)
    for b in range(blocks.start.size - 1):
        covered, begin, end = False, blocks.start[b], blocks.start[b + 1]
        windows = near.component[near.first[b] : near.first[b + 1]]
        for j in windows:
            covered |= holds(low, high, j, blocks.low, blocks.high, b)
        for i in range(begin, end):
            free[i] = not covered
        for j in windows[: 0 if covered else windows.size]:
            for i in range(begin, end):
                free[i] &= not ((x[i] >= low[0, j]) & (x[i] <= high[0, j]) & (y[i] >= low[1, j]) & (y[i] <= high[1, j]))
    return free


@njit(**ENTRY)
def claim(blocks: Blocks, grid: Grid, free: Bool, asked: I8, low: F8, high: F8) -> tuple[F8, Bool]:
    """Centres (d, m) among the particles that are ``free`` (L,), and which are left.

    Each of the particles ``asked`` (k,) that is still free claims the free ones in its window (2, k): their mean is a
    centre.
    """
    state, d, left, count = blocks.state, blocks.state.shape[0], free.copy(), 0
    found, centre, total = np.empty(blocks.start.size, np.int64), np.empty((d, asked.size)), np.empty(d)
    for a in range(asked.size):
        own, mass = asked[a], 0.0
        if not left[own]:
            continue
        for r in range(d):
            total[r] = 0.0
        for m in range(overlapping(low[0, a], low[1, a], high[0, a], high[1, a], grid, found)):
            b = found[m]
            for i in range(blocks.start[b], blocks.start[b + 1]):
                inside = low[0, a] <= state[0, i] <= high[0, a] and low[1, a] <= state[1, i] <= high[1, a]
                if not (inside and left[i]):
                    continue
                left[i] = False
                weight = blocks.weight[i] if blocks.weight.size > 1 else blocks.weight[0]
                mass += weight
                for r in range(d):
                    # About the asked particle: sums far from the origin lose their digits.
                    total[r] += weight * (state[r, i] - state[r, own])
        if mass > 0.0:
            for r in range(d):
                centre[r, count] = state[r, own] + total[r] / mass
            count += 1
    return centre[:, :count].copy(), left
