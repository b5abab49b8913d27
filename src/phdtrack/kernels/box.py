"""What boxes in the image are for motion, sensor and clutter: predictions, noises, overlaps,
neighbours.

The formulas stand in `models.box`. States are (px, py, vx, vy, w, h).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import Predicted

Noise = tuple[int, float, float, float, float]
# Rows of the state that a measurement shows.
ROWS = (0, 1, 4, 5)
PARTICLE, DETECTION, FIXED, GIVEN = range(4)
TINY_VARIANCE = 1e-12
LEAST_SPEED = 1e-6
# Steps of boxes that are this many times their mean count half in `agreement`; the mean is of the
# last so many.
LARGE = 3.0
MEMORY = 200.0
# Where D is less, a point is about to pass the horizon of the map: it is taken this far, out of any
# image, and no further.
LEAST = 0.05


@njit(**ENTRY)
def apart(boxes: F8, order: I8, overlap: float) -> I8:
    """(k,) which of the boxes (n, 4) are left if each goes that overlaps one left before it by more
    than ``overlap`` (IoU).

    ``order`` (n,): their numbers by left sides, rising. Only boxes that begin left of its end and
    reach beyond its beginning are compared with a box.
    """
    n = order.size
    place = np.empty(n, np.int64)
    reach = np.empty(n)
    left = np.empty(n, np.int64)
    farthest = -np.inf
    k = 0 * n
    for p in range(n):
        right = boxes[order[p], 2]
        if right > farthest:
            farthest = right
        else:
            farthest = farthest
        place[order[p]] = p
        reach[p] = farthest
    for j in range(n):
        p = place[j]
        while p > 0 and reach[p - 1] > boxes[j, 0]:
            p -= 1
        while p < n and boxes[order[p], 0] < boxes[j, 2]:
            i = order[p]
            if i < j and place[i] >= 0 and overlap_of(boxes, i, boxes, j) > overlap:
                place[j] = -1
                break
            p += 1
        if place[j] >= 0:
            left[k] = j
            k += 1
    return left[:k].copy()


@njit(**ENTRY)
def following(before: F8, after: F8, overlap: float) -> I8:
    """(m,) which of the boxes (n, 4) before each of those after (m, 4) follows, −1 for none.

    Each is the one that overlaps the other most, by at least ``overlap`` (IoU).
    """
    m = len(after)
    best = np.full(m, -1)
    most = np.zeros(m)
    other = np.full(len(before), -1)
    other_most = np.zeros(len(before))
    for i in range(len(before)):
        for j in range(m):
            share = overlap_of(before, i, after, j)
            if share >= overlap and share > most[j]:
                best[j] = i
                most[j] = share
            if share >= overlap and share > other_most[i]:
                other[i] = j
                other_most[i] = share
    for j in range(m):
        if best[j] >= 0 and other[best[j]] != j:
            best[j] = -1
    return best


@njit(**ENTRY)
def agreement(
    then: tuple[I8, F8, F8],
    between: tuple[I8, F8],
    now: tuple[I8, F8],
    ratio: float,
    kept: float,
    before: F8,
) -> F8:
    """(2, 4) the sums ``before`` of `smooth.online`, with what the boxes of three frames add, those
    of one target each.

    ``then``: identities (n,), boxes seen and filtered (n, 4). The others: identities and boxes
    seen. ``ratio``: of their intervals; ``kept``: the share of all sums but the last that is
    remembered.
    """
    sums = before.copy()
    sums[:, :3] *= kept
    name, seen, filtered = then
    name_between, seen_between = between
    name_now, seen_now = now
    for i in range(name.size):
        j = k = 0
        while j < name_between.size and name_between[j] != name[i]:
            j += 1
        while k < name_now.size and name_now[k] != name[i]:
            k += 1
        if j == name_between.size or k == name_now.size:
            continue
        for part in range(2):
            # Twice the centre, and the size, along each axis.
            sign = 1.0 - 2 * part
            for axis in range(2):
                side = seen[i, 2 + axis] - seen[i, axis]
                z = seen[i, 2 + axis] + sign * seen[i, axis]
                m = filtered[i, 2 + axis] + sign * filtered[i, axis]
                a = seen_between[j, 2 + axis] + sign * seen_between[j, axis]
                b = seen_now[k, 2 + axis] + sign * seen_now[k, axis]
                step = (m - z) / side
                told = (a - (b - a) * ratio - z) / side
                sums[part, 2] += 1
                if sums[part, 2] < MEMORY:
                    most = sums[part, 2]
                else:
                    most = MEMORY
                sums[part, 3] += (abs(step) - sums[part, 3]) / most
                share = step / (LARGE * sums[part, 3] + TINY_VARIANCE)
                weight = 1 / (1 + share * share)
                sums[part, 0] += weight * step * told
                sums[part, 1] += weight * step * step
    return sums


@njit(**ENTRY)
def between(seen: F8, filtered: F8, centre: float, size: float) -> F8:
    """(n, 4) boxes with these shares of the way from those ``seen`` to those ``filtered``, of
    centres and of sizes.
    """
    out = np.empty(seen.shape)
    for i in range(seen.shape[0]):
        for axis in range(2):
            low = filtered[i, axis] - seen[i, axis]
            high = filtered[i, 2 + axis] - seen[i, 2 + axis]
            middle = centre * (low + high) / 2
            half = size * (high - low) / 2
            out[i, axis] = seen[i, axis] + middle - half
            out[i, 2 + axis] = seen[i, 2 + axis] + middle + half
    return out


@njit(**INNER)
def overlap_of(boxes: F8, i: int, others: F8, j: int) -> float:
    """IoU of box i of (n, 4) and j of ``others`` (m, 4); 0 of such as have no area."""
    left = others[j, 0]
    top = others[j, 1]
    right = others[j, 2]
    bottom = others[j, 3]
    area = (right - left) * (bottom - top)
    # Conditionals and not min and max: they compile faster.
    wide = (boxes[i, 2] if boxes[i, 2] < right else right) - (
        boxes[i, 0] if boxes[i, 0] > left else left
    )
    high = (boxes[i, 3] if boxes[i, 3] < bottom else bottom) - (
        boxes[i, 1] if boxes[i, 1] > top else top
    )
    if not (wide > 0.0 and high > 0.0):
        return 0.0
    union = (boxes[i, 2] - boxes[i, 0]) * (boxes[i, 3] - boxes[i, 1]) + area
    share: float = wide * high / (union - wide * high)
    return share


# The two records come as plain tuples: Numba looks up the class of every named one, which takes as
# long as some kernels.
class BoxDynamics(NamedTuple):
    """Motion of boxes over one interval: variances of position, of position with velocity, of
    velocity and of size along an axis, of a target of size 1 where ``scaled``; ``p_survive`` inside
    the frame of this size (0: no border)."""

    dt: float
    position: float
    mixed: float
    velocity: float
    extent: float
    min_size: float
    scaled: bool
    p_survive: float
    width: float
    height: float


class BoxNoise(NamedTuple):
    """Noise of measured boxes: what its deviations follow, settings of `BoxSensor`, constant
    variances of position and size."""

    scaling: int
    box_noise: float
    min_noise: float
    fixed_position: float
    fixed_size: float


@njit(**ENTRY)
def predicted_boxes(mean: F8, covariance: F8, motion: tuple[Any, ...], factor: F8) -> Predicted:
    """Boxes at constant velocity, (J, 6) and (J, 6, 6), after an interval: F P Fᵀ + Q [M09 (11)].

    ``factor`` (J,) multiplies the variance of each one's acceleration; (0,): none does.
    """
    motion = BoxDynamics(*motion)
    n, d = mean.shape
    out_mean = np.empty((n, d))
    out_cov = np.empty((n, d, d))
    p_survive = np.empty(n)
    dt = motion.dt
    bordered = motion.width > 0.0 and motion.height > 0.0
    axes = d // 3
    for i in range(n):
        for r in range(d):
            out_mean[i, r] = mean[i, r]
            for s in range(d):
                out_cov[i, r, s] = covariance[i, r, s]
        # Rows first, then columns: P → F P → F P Fᵀ. Axes are counted, as the compiler would write
        # loops of two out.
        for a in range(axes):
            out_mean[i, a] += dt * mean[i, a + 2]
            for s in range(d):
                out_cov[i, a, s] += dt * out_cov[i, a + 2, s]
        inside = True
        for a in range(axes):
            for s in range(d):
                out_cov[i, s, a] += dt * out_cov[i, s, a + 2]
            size = mean[i, a + 4]
            if size > motion.min_size:
                unit = size
            else:
                unit = motion.min_size
            unit = unit * unit if motion.scaled else 1.0
            if len(factor) > 0:
                agile = unit * factor[i]
            else:
                agile = unit
            out_cov[i, a, a] += motion.position * agile
            out_cov[i, a, a + 2] += motion.mixed * agile
            out_cov[i, a + 2, a] += motion.mixed * agile
            out_cov[i, a + 2, a + 2] += motion.velocity * agile
            out_cov[i, a + 4, a + 4] += motion.extent * unit
            half = 0.5 * size
            if a == 0:
                end = motion.width
            else:
                end = motion.height
            inside &= -half < mean[i, a] < end + half
        p_survive[i] = motion.p_survive if inside or not bordered else 0.0
    return Predicted(out_mean, out_cov, p_survive)


@njit(**ENTRY)
def moved_boxes(
    x: F8,
    dt: float,
    position: float,
    mixed: float,
    velocity: float,
    extent: float,
    min_size: float,
    scaled: bool,
) -> tuple[F8, F8, F8]:
    """Means (6, n), the Jacobian (6, 6) of all, and noises (6, 6, n) of boxes (6, n) after an
    interval [M09 (11)].
    """
    mean = x.copy()
    jacobian = np.eye(len(x))
    noise = np.zeros((len(x), len(x), x.shape[1]))
    for a in range(2):
        jacobian[a, a + 2] = dt
        for n in range(x.shape[1]):
            mean[a, n] += dt * x[a + 2, n]
            if x[a + 4, n] < min_size:
                size = min_size
            else:
                size = x[a + 4, n]
            unit = size * size if scaled else 1.0
            noise[a, a, n] = position * unit
            noise[a, a + 2, n] = noise[a + 2, a, n] = mixed * unit
            noise[a + 2, a + 2, n] = velocity * unit
            noise[a + 4, a + 4, n] = extent * unit
    return mean, jacobian, noise


@njit(**INNER)
def box_variances(noise: BoxNoise, w: float, h: float) -> tuple[float, float, float, float]:
    """Variances of (px, py, w, h) of a measured box whose noise follows the size ``w``, ``h``."""
    if noise.scaling == FIXED:
        return noise.fixed_position, noise.fixed_position, noise.fixed_size, noise.fixed_size
    sw = noise.box_noise * w
    sh = noise.box_noise * h
    least = noise.min_noise
    sw = sw if sw > least else least
    sh = sh if sh > least else least
    # Without a floor the noise of a vanishing box would be none, and no density.
    vw = sw * sw
    vh = sh * sh
    if vw > TINY_VARIANCE:
        vw = vw
    else:
        vw = TINY_VARIANCE
    if vh > TINY_VARIANCE:
        vh = vh
    else:
        vh = TINY_VARIANCE
    px = 0.25 * vw
    py = 0.25 * vh
    return (
        px if px > TINY_VARIANCE else TINY_VARIANCE,
        py if py > TINY_VARIANCE else TINY_VARIANCE,
        vw,
        vh,
    )


@njit(**ENTRY)
def box_covariances(size: F8, noise: Noise) -> F8:
    """(L, 4, 4) noise covariances of (px, py, w, h) of measured boxes whose noise follows sizes (2,
    L).
    """
    noise = BoxNoise(*noise)
    n = size.shape[1]
    m = len(ROWS)
    out = np.empty((n, m, m))
    for i in range(n):
        for a in range(m):
            for b in range(m):
                out[i, a, b] = 0.0
        out[i, 0, 0], out[i, 1, 1], out[i, 2, 2], out[i, 3, 3] = box_variances(
            noise, size[0, i], size[1, i]
        )
    return out


@njit(**ENTRY)
def states_of_boxes(z: F8, noise: Noise, speed: float) -> tuple[F8, F8]:
    """States at rest (6, N) that boxes ``z`` (m, N) alone show, and their covariances (N, 6, 6).

    ``speed`` is the deviation of each velocity component, in √(wh), or in pixels where the noise is
    constant.
    """
    noise = BoxNoise(*noise)
    n = z.shape[1]
    dim = 6
    x = np.empty((dim, n))
    cov = np.empty((n, dim, dim))
    for j in range(n):
        for a in range(dim):
            x[a, j] = 0.0
            for b in range(dim):
                cov[j, a, b] = 0.0
        here = box_variances(noise, z[2, j], z[3, j])
        if noise.scaling == GIVEN:
            here = z[4, j], z[5, j], z[6, j], z[7, j]
        if noise.scaling == FIXED:
            size = 1.0
        else:
            size = np.sqrt(z[2, j] * z[3, j])
        moving = speed * size
        if moving > LEAST_SPEED:
            moving = moving * moving
        else:
            moving = LEAST_SPEED * LEAST_SPEED
        for a in range(2):
            x[a, j] = z[a, j]
            cov[j, a, a] = here[a]
            cov[j, a + 2, a + 2] = moving
        for c in range(4, dim):
            a = 2 + c % 2
            x[c, j] = z[a, j]
            cov[j, c, c] = here[a]
    return x, cov


@njit(**ENTRY)
def box_deviations(x: F8, noise: Noise, speed: float) -> F8:
    """(d, n) deviations by which boxes ``x`` (d, n) are resolved: measured ones', and ``speed`` as
    of `states_of_boxes`.
    """
    noise = BoxNoise(*noise)
    out = np.empty(x.shape)
    for i in range(x.shape[1]):
        variance = box_variances(noise, x[4, i], x[5, i])
        moving = speed * (1.0 if noise.scaling == FIXED else np.sqrt(x[4, i] * x[5, i]))
        for a in range(2):
            out[a, i] = np.sqrt(variance[a])
            out[a + 2, i] = moving if moving > LEAST_SPEED else LEAST_SPEED
        for c in range(4, x.shape[0]):
            out[c, i] = np.sqrt(variance[2 + c % 2])
    return out


# States carried by a homography: the formulas stand in `models.warp`.
@njit(**ENTRY)
def warped_states(x: F8, warp: F8, areas: float) -> F8:
    """(d, n) states after the homography (3, 3), whose determinant is ``areas``; rows behind the
    velocities are lengths.
    """
    out = np.empty(x.shape)
    for i in range(x.shape[1]):
        px, py, depth, a, b, c, d = _local(warp, x[0, i], x[1, i])
        out[0, i] = px
        out[1, i] = py
        out[2, i] = a * x[2, i] + b * x[3, i]
        out[3, i] = c * x[2, i] + d * x[3, i]
        scale = np.sqrt(areas / (depth * depth * depth))
        for row in range(4, len(x)):
            out[row, i] = scale * x[row, i]
    return out


@njit(**ENTRY)
def warped_slopes(x: F8, warp: F8, areas: float) -> F8:
    """(n, d, d) the Jacobians of `warped_states`."""
    rows, n = x.shape
    out = np.zeros((n, rows, rows))
    g = warp[2, 0]
    h = warp[2, 1]
    for i in range(n):
        _, _, depth, a, b, c, d = _local(warp, x[0, i], x[1, i])
        vx = x[2, i]
        vy = x[3, i]
        for place in range(0, 4, 2):
            out[i, place, place] = a
            out[i, place, place + 1] = b
            out[i, place + 1, place] = c
            out[i, place + 1, place + 1] = d
        # ∂(J v)/∂p = −(J gᵀv + (J v) gᵀ)/D
        along = g * vx + h * vy
        wx = a * vx + b * vy
        wy = c * vx + d * vy
        out[i, 2, 0] = -(a * along + wx * g) / depth
        out[i, 2, 1] = -(b * along + wx * h) / depth
        out[i, 3, 0] = -(c * along + wy * g) / depth
        out[i, 3, 1] = -(d * along + wy * h) / depth
        scale = np.sqrt(areas / (depth * depth * depth))
        for row in range(4, rows):
            out[i, row, row] = scale
            tilt = -1.5 * scale * x[row, i] / depth
            out[i, row, 0] = tilt * g
            out[i, row, 1] = tilt * h
    return out


@njit(**INNER)
def _local(warp: F8, x: float, y: float) -> tuple[float, float, float, float, float, float, float]:
    """The place where the pixel goes, D there, and the Jacobian row by row."""
    depth = max(warp[2, 0] * x + warp[2, 1] * y + 1.0, LEAST)
    px = (warp[0, 0] * x + warp[0, 1] * y + warp[0, 2]) / depth
    py = (warp[1, 0] * x + warp[1, 1] * y + warp[1, 2]) / depth
    a = (warp[0, 0] - px * warp[2, 0]) / depth
    b = (warp[0, 1] - px * warp[2, 1]) / depth
    c = (warp[1, 0] - py * warp[2, 0]) / depth
    d = (warp[1, 1] - py * warp[2, 1]) / depth
    return px, py, depth, a, b, c, d
