"""Sweeps over blocks of particles: predict, likelihoods, weights [M07 §2, M09 §III].

A block is a run of at most `BLOCK` particles that lie close together, so that the measurements near
it are found once for all of them. The model's functions come from `kernels.particle_models`. A
block's work depends on its own number alone: however the blocks are divided among threads, the
result is the same to the bit.

Weights are ``unit·share``, ``share`` (L,) in the precision of the states, or (0,) where all are 1.
Sums over blocks are float64.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Real
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import (
    ENTRY,
    FAST,
    INLINED_VECTOR,
    INNER,
    LANES,
    ROUNDS,
    VECTOR,
    cos_sin_turn,
    exp_of,
    log32,
    philox,
    sortable,
    sorted_number,
    unit,
    whole,
    xoroshiro,
)
from phdtrack.kernels.fast32 import D as U
from phdtrack.kernels.fast32 import W as WORD
from phdtrack.kernels.grid import Grid, overlapping
from phdtrack.kernels.particle_models import (
    BLOCK,
    N0,
    N1,
    N2,
    N3,
    N4,
    VX,
    VY,
    Number,
    X,
    Y,
    distance,
    move,
    neighbourhood,
    normals,
    number,
    prepare,
    seen,
    sees_velocity,
    survives,
    word,
)

F = np.float32
# Column indices are unsigned (U): the check of one that might be negative keeps loops from being
# vectorised. Rows of the scratch array behind the state and the normal numbers: weights, weights
# times p_D, sums; states of generators.
WEIGHT, DETECTED, SUM = (BLOCK * row for row in range(16, 19))
S0, S1, S2, S3 = (BLOCK * row for row in range(18, 22))
ROWS = 23
MINUS_TWO = F(-2.0)
MINUS_HALF = F(-0.5)
# Squared distances beyond which a likelihood is 0, in single and double precision: products of
# numbers below the smallest normal one take a hundred times as long.
FAR = F(100.0)
VERY_FAR = F(1400.0)


class Part(NamedTuple):
    """Particles in B blocks.

    ``state`` (d, L); ``share`` (L,) or (0,): 1 each; ``detect`` p_D, (L,) of each or (1,) of all;
    ``start`` (B + 1,).
    """

    state: Real
    share: Real
    detect: Real
    start: I8


class Sums(NamedTuple):
    """The measurements near each block, and the sums of their likelihoods.

    ``extents`` (B, 6): left, top, right, bottom of its positions, mean width and height of a few
    neighbourhoods in it; ``mass``, ``missed`` (B,): Σ share, Σ (1 − p_D)·share. ``first`` (B + 1,):
    block b has the pairs first[b] … first[b + 1] − 1; ``which`` (P,): the measurement of each;
    ``evidence`` (P,): Σ p_D·share·g(z|x) of each, ``near`` (P,): Σ share of the particles inside
    the region.
    """

    extents: Real
    mass: F8
    missed: F8
    first: I8
    which: I8
    evidence: F8
    near: F8


@njit(**VECTOR)
def load(s: Real, n: int, state: Real, at: int, velocity: bool) -> None:
    """Copy the columns at … at + n − 1 of ``state`` (d, L) into the block, and copies of the last
    to fill the vector registers.
    """
    full = min(whole(n), state.shape[1] - at)
    for r in range(state.shape[0]):
        row = U(r * BLOCK)
        begin = U(at)
        if not velocity and (r * BLOCK == VX or r * BLOCK == VY):
            continue
        # Whole registers, with what lies behind the block: remaining numbers would be copied one
        # by one.
        for i in range(U(full)):
            s[row + i] = state[r, begin + i]
        for i in range(U(n), U(whole(n))):
            s[row + i] = s[row + U(n - 1)]


@njit(**VECTOR)
def load_row(s: Real, row: int, n: int, values: Real, at: int) -> None:
    """Copy values[at] … into a row of the block, or ones if there are none, or the only one; zeros
    follow.
    """
    to = U(row)
    begin = U(at)
    if values.size > 1:
        for i in range(U(min(whole(n), values.size - at))):
            s[to + i] = values[begin + i]
    else:
        value = s.dtype.type(1)
        if values.size == 1:
            value = values[0]
        for i in range(U(whole(n))):
            s[to + i] = value
    for i in range(U(n), U(whole(n))):
        s[to + i] = s.dtype.type(0)


@njit(**VECTOR)
def fill_normals(
    s: Real, n: int, c1: np.uint32, c2: np.uint32, k0: np.uint32, k1: np.uint32
) -> None:
    """Write standard normals into the rows N0 to N3 [Box and Muller 1958].

    Particle i uses the words of the two streams of lane i mod `LANES`, which are seeded with the
    words of the counter (lane, c1, c2, 0). The streams' states are in the rows from S0 on, in one
    array with the normals: so the compiler knows that rows do not overlap.
    """
    like = s[0]
    for i in range(LANES):
        a, b, c, d = philox(WORD(i), c1, c2, WORD(0), k0, k1, ROUNDS)
        s[S0 + i] = number(a, like)
        s[S1 + i] = number(b, like)
        s[S2 + i] = number(c, like)
        s[S3 + i] = number(d, like)
    for i in range(n):
        a = word(s[S0 + i])
        b = word(s[S1 + i])
        c = word(s[S2 + i])
        d = word(s[S3 + i])
        first, a, b = xoroshiro(a, b)
        second, a, b = xoroshiro(a, b)
        third, c, d = xoroshiro(c, d)
        fourth, c, d = xoroshiro(c, d)
        s[S0 + LANES + i] = number(a, like)
        s[S1 + LANES + i] = number(b, like)
        s[S2 + LANES + i] = number(c, like)
        s[S3 + LANES + i] = number(d, like)
        s[N0 + i] = unit(first)
        s[N1 + i] = unit(second)
        s[N2 + i] = unit(third)
        s[N3 + i] = unit(fourth)
    for i in range(n):
        radius = np.sqrt(MINUS_TWO * log32(F(s[N0 + i])))
        cosine, sine = cos_sin_turn(F(s[N1 + i]))
        s[N0 + i] = radius * cosine
        s[N1 + i] = radius * sine
    for i in range(n):
        radius = np.sqrt(MINUS_TWO * log32(F(s[N2 + i])))
        cosine, sine = cos_sin_turn(F(s[N3 + i]))
        s[N2 + i] = radius * cosine
        s[N3 + i] = radius * sine


@njit(**VECTOR)
def move_block(motion: Number, s: Real, n: int) -> None:
    """Multiply the weights of n particles by p_S and move them. (Loops over one array in a function
    alone vectorise.)
    """
    for i in range(n):
        s[WEIGHT + i] *= survives(motion, s, i)
    for i in range(n):
        move(motion, s, i)


@njit(**(ENTRY | {"fastmath": FAST}))
def predict(
    lo: int,
    hi: int,
    motion: Number,
    state: Real,
    share: Real,
    start: I8,
    key: I8,
    moved: Real,
    kept: Real,
) -> None:
    """Write the particles of blocks lo … hi − 1, moved by f(·|x), into ``moved`` (d, L), and their
    shares times p_S into ``kept`` (L,).
    """
    k0 = WORD(key[0])
    k1 = WORD(key[1])
    # Zeros: a motion may multiply normal numbers that were not drawn with 0.
    s = np.zeros(ROWS * BLOCK, state.dtype)
    d = state.shape[0]
    for b in range(lo, hi):
        at = start[b]
        n = start[b + 1] - start[b]
        if n == 0:
            continue
        full = whole(n)
        load(s, n, state, at, True)
        load_row(s, WEIGHT, n, share, at)
        if normals(motion) > 4:
            fill_normals(s, full, WORD(b), WORD(1), k0, k1)
            for i in range(4 * BLOCK):
                s[N4 + i] = s[N0 + i]
        fill_normals(s, full, WORD(b), WORD(0), k0, k1)
        move_block(motion, s, full)
        # Whole registers: the next block overwrites what is too much.
        begin = U(at)
        full = min(full, start[hi] - at)
        for r in range(d):
            for i in range(U(full)):
                moved[r, begin + i] = s[r * BLOCK + i]
        for i in range(U(full)):
            kept[begin + i] = s[WEIGHT + i]


@njit(**VECTOR)
def outline(sensor: Number, s: Real, n: int, out: Real) -> None:
    """Write left, top, right, bottom of n positions, mean width and height of a few neighbourhoods,
    into ``out`` (6,).
    """
    left = right = sortable(s[X])
    top = bottom = sortable(s[Y])
    for i in range(n):
        x = sortable(s[X + i])
        y = sortable(s[Y + i])
        left = min(left, x)
        right = max(right, x)
        top = min(top, y)
        bottom = max(bottom, y)
    out[0] = sorted_number(left)
    out[1] = sorted_number(top)
    out[2] = sorted_number(right)
    out[3] = sorted_number(bottom)
    wide = high = s.dtype.type(0)
    for i in range(LANES):
        w, h = neighbourhood(sensor, s, i)
        wide += w
        high += h
    out[4] = wide / LANES
    out[5] = high / LANES


@njit(**VECTOR)
def load_part(
    sensor: Number, s: Real, n: int, state: Real, share: Real, detect: Real, at: int
) -> None:
    """Copy a block's states and weights, and write its weights times p_D and the terms of
    likelihoods.
    """
    load(s, n, state, at, sees_velocity(sensor))
    load_row(s, WEIGHT, n, share, at)
    load_row(s, DETECTED, n, detect, at)
    for i in range(whole(n)):
        s[DETECTED + i] *= s[WEIGHT + i]
    for i in range(whole(n)):
        prepare(sensor, s, i)


@njit(**VECTOR)
def add_up(s: Real, n: int) -> tuple[Number, Number]:
    """Σ share, and Σ (1 − p_D)·share of n particles."""
    mass = s.dtype.type(0)
    missed = s.dtype.type(0)
    for i in range(n):
        mass += s[WEIGHT + i]
        missed += s[WEIGHT + i] - s[DETECTED + i]
    return mass, missed


@njit(**INLINED_VECTOR)
def evaluate(
    sensor: Number, table: Real, j: int, s: Real, n: int, limit: Number
) -> tuple[Number, Number]:
    """Σ p_D·share·g(z_j|x) of n particles, and Σ share of those within the squared radius
    ``limit``.
    """
    z = seen(sensor, table, j)
    far = FAR if s.itemsize < 8 else VERY_FAR
    half = s.dtype.type(MINUS_HALF)
    zero = total = near = s.dtype.type(0)
    for i in range(n):
        d2, factor = distance(sensor, z, s, i)
        value = exp_of(half * d2) if d2 <= far else zero
        total += factor * value * s[DETECTED + i]
        near += s[WEIGHT + i] if d2 <= limit else zero
    return total, near


@njit(**INLINED_VECTOR)
def _add_detected(sensor: Number, table: Real, j: int, s: Real, n: int, by: Number) -> None:
    """The body of `add_detected`."""
    z = seen(sensor, table, j)
    far = FAR if s.itemsize < 8 else VERY_FAR
    half = s.dtype.type(MINUS_HALF)
    zero = s.dtype.type(0)
    for i in range(n):
        d2, factor = distance(sensor, z, s, i)
        value = exp_of(half * d2) if d2 <= far else zero
        s[SUM + i] += by * factor * value * s[DETECTED + i]


@njit(**VECTOR)
def add_detected(sensor: Number, table: Real, j: int, s: Real, n: int, by: Number) -> None:
    """Add ``by``·p_D·share·g(z_j|x) of n particles to SUM."""
    # LLVM optimises a function alone once, and a function within another twice, which changes the
    # order of factors. The body is within another everywhere, so that every copy rounds alike.
    _add_detected(sensor, table, j, s, n, by)


@njit(**INNER)
def longer(which: I8, sums: F8, used: int, size: int) -> tuple[I8, F8]:
    """Copies of the first ``used`` pairs with room for ``size``."""
    wide = np.empty(size, np.int64)
    deep = np.empty((2, size))
    for e in range(used):
        wide[e] = which[e]
        deep[0, e] = sums[0, e]
        deep[1, e] = sums[1, e]
    return wide, deep


@njit(**(ENTRY | {"fastmath": FAST}))
def likelihoods(
    lo: int, hi: int, part: Part, sensor: Number, table: Real, gates: Grid, region: float
) -> Sums:
    """Sums of the likelihoods of measurements near the blocks lo … hi − 1.

    A block and the measurements whose ``gates`` its extent overlaps are a pair. ``region``: the
    squared radius within which mass counts as explaining a measurement.
    """
    state, share, detect, start = part
    blocks = hi - lo
    used = 0
    extents = np.zeros((blocks, 6), state.dtype)
    mass = np.zeros(blocks)
    missed = np.zeros(blocks)
    s = np.empty(ROWS * BLOCK, state.dtype)
    gated = np.empty(table.shape[1] + 1, np.int64)
    limit = state.dtype.type(region)
    first = np.zeros(blocks + 1, np.int64)
    which = np.empty(2 * blocks + 64, np.int64)
    sums = np.empty((2, 2 * blocks + 64))
    for b in range(blocks):
        at = start[lo + b]
        n = start[lo + b + 1] - start[lo + b]
        near = 0
        if n > 0:
            load_part(sensor, s, n, state, share, detect, at)
            outline(sensor, s, whole(n), extents[b])
            left, top, right, bottom, _, _ = extents[b]
            near = overlapping(float(left), float(top), float(right), float(bottom), gates, gated)
            here, lost = add_up(s, whole(n))
            mass[b] = float(here)
            missed[b] = float(lost)
        if used + near > which.size:
            which, sums = longer(which, sums, used, 2 * (used + near))
        for m in range(near):
            total, inside = evaluate(sensor, table, gated[m], s, whole(n), limit)
            which[used + m] = gated[m]
            sums[0, used + m] = float(total)
            sums[1, used + m] = float(inside)
        used += near
        first[b + 1] = used
    return Sums(extents, mass, missed, first, which[:used], sums[0, :used], sums[1, :used])


@njit(**VECTOR)
def update_weights(
    sensor: Number,
    table: Real,
    s: Real,
    n: int,
    which: I8,
    begin: int,
    end: int,
    missed: float,
    factor: F8,
) -> None:
    """Update the shares in WEIGHT [M07 (5), M09 (10)].

    share·(``missed``·(1 − p_D) + Σ_z ``factor``[z]·p_D·g(z|x)), z of the pairs ``begin`` … ``end``
    − 1.
    """
    real = s.dtype.type
    for i in range(n):
        s[SUM + i] = real(missed) * (s[WEIGHT + i] - s[DETECTED + i])
    for e in range(begin, end):
        add_detected(sensor, table, which[e], s, n, real(factor[which[e]]))
    for i in range(n):
        s[WEIGHT + i] = s[SUM + i]


@njit(**(ENTRY | {"fastmath": FAST}))
def weigh(
    lo: int,
    hi: int,
    part: Part,
    sums: Sums,
    sensor: Number,
    table: Real,
    missed: float,
    factor: F8,
    result: Real,
) -> None:
    """Write the shares of blocks lo … hi − 1 after the update into ``result`` (L,), see
    `update_weights`.
    """
    state, share, detect, start = part
    s = np.empty(ROWS * BLOCK, state.dtype)
    for b in range(lo, hi):
        begin = U(start[b])
        n = start[b + 1] - start[b]
        load_part(sensor, s, n, state, share, detect, start[b])
        update_weights(
            sensor, table, s, whole(n), sums.which, sums.first[b], sums.first[b + 1], missed, factor
        )
        for i in range(U(n)):
            result[begin + i] = s[WEIGHT + i]


@njit(**ENTRY)
def masses(sums: Sums, missed: float, factor: F8) -> F8:
    """(B,) the sums of the blocks' shares after the update; ``missed``, ``factor`` as in
    `weigh`.
    """
    out = missed * sums.missed
    for b in range(out.size):
        for e in range(sums.first[b], sums.first[b + 1]):
            out[b] += factor[sums.which[e]] * sums.evidence[e]
    return out
