"""Sweeps over blocks of particles: predict, likelihoods, weights, resampling [M07 §2, M09 §III].

A block is a run of at most `BLOCK` particles that lie close together, so that the measurements near it are found once for
all of them. The model's functions come from `kernels.particle_models`. A block's work depends on its own number alone:
however the blocks are divided among threads, the result is the same to the bit.

Weights are ``unit·share``, ``share`` (L,) in the precision of the states, or (0,) where all are 1. Sums over blocks are
float64.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, FAST, INNER, VECTOR, cos_sin_turn, log32
from phdtrack.kernels.grid import Grid, cell_of, overlapping
from phdtrack.kernels.particle_models import (
    BLOCK,
    N0,
    N1,
    N2,
    N3,
    N4,
    Number,
    Real,
    X,
    Y,
    distance,
    exp_half,
    move,
    neighbourhood,
    normals,
    number,
    seen,
    survives,
    word,
)
from phdtrack.kernels.random import ROUNDS, W, philox, unit, xoroshiro

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
I4 = NDArray[np.int32]
U4 = NDArray[np.uint32]
F = np.float32
# Columns are counted without a sign: one that might be negative is checked, and the check keeps loops from being vectorised.
U = np.uint64
# Numbers in the widest vector register; narrower ones divide it. Loops run over whole registers.
LANES = 16
# Rows of the scratch array behind the state and the normal numbers: weights, likelihoods, running sums, owners' rows.
WEIGHT, SEEN, G, SUM = (BLOCK * row for row in range(16, 20))
S0, S1, S2, S3 = (BLOCK * row for row in range(18, 22))
ROWS = 23
QUARTER = BLOCK // 4
MINUS_TWO = F(-2.0)
FIXED = 2.0**32
SMALL, MOST_CELLS = 1e-9, 2048.0


class Pairs(NamedTuple):
    """The measurements near each block.

    ``first`` (B + 1,): block b has the pairs first[b] … first[b + 1] − 1; ``which`` (P,): the measurement of each;
    ``place`` (P + 1,): where each pair's likelihoods begin, one for each particle of the block.
    """

    first: I8
    which: I8
    place: I8


class Weights(NamedTuple):
    """``share`` (L,) or (0,): 1 each; ``detect`` p_D, (L,) of each or (1,) of all particles."""

    share: Real
    detect: Real


class Sums(NamedTuple):
    """``g`` (G,) p_D·share·g(z|x) of the particles of each pair, one pair behind the other. ``evidence`` (P,) its sum over a
    pair, ``near`` (P,) the sum of the shares inside the region. ``mass``, ``missed`` (B,) Σ share, Σ (1 − p_D)·share."""

    g: Real
    evidence: F8
    near: F8
    mass: F8
    missed: F8


class Comb(NamedTuple):
    """The resampling comb over blocks in their order.

    ``teeth``, ``first`` (B,) how many offspring each has, and the column of the first;
    ``phase``, ``width`` (B,) where its first tooth stands and how wide it is, in steps of the comb; ``divided`` (B,) 1 or 2
    where its particles are to be parted along x or y.
    """

    teeth: I8
    first: I8
    phase: F8
    width: F8
    divided: I8


@njit(**INNER)
def whole(n: int) -> int:
    """The least multiple of `LANES` that is not below n."""
    return (n + LANES - 1) // LANES * LANES


@njit(**VECTOR)
def load(s: Real, n: int, state: Real, at: int) -> None:
    """Copy the columns at … at + n − 1 of ``state`` (d, L) into the block; copies of the last fill the vector registers."""
    for r in range(state.shape[0]):
        row, begin = r * BLOCK, U(at)
        for i in range(U(n)):
            s[row + i] = state[r, begin + i]
        for i in range(n, whole(n)):
            s[row + i] = s[row + n - 1]


@njit(**VECTOR)
def load_row(s: Real, row: int, n: int, values: Real, at: int) -> None:
    """Copy values[at] … into a row of the block: of an empty array ones, of one number that number; zeros follow."""
    begin, one, nothing = U(at), s.dtype.type(1), s.dtype.type(0)
    if values.size > 1:
        for i in range(U(n)):
            s[row + i] = values[begin + i]
    else:
        value = values[0] if values.size == 1 else one
        for i in range(U(n)):
            s[row + i] = value
    for i in range(n, whole(n)):
        s[row + i] = nothing


@njit(**VECTOR)
def fill_normals(s: Real, n: int, c1: np.uint32, c2: np.uint32, k0: np.uint32, k1: np.uint32) -> None:
    """Standard normals into the rows N0 to N3 [Box and Muller 1958].

    Particle i takes the words of the two streams of lane i mod `LANES` whose states are the words of the counter
    (lane, c1, c2, 0). The streams' states go through the rows from G on, in one array with the normals: so the compiler
    sees that rows do not overlap.
    """
    like = s[0]
    for i in range(LANES):
        a, b, c, d = philox(W(i), c1, c2, W(0), k0, k1, ROUNDS)
        s[S0 + i], s[S1 + i], s[S2 + i], s[S3 + i] = number(a, like), number(b, like), number(c, like), number(d, like)
    for i in range(n):
        a, b, c, d = word(s[S0 + i]), word(s[S1 + i]), word(s[S2 + i]), word(s[S3 + i])
        first, a, b = xoroshiro(a, b)
        second, a, b = xoroshiro(a, b)
        third, c, d = xoroshiro(c, d)
        fourth, c, d = xoroshiro(c, d)
        s[S0 + LANES + i], s[S1 + LANES + i] = number(a, like), number(b, like)
        s[S2 + LANES + i], s[S3 + LANES + i] = number(c, like), number(d, like)
        s[N0 + i], s[N1 + i] = unit(first), unit(second)
        s[N2 + i], s[N3 + i] = unit(third), unit(fourth)
    for i in range(n):
        radius = np.sqrt(MINUS_TWO * log32(F(s[N0 + i])))
        cosine, sine = cos_sin_turn(F(s[N1 + i]))
        s[N0 + i], s[N1 + i] = radius * cosine, radius * sine
    for i in range(n):
        radius = np.sqrt(MINUS_TWO * log32(F(s[N2 + i])))
        cosine, sine = cos_sin_turn(F(s[N3 + i]))
        s[N2 + i], s[N3 + i] = radius * cosine, radius * sine


@njit(**VECTOR)
def move_block(motion: Number, s: Real, n: int) -> None:
    """Multiply the weights of n particles by p_S and move them. (Loops over one array in a function alone vectorise.)"""
    for i in range(n):
        s[WEIGHT + i] *= survives(motion, s, i)
    for i in range(n):
        move(motion, s, i)


@njit(**(ENTRY | {"fastmath": FAST}))
def predict(lo: int, hi: int, motion: Number, state: Real, share: Real, start: I8, key: I8, moved: Real, kept: Real) -> None:
    """Move the blocks lo … hi − 1 by f(·|x) into ``moved`` (d, L), and multiply their shares by p_S into ``kept`` (L,)."""
    k0, k1 = W(key[0]), W(key[1])
    # Zeros: a motion may multiply normal numbers that were not drawn with 0.
    s, d = np.zeros(ROWS * BLOCK, state.dtype), state.shape[0]
    for b in range(lo, hi):
        at, n = start[b], start[b + 1] - start[b]
        if n == 0:
            continue
        full = whole(n)
        load(s, n, state, at)
        load_row(s, WEIGHT, n, share, at)
        if normals(motion) > 4:
            fill_normals(s, full, W(b), W(1), k0, k1)
            for i in range(4 * BLOCK):
                s[N4 + i] = s[N0 + i]
        fill_normals(s, full, W(b), W(0), k0, k1)
        move_block(motion, s, full)
        begin = U(at)
        for r in range(d):
            for i in range(U(n)):
                moved[r, begin + i] = s[r * BLOCK + i]
        for i in range(U(n)):
            kept[begin + i] = s[WEIGHT + i]


# With numbers that are taken to be none of NaN, minima and maxima vectorise.
@njit(**(ENTRY | {"fastmath": FAST | {"nnan"}}))
def bound(sensor: Number, state: Real, start: I8) -> Real:
    """(B, 6) left, top, right, bottom of each block's positions, and the mean width and height of its neighbourhoods."""
    out = np.empty((start.size - 1, 6), state.dtype)
    s = np.empty(ROWS * BLOCK, state.dtype)
    for b in range(start.size - 1):
        at, n = start[b], start[b + 1] - start[b]
        for c in range(6):
            out[b, c] = 0
        if n == 0:
            continue
        load(s, n, state, at)
        left, top, right, bottom = s[X], s[Y], s[X], s[Y]
        wide, high, full = s.dtype.type(0), s.dtype.type(0), whole(n)
        for i in range(full):
            x, y = s[X + i], s[Y + i]
            left = x if x < left else left
            right = x if x > right else right
            top = y if y < top else top
            bottom = y if y > bottom else bottom
        for i in range(full):
            w, h = neighbourhood(sensor, s, i)
            wide += w
            high += h
        out[b, 0], out[b, 1], out[b, 2], out[b, 3], out[b, 4], out[b, 5] = left, top, right, bottom, wide / full, high / full
    return out


