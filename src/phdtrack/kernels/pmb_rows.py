"""Hypotheses of the box model as rows: prediction, measurements within the gate, posteriors.

In the box model the two axes and the two sizes do not mix: a covariance is two of position and velocity and two variances.
A row begins with the state (px, py, vx, vy, w, h), the variances of the same, and the covariances of px and vx, py and vy:
(14,); what else it holds is the caller's. What else stands in a covariance, where a camera that turns has mixed them or the
initial one was given so, is left out.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import INNER
from phdtrack.kernels.gm_model import DETECTION, FIXED, GIVEN, BoxNumbers, D, Scene, cells, noise, widest

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

NORM = 1.0 / (2.0 * math.pi) ** 2
# Where in a row the variances begin, where the two covariances, how long it is.
VARIANCE, MIXED, ROW = D, 2 * D, 2 * D + 2
NOTHING = (0.0, 0.0, 0.0, 0.0)
# How well a source's place can be known, as a share of the variance of one measurement.
SURE = 0.5


@njit(**INNER)
def moved(rows: F8, i: int, b: BoxNumbers) -> None:
    """Row i through f, in place."""
    dt = b.dt
    position, mixed = dt * dt * dt / 3.0 - min(dt, dt * dt * dt) / 12.0, dt * dt / 2.0
    for a in range(2):
        v, s = a + 2, a + 4
        unit = max(rows[i, s], b.smallest) if b.scaled > 0.0 else 1.0
        a2, b2 = b.acceleration * unit * (b.acceleration * unit), b.resize * unit * (b.resize * unit)
        rows[i, a] += dt * rows[i, v]
        rows[i, VARIANCE + a] += dt * (2.0 * rows[i, MIXED + a] + dt * rows[i, VARIANCE + v]) + a2 * position
        rows[i, MIXED + a] += dt * rows[i, VARIANCE + v] + a2 * mixed
        rows[i, VARIANCE + v] += a2 * dt
        rows[i, VARIANCE + s] += b2 * dt


@njit(**INNER)
def left_alone(rows: F8, i: int, b: BoxNumbers) -> None:
    """Row i, that of a source, in place: where it fires is never known better than `SURE` of one measurement's variance."""
    for a in range(2):
        size = max(b.spread * rows[i, a + 4], b.floor)
        position2, size2 = (b.fixed_position, b.fixed_size) if b.scaling == FIXED else (0.25 * size * size, size * size)
        rows[i, VARIANCE + a] = max(rows[i, VARIANCE + a], SURE * position2)
        rows[i, VARIANCE + a + 4] = max(rows[i, VARIANCE + a + 4], SURE * size2)


@njit(**INNER)
def _longer(point: I8, which: I8, density: F8, used: int, more: int) -> tuple[I8, I8, F8]:
    """The pairs, of which so many are used, copied into arrays that have room for ``more`` and for as many again."""
    a, b, c = np.empty(2 * used + more, np.int64), np.empty(2 * used + more, np.int64), np.empty(2 * used + more)
    for q in range(used):
        a[q], b[q], c[q] = point[q], which[q], density[q]
    return a, b, c


@njit(**INNER)
def paired(rows: F8, scene: Scene, b: BoxNumbers, gate: float) -> tuple[I8, I8, F8, int]:
    """Pairs (row, measurement in the scene's order) within the gate, with q(z), and how many there are."""
    boxes, start, nx, count = scene.boxes, scene.start, scene.nx, len(rows)
    own = not (b.scaling == DETECTION or b.scaling == GIVEN)
    most = widest(boxes, b)
    point, which, density = np.empty(4 * count + 16, np.int64), np.empty(4 * count + 16, np.int64), np.empty(4 * count + 16)
    found, limit = 0 * count, gate * gate
    for i in range(count):
        x, y, w, h = rows[i, 0], rows[i, 1], rows[i, 4], rows[i, 5]
        px, py, pw, ph = rows[i, VARIANCE], rows[i, VARIANCE + 1], rows[i, VARIANCE + 4], rows[i, VARIANCE + 5]
        here = noise(b, w, h, boxes, 0) if own else NOTHING
        vx, vy = (here[0], here[1]) if own else most
        half_x, half_y = gate * np.sqrt(px + vx), gate * np.sqrt(py + vy)
        left, right, top, bottom = cells(x, y, half_x, half_y, scene)
        for line in range(top, bottom + 1):
            low, high = start[line * nx + left], start[line * nx + right + 1]
            if found + high - low > point.size:
                point, which, density = _longer(point, which, density, found, high - low)
            for j in range(low, high):
                if not own:
                    here = noise(b, 0.0, 0.0, boxes, j)
                sx, sy, sw, sh = px + here[0], py + here[1], pw + here[2], ph + here[3]
                dx, dy, dw, dh = boxes[j, 0] - x, boxes[j, 1] - y, boxes[j, 2] - w, boxes[j, 3] - h
                distance2 = dx * dx / sx + dy * dy / sy + dw * dw / sw + dh * dh / sh
                if distance2 <= limit:
                    point[found], which[found] = i, j
                    density[found] = NORM * np.exp(-0.5 * distance2) / np.sqrt(sx * sy * sw * sh)
                    found += 1
    return point, which, density, found


@njit(**INNER)
def taken(rows: F8, i: int, boxes: F8, j: int, b: BoxNumbers, out: F8, k: int) -> None:
    """Row i after measurement j, in the k-th place of ``out``."""
    here = noise(b, rows[i, 4], rows[i, 5], boxes, j)
    for a in range(2):
        v, s = a + 2, a + 4
        own, mixed = rows[i, VARIANCE + a], rows[i, MIXED + a]
        total = own + here[a]
        gain, push, step = own / total, mixed / total, boxes[j, a] - rows[i, a]
        out[k, a], out[k, v] = rows[i, a] + gain * step, rows[i, v] + push * step
        out[k, VARIANCE + a], out[k, MIXED + a] = own * here[a] / total, mixed * here[a] / total
        out[k, VARIANCE + v] = rows[i, VARIANCE + v] - push * mixed
        own = rows[i, VARIANCE + s]
        total = own + here[a + 2]
        out[k, s] = rows[i, s] + own / total * (boxes[j, a + 2] - rows[i, s])
        out[k, VARIANCE + s] = own * here[a + 2] / total


@njit(**INNER)
def told_alone(boxes: F8, j: int, b: BoxNumbers, out: F8, k: int) -> None:
    """What measurement j tells alone, in the k-th place of ``out``."""
    here = noise(b, boxes[j, 2], boxes[j, 3], boxes, j)
    size = np.sqrt(boxes[j, 2] * boxes[j, 3])
    speed = max(b.deviation_fixed if b.scaling == FIXED else b.deviation_scaled * size, 1e-6)
    for a in range(2):
        out[k, a], out[k, a + 2], out[k, a + 4] = boxes[j, a], 0.0, boxes[j, a + 2]
        out[k, VARIANCE + a], out[k, VARIANCE + a + 2], out[k, VARIANCE + a + 4] = here[a], speed * speed, here[a + 2]
        out[k, MIXED + a] = 0.0
