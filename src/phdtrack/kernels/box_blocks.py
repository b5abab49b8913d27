"""A block of boxes at once: moved, bounded, and weighed against a detection; float32, branch-free, in vector registers.

A block lies in a scratch array of rows of ``BLOCK`` numbers, one row per quantity: with one array and constant distances
the compiler sees that rows do not overlap.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import FOUR, HALF, INNER, ONE, VECTOR, cos_sin_turn, exp32, log32, sortable, sorted_number
from phdtrack.kernels.philox import ROUNDS, philox, unit
from phdtrack.kernels.xoroshiro import xoroshiro

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
F = np.float32
# Columns are counted without a sign: one that might be negative is checked, and the check keeps loops from being vectorised.
U = np.uint64
BLOCK = 256
# Rows of the scratch array: the state, four normals, what a detection is compared with, and the weight. While the normals
# are drawn, four rows hold the states of the random streams, and the row behind them what runs over.
X, Y, VX, VY, W, H = (BLOCK * row for row in range(6))
N0, N1, N2, N3 = (BLOCK * row for row in range(6, 10))
IW, IH, ALIVE, SCALE, G = (BLOCK * row for row in range(10, 15))
SUM = BLOCK * 17
STREAM_0, STREAM_1, STREAM_2, STREAM_3 = (BLOCK * row for row in range(13, 17))
ROWS = 18
# Numbers in the widest vector register; narrower ones divide it.
LANES = 16
# Rows of the table of detections: z, one over the deviations, the likelihood's normaliser; then what births need.
ZX, ZY, ZW, ZH, IX, IY, IZW, IZH, GSCALE = range(9)
MINUS_TWO, MINUS_HALF, ZERO = F(-2.0), F(-0.5), F(0.0)
# (2π)⁻² times 4, because σ_px σ_py = σ_w σ_h / 4.
NORM = F(4.0 / (2.0 * np.pi) ** 2)


@njit(**INNER)
def load(s: F4, n: int, state: F4, at: int) -> None:
    """Copy the columns ``at`` … at + n − 1 of ``state`` (6, L) into the block."""
    # One loop with all rows in it: of a loop over rows the compiler would make eight, each with a vectorised one inside.
    for i in range(n):
        p = U(at) + U(i)
        s[X + i], s[Y + i], s[VX + i] = state[0, p], state[1, p], state[2, p]
        s[VY + i], s[W + i], s[H + i] = state[3, p], state[4, p], state[5, p]


@njit(**INNER)
def pad(s: F4, n: int) -> int:
    """Fill the block up to whole vector registers with copies of its last particle; how many there are then.

    What is left over at the end of a vectorised loop runs one by one, at the price of several registers. Copies have ALIVE 0
    once `bury` is called, and count for nothing.
    """
    full = (n + LANES - 1) // LANES * LANES
    last = n - 1
    x, y, vx, vy, w, h = s[X + last], s[Y + last], s[VX + last], s[VY + last], s[W + last], s[H + last]
    for i in range(n, full):
        s[X + i], s[Y + i], s[VX + i], s[VY + i], s[W + i], s[H + i] = x, y, vx, vy, w, h
    return full


@njit(**INNER)
def bury(s: F4, n: int, full: int) -> None:
    """ALIVE becomes 0 for the particles from number n on, which are there to fill registers."""
    for i in range(ALIVE + n, ALIVE + full):
        s[i] = ZERO


@njit(**VECTOR)
def summed(s: F4, n: int) -> np.float32:
    """Σ ALIVE over the block."""
    total = ZERO
    for i in range(n):
        total += s[ALIVE + i]
    return total


@njit(**INNER)
def store(s: F4, n: int, state: F4, at: int) -> None:
    """Copy the block into the columns ``at`` … at + n − 1 of ``state`` (6, L)."""
    for i in range(n):
        p = U(at) + U(i)
        state[0, p], state[1, p], state[2, p] = s[X + i], s[Y + i], s[VX + i]
        state[3, p], state[4, p], state[5, p] = s[VY + i], s[W + i], s[H + i]


@njit(**VECTOR)
def fill_normals(s: F4, n: int, c1: np.uint32, c2: np.uint32, k0: np.uint32, k1: np.uint32) -> None:
    """Standard normals into the rows N0 … N3, four a particle [Box and Muller 1958].

    Particle i takes the words of the two streams of lane i mod ``LANES`` whose states are the words of the counter
    (lane, c1, c2, 0). Leaves something in the rows from SCALE to SUM.
    """
    for i in range(LANES):
        a, b, c, d = philox(np.uint32(i), c1, c2, np.uint32(0), k0, k1, ROUNDS)
        s[STREAM_0 + i], s[STREAM_1 + i], s[STREAM_2 + i], s[STREAM_3 + i] = _number(a), _number(b), _number(c), _number(d)
    for i in range(n):
        a, b, c, d = _bits(s[STREAM_0 + i]), _bits(s[STREAM_1 + i]), _bits(s[STREAM_2 + i]), _bits(s[STREAM_3 + i])
        first, a, b = xoroshiro(a, b)
        second, a, b = xoroshiro(a, b)
        third, c, d = xoroshiro(c, d)
        fourth, c, d = xoroshiro(c, d)
        s[STREAM_0 + LANES + i], s[STREAM_1 + LANES + i] = _number(a), _number(b)
        s[STREAM_2 + LANES + i], s[STREAM_3 + LANES + i] = _number(c), _number(d)
        s[N0 + i], s[N1 + i], s[N2 + i], s[N3 + i] = unit(first), unit(second), unit(third), unit(fourth)
    # Two loops and not one over the rows: a row's place must be a constant for the compiler to vectorise.
    for i in range(n):
        radius = np.sqrt(MINUS_TWO * log32(s[N0 + i]))
        cosine, sine = cos_sin_turn(s[N1 + i])
        s[N0 + i], s[N1 + i] = radius * cosine, radius * sine
    for i in range(n):
        radius = np.sqrt(MINUS_TWO * log32(s[N2 + i]))
        cosine, sine = cos_sin_turn(s[N3 + i])
        s[N2 + i], s[N3 + i] = radius * cosine, radius * sine


@njit(**INNER)
def _number(bits: np.uint32) -> np.float32:
    """The number that has these bits."""
    out: np.float32 = np.uint32(bits).view(np.float32)
    return out


@njit(**INNER)
def _bits(number: np.float32) -> np.uint32:
    """The bits of a number."""
    out: np.uint32 = F(number).view(np.uint32)
    return out


@njit(**VECTOR)
def move(s: F4, n: int, motion: F4) -> None:
    """One draw of f(·|ξ) for each particle of the block, from the normals in N0 … N3 [M09 (11)].

    ``motion``: dt, a√dt, b√dt, smallest size, whether noises scale with the size, the frame's width and height (0: no
    border). A particle whose whole box has left the frame does not survive: ALIVE is 0 for it, else 1.
    """
    dt, kick, resize, smallest, scaled, width, height = (
        motion[0],
        motion[1],
        motion[2],
        motion[3],
        motion[4],
        motion[5],
        motion[6],
    )
    for i in range(n):
        s[ALIVE + i] = ONE
    if width > ZERO:
        for i in range(n):
            inside_x = (s[X + i] > -HALF * s[W + i]) & (s[X + i] < width + HALF * s[W + i])
            inside_y = (s[Y + i] > -HALF * s[H + i]) & (s[Y + i] < height + HALF * s[H + i])
            s[ALIVE + i] = ONE if inside_x & inside_y else ZERO
    for i in range(n):
        w, h = s[W + i], s[H + i]
        unit_x = ONE + scaled * ((w if w > smallest else smallest) - ONE)
        unit_y = ONE + scaled * ((h if h > smallest else smallest) - ONE)
        push_x, push_y = kick * unit_x * s[N0 + i], kick * unit_y * s[N1 + i]
        vx, vy = s[VX + i], s[VY + i]
        s[X + i] += dt * (vx + HALF * push_x)
        s[Y + i] += dt * (vy + HALF * push_y)
        s[VX + i], s[VY + i] = vx + push_x, vy + push_y
        s[W + i] = smallest + abs(w + resize * unit_x * s[N2 + i] - smallest)
        s[H + i] = smallest + abs(h + resize * unit_y * s[N3 + i] - smallest)
        s[IW + i], s[IH + i] = unit_x, unit_y


@njit(**VECTOR)
def drift(s: F4, n: int, rest: np.float32) -> None:
    """For dt > 1 what the position's variance is beside the part that the velocity's noise explains [M09 (11)].

    Uses the normals in N0 and N1, drawn anew, and the unit of the noises that `move` left in IW and IH.
    """
    for i in range(n):
        s[X + i] += rest * s[IW + i] * s[N0 + i]
        s[Y + i] += rest * s[IH + i] * s[N1 + i]


@njit(**VECTOR)
def extent(s: F4, n: int, out: F4, b: int) -> np.float32:
    """Into row b of ``out``: left, top, right, bottom of the block's positions, its mean width and height; gives Σ ALIVE."""
    left, top = sortable(s[X]), sortable(s[Y])
    right, bottom = left, top
    width, height, alive = ZERO, ZERO, ZERO
    for i in range(n):
        x, y = sortable(s[X + i]), sortable(s[Y + i])
        left = x if x < left else left
        right = x if x > right else right
        top = y if y < top else top
        bottom = y if y > bottom else bottom
    for i in range(n):
        width += s[W + i]
        height += s[H + i]
        alive += s[ALIVE + i]
    out[b, 0], out[b, 1] = sorted_number(left), sorted_number(top)
    out[b, 2], out[b, 3] = sorted_number(right), sorted_number(bottom)
    out[b, 4], out[b, 5] = width / F(n), height / F(n)
    return alive


