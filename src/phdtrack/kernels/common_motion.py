"""The motion that the detections of a frame have in common: shift, zoom and turn about the middle
of the image.

θ = (x, y, zoom, turn) is in pixels; zoom and turn are what they shift at half a width from the
middle. With e_ij the difference of detection j from what target i predicts, of centre and
logarithms of the size, and its linear map B_i,

    p(e_ij|θ) = Student's t (e_ij − B_i θ; S_i)
    target i is missed, or gives one:  1 − p_D + (p_D/λ) Σ_j p(e_ij|θ)

with λ the mean density of detections. The prior of each component of θ is a t-distribution, or
Gaussian, about 0. θ is found by expectation-maximisation: hidden are which detection is whose, and
the precisions that make a t-distribution of Gaussians.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from phdtrack.kernels import F8, I8
from phdtrack.kernels.box import Noise, box_covariances, predicted_boxes
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, MERGED
from phdtrack.kernels.grid import sorted_along, within
from phdtrack.kernels.small_arrays import floats, select

# Degrees of freedom of the errors of boxes, and of a camera's motion.
FREEDOM = 4.0
PRIOR_FREEDOM = 3.0
# Pairs are compared if their centres are within so many deviations, and the logarithms of their
# sizes differ by less.
NEAR = 6.0
SIZES = 1.0
# Makes up for rounding where pairs are only looked for.
ROUNDING = 1.000001
# The same for the logarithms of sizes in the vote on shifts, and its number of cells on each side.
LIKE = 0.4
CELLS = 16
ITERATIONS = 6
CLOSE = 0.02
# Prior deviations of an unknown shift, and of zoom and turn, in halves of the width.
ANY_SHIFT = 0.3
ANY_ZOOM = 0.03
# Least scale of a motion, in halves of the width; smaller motions in pixels are none; the first
# frame counts like so many in learning.
LEAST = 1e-4
NONE = 0.02
FRAMES = 10.0
# Deviations of a jump of shift, and of zoom and turn, in halves of the width; detections that must
# agree on it. There was no jump if more than this share of targets, or of detections if these are
# fewer, is detected without one.
JUMP = 0.1
JUMP_ZOOM = 0.01
AGREE = 3
MATCHED = 0.7
# Factor of the density of a t-distribution in four dimensions.
DENSITY = math.gamma(0.5 * FREEDOM + 2.0) / math.gamma(0.5 * FREEDOM) / (FREEDOM * math.pi) ** 2
Pairs = tuple[I8, F8, F8, F8]
# No target is detected more surely.
MOST_DETECTED = 0.95
# The motion (4,), its evidence, the sums of q (4,) and of their weights (4,), and of `CommonMotion`
# the accuracy of boxes (4,) with the pairs behind it (4,).
Alternative = tuple[F8, float, F8, F8, F8, F8]


@njit(**MERGED)
def differences(mean: F8, covariance: F8, noise: F8, z: F8, scale: F8) -> tuple[F8, F8, F8]:
    """(n, 4) predicted centres and log sizes of targets, and the variances of differences from
    them; (N, 4) centres and log sizes of detections.

    ``mean``, ``covariance``: of boxes (n, d), (n, d, d). ``noise`` (n or 1, 4, 4), ``z`` (N, 4): of
    detections. ``scale`` (4,) multiplies variances.
    """
    n = len(mean)
    rows = (0, 1, 4, 5)
    predicted = np.empty((n, 4))
    variance = np.empty((n, 4))
    measured = z.copy()
    for i in range(n):
        for k in range(4):
            row = rows[k]
            own = covariance[i, row, row] + noise[min(i, len(noise) - 1), k, k]
            size = 1.0
            predicted[i, k] = mean[i, row]
            if k > 1:
                size = max(mean[i, row], 1e-3)
                predicted[i, k] = math.log(size)
            variance[i, k] = max(scale[k] * own / (size * size), 1e-9)
    for j in range(len(z)):
        for k in range(2, 4):
            measured[j, k] = math.log(max(z[j, k], 1e-3))
    return predicted, variance, measured


@njit(**INNER)
def _middle(values: F8) -> float:
    """The median of values (n,), one or more, whose order changes."""
    half = values.size // 2
    middle: float = select(values, half)
    if values.size % 2 == 0:
        below: float = values[0]
        for k in range(half):
            below = max(below, values[k])
        middle = 0.5 * (below + middle)
    return middle


@njit(**INNER)
def _product(matrix: F8, vector: F8) -> F8:
    """(4,) the product of a matrix (4, 4) and a vector (4,)."""
    out = np.empty(4)
    for k in range(4):
        even = matrix[k, 0] * vector[0] + matrix[k, 2] * vector[2]
        out[k] = even + (matrix[k, 1] * vector[1] + matrix[k, 3] * vector[3])
    return out


@njit(**ENTRY)
def voted(predicted: F8, z: F8, half: float) -> tuple[float, float, float, float]:
    """The shift, other than 0, on which most differences of similar boxes agree: x, y, the size of
    cells, and the number of differences.

    ``predicted`` (n, 4) and ``z`` (N, 4): centres and log sizes; ``half``: half of the width of the
    image.
    """
    reach = ANY_SHIFT * half
    width = np.empty(len(predicted))
    for i in range(len(predicted)):
        width[i] = predicted[i, 2]
    cell = max(0.5 * math.exp(_middle(width)), reach / CELLS)
    side = int(reach / cell)
    votes = np.empty((2 * side + 3, 2 * side + 3))
    for c in range(2 * side + 3):
        for d in range(2 * side + 3):
            votes[c, d] = 0.0
    for i in range(len(predicted)):
        for j in range(len(z)):
            x = (z[j, 0] - predicted[i, 0]) / cell
            y = (z[j, 1] - predicted[i, 1]) / cell
            if abs(x) > side or abs(y) > side:
                continue
            if abs(z[j, 2] - predicted[i, 2]) < LIKE and abs(z[j, 3] - predicted[i, 3]) < LIKE:
                votes[round(x) + side + 1, round(y) + side + 1] += 1.0
    best = 0.0
    right = 0
    down = 0
    for a in range(-side, side + 1):
        for b in range(-side, side + 1):
            if abs(a) <= 1 and abs(b) <= 1:
                continue
            around = 0.0
            for c in range(a + side, a + side + 3):
                for d in range(b + side, b + side + 3):
                    around += votes[c, d]
            if around > best:
                best = around
                right = a
                down = b
    return right * cell, down * cell, cell, best


@njit(**ENTRY)
def fitted(
    predicted: F8,
    variance: F8,
    z: F8,
    detected: F8,
    density: float,
    frame: F8,
    scale: F8,
    start: F8,
) -> tuple[F8, F8, F8, float, F8]:
    """The most probable motion near a ``start``: a shift (2), and its deviation.

    ``predicted``, ``variance``, ``z`` from `differences`; ``detected`` (n,): p_D of each target;
    ``density``: λ; ``frame``: middle of the image and half of its width; ``scale`` (4,): squared
    scales of the t-distributions that are the prior of θ, or, if negative, variances of Gaussians.

    Returns, (4,) each, θ, its estimate without the prior and the variances of that; the
    log-probability of the detections; and (2, 4) the sums of squared errors in units of their
    variances, whatever the motion is, and of pairs.
    """
    # The uncertainty of the start counts in the first step alone.
    around = start[2] * start[2]
    pairs = _pairs(predicted, variance, z, frame, start)
    weight = floats(len(pairs[0]), 0.0)
    total = np.empty(len(predicted))
    motion = floats(len(scale), 0.0)
    spread = _magnitudes(scale)
    pull = np.empty(4)
    motion[0] = start[0]
    motion[1] = start[1]
    information = np.empty((4, 4))
    covariance = np.empty((4, 4))
    determinant = 0.0
    for step in range(ITERATIONS):
        _weigh(pairs, motion, around, detected, density, frame[2], weight, total)
        _sum(pairs, weight, around, frame[2], information, pull)
        around = 0.0
        determinant = _invert(information, spread, covariance)
        before = motion
        motion = _product(covariance, pull)
        for k in range(4):
            if scale[k] > 0.0:
                squared = motion[k] * motion[k] + covariance[k, k]
                spread[k] = (PRIOR_FREEDOM * scale[k] + squared) / (PRIOR_FREEDOM + 1.0)
        change = 0.0
        for k in range(4):
            change = max(change, abs(motion[k] - before[k]))
        if step > 1 and change < CLOSE:
            break
    estimate = np.empty(4)
    error = np.empty(4)
    # The log-probability of the detections, by the last weights.
    evidence = _log_product(total) - 0.5 * math.log(determinant)
    for k in range(4):
        error[k] = 1.0 / max(1.0 / covariance[k, k] - 1.0 / spread[k], 1e-12)
        estimate[k] = error[k] * motion[k] / covariance[k, k]
        evidence -= _prior_penalty(motion[k], scale[k])
    squares = _errors(pairs, weight, total, detected, frame[2], information, pull)
    return motion, estimate, error, evidence, squares


@njit(**INNER)
def _magnitudes(numbers: F8) -> F8:
    """The numbers (4,) without their signs."""
    out = np.empty(4)
    for k in range(4):
        out[k] = abs(numbers[k])
    return out


@njit(**INNER)
def _log_product(numbers: F8) -> float:
    """The logarithm of the product of the numbers (n,)."""
    total = 0.0
    for i in range(len(numbers)):
        total += math.log(numbers[i])
    return total


@njit(**INNER)
def _prior_penalty(motion: float, scale: float) -> float:
    """−log of the prior density of a component of θ, by Laplace's method, without the terms that
    both priors share.
    """
    off = motion * motion / abs(scale)
    penalty = 0.5 * off
    if scale > 0.0:
        penalty = 0.5 * (PRIOR_FREEDOM + 1.0) * math.log(1.0 + off / PRIOR_FREEDOM)
    return 0.5 * math.log(abs(scale)) + penalty


@njit(**INNER)
def _vector(x: float, y: float, z: float) -> F8:
    """The three numbers as an array."""
    out = np.empty(3)
    out[0] = x
    out[1] = y
    out[2] = z
    return out


@njit(**INNER)
def _sizes(predicted: F8) -> F8:
    """(n,) sizes of targets, from the logarithms of their widths and heights."""
    out = np.empty(len(predicted))
    for i in range(len(predicted)):
        out[i] = math.exp(0.5 * (predicted[i, 2] + predicted[i, 3]))
    return out


@njit(**MERGED)
def frame_motion(
    boxes: tuple[F8, F8, F8],
    rule: tuple[F8, float, F8, float, float, float, float],
    jumps: bool,
    excess: F8,
    weight: F8,
) -> tuple[F8, float, F8, F8, F8]:
    """The motion (4,), its evidence, the sums of q after the frame, and the squares of `fitted`.

    ``boxes`` from `differences`; ``rule``: p_D of targets (n,), λ, the frame (3,), the interval,
    and settings of `CommonMotion`; ``excess``, ``weight`` (4,): the sums before. With ``jumps`` a
    sudden shift on which many agree is tried, too, if most targets are not at their predictions.
    """
    predicted, variance, z = boxes
    detected, density, frame, dt, jump_penalty, least_share, kept = rule
    least = (LEAST * frame[2] * dt) ** 2
    scale = np.empty(4)
    wide = np.empty(4)
    for k in range(4):
        total = max(weight[k], 1e-300)
        scale[k] = max((excess[k] / total - math.sqrt(2.0 / total)) * dt * dt, least)
        wide[k] = -max(scale[k], (frame[2] * (JUMP if k < 2 else JUMP_ZOOM)) ** 2)
    fit = fitted(predicted, variance, z, detected, density, frame, scale, floats(len(frame), 0.0))
    motion, estimate, errors, evidence, squares = fit
    for k in range(4):
        if not scale[k] > least:
            motion[k] = 0.0
    few = squares[1, 0] < MATCHED * min(len(predicted), len(z))
    if jumps and few and len(predicted) >= AGREE:
        x, y, cell, votes = voted(predicted, z, frame[2])
        if votes >= AGREE:
            at = _vector(x, y, cell)
            jump = fitted(predicted, variance, z, detected, density, frame, wide, at)
            if jump[3] - jump_penalty > evidence:
                motion, estimate, errors, evidence, squares = jump
                evidence -= jump_penalty
    share = (least_share * _middle(_sizes(predicted))) ** 2
    first = True
    for k in range(4):
        first = first and weight[k] == 0.0
    new_excess = np.empty(4)
    new_weight = np.empty(4)
    for k in range(4):
        if not abs(motion[k]) >= NONE:
            motion[k] = 0.0
        error = errors[k] + share
        square = estimate[k] * estimate[k]
        counts = 1.0 / (scale[k] + error) ** 2
        # A t-distribution's scale: the farther out, the less a square counts.
        squared = square * (PRIOR_FREEDOM + 1.0) / (PRIOR_FREEDOM + square / (scale[k] + error))
        new_excess[k] = kept * excess[k] + counts * (squared - error) / (dt * dt)
        new_weight[k] = kept * (FRAMES * counts if first else weight[k]) + counts
    return motion, evidence, new_excess, new_weight, squares


@njit(**MERGED)
def learned_motion(
    boxes: tuple[F8, F8, F8],
    rule: tuple[F8, float, F8, float, float, float, float],
    jumps: bool,
    sums: tuple[F8, F8],
    accuracy: tuple[F8, F8],
    prior: tuple[float, float, float, float],
) -> Alternative:
    """The finding of `frame_motion`, and the accuracy of boxes after the frame: ratios of variances
    (4,), and the pairs behind them (4,).

    ``sums``: ``excess`` and ``weight`` of `frame_motion`; ``accuracy``: the ratios and pairs
    before; ``prior``: how many pairs the prior counts for, how many are remembered, and the limits
    of the ratios.
    """
    motion, evidence, excess, weight, squares = frame_motion(boxes, rule, jumps, sums[0], sums[1])
    scale, pairs = accuracy
    usual, remembered, least, most = prior
    kept = math.exp(-squares[1, 0] / remembered)
    new_scale = np.empty(4)
    new_pairs = np.empty(4)
    for k in range(4):
        before = usual + kept * pairs[k]
        ratio = scale[k] * (before + squares[0, k]) / (before + squares[1, k])
        new_scale[k] = min(max(ratio, least), most)
        new_pairs[k] = kept * pairs[k] + squares[1, k]
    return motion, evidence, excess, weight, new_scale, new_pairs


@njit(**ENTRY)
def motion_of_boxes(
    targets: tuple[F8, F8],
    z: F8,
    dynamics: tuple[Any, ...],
    sensor: tuple[Noise, float],
    rule: tuple[float, F8, float, float, float, float],
    jumps: bool,
    sums: tuple[F8, F8],
    accuracy: tuple[F8, F8],
    prior: tuple[float, float, float, float],
) -> Alternative:
    """`learned_motion` of boxes at constant velocity, whose noise scales with the target or is the
    same for all.

    ``targets``: means (n, 6) and covariances (n, 6, 6) of the frame before, in the pixels of this
    one. ``z`` (4, N): the measurements. ``dynamics``: `kernels.box.BoxDynamics`. ``sensor``: its
    noise, and p_D. ``rule``: that of `frame_motion` without p_D.
    """
    noise, p_detect = sensor
    density, frame, dt, jump_penalty, least_share, remembered = rule
    ahead = predicted_boxes(targets[0], targets[1], dynamics, np.empty(0))
    n = len(ahead.mean)
    size = np.empty((2, n))
    for i in range(n):
        size[0, i] = ahead.mean[i, 4]
        size[1, i] = ahead.mean[i, 5]
    rows = np.empty((z.shape[1], 4))
    for j in range(len(rows)):
        for a in range(4):
            rows[j, a] = z[a, j]
    boxes = differences(
        ahead.mean, ahead.covariance, box_covariances(size, noise), rows, accuracy[0]
    )
    detected = floats(n, min(p_detect, MOST_DETECTED))
    whole = (detected, density, frame, dt, jump_penalty, least_share, remembered)
    found: Alternative = learned_motion(boxes, whole, jumps, sums, accuracy, prior)
    return found


@njit(**INNER)
def _pairs(predicted: F8, variance: F8, z: F8, frame: F8, start: F8) -> Pairs:
    """Possible pairs: target (P,), difference (P, 4), its variances (P, 4), position (P, 2) in
    halves of the width.
    """
    target = np.empty((len(predicted) * len(z), 2), np.int64)
    count = 0 * len(z)
    wide = start[2] * start[2]
    across = np.empty(len(z))
    for j in range(len(z)):
        across[j] = z[j, 0]
    cells = sorted_along(across)
    for i in range(len(predicted)):
        x = predicted[i, 0] + start[0]
        y = predicted[i, 1] + start[1]
        aside = NEAR * NEAR * (variance[i, 0] + wide)
        down = NEAR * NEAR * (variance[i, 1] + wide)
        first = count
        begin, end = within(x, ROUNDING * math.sqrt(aside), cells)
        for k in range(begin, end):
            j = cells[1][k]
            if (z[j, 0] - x) ** 2 > aside or (z[j, 1] - y) ** 2 > down:
                continue
            if abs(z[j, 2] - predicted[i, 2]) < SIZES and abs(z[j, 3] - predicted[i, 3]) < SIZES:
                # In the order of the detections, however far right they are.
                q = count
                while q > first and target[q - 1, 1] > j:
                    target[q, 1] = target[q - 1, 1]
                    q -= 1
                target[count, 0] = i
                target[q, 1] = j
                count += 1
    error = np.empty((count, 4))
    own = np.empty((count, 4))
    place = np.empty((count, 2))
    for p in range(count):
        i = target[p, 0]
        j = target[p, 1]
        for k in range(4):
            error[p, k] = z[j, k] - predicted[i, k]
            own[p, k] = variance[i, k]
        place[p, 0] = (predicted[i, 0] - frame[0]) / frame[2]
        place[p, 1] = (predicted[i, 1] - frame[1]) / frame[2]
    return target[:count, 0].copy(), error, own, place


@njit(**INNER)
def _residual(
    error: F8, place: F8, p: int, motion: F8, half: float
) -> tuple[float, float, float, float]:
    """e − B θ of pair p."""
    u = place[p, 0]
    v = place[p, 1]
    x = error[p, 0] - motion[0] - u * motion[2] + v * motion[3]
    y = error[p, 1] - motion[1] - v * motion[2] - u * motion[3]
    w = error[p, 2] - motion[2] / half
    h = error[p, 3] - motion[2] / half
    return x, y, w, h


@njit(**INNER)
def _weigh(
    pairs: Pairs,
    motion: F8,
    wide: float,
    detected: F8,
    density: float,
    half: float,
    weight: F8,
    total: F8,
) -> None:
    """Write the weight of each pair (P,), and the density of each target's detections into
    ``total``.
    """
    target, error, variance, place = pairs
    precision = np.empty(len(target))
    for i in range(len(total)):
        total[i] = 0.0
    for p in range(len(target)):
        x, y, w, h = _residual(error, place, p, motion, half)
        across = variance[p, 0] + wide
        down = variance[p, 1] + wide
        square = x * x / across + y * y / down + w * w / variance[p, 2] + h * h / variance[p, 3]
        tail = 1.0 + square / FREEDOM
        volume = math.sqrt(across * down * variance[p, 2] * variance[p, 3])
        weight[p] = detected[target[p]] / density * DENSITY / (volume * tail * tail * tail * tail)
        precision[p] = (FREEDOM + 4.0) / (FREEDOM + square)
        total[target[p]] += weight[p]
    for i in range(len(total)):
        total[i] += 1.0 - detected[i]
    for p in range(len(target)):
        weight[p] *= precision[p] / total[target[p]]


@njit(**INNER)
def _sum(pairs: Pairs, weight: F8, wide: float, half: float, information: F8, pull: F8) -> None:
    """Write Σ w Bᵀ S⁻¹ B into ``information`` (4, 4) and Σ w Bᵀ S⁻¹ e into ``pull`` (4,)."""
    _, error, variance, place = pairs
    a = information
    b = pull
    for k in range(4):
        b[k] = 0.0
        for m in range(4):
            a[k, m] = 0.0
    for p in range(len(weight)):
        u = place[p, 0]
        v = place[p, 1]
        x = weight[p] / (variance[p, 0] + wide)
        y = weight[p] / (variance[p, 1] + wide)
        w = weight[p] / (variance[p, 2] * half)
        h = weight[p] / (variance[p, 3] * half)
        a[0, 0] += x
        a[0, 2] += x * u
        a[0, 3] -= x * v
        a[1, 1] += y
        a[1, 2] += y * v
        a[1, 3] += y * u
        a[2, 2] += x * u * u + y * v * v + (w + h) / half
        a[2, 3] += (y - x) * u * v
        a[3, 3] += x * v * v + y * u * u
        b[0] += x * error[p, 0]
        b[1] += y * error[p, 1]
        b[2] += x * u * error[p, 0] + y * v * error[p, 1] + w * error[p, 2] + h * error[p, 3]
        b[3] += y * u * error[p, 1] - x * v * error[p, 0]
    for k in range(4):
        for m in range(k):
            a[k, m] = a[m, k]


@njit(**INNER)
def _invert(information: F8, spread: F8, out: F8) -> float:
    """The determinant of the information with that of a prior of variances ``spread`` (4,); writes
    its inverse into ``out``.
    """
    determinant = 1.0
    for k in range(4):
        for m in range(4):
            out[k, m] = information[k, m]
        out[k, k] += 1.0 / spread[k]
    # Gauss and Jordan, in place: pivots of a positive definite matrix need no order.
    for k in range(4):
        pivot = out[k, k]
        determinant *= pivot
        out[k, k] = 1.0
        for m in range(4):
            out[k, m] /= pivot
        for r in range(4):
            if r != k:
                factor = out[r, k]
                out[r, k] = 0.0
                for m in range(4):
                    out[r, m] -= factor * out[k, m]
    return determinant


@njit(**INNER)
def _errors(
    pairs: Pairs, weight: F8, total: F8, detected: F8, half: float, information: F8, pull: F8
) -> F8:
    """(2, 4) the sums of squared errors in units of their variances, without a prior of the motion,
    and of pairs.
    """
    target, error, variance, place = pairs
    free = np.empty(4)
    c = np.empty((4, 4))
    out = np.empty((2, 4))
    for k in range(4):
        out[0, k] = 0.0
        out[1, k] = 0.0
        free[k] = (ANY_SHIFT * half) ** 2 if k < 2 else (ANY_ZOOM * half) ** 2
    _invert(information, free, c)
    motion = _product(c, pull)
    for p in range(len(target)):
        u = place[p, 0]
        v = place[p, 1]
        x, y, w, h = _residual(error, place, p, motion, half)
        zoom = c[2, 2] / (half * half)
        x = (
            x * x
            + c[0, 0]
            + u * u * c[2, 2]
            + v * v * c[3, 3]
            + 2 * (u * c[0, 2] - v * c[0, 3] - u * v * c[2, 3])
        )
        y = (
            y * y
            + c[1, 1]
            + v * v * c[2, 2]
            + u * u * c[3, 3]
            + 2 * (v * c[1, 2] + u * c[1, 3] + u * v * c[2, 3])
        )
        out[0, 0] += weight[p] * x / variance[p, 0]
        out[0, 1] += weight[p] * y / variance[p, 1]
        out[0, 2] += weight[p] * (w * w + zoom) / variance[p, 2]
        out[0, 3] += weight[p] * (h * h + zoom) / variance[p, 3]
    for i in range(len(total)):
        share = 1.0 - (1.0 - detected[i]) / total[i]
        for k in range(4):
            out[1, k] += share
    return out
