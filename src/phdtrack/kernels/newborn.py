"""Newborn boxes around the detections, placed from one table of standard points a frame instead of being stored.

Positions and sizes come from the observation noise inside its 99 % region, their radii stratified. A point of the unit
sphere in four dimensions is two angles and a share: of two independent complex normals, the share of the first in the
squared radius is uniform. Every detection takes its own stretch of the frame's table: each one's newborn follow the proposal
exactly; those of two detections in one frame are not independent of each other, which changes no expectation, and the
table is drawn anew for every frame.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.box_blocks import ALIVE, IH, IW, MINUS_TWO, ZERO, ZH, ZW, ZX, ZY, H, U, W, X, Y
from phdtrack.kernels.fast32 import ENTRY, FAST, HALF, INNER, ONE, VECTOR, cos_sin_turn, exp32, log32
from phdtrack.kernels.philox import ROUNDS, philox, unit

F4 = NDArray[np.float32]
I8 = NDArray[np.int64]
F = np.float32
# Rows of the table of detections beside those of `box_blocks`: the deviations, one over them for the proposal, and the
# densities there of the proposal (J_i at its peak) and of γ.
SX, SY, SW, SH, BX, BY, BW, BH, PEAK, DENSITY = range(9, 19)
COLUMNS = 19
SMALLEST = F(1e-3)
LOWEST_SIZE, HIGHEST_SIZE = F(0.5), F(1.5)
STAGE_POINT, STAGE_VELOCITY = np.uint32(2), np.uint32(3)
ALL = np.uint32(0xFFFFFFFF)
GOLDEN = 0.6180339887498949


@njit(**ENTRY, fastmath=FAST)
def standard_points(count: int, radius: F4, key: I8) -> F4:
    """(7, count) points of a standard Gaussian in four dimensions inside its kept part, exp(−r²/2) of each, and velocities.

    ``radius`` are the radii at equal steps of the quantile. The quantiles are a golden-section sequence, so that every
    stretch of the points has about every radius; its random start makes the law of each single one exact. The velocities
    (2, count) have uniform direction and standard Gaussian amplitude [M07 §2].
    """
    k0, k1 = np.uint32(key[0]), np.uint32(key[1])
    out = np.empty((7, count), np.float32)
    x, y, w, h, density, vx, vy = out[0], out[1], out[2], out[3], out[4], out[5], out[6]
    a, _, _, _ = philox(ALL, ALL, STAGE_POINT, np.uint32(0), k0, k1, ROUNDS)
    start, cells, last = np.float64(unit(a)), np.float64(radius.size - 1), np.int32(radius.size - 2)
    for i in range(count):
        _, b, c, e = philox(np.uint32(i), np.uint32(0), STAGE_POINT, np.uint32(0), k0, k1, ROUNDS)
        x[i], y[i], w[i] = unit(b), unit(c), unit(e)
    for i in range(count):
        turn = start + GOLDEN * i
        h[i] = F((turn - np.floor(turn)) * cells)
    for i in range(count):
        below = np.int32(h[i])
        below = below if below < last else last
        density[i] = radius[below] + (radius[below + np.int32(1)] - radius[below]) * (h[i] - F(below))
    for i in range(count):
        first = density[i] * np.sqrt(x[i])
        cosine, sine = cos_sin_turn(y[i])
        h[i] = density[i] * np.sqrt(ONE - x[i])
        x[i], y[i] = first * cosine, first * sine
    for i in range(count):
        second = h[i]
        cosine, sine = cos_sin_turn(w[i])
        w[i], h[i] = second * cosine, second * sine
        density[i] = exp32(-HALF * density[i] * density[i])
    for i in range(count):
        a, b, c, _ = philox(np.uint32(i), np.uint32(0), STAGE_VELOCITY, np.uint32(0), k0, k1, ROUNDS)
        vx[i], vy[i] = np.sqrt(MINUS_TWO * log32(unit(a))) * cos_sin_turn(unit(b))[0], unit(c)
    for i in range(count):
        cosine, sine = cos_sin_turn(vy[i])
        vx[i], vy[i] = vx[i] * cosine, vx[i] * sine
    return out


@njit(**INNER)
def stretch(j: int, room: int, k0: np.uint32, k1: np.uint32) -> np.int64:
    """Where in the standard points those of detection j begin, 0 ≤ … ≤ ``room``."""
    a, _, _, _ = philox(np.uint32(j), ALL, STAGE_POINT, np.uint32(0), k0, k1, ROUNDS)
    return np.int64(a) % (room + 1)


@njit(**VECTOR)
def place_newborn(s: F4, n: int, points: F4, first: int, d: F4, j: int) -> None:
    """The points ``first`` … first + n − 1 around detection j into X, Y, W, H, their own proposal's density into IW."""
    zx, zy, zw, zh = d[ZX, j], d[ZY, j], d[ZW, j], d[ZH, j]
    sx, sy, sw, sh, peak = d[SX, j], d[SY, j], d[SW, j], d[SH, j], d[PEAK, j]
    for i in range(n):
        p = U(first) + U(i)
        s[X + i], s[Y + i], s[IW + i] = zx + sx * points[0, p], zy + sy * points[1, p], peak * points[4, p]
        s[W + i], s[H + i] = zw + sw * points[2, p], zh + sh * points[3, p]


@njit(**VECTOR)
def weigh_newborn(
    s: F4, n: int, d: F4, j: int, neighbour: I8, count: int, limit: np.float32, local: bool, flat: np.float32
) -> np.float32:
    """Importance weights γ(x) / Σ_i J_i p_i(x) into ALIVE, with the proposals and γ of all neighbours [M07 §2]; their sum.

    ``flat``: γ where it is the same everywhere, else 0: with ``local`` it is the sum of the neighbourhoods that hold x. IW
    holds the particles' own proposal already.
    """
    for i in range(n):
        s[IH + i] = flat
    for m in range(count):
        k = neighbour[m]
        zx, zy, zw, zh = d[ZX, k], d[ZY, k], d[ZW, k], d[ZH, k]
        bx, by, bw, bh, peak = d[BX, k], d[BY, k], d[BW, k], d[BH, k], d[PEAK, k]
        if peak > ZERO and k != j:
            for i in range(n):
                dx, dy, dw, dh = (s[X + i] - zx) * bx, (s[Y + i] - zy) * by, (s[W + i] - zw) * bw, (s[H + i] - zh) * bh
                distance2 = (dx * dx + dy * dy) + (dw * dw + dh * dh)
                p = peak * exp32(-HALF * distance2)
                s[IW + i] += p if distance2 <= limit else ZERO
        if local:
            density = d[DENSITY, k]
            least_w, most_w, least_h, most_h = LOWEST_SIZE * zw, HIGHEST_SIZE * zw, LOWEST_SIZE * zh, HIGHEST_SIZE * zh
            for i in range(n):
                w, h = s[W + i], s[H + i]
                there = (abs(s[X + i] - zx) <= zw) & (abs(s[Y + i] - zy) <= zh)
                alike = (w >= least_w) & (w <= most_w) & (h >= least_h) & (h <= most_h)
                s[IH + i] += density if there & alike else ZERO
    total = ZERO
    for i in range(n):
        w, h = s[W + i], s[H + i]
        weight = s[IH + i] / s[IW + i]
        weight = weight if (w > ZERO) & (h > ZERO) else ZERO
        s[ALIVE + i] = weight
        total += weight
        # A size that cannot be still needs a deviation above zero in the likelihood.
        s[W + i], s[H + i] = w if w > SMALLEST else SMALLEST, h if h > SMALLEST else SMALLEST
    return total
