"""The shipped box model in numbers, for the fused GM-PHD step: prediction, noise, and the densities of births and clutter.

State (px, py, vx, vy, w, h), measurement (px, py, w, h[, their variances]). What the numbers mean, and why the formulas are
what they are, stands at `BoxMotion`, `BoxSensor`, `MeasurementBirth` and the clutters; here they are only written out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# (px, py, w, h).
Box = tuple[float, float, float, float]
# Covariances are kept as their lower triangles, row by row: that is 42 % less to move.
D, M, ENTRIES = 6, 4, 21
ROWS = (0, 1, 4, 5)
# Names are floats too, because all numbers are handed over in one array.
PARTICLE, DETECTION, FIXED, GIVEN = 0.0, 1.0, 2.0, 3.0
NOWHERE, IMAGE, LOCAL, PLACES = 0.0, 1.0, 2.0, 3.0
# Of births by place: how many times as many they are at a measurement, mean and covariance (three numbers) of the
# velocities there.
ABOUT = 6
TINY_VARIANCE = 1e-12


class Scene(NamedTuple):
    """The measurements of a frame, sorted into the cells of a grid.

    ``boxes`` (N, m), of which the k-th was measurement ``order[k]``; ``start`` (cells + 1,) where each cell's begin;
    ``x0``, ``y0`` the grid's origin, ``sx``, ``sy`` cells per pixel, ``nx``, ``ny`` how many there are.
    """

    boxes: F8
    order: I8
    start: I8
    x0: float
    y0: float
    sx: float
    sy: float
    nx: int
    ny: int


class BoxNumbers(NamedTuple):
    """Settings of motion, sensor, birth and clutter over one interval.

    ``survival`` is p_S^dt, ``frame_*`` 0 where there is no border; ``scaling`` one of the four names above; ``deviation_*``
    those of a newborn velocity, relative to √(wh) or in pixels; ``birth`` and ``clutter`` say what γ and κ are spread over:
    ``born`` and ``false`` are densities (``IMAGE``), or rates around each detection (``LOCAL``) of 4w²h² pixel⁴. By place
    (``PLACES``) both are rates around each too: γ is as many times what is handed in, and what is handed in comes to κ.
    Births about a measurement need it from ``low`` to ``high``, but for those by place.
    """

    dt: float
    acceleration: float
    resize: float
    scaled: float
    smallest: float
    survival: float
    frame_width: float
    frame_height: float
    scaling: float
    spread: float
    floor: float
    fixed_position: float
    fixed_size: float
    deviation_scaled: float
    deviation_fixed: float
    p_detect: float
    birth: float
    born: float
    newborn_volume: float
    newborn_stretch: float
    newborn_limit: float
    clutter: float
    false: float
    local_volume: float
    reach: float
    size_low: float
    size_high: float
    low: Box
    high: Box


@njit(**INNER)
def box_numbers(t: F8) -> BoxNumbers:
    """The numbers from an array (35,), which costs less to hand over than a tuple."""
    return BoxNumbers(
        t[0], t[1], t[2], t[3], t[4], t[5], t[6], t[7], t[8], t[9], t[10], t[11], t[12], t[13],
        t[14], t[15], t[16], t[17], t[18], t[19], t[20], t[21], t[22], t[23], t[24], t[25], t[26],
        (t[27], t[28], t[29], t[30]), (t[31], t[32], t[33], t[34]),
    )  # fmt: skip


@njit(**INNER)
def entry(r: int, s: int) -> int:
    """Where the element in row r, column s ≤ r of a covariance is kept."""
    return r * (r + 1) // 2 + s


@njit(**INNER)
def predicted(weight: F8, mean: F8, cov: F8, tag: I8, b: BoxNumbers, w: F8, x: F8, p: F8, t: I8) -> int:
    """Predict a mixture into ``w``, ``x``, ``p`` (triangles), ``t`` (tags); how many survive.

    ``mean`` (d, J), ``cov`` (J, d, d); room of at least (J,), (J, d), (J, 21), (J,).
    """
    dt = b.dt
    position, mixed = dt * dt * dt / 3.0 - min(dt, dt * dt * dt) / 12.0, dt * dt / 2.0
    bordered = b.frame_width > 0.0 and b.frame_height > 0.0
    k = 0
    for i in range(weight.size):
        if bordered:
            half_w, half_h = 0.5 * mean[4, i], 0.5 * mean[5, i]
            inside = -half_w < mean[0, i] < b.frame_width + half_w and -half_h < mean[1, i] < b.frame_height + half_h
            if not inside:
                continue
        w[k] = weight[i] * b.survival
        if not w[k] > 0.0:
            continue
        t[k] = tag[i]
        for r in range(D):
            x[k, r] = mean[r, i]
        for a in range(2):
            x[k, a] = mean[a, i] + dt * mean[a + 2, i]
        for r in range(D):
            for s in range(r + 1):
                p[k, entry(r, s)] = cov[i, r, s]
        # F P Fᵀ, lower triangle: first the columns of the velocities onto those of the positions, then the rows.
        for a in range(2):
            for r in range(2, D):
                p[k, entry(r, a)] += dt * cov[i, r, a + 2]
        p[k, entry(0, 0)] += dt * (2.0 * cov[i, 2, 0] + dt * cov[i, 2, 2])
        p[k, entry(1, 1)] += dt * (2.0 * cov[i, 3, 1] + dt * cov[i, 3, 3])
        p[k, entry(1, 0)] += dt * (cov[i, 3, 0] + cov[i, 2, 1] + dt * cov[i, 3, 2])
        for a in range(2):
            unit = max(mean[a + 4, i], b.smallest) if b.scaled > 0.0 else 1.0
            a2, b2 = (b.acceleration * unit) ** 2, (b.resize * unit) ** 2
            p[k, entry(a, a)] += a2 * position
            p[k, entry(a + 2, a)] += a2 * mixed
            p[k, entry(a + 2, a + 2)] += a2 * dt
            p[k, entry(a + 4, a + 4)] += b2 * dt
        k += 1
    return k


@njit(**INNER)
def noise(b: BoxNumbers, w: float, h: float, z: F8, j: int) -> tuple[float, float, float, float]:
    """Variances of (px, py, w, h) of the measurement ``j`` of ``z`` (N, m), of a box of size ``w``, ``h``."""
    if b.scaling == FIXED:
        return b.fixed_position, b.fixed_position, b.fixed_size, b.fixed_size
    if b.scaling == GIVEN:
        return z[j, 4], z[j, 5], z[j, 6], z[j, 7]
    if b.scaling == DETECTION:
        w, h = z[j, 2], z[j, 3]
    sw, sh = max(b.spread * w, b.floor), max(b.spread * h, b.floor)
    vw, vh = max(sw * sw, TINY_VARIANCE), max(sh * sh, TINY_VARIANCE)
    return max(0.25 * vw, TINY_VARIANCE), max(0.25 * vh, TINY_VARIANCE), vw, vh


@njit(**INNER)
def widest(boxes: F8, b: BoxNumbers) -> tuple[float, float]:
    """The largest variances of position that a measurement brings; 0 where they follow the state."""
    vx, vy = 0.0, 0.0
    if b.scaling == DETECTION or b.scaling == GIVEN:
        for j in range(len(boxes)):
            here = noise(b, 0.0, 0.0, boxes, j)
            vx, vy = max(vx, here[0]), max(vy, here[1])
    return vx, vy


@njit(**INNER)
def possible(b: BoxNumbers, boxes: F8, j: int) -> bool:
    """Whether a birth about measurement ``j`` is."""
    inside = True
    for a in range(M):
        inside &= b.low[a] <= boxes[j, a] <= b.high[a]
    return inside


@njit(**INNER)
def cell(value: float, origin: float, scale: float, count: int) -> int:
    """Index of the cell that holds ``value``, clamped to the grid; ``scale`` is the inverse of a cell's size."""
    position = (value - origin) * scale
    if not position > 0.0:  # also NaN
        return 0
    return count - 1 if position >= count else int(position)