@njit(**ENTRY)
def pair_up(extents: Real, start: I8, gates: Grid) -> Pairs:
    """The measurements whose ``gates`` overlap each block's ``extents`` (B, 6)."""
    blocks = start.size - 1
    first, found = np.empty(blocks + 1, np.int64), np.empty(gates.lower.shape[1] + 1, np.int64)
    which, place = np.empty(2 * blocks + 64, np.int64), np.empty(2 * blocks + 64, np.int64)
    used, at = 0, 0
    for b in range(blocks):
        first[b], n, near = used, start[b + 1] - start[b], 0
        if n > 0:
            left, top, right, bottom = extents[b, 0], extents[b, 1], extents[b, 2], extents[b, 3]
            near = overlapping(float(left), float(top), float(right), float(bottom), gates, found)
        if used + near + 1 > which.size:
            longer, wider = np.empty(2 * (used + near) + 2, np.int64), np.empty(2 * (used + near) + 2, np.int64)
            longer[:used], wider[:used] = which[:used], place[:used]
            which, place = longer, wider
        for m in range(near):
            which[used], place[used] = found[m], at
            used += 1
            at += n
    first[blocks], place[used] = used, at
    return Pairs(first, which[:used], place[: used + 1])


@njit(**VECTOR)
def show(s: Real, n: int) -> tuple[Number, Number]:
    """Multiply the p_D in SEEN by the shares in WEIGHT; Σ share, and Σ (1 − p_D)·share."""
    known, lost = s.dtype.type(0), s.dtype.type(0)
    for i in range(n):
        weight = s[WEIGHT + i]
        shown = weight * s[SEEN + i]
        s[SEEN + i] = shown
        known += weight
        lost += weight - shown
    return known, lost


