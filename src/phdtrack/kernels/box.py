"""Boxes in the image, for motion, sensor and clutter: predictions, noises, overlaps, neighbours.

The formulas stand in `models.box`. States are (px, py, vx, vy, w, h).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, MERGED
from phdtrack.kernels.gaussian import Predicted, copy_gaussian
from phdtrack.kernels.grid import sorted_along, within
from phdtrack.kernels.small_arrays import floats, minus_ones

Noise = tuple[int, float, float, float, float]
# Rows of the state that a measurement shows.
OBSERVED = (0, 1, 4, 5)
PARTICLE, DETECTION, FIXED, GIVEN = range(4)
TINY_VARIANCE = 1e-12
LEAST_SPEED = 1e-6
# Steps of boxes that are this many times their mean count half in `agreement`; the mean is over the
# last so many steps.
LARGE = 3.0
MEMORY = 200.0
# If D is less, a point is about to pass the horizon of the map: it goes this far, out of any image,
# and no farther.
LEAST = 0.05


@njit(**ENTRY)
def plausible_boxes(
    boxes: F8, width: float, height: float, sides: tuple[float, float]
) -> tuple[I8, int]:
    """(k,) the boxes (n, 4) of plausible size and place, and how many others have a width or
    height that is not above 0.

    ``sides``: the least side in pixels, and the longest in frames of ``width`` and ``height``,
    which is also how far outside a frame a centre may be.
    """
    least, most = sides
    frame = (width, height)
    rows = np.empty(len(boxes), np.int64)
    k = 0 * len(boxes)
    empty = 0 * len(boxes)
    for j in range(len(boxes)):
        sized = True
        near = True
        for a in range(2):
            side = boxes[j, 2 + a] - boxes[j, a]
            away = abs(boxes[j, a] / 2 + boxes[j, 2 + a] / 2 - frame[a] / 2)
            sized = sized and side > 0.0
            near = near and least <= side <= most * frame[a] and away <= (most + 0.5) * frame[a]
        empty += not sized
        if near:
            rows[k] = j
            k += 1
    return rows[:k].copy(), empty


@njit(**ENTRY)
def first_not_finite(boxes: F8, score: F8) -> int:
    """The first of the boxes (n, 4) with a number that is not finite, or whose score is not; −1 if
    there is none.
    """
    for j in range(len(boxes)):
        total = score[j]
        for a in range(4):
            # Finite numbers times 0 are 0.
            total = total * 0.0 + boxes[j, a] * 0.0
        if total != 0.0:
            return j
    return -1


@njit(**ENTRY)
def outermost(boxes: F8) -> tuple[float, float, float, float, float]:
    """The largest left, top, right and bottom of boxes (n, 4), and the smallest right or bottom."""
    most = np.empty(4)
    for a in range(4):
        most[a] = -np.inf
    least = np.inf
    for j in range(len(boxes)):
        for a in range(4):
            most[a] = max(most[a], boxes[j, a])
        least = min(least, boxes[j, 2], boxes[j, 3])
    return most[0], most[1], most[2], most[3], least


@njit(**ENTRY)
def centres_and_sizes(boxes: F8) -> F8:
    """(4, n) centre x, centre y, width and height of boxes (n, 4): `arrays.to_cxcywh`, compiled.

    That one costs 4 µs more, but needs no Numba, as files and scores do not.
    """
    out = np.empty((4, len(boxes)))
    for j in range(len(boxes)):
        for a in range(2):
            out[a, j] = (boxes[j, a] + boxes[j, 2 + a]) / 2
            out[2 + a, j] = boxes[j, 2 + a] - boxes[j, a]
    return out


@njit(**ENTRY)
def apart(boxes: F8, order: I8, overlap: float) -> I8:
    """(k,) the boxes (n, 4) that are kept if each one is dropped that overlaps a kept one before it
    by more than ``overlap`` (IoU).

    ``order`` (n,): their numbers by left sides, ascending. A box is compared only with those that
    begin left of its end and reach beyond its beginning.
    """
    n = order.size
    place = np.empty(n, np.int64)
    reach = np.empty(n)
    left = np.empty(n, np.int64)
    farthest = -np.inf
    k = 0 * n
    for p in range(n):
        farthest = max(farthest, boxes[order[p], 2])
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
    """(m,) the box ``before`` (n, 4) that each of the boxes ``after`` (m, 4) continues, −1 for
    none.

    Each of the two is the one that overlaps the other most, by at least ``overlap`` (IoU).
    """
    m = len(after)
    best: I8 = minus_ones(m)
    most = floats(m, 0.0)
    other = minus_ones(len(before))
    middle = np.empty(m)
    widest = 0.0
    for j in range(m):
        middle[j] = after[j, 0] + after[j, 2]
        widest = max(widest, after[j, 2] - after[j, 0])
    cells = sorted_along(middle)
    for i in range(len(before)):
        other_most = 0.0
        # Twice the distance of two centres that share an area is less than both widths.
        reach = before[i, 2] - before[i, 0] + widest
        begin, end = within(before[i, 0] + before[i, 2], reach, cells)
        for k in range(begin, end):
            j = cells[1][k]
            share = overlap_of(before, i, after, j)
            if not (share >= overlap and share > 0.0):
                continue
            if share > most[j]:
                best[j] = i
                most[j] = share
            # Of equal ones the first, in whichever order they come.
            if share > other_most or (share == other_most and j < other[i]):
                other[i] = j
                other_most = share
    for j in range(m):
        if best[j] >= 0 and other[best[j]] != j:
            best[j] = -1
    return best


@njit(**INNER)
def _index(names: I8, name: int, first: int) -> int:
    """The index of a name that is there once, −1 if it is not there; looked for from ``first``
    on.
    """
    for k in range(max(first, 0), names.size):
        if names[k] == name:
            return k
    for k in range(min(first, names.size)):
        if names[k] == name:
            return k
    return -1


@njit(**MERGED)
def agreement(
    then: tuple[I8, F8, F8],
    between: tuple[I8, F8],
    now: tuple[I8, F8],
    ratio: float,
    kept: float,
    before: F8,
) -> F8:
    """(2, 4) the sums of `smooth.online` after three frames, from those ``before``.

    ``then``: identities (n,), detected and filtered boxes (n, 4) of the first frame. ``between``,
    ``now``: identities and detected boxes of the others. ``ratio``: of the two intervals; ``kept``:
    the share of all sums but the last that is remembered.
    """
    sums = before.copy()
    for part in range(2):
        for column in range(3):
            sums[part, column] *= kept
    name, detected, filtered = then
    name_between, detected_between = between
    name_now, detected_now = now
    j = k = 0 * name.size
    for i in range(name.size):
        # Names mostly come in the same order in all frames.
        j = _index(name_between, name[i], j)
        k = _index(name_now, name[i], k)
        if j < 0 or k < 0:
            continue
        for part in range(2):
            # Twice the centre, and the size, along each axis.
            sign = 1.0 - 2 * part
            for axis in range(2):
                side = detected[i, 2 + axis] - detected[i, axis]
                z = detected[i, 2 + axis] + sign * detected[i, axis]
                m = filtered[i, 2 + axis] + sign * filtered[i, axis]
                a = detected_between[j, 2 + axis] + sign * detected_between[j, axis]
                b = detected_now[k, 2 + axis] + sign * detected_now[k, axis]
                step = (m - z) / side
                # Where the next two frames put it, by a straight line through them.
                later = (a - (b - a) * ratio - z) / side
                sums[part, 2] += 1
                sums[part, 3] += (abs(step) - sums[part, 3]) / min(MEMORY, sums[part, 2])
                share = step / (LARGE * sums[part, 3] + TINY_VARIANCE)
                weight = 1 / (1 + share * share)
                sums[part, 0] += weight * step * later
                sums[part, 1] += weight * step * step
    return sums


@njit(**MERGED)
def between(detected: F8, filtered: F8, centre: float, size: float) -> F8:
    """(n, 4) boxes between those ``detected`` and those ``filtered``: centres and sizes go these
    shares of the way.
    """
    out = np.empty(detected.shape)
    for i in range(detected.shape[0]):
        for axis in range(2):
            low = filtered[i, axis] - detected[i, axis]
            high = filtered[i, 2 + axis] - detected[i, 2 + axis]
            middle = centre * (low + high) / 2
            half = size * (high - low) / 2
            out[i, axis] = detected[i, axis] + middle - half
            out[i, 2 + axis] = detected[i, 2 + axis] + middle + half
    return out


@njit(**ENTRY)
def share_of(sums: F8, part: int, prior: tuple[float, float, float]) -> float:
    """a of `smooth.online` of centres (part 0) or sizes (1), by its sums."""
    usual, weight, most = prior
    slope = sums[part, 0] / max(sums[part, 1], 1e-12)
    share: float = (sums[part, 2] * slope + weight * usual) / (sums[part, 2] + weight)
    return min(max(share, 0.0), most)


@njit(**ENTRY)
def shown_between(
    rows: tuple[I8, I8, I8, F8],
    frame: tuple[int, I8, F8],
    first: tuple[I8, F8, F8],
    second: tuple[I8, F8],
    ratio: float,
    remembered: float,
    sums: F8,
    prior: tuple[float, float, float],
) -> tuple[F8, I8, F8, F8]:
    """The sums of `smooth.online` after a frame, and of its rows that rest on detections the
    identity (n,) and the boxes detected and filtered (n, 4). The boxes of these rows are moved
    between the two.

    Parameters
    ----------
    rows : frame, identity, detection (M,) and boxes (M, 4), which are overwritten, of tracks.
    frame : its number, and `Detections.row` (N,) and boxes (N, 4) of its detections.
    first, second : the rows of the two frames before, as of `agreement`.
    ratio : as of `agreement`.
    remembered : sides of boxes that are remembered.
    prior : share before anything is seen, what it counts for, and the largest share.
    """
    number, row, boxes = frame
    at = np.empty(len(rows[0]), np.int64)
    n = 0 * len(row)
    for r in range(len(rows[0])):
        if rows[0][r] == number and rows[2][r] >= 0:
            at[n] = r
            n += 1
    identity = np.empty(n, np.int64)
    seen = np.empty((n, 4))
    filtered = np.empty((n, 4))
    for k in range(n):
        identity[k] = rows[1][at[k]]
        j = _index(row, rows[2][at[k]], rows[2][at[k]] if rows[2][at[k]] < len(row) else 0)
        for a in range(4):
            seen[k, a] = boxes[j, a]
            filtered[k, a] = rows[3][at[k], a]
    if n == 0:
        return sums, identity, seen, filtered
    if len(first[0]) > 0:
        kept = max(1.0 - 2.0 * n / remembered, 0.0)
        sums = agreement(first, second, (identity, seen), ratio, kept, sums)
    centre = 0 * n
    moved = between(
        seen, filtered, share_of(sums, centre, prior), share_of(sums, centre + 1, prior)
    )
    for k in range(n):
        for a in range(4):
            rows[3][at[k], a] = moved[k, a]
    return sums, identity, seen, filtered


@njit(**INNER)
def overlap_of(boxes: F8, i: int, others: F8, j: int) -> float:
    """IoU of box i of (n, 4) and box j of ``others`` (m, 4); 0 if they share no area."""
    left = others[j, 0]
    top = others[j, 1]
    right = others[j, 2]
    bottom = others[j, 3]
    area = (right - left) * (bottom - top)
    wide = min(right, boxes[i, 2]) - max(left, boxes[i, 0])
    high = min(bottom, boxes[i, 3]) - max(top, boxes[i, 1])
    if not (wide > 0.0 and high > 0.0):
        return 0.0
    union = (boxes[i, 2] - boxes[i, 0]) * (boxes[i, 3] - boxes[i, 1]) + area
    share: float = wide * high / (union - wide * high)
    return share


# Callers pass the two records as plain tuples: Numba looks up the class of every named one, which
# takes as long as some kernels.
class BoxDynamics(NamedTuple):
    """Motion of boxes over one interval: variances of position, of position with velocity, of
    velocity and of size along an axis, for a target of size 1 if ``scaled``; ``p_survive`` inside
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
    """Noise of measured boxes: the size that it scales with, settings of `BoxSensor`, constant
    variances of position and size."""

    scaling: int
    box_noise: float
    min_noise: float
    fixed_position: float
    fixed_size: float


