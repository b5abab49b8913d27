"""Newborn boxes around one detection: drawn from counters, so that they can be drawn again instead of being stored.

Positions and sizes come from the observation noise inside its 99 % region, their radii stratified. A point of the unit
sphere in four dimensions is two angles and a share: of two independent complex normals, the share of the first in the
squared radius is uniform.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.box_blocks import ALIVE, BLOCK, G, H, IH, IW, IX, IY, IZH, IZW, W, X, Y, ZERO, ZH, ZW, ZX, ZY
from phdtrack.kernels.fast32 import FAST, HALF, ONE, cos_sin_turn, exp32, log32
from phdtrack.kernels.philox import ROUNDS, philox, unit

F4 = NDArray[np.float32]
I8 = NDArray[np.int64]
F = np.float32
# Rows of the table of detections beside those of `box_blocks`: the deviations, one over them for the proposal, and the
# densities there of the proposal (J_i at its peak) and of γ.
SX, SY, SW, SH, BX, BY, BW, BH, PEAK, DENSITY = range(9, 19)
COLUMNS = 19
LOWEST_SIZE, HIGHEST_SIZE = F(0.5), F(1.5)
STAGE_POINT, STAGE_VELOCITY = np.uint32(2), np.uint32(3)


@njit(fastmath=FAST, error_model="numpy")
def draw_newborn(s: F4, n: int, first: int, many: int, d: F4, j: int, radius: F4, k0: np.uint32, k1: np.uint32) -> None:
    """Particles ``first`` … first + n − 1 of the ``many`` around detection j, into X, Y, W, H [M07 §2].

    ``radius`` are the radii at equal steps of the quantile.
    """
    cells = F(radius.size - 1)
    share = ONE / F(many)
    for i in range(n):
        a, b, c, e = philox(np.uint32(first + i), np.uint32(j), STAGE_POINT, np.uint32(0), k0, k1, ROUNDS)
        s[IW + i], s[IH + i], s[G + i] = unit(b), unit(c), unit(e)
        s[ALIVE + i] = min((F(first + i) + unit(a)) * share, ONE) * cells
    for i in range(n):
        place = s[ALIVE + i]
        below = min(np.int32(place), np.int32(radius.size - 2))
        low = radius[below]
        s[ALIVE + i] = low + (radius[below + 1] - low) * (place - F(below))
    for i in range(n):
        length = s[ALIVE + i] * np.sqrt(s[G + i])
        cosine, sine = cos_sin_turn(s[IW + i])
        s[X + i] = d[ZX, j] + d[SX, j] * length * cosine
        s[Y + i] = d[ZY, j] + d[SY, j] * length * sine
    for i in range(n):
        length = s[ALIVE + i] * np.sqrt(ONE - s[G + i])
        cosine, sine = cos_sin_turn(s[IH + i])
        s[W + i] = d[ZW, j] + d[SW, j] * length * cosine
        s[H + i] = d[ZH, j] + d[SH, j] * length * sine


@njit(fastmath=FAST, error_model="numpy")
def weigh_newborn(
    s: F4, n: int, d: F4, j: int, neighbour: I8, count: int, limit: np.float32, local: bool, flat: np.float32
) -> None:
    """Importance weights γ(x) / Σ_i J_i p_i(x) into ALIVE, with the proposals and the γ of all neighbours [M07 §2].

    ``flat``: γ where it is the same everywhere; with ``local`` it is the sum of the neighbourhoods that hold x.
    """
    for i in range(n):
        s[IW + i] = ZERO
        s[IH + i] = ZERO if local else flat
    for m in range(count):
        k = neighbour[m]
        zx, zy, zw, zh = d[ZX, k], d[ZY, k], d[ZW, k], d[ZH, k]
        bx, by, bw, bh, peak = d[BX, k], d[BY, k], d[BW, k], d[BH, k], d[PEAK, k]
        # Its own region holds every particle, whatever rounding says.
        reach = F(1e30) if k == j else limit
        if peak > ZERO:
            for i in range(n):
                dx, dy, dw, dh = (s[X + i] - zx) * bx, (s[Y + i] - zy) * by, (s[W + i] - zw) * bw, (s[H + i] - zh) * bh
                distance2 = (dx * dx + dy * dy) + (dw * dw + dh * dh)
                p = peak * exp32(-HALF * distance2)
                s[IW + i] += p if distance2 <= reach else ZERO
        if local:
            density = d[DENSITY, k]
            least_w, most_w, least_h, most_h = LOWEST_SIZE * zw, HIGHEST_SIZE * zw, LOWEST_SIZE * zh, HIGHEST_SIZE * zh
            for i in range(n):
                w, h = s[W + i], s[H + i]
                there = (abs(s[X + i] - zx) <= zw) & (abs(s[Y + i] - zy) <= zh)
                alike = (w >= least_w) & (w <= most_w) & (h >= least_h) & (h <= most_h)
                s[IH + i] += density if there & alike else ZERO
    for i in range(n):
        possible = (s[W + i] > ZERO) & (s[H + i] > ZERO)
        s[ALIVE + i] = s[IH + i] / s[IW + i] if possible else ZERO
    for i in range(n):
        # A size that cannot be still needs a deviation above zero below.
        s[W + i], s[H + i] = max(s[W + i], F(1e-3)), max(s[H + i], F(1e-3))


@njit(fastmath=FAST, error_model="numpy")
def velocity(tooth: int, j: int, amplitude: np.float32, k0: np.uint32, k1: np.uint32) -> tuple[np.float32, np.float32]:
    """A velocity of uniform direction and Gaussian amplitude, for one offspring of a newborn particle [M07 §2]."""
    a, b, c, _ = philox(np.uint32(tooth), np.uint32(j), STAGE_VELOCITY, np.uint32(0), k0, k1, ROUNDS)
    normal, _ = cos_sin_turn(unit(b))
    cosine, sine = cos_sin_turn(unit(c))
    length = amplitude * np.sqrt(F(-2.0) * log32(unit(a))) * normal
    return length * cosine, length * sine