@njit(**VECTOR)
def evaluate(sensor: Number, table: Real, j: int, s: Real, n: int, limit: Number) -> tuple[Number, Number]:
    """p_D·share·g(z_j|x) of n particles into G; its sum, and Σ share within the squared radius ``limit``."""
    z = seen(sensor, table, j)
    total, near = s.dtype.type(0), s.dtype.type(0)
    for i in range(n):
        d2, factor = distance(sensor, z, s, i)
        weight = s[WEIGHT + i]
        value = factor * exp_half(d2) * s[SEEN + i]
        s[G + i] = value
        total += value
        near += weight if d2 <= limit else s.dtype.type(0)
    return total, near


@njit(**(ENTRY | {"fastmath": FAST}))
def likelihoods(
    lo: int, hi: int, sensor: Number, table: Real, region: float, state: Real, weights: Weights, start: I8, pairs: Pairs,
    out: Sums,
) -> None:  # fmt: skip
    """Fill ``out`` for the blocks lo … hi − 1.

    Parameters
    ----------
    table, region : the measurements' columns, and the squared radius within which mass counts as explaining one.
    state, weights, start : (d, L) particles, their shares and p_D, and where their blocks begin.
    """
    s, real = np.empty(ROWS * BLOCK, state.dtype), state.dtype.type
    limit = real(region)
    for b in range(lo, hi):
        at, n = start[b], start[b + 1] - start[b]
        full = whole(n)
        load(s, n, state, at)
        load_row(s, WEIGHT, n, weights.share, at)
        load_row(s, SEEN, n, weights.detect, at)
        known, lost = show(s, full)
        out.mass[b], out.missed[b] = float(known), float(lost)
        for e in range(pairs.first[b], pairs.first[b + 1]):
            total, near = evaluate(sensor, table, pairs.which[e], s, full, limit)
            out.evidence[e], out.near[e] = float(total), float(near)
            to = U(pairs.place[e])
            for i in range(U(n)):
                out.g[to + i] = s[G + i]