@njit(**VECTOR)
def own_precisions(s: F4, n: int, spread: np.float32, floor: np.float32) -> None:
    """1/σ_w and 1/σ_h of each particle into IW and IH, and the likelihood's normaliser into SCALE [M09 §III]."""
    for i in range(n):
        deviation_w, deviation_h = spread * s[W + i], spread * s[H + i]
        iw = ONE / (deviation_w if deviation_w > floor else floor)
        ih = ONE / (deviation_h if deviation_h > floor else floor)
        s[IW + i], s[IH + i] = iw, ih
        s[SCALE + i] = NORM * (iw * ih) * (iw * ih)


@njit(**VECTOR)
def likelihood_own(s: F4, n: int, d: F4, j: int, region: np.float32) -> tuple[np.float32, np.float32]:
    """g(z_j|x)·ALIVE into G, where σ follows the particle; gives its sum and how many lie in the ``region`` around z_j.

    ``d`` is the table of detections, see `the rows above. [M07 §2, M09 §III]
    """
    zx, zy, zw, zh = d[ZX, j], d[ZY, j], d[ZW, j], d[ZH, j]
    total, near = ZERO, ZERO
    for i in range(n):
        dx, dy = (zx - s[X + i]) * s[IW + i], (zy - s[Y + i]) * s[IH + i]
        dw, dh = (zw - s[W + i]) * s[IW + i], (zh - s[H + i]) * s[IH + i]
        distance2 = FOUR * (dx * dx + dy * dy) + (dw * dw + dh * dh)
        alive = s[ALIVE + i]
        g = exp32(MINUS_HALF * distance2) * s[SCALE + i] * alive
        s[G + i] = g
        total += g
        near += alive if distance2 <= region else ZERO
    return total, near