@njit(**INNER)
def sorted_boxes(z: F8) -> Scene:
    """The measurements ``z`` (m, N) in a grid with about one of them a cell.

    Raises ValueError where a position is NaN or infinite.
    """
    m, n = z.shape
    x0, x1, y0, y1, total = 0.0, 0.0, 0.0, 0.0, 0.0
    if n > 0:
        x0, x1, y0, y1 = z[0, 0], z[0, 0], z[1, 0], z[1, 0]
    for j in range(n):
        x0, x1 = min(x0, z[0, j]), max(x1, z[0, j])
        y0, y1 = min(y0, z[1, j]), max(y1, z[1, j])
        total += z[0, j] + z[1, j]
    if not np.isfinite(total):
        raise ValueError("positions must be finite")
    wide, high = x1 - x0 + 1e-9, y1 - y0 + 1e-9
    nx = int(max(min(np.sqrt(n * (wide / high)), float(n)), 1.0))
    ny = max(1, n // nx)
    sx, sy = nx / wide, ny / high
    # A counting sort. ``start`` is shifted by one while it is filled.
    start, home = np.empty(nx * ny + 2, np.int64), np.empty(n, np.int64)
    order, boxes = np.empty(n, np.int64), np.empty((n, m))
    for c in range(start.size):
        start[c] = 0
    for j in range(n):
        home[j] = cell(z[1, j], y0, sy, ny) * nx + cell(z[0, j], x0, sx, nx)
        start[home[j] + 2] += 1
    for c in range(2, start.size):
        start[c] += start[c - 1]
    for j in range(n):
        k = start[home[j] + 1]
        start[home[j] + 1] = k + 1
        order[k] = j
        for r in range(m):
            boxes[k, r] = z[r, j]
    return Scene(boxes, order, start, x0, y0, sx, sy, nx, ny)


@njit(**INNER)
def cells(x: float, y: float, half_x: float, half_y: float, scene: Scene) -> tuple[int, int, int, int]:
    """First and last column, first and last line of the cells that a rectangle about (x, y) touches."""
    left, right = cell(x - half_x, scene.x0, scene.sx, scene.nx), cell(x + half_x, scene.x0, scene.sx, scene.nx)
    top, bottom = cell(y - half_y, scene.y0, scene.sy, scene.ny), cell(y + half_y, scene.y0, scene.sy, scene.ny)
    return left, right, top, bottom


@njit(**INNER)
def around_each(b: BoxNumbers) -> bool:
    """Whether anything is spread around each detection."""
    births = b.birth == LOCAL or b.birth == PLACES
    return births or b.clutter == LOCAL or (b.clutter == PLACES and b.false > 0.0)


@njit(**INNER)
def crowding(scene: Scene, b: BoxNumbers) -> F8:
    """(N,) Σ_i 1/V_i over the neighbourhoods in which each measurement lies: a local density per rate of one."""
    boxes, start, nx = scene.boxes, scene.start, scene.nx
    out = np.zeros(len(boxes))
    for i in range(len(boxes)):
        x, y, w, h = boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3]
        density = 1.0 / (b.local_volume * (w * h * (w * h)))
        left, right, top, bottom = cells(x, y, b.reach * w, b.reach * h, scene)
        for line in range(top, bottom + 1):
            for k in range(start[line * nx + left], start[line * nx + right + 1]):
                near = abs(boxes[k, 0] - x) <= b.reach * w and abs(boxes[k, 1] - y) <= b.reach * h
                near = near and b.size_low * w <= boxes[k, 2] <= b.size_high * w
                if near and b.size_low * h <= boxes[k, 3] <= b.size_high * h:
                    out[k] += density
    return out