@njit(**(ENTRY | {"fastmath": FAST}))
def weigh(
    lo: int, hi: int, missed: float, factor: F8, weights: Weights, start: I8, pairs: Pairs, g: Real, result: Real
) -> None:
    """Shares after the update of the blocks lo … hi − 1 into ``result`` (L,) [M07 (5), M09 (10)].

    share·(``missed``·(1 − p_D) + Σ_z ``factor``[z]·p_D·g(z|x)), ``factor`` (N,).
    """
    s, real = np.empty(ROWS * BLOCK, result.dtype), result.dtype.type
    for b in range(lo, hi):
        at, n = start[b], start[b + 1] - start[b]
        load_row(s, WEIGHT, n, weights.share, at)
        load_row(s, SEEN, n, weights.detect, at)
        begin, left = U(at), real(missed)
        for i in range(n):
            s[SUM + i] = left * s[WEIGHT + i] * (real(1) - s[SEEN + i])
        for e in range(pairs.first[b], pairs.first[b + 1]):
            by, of = real(factor[pairs.which[e]]), U(pairs.place[e])
            for i in range(U(n)):
                s[SUM + i] += by * g[of + i]
        for i in range(U(n)):
            result[begin + i] = s[SUM + i]


@njit(**(ENTRY | {"fastmath": FAST}))
def masses(share: Real, start: I8) -> F8:
    """(B,) the sum of the shares of each block; of an empty ``share`` the number of its particles."""
    out = np.empty(start.size - 1)
    for b in range(out.size):
        total, at = share.dtype.type(0), U(start[b])
        if share.size == 0:
            out[b] = start[b + 1] - start[b]
            continue
        for i in range(U(start[b + 1] - start[b])):
            total += share[at + i]
        out[b] = total
    return out