@njit(**VECTOR)
def likelihood_given(s: F4, n: int, d: F4, j: int, region: np.float32) -> tuple[np.float32, np.float32]:
    """The same where σ is the detection's."""
    zx, zy, zw, zh = d[ZX, j], d[ZY, j], d[ZW, j], d[ZH, j]
    ix, iy, iw, ih, scale = d[IX, j], d[IY, j], d[IZW, j], d[IZH, j], d[GSCALE, j]
    total, near = ZERO, ZERO
    for i in range(n):
        dx, dy = (zx - s[X + i]) * ix, (zy - s[Y + i]) * iy
        dw, dh = (zw - s[W + i]) * iw, (zh - s[H + i]) * ih
        distance2 = (dx * dx + dy * dy) + (dw * dw + dh * dh)
        alive = s[ALIVE + i]
        g = exp32(MINUS_HALF * distance2) * scale * alive
        s[G + i] = g
        total += g
        near += alive if distance2 <= region else ZERO
    return total, near


@njit(**VECTOR, inline="always")
def likelihood(s: F4, n: int, d: F4, j: int, region: np.float32, own: bool) -> tuple[np.float32, np.float32]:
    """g(z_j|x)·ALIVE into G; its sum, and how many particles lie in the ``region`` around z_j."""
    total, near = ZERO, ZERO
    if own:
        total, near = likelihood_own(s, n, d, j, region)
    else:
        total, near = likelihood_given(s, n, d, j, region)
    return total, near