@njit(**INNER)
def newborn(
    scene: Scene, b: BoxNumbers, gamma: F8, about: F8, covered: F8, w: F8, x: F8, p: F8, t: I8, k: int, fresh: int
) -> int:
    """Put Gaussians about what nothing covers behind the first ``k`` of ``w``, ``x``, ``p``, ``t``; how many there are then.

    ``gamma`` (N,) is the density of births at each, per interval; ``about`` (N, 6), by measurement, the velocities, where
    births are by place. Tags from ``fresh`` on, in the order of the measurements.
    """
    boxes, start, nx = scene.boxes, scene.start, scene.nx
    n, first = len(boxes), k
    parent, deviation2 = np.empty(n, np.int64), np.empty((n, M))
    shared, number = np.zeros(n), np.zeros(n, np.int64)
    for j in range(n):
        if not (covered[j] < 1.0 and gamma[j] > 0.0):
            continue
        here = noise(b, boxes[j, 2], boxes[j, 3], boxes, j)
        for a in range(M):
            deviation2[j, a] = b.newborn_stretch * here[a]
        half_x, half_y = np.sqrt(b.newborn_limit * deviation2[j, 0]), np.sqrt(b.newborn_limit * deviation2[j, 1])
        left, right, top, bottom = cells(boxes[j, 0], boxes[j, 1], half_x, half_y, scene)
        for line in range(top, bottom + 1):
            for i in range(start[line * nx + left], start[line * nx + right + 1]):
                distance2 = 0.0
                for a in range(M):
                    step = boxes[i, a] - boxes[j, a]
                    distance2 += step * step / deviation2[j, a]
                if distance2 <= b.newborn_limit:
                    shared[i] += gamma[j] * np.exp(-0.5 * distance2)
        parent[k - first] = j
        k += 1
    for i in range(first, k):
        number[scene.order[parent[i - first]]] = 1
    for j in range(1, n):
        number[j] += number[j - 1]
    for i in range(first, k):
        j = parent[i - first]
        size = np.sqrt(boxes[j, 2] * boxes[j, 3])
        speed = b.deviation_fixed if b.scaling == FIXED else b.deviation_scaled * size
        for r in range(D):
            x[i, r] = 0.0
        for e in range(ENTRIES):
            p[i, e] = 0.0
        volume = b.newborn_volume
        for a in range(M):
            x[i, ROWS[a]] = boxes[j, a]
            here2 = deviation2[j, a] / b.newborn_stretch
            p[i, entry(ROWS[a], ROWS[a])] = deviation2[j, a] - here2
            volume *= np.sqrt(here2)
        for a in range(2):
            p[i, entry(a + 2, a + 2)] = max(speed, 1e-6) ** 2
        if b.birth == PLACES:
            of = scene.order[j]
            x[i, 2], x[i, 3], p[i, entry(2, 2)] = about[of, 1], about[of, 2], about[of, 3]
            p[i, entry(3, 2)], p[i, entry(3, 3)] = about[of, 4], about[of, 5]
        t[i] = fresh + number[scene.order[j]] - 1
        w[i] = gamma[j] * volume * gamma[j] / shared[j]
    return k