@njit(**ENTRY)
def by_cells(extents: Real) -> I8:
    """(B,) the blocks in the order of the cells that their centres lie in; cells are as large as neighbourhoods are."""
    n = extents.shape[0]
    x, y = np.empty(n), np.empty(n)
    width, height = 0.0, 0.0
    for i in range(n):
        x[i], y[i] = 0.5 * (extents[i, 0] + extents[i, 2]), 0.5 * (extents[i, 1] + extents[i, 3])
        width += extents[i, 4]
        height += extents[i, 5]
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    for i in range(n):
        x0, x1, y0, y1 = min(x0, x[i]), max(x1, x[i]), min(y0, y[i]), max(y1, y[i])
    wide, high = x1 - x0 if n else 0.0, y1 - y0 if n else 0.0
    nx, ny = int(min(wide * n / max(width, SMALL), MOST_CELLS)) + 1, int(min(high * n / max(height, SMALL), MOST_CELLS)) + 1
    if nx * ny > 4 * n + 16:
        shrink = np.sqrt((4 * n + 16) / (nx * ny))
        nx, ny = max(int(nx * shrink), 1), max(int(ny * shrink), 1)
    per_x, per_y = nx / max(wide, SMALL), ny / max(high, SMALL)
    start, cell, order = np.zeros(nx * ny + 1, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    for i in range(n):
        cell[i] = cell_of(y[i], y0, per_y, ny) * nx + cell_of(x[i], x0, per_x, nx)
        start[cell[i] + 1] += 1
    for c in range(nx * ny):
        start[c + 1] += start[c]
    for i in range(n):
        order[start[cell[i]]] = i
        start[cell[i]] += 1
    return order


@njit(**ENTRY)
def comb(mass: F8, extents: Real, count: int, offset: float) -> tuple[Comb, I8]:
    """The teeth of a comb of ``count`` teeth over the blocks, and ``start`` (B',) of the blocks of their offspring.

    Tooth k stands at (k + offset)/count of the total, 0 ≤ offset < 1. Masses (B,) count in steps of 2⁻³² of the total, so
    that the order of a sum cannot matter. Offspring are put together into blocks of at most `BLOCK` while their common
    extent is at most the neighbourhood's. A block that is wider itself is to be parted along its longer side, and its
    offspring are halved: what has drifted apart is parted in a few frames.
    """
    n, order = mass.size, by_cells(extents)
    teeth, first, divided = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64)
    phase, width = np.zeros(n), np.zeros(n)
    scale = FIXED / max(mass.sum(), 1e-300)
    total = 0
    for b in range(n):
        total += int(mass[b] * scale)
    start = np.empty(2 * n + count // BLOCK + 2, np.int64)
    start[0] = 0
    reached, done, blocks, filled = 0, 0, 0, 0
    per = count / max(total, 1)
    left, top, right, bottom = 0.0, 0.0, 0.0, 0.0
    for o in range(n):
        b = order[o]
        size = int(mass[b] * scale)
        begin = reached * per
        reached += size
        upto = int(np.ceil(reached * per - offset))
        upto = count if reached >= total else max(min(upto, count), done)
        teeth[b], first[b], phase[b], width[b] = upto - done, done, done + offset - begin, size * per
        done = upto
        if teeth[b] == 0:
            continue
        x0, y0, x1, y1 = float(extents[b, 0]), float(extents[b, 1]), float(extents[b, 2]), float(extents[b, 3])
        w, h = float(extents[b, 4]), float(extents[b, 5])
        if x1 - x0 > w or y1 - y0 > h:
            # In neighbourhoods, without a division: a given state may have no size.
            divided[b] = 1 if (x1 - x0) * h >= (y1 - y0) * w else 2
        if filled > 0:
            left, top, right, bottom = min(left, x0), min(top, y0), max(right, x1), max(bottom, y1)
            if divided[b] > 0 or not (right - left <= w and bottom - top <= h):
                blocks += 1
                start[blocks] = start[blocks - 1] + filled
                filled = 0
        if filled == 0:
            left, top, right, bottom = x0, y0, x1, y1
        rest, most = teeth[b], BLOCK
        if divided[b] > 0 and rest < 2 * BLOCK:
            most = (rest + 1) // 2
        while rest > 0:
            take = min(rest, most - filled)
            filled += take
            rest -= take
            if filled >= most:
                blocks += 1
                start[blocks] = start[blocks - 1] + filled
                filled = 0
        if divided[b] > 0 and filled > 0:
            blocks += 1
            start[blocks] = start[blocks - 1] + filled
            filled = 0
    if filled > 0:
        blocks += 1
        start[blocks] = start[blocks - 1] + filled
    return Comb(teeth, first, phase, width, divided), start[: blocks + 1]


@njit(**ENTRY)
def pick(lo: int, hi: int, teeth: Comb, shift: int, state: Real, share: Real, start: I8, out: Real) -> None:
    """The offspring of the blocks lo … hi − 1, which are ``shift`` further in the comb, into their columns of ``out``."""
    d = state.shape[0]
    s, parted = np.empty(ROWS * BLOCK, state.dtype), np.empty(ROWS * BLOCK, state.dtype)
    upto, owner = np.empty(BLOCK, np.int32), np.empty(teeth.teeth.max() + 2, np.uint32)
    for b in range(lo, hi):
        c = b + shift
        if teeth.teeth[c] == 0:
            continue
        at, n = start[b], start[b + 1] - start[b]
        load(s, n, state, at)
        load_row(s, WEIGHT, n, share, at)
        if teeth.divided[c] > 0:
            part(s, n, d, X if teeth.divided[c] == 1 else Y, upto, parted)
            write_offspring(parted, n, d, c, teeth, upto, owner, out)
        else:
            write_offspring(s, n, d, c, teeth, upto, owner, out)


@njit(**INNER)
def part(s: Real, n: int, d: int, row: int, target: I4, parted: Real) -> None:
    """Copy the block to ``parted``: first the particles before the middle of its extent along a row, then the others."""
    least, most, right = s[row], s[row], 0
    for i in range(n):
        least, most = min(least, s[row + i]), max(most, s[row + i])
    middle = s.dtype.type(0.5) * (least + most)
    for i in range(n):
        right += 1 if s[row + i] < middle else 0
    left = 0
    for i in range(n):
        before = s[row + i] < middle
        target[i] = left if before else right
        left, right = left + (1 if before else 0), right + (0 if before else 1)
    for r in range(d + 1):
        line = r * BLOCK if r < d else WEIGHT
        for i in range(n):
            parted[line + target[i]] = s[line + i]


@njit(**INNER)
def write_offspring(s: Real, n: int, d: int, b: int, teeth: Comb, upto: I4, owner: U4, out: Real) -> None:
    """Write the particles of a block on whose stretch of the weights a tooth of the comb falls.

    In steps of the comb the block is ``width`` wide and its teeth stand at phase, phase + 1, … Rounding can leave the last
    tooth beyond the last sum: it belongs to the last particle that has a weight.
    """
    count, at, last = teeth.teeth[b], teeth.first[b], n
    total = running_sum(s, n)
    # Below 1, or a tooth at the very beginning would fall on particles without weight there.
    shift = min(1.0 - teeth.phase[b], 1.0 - 2.0**-24)
    teeth_before(s, n, teeth.width[b] / total if total > 0.0 else 0.0, shift, count, upto)
    while last > 1 and not s[WEIGHT + last - 1] > 0.0:
        last -= 1
    # Where its teeth begin each particle puts its number; a later one overwrites those without any. The running maximum
    # then is the owner of each tooth: no branch to miss.
    begin = 0
    for t in range(count):
        owner[t] = W(0)
    for i in range(last):
        owner[begin] = i
        begin = upto[i]
    mine = W(0)
    for t in range(count):
        mine = owner[t] if owner[t] > mine else mine
        owner[t] = mine
    for r in range(d):
        row, to = W(r * BLOCK), U(at)
        for t in range(U(count)):
            out[r, to + t] = s[row + owner[t]]


@njit(**INNER)
def running_sum(s: Real, n: int) -> float:
    """The running sum of the weights into SUM, of four quarters at once so that none waits for another's; the whole."""
    zero = s.dtype.type(0)
    for i in range(n, BLOCK):
        s[WEIGHT + i] = zero
    a, b, c, e = zero, zero, zero, zero
    for i in range(QUARTER):
        a += s[WEIGHT + i]
        b += s[WEIGHT + QUARTER + i]
        c += s[WEIGHT + 2 * QUARTER + i]
        e += s[WEIGHT + 3 * QUARTER + i]
        s[SUM + i], s[SUM + QUARTER + i], s[SUM + 2 * QUARTER + i], s[SUM + 3 * QUARTER + i] = a, b, c, e
    b += a
    c += b
    for i in range(QUARTER):
        s[SUM + QUARTER + i] += a
        s[SUM + 2 * QUARTER + i] += b
        s[SUM + 3 * QUARTER + i] += c
    return float(c + e)


@njit(**VECTOR)
def teeth_before(s: Real, n: int, scale: float, shift: float, count: int, upto: I4) -> None:
    """How many teeth stand before the end of each particle's stretch, from the running sums."""
    most, per, more = np.int32(count), s.dtype.type(scale), s.dtype.type(shift)
    for i in range(n):
        here = np.int32(s[SUM + i] * per + more)
        upto[i] = here if here < most else most