@njit(**INNER)
def _unit_variance(size: float, min_size: float, scaled: bool) -> float:
    """The variance of a noise of one unit: the square of the size, or 1 if not ``scaled``."""
    if not scaled:
        return 1.0
    unit = max(min_size, size)
    return unit * unit


@njit(**INNER)
def _in_frame(mean: F8, i: int, width: float, height: float) -> bool:
    """True if a part of box i is inside the frame."""
    wide = 0.5 * mean[i, 4]
    high = 0.5 * mean[i, 5]
    across: bool = -wide < mean[i, 0] < width + wide
    along: bool = -high < mean[i, 1] < height + high
    return across and along


@njit(**MERGED)
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
    # Counted, because the compiler would write loops of two out.
    axes = d // 3
    for i in range(n):
        copy_gaussian(mean, covariance, i, out_mean, out_cov, i)
        # Rows first, then columns: P → F P → F P Fᵀ.
        for a in range(axes):
            out_mean[i, a] += dt * mean[i, a + 2]
            for s in range(d):
                out_cov[i, a, s] += dt * out_cov[i, a + 2, s]
        for a in range(axes):
            for s in range(d):
                out_cov[i, s, a] += dt * out_cov[i, s, a + 2]
            unit = _unit_variance(mean[i, a + 4], motion.min_size, motion.scaled)
            agile = unit
            if len(factor) > 0:
                agile = unit * factor[i]
            out_cov[i, a, a] += motion.position * agile
            out_cov[i, a, a + 2] += motion.mixed * agile
            out_cov[i, a + 2, a] += motion.mixed * agile
            out_cov[i, a + 2, a + 2] += motion.velocity * agile
            out_cov[i, a + 4, a + 4] += motion.extent * unit
        p_survive[i] = motion.p_survive
        if bordered and not _in_frame(mean, i, motion.width, motion.height):
            p_survive[i] = 0.0
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
    """Means (6, n), the common Jacobian (6, 6), and noises (6, 6, n) of boxes (6, n) after an
    interval [M09 (11)].
    """
    mean = x.copy()
    jacobian = np.empty((len(x), len(x)))
    noise = np.empty((len(x), len(x), x.shape[1]))
    for a in range(len(x)):
        for b in range(len(x)):
            jacobian[a, b] = 1.0 if a == b else 0.0
            for n in range(x.shape[1]):
                noise[a, b, n] = 0.0
    for a in range(2):
        jacobian[a, a + 2] = dt
        for n in range(x.shape[1]):
            mean[a, n] += dt * x[a + 2, n]
            unit = _unit_variance(x[a + 4, n], min_size, scaled)
            noise[a, a, n] = position * unit
            noise[a, a + 2, n] = noise[a + 2, a, n] = mixed * unit
            noise[a + 2, a + 2, n] = velocity * unit
            noise[a + 4, a + 4, n] = extent * unit
    return mean, jacobian, noise


@njit(**INNER)
def box_variances(noise: BoxNoise, w: float, h: float) -> tuple[float, float, float, float]:
    """Variances of (px, py, w, h) of a measured box whose noise scales with ``w``, ``h``."""
    if noise.scaling == FIXED:
        return noise.fixed_position, noise.fixed_position, noise.fixed_size, noise.fixed_size
    sw = noise.box_noise * w
    sh = noise.box_noise * h
    sw = max(noise.min_noise, sw)
    sh = max(noise.min_noise, sh)
    # Without a floor a vanishing box would have no noise, and so no density.
    vw = max(TINY_VARIANCE, sw * sw)
    vh = max(TINY_VARIANCE, sh * sh)
    return max(TINY_VARIANCE, 0.25 * vw), max(TINY_VARIANCE, 0.25 * vh), vw, vh


@njit(**INNER)
def _speed_deviation(noise: BoxNoise, speed: float, w: float, h: float) -> float:
    """Deviation of each component of an unknown velocity: ``speed`` in √(wh), or in pixels if the
    noise is constant.
    """
    if noise.scaling != FIXED:
        speed *= np.sqrt(w * h)
    return max(LEAST_SPEED, speed)


@njit(**ENTRY)
def box_covariances(size: F8, noise: Noise) -> F8:
    """(L, 4, 4) noise covariances of (px, py, w, h) of measured boxes whose noise scales with sizes
    (2, L).
    """
    noise = BoxNoise(*noise)
    n = size.shape[1]
    m = len(OBSERVED)
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
    """States at rest (6, N) that boxes ``z`` (m, N) alone imply, and their covariances (N, 6, 6).

    ``speed``: deviation of each velocity component, in √(wh), or in pixels if the noise is
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
        variance = box_variances(noise, z[2, j], z[3, j])
        if noise.scaling == GIVEN:
            variance = z[4, j], z[5, j], z[6, j], z[7, j]
        moving = _speed_deviation(noise, speed, z[2, j], z[3, j])
        for a in range(2):
            x[a, j] = z[a, j]
            cov[j, a, a] = variance[a]
            cov[j, a + 2, a + 2] = moving * moving
        for c in range(4, dim):
            a = 2 + c % 2
            x[c, j] = z[a, j]
            cov[j, c, c] = variance[a]
    return x, cov


@njit(**MERGED)
def local_densities(z: F8, rate: float, factor: float) -> F8:
    """(N,) the density at boxes ``z`` (m, N) of which ``rate`` are expected in the neighbourhood of
    each, whose volume is ``factor`` w²h² (`models.volumes`).
    """
    out = np.empty(z.shape[1])
    for j in range(z.shape[1]):
        area = z[2, j] * z[3, j]
        out[j] = rate / (factor * (area * area))
    return out


@njit(**ENTRY)
def box_deviations(x: F8, noise: Noise, speed: float) -> F8:
    """(d, n) deviations by which the sensor resolves boxes ``x`` (d, n): of a measured box, and
    ``speed`` as in `states_of_boxes`.
    """
    noise = BoxNoise(*noise)
    out = np.empty(x.shape)
    for i in range(x.shape[1]):
        variance = box_variances(noise, x[4, i], x[5, i])
        moving = _speed_deviation(noise, speed, x[4, i], x[5, i])
        for a in range(2):
            out[a, i] = np.sqrt(variance[a])
            out[a + 2, i] = moving
        for c in range(4, x.shape[0]):
            out[c, i] = np.sqrt(variance[2 + c % 2])
    return out


# States warped by a homography: the formulas stand in `models.warp`.
@njit(**ENTRY)
def warped_states(x: F8, warp: F8) -> F8:
    """(d, n) states after the homography (3, 3); rows behind the velocities are lengths."""
    areas = _determinant(warp)
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
def warped_slopes(x: F8, warp: F8) -> F8:
    """(n, d, d) the Jacobians of `warped_states`."""
    rows, n = x.shape
    areas = _determinant(warp)
    out = np.empty((n, rows, rows))
    for i in range(n):
        for a in range(rows):
            for b in range(rows):
                out[i, a, b] = 0.0
    g = warp[2, 0]
    h = warp[2, 1]
    for i in range(n):
        _, _, depth, a, b, c, d = _local(warp, x[0, i], x[1, i])
        vx = x[2, i]
        vy = x[3, i]
        for row in range(0, 4, 2):
            out[i, row, row] = a
            out[i, row, row + 1] = b
            out[i, row + 1, row] = c
            out[i, row + 1, row + 1] = d
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
def _determinant(m: F8) -> float:
    """The determinant of a matrix (3, 3)."""
    first = m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
    second = m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
    third = m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
    determinant: float = first - second + third
    return determinant


@njit(**INNER)
def _local(warp: F8, x: float, y: float) -> tuple[float, float, float, float, float, float, float]:
    """The position of the warped pixel, D there, and the Jacobian row by row."""
    depth = max(warp[2, 0] * x + warp[2, 1] * y + 1.0, LEAST)
    px = (warp[0, 0] * x + warp[0, 1] * y + warp[0, 2]) / depth
    py = (warp[1, 0] * x + warp[1, 1] * y + warp[1, 2]) / depth
    a = (warp[0, 0] - px * warp[2, 0]) / depth
    b = (warp[0, 1] - px * warp[2, 1]) / depth
    c = (warp[1, 0] - py * warp[2, 0]) / depth
    d = (warp[1, 1] - py * warp[2, 1]) / depth
    return px, py, depth, a, b, c, d
