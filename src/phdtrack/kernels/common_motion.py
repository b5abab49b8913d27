"""The motion that the detections of a frame have in common: shift, zoom and turn about the middle
of the image.

θ = (x, y, zoom, turn) is in pixels; zoom and turn are what they shift at half a width from the
middle. With e_ij the difference of detection j from what target i predicts, of centre and
logarithms of the size, and its linear map B_i,

    p(e_ij|θ) = Student's t (e_ij − B_i θ; S_i),    target i is missed, or gives one:  1 − p_D +
    (p_D/λ) Σ_j p(e_ij|θ)

with λ the mean density of detections. The prior of each component of θ is a t-distribution, or
Gaussian, about 0. θ is found by expectation-maximisation: hidden are which detection is whose, and
the precisions that make a t-distribution of Gaussians.
"""

from __future__ import annotations

import math

import numpy as np

from phdtrack.kernels import F8, I8
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

# Degrees of freedom of the errors of boxes, and of a camera's motion.
FREEDOM = 4.0
PRIOR_FREEDOM = 3.0
# Pairs that are compared: centres within so many deviations, sizes within so large a difference of
# logarithms.
NEAR = 6.0
SIZES = 1.0
# The same for shifts that are voted on, and how many cells the vote has on each side.
LIKE = 0.4
CELLS = 16
ITERATIONS = 6
CLOSE = 0.02
# Deviations of shift, and of zoom and turn, of which nothing is known, in halves of the width.
ANY_SHIFT = 0.3
ANY_ZOOM = 0.03
# Least scale of a motion, in halves of the width; pixels that are none; frames that the beginning
# counts for in learning.
LEAST = 1e-4
NONE = 0.02
FRAMES = 10.0
# Deviations of a jump of shift, and of zoom and turn, in halves of the width; detections that must
# agree on it; the share of targets, or of detections where they are fewer, that are found without
# one: where it is more there was none.
JUMP = 0.1
JUMP_ZOOM = 0.01
AGREE = 3
MATCHED = 0.7
# Of the density of a t-distribution in four dimensions.
DENSITY = math.gamma(0.5 * FREEDOM + 2.0) / math.gamma(0.5 * FREEDOM) / (FREEDOM * math.pi) ** 2
Pairs = tuple[I8, F8, F8, F8]


@njit(**ENTRY)
def differences(mean: F8, covariance: F8, noise: F8, z: F8, scale: F8) -> tuple[F8, F8, F8]:
    """(n, 4) centres and log sizes that targets predict, the variances of differences from them,
    (N, 4) those of detections.

    ``mean``, ``covariance``: of boxes (n, d), (n, d, d). ``noise`` (n or 1, 4, 4), ``z`` (N, 4): of
    detections. ``scale`` (4,) multiplies variances.
    """
    n = len(mean)
    rows = (0, 1, 4, 5)
    expected = np.empty((n, 4))
    variance = np.empty((n, 4))
    found = z.copy()
    for i in range(n):
        for k in range(4):
            row = rows[k]
            own = covariance[i, row, row] + noise[min(i, len(noise) - 1), k, k]
            if k > 1:
                size = max(mean[i, row], 1e-3)
            else:
                size = 1.0
            expected[i, k] = math.log(size) if k > 1 else mean[i, row]
            variance[i, k] = max(scale[k] * own / (size * size), 1e-9)
    for j in range(len(z)):
        for k in range(2, 4):
            found[j, k] = math.log(max(z[j, k], 1e-3))
    return expected, variance, found


@njit(**ENTRY)
def voted(expected: F8, z: F8, half: float) -> tuple[float, float, float, float]:
    """The shift that most differences of like boxes have, away from none: x, y, the cells' size,
    differences in them.

    ``expected`` (n, 4) and ``z`` (N, 4): centres and log sizes; ``half``: half of the width of the
    image.
    """
    reach = ANY_SHIFT * half
    cell = max(0.5 * math.exp(np.median(expected[:, 2])), reach / CELLS)
    side = int(reach / cell)
    votes = np.zeros((2 * side + 3, 2 * side + 3))
    for i in range(len(expected)):
        for j in range(len(z)):
            x = (z[j, 0] - expected[i, 0]) / cell
            y = (z[j, 1] - expected[i, 1]) / cell
            if abs(x) > side or abs(y) > side:
                continue
            if abs(z[j, 2] - expected[i, 2]) < LIKE and abs(z[j, 3] - expected[i, 3]) < LIKE:
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
    expected: F8, variance: F8, z: F8, detected: F8, density: float, frame: F8, scale: F8, start: F8
) -> tuple[F8, F8, F8, float, F8]:
    """The most probable motion near a ``start``: a shift, and how far off it may be.

    ``expected``, ``variance``, ``z`` as `differences` gives them; ``detected`` (n,): p_D of each
    target; ``density``: λ; ``frame``: middle of the image and half of its width; ``scale`` (4,):
    squared scales of the t-distributions that are the prior of θ, below 0 variances of Gaussians.

    Back come, (4,) each, θ and what the detections say of each component without its prior, with
    variances; the log of the probability of the detections; and (2, 4) the sums of squared errors
    in their variances, whatever the motion is, and of pairs.
    """
    wide = start[2] * start[2]
    pairs = _pairs(expected, variance, z, frame, start)
    weight = np.zeros(len(pairs[0]))
    total = np.empty(len(expected))
    motion = np.zeros(4)
    spread = np.abs(scale)
    pull = np.empty(4)
    motion[:2] = start[:2]
    information = np.empty((4, 4))
    covariance = np.empty((4, 4))
    evidence = determinant = 0.0
    for step in range(ITERATIONS):
        evidence = _weigh(
            pairs, motion, wide if step == 0 else 0.0, detected, density, frame[2], weight, total
        )
        _sum(pairs, weight, wide if step == 0 else 0.0, frame[2], information, pull)
        determinant = _invert(information, spread, covariance)
        before = motion
        motion = covariance @ pull
        for k in range(4):
            if scale[k] > 0.0:
                squared = motion[k] * motion[k] + covariance[k, k]
                spread[k] = (PRIOR_FREEDOM * scale[k] + squared) / (PRIOR_FREEDOM + 1.0)
        if step > 1 and np.abs(motion - before).max() < CLOSE:
            break
    seen = np.empty(4)
    known = np.empty(4)
    evidence -= 0.5 * math.log(determinant)
    for k in range(4):
        known[k] = 1.0 / max(1.0 / covariance[k, k] - 1.0 / spread[k], 1e-12)
        seen[k] = known[k] * motion[k] / covariance[k, k]
        # By Laplace's method, of which all is left out that both priors have.
        off = motion[k] * motion[k] / abs(scale[k])
        heavy = 0.5 * (PRIOR_FREEDOM + 1.0) * math.log(1.0 + off / PRIOR_FREEDOM)
        evidence -= 0.5 * math.log(abs(scale[k])) + (heavy if scale[k] > 0.0 else 0.5 * off)
    squares = _errors(pairs, weight, total, detected, frame[2], information, pull)
    return motion, seen, known, evidence, squares


@njit(**ENTRY)
def found(
    boxes: tuple[F8, F8, F8],
    rule: tuple[F8, float, F8, float, float, float, float],
    jumps: bool,
    excess: F8,
    weight: F8,
) -> tuple[F8, float, F8, F8, F8]:
    """The motion (4,), its evidence, the sums of q with what the frame says of it, and the squares
    of `fitted`.

    ``boxes``: as `differences` gives them; ``rule``: p_D of targets (n,), λ, the frame (3,), the
    interval, and settings of `CommonMotion`; ``excess``, ``weight`` (4,): the sums before. With
    ``jumps`` a sudden shift that many agree on is tried, too, where most targets are not where they
    should be.
    """
    expected, variance, z = boxes
    detected, density, frame, dt, jump_penalty, least_share, kept = rule
    least = (LEAST * frame[2] * dt) ** 2
    scale = np.empty(4)
    wide = np.empty(4)
    for k in range(4):
        known = max(weight[k], 1e-300)
        scale[k] = max((excess[k] / known - math.sqrt(2.0 / known)) * dt * dt, least)
        wide[k] = -max(scale[k], (frame[2] * (JUMP if k < 2 else JUMP_ZOOM)) ** 2)
    motion, seen, errors, evidence, squares = fitted(
        expected, variance, z, detected, density, frame, scale, np.zeros(3)
    )
    for k in range(4):
        motion[k] = motion[k] if scale[k] > least else 0.0
    if jumps and len(expected) >= AGREE and squares[1, 0] < MATCHED * min(len(expected), len(z)):
        x, y, cell, votes = voted(expected, z, frame[2])
        if votes >= AGREE:
            at = np.array([x, y, cell])
            other, shown, known_to, sure, all_squares = fitted(
                expected, variance, z, detected, density, frame, wide, at
            )
            if sure - jump_penalty > evidence:
                motion = other
                seen = shown
                errors = known_to
                evidence = sure - jump_penalty
                squares = all_squares
    share = (least_share * np.median(np.exp(0.5 * (expected[:, 2] + expected[:, 3])))) ** 2
    first = not weight.any()
    new_excess = np.empty(4)
    new_weight = np.empty(4)
    for k in range(4):
        motion[k] = motion[k] if abs(motion[k]) >= NONE else 0.0
        error = errors[k] + share
        square = seen[k] * seen[k]
        counts = 1.0 / (scale[k] + error) ** 2
        # A t-distribution's scale: the farther out, the less a square counts.
        squared = square * (PRIOR_FREEDOM + 1.0) / (PRIOR_FREEDOM + square / (scale[k] + error))
        new_excess[k] = kept * excess[k] + counts * (squared - error) / (dt * dt)
        new_weight[k] = kept * (FRAMES * counts if first else weight[k]) + counts
    return motion, evidence, new_excess, new_weight, squares


@njit(**INNER)
def _pairs(expected: F8, variance: F8, z: F8, frame: F8, start: F8) -> Pairs:
    """Pairs that may be one: target (P,), difference (P, 4), its variances (P, 4), place (P, 2) in
    halves of the width.
    """
    target = np.empty((len(expected) * len(z), 2), np.int64)
    count = 0
    wide = start[2] * start[2]
    for i in range(len(expected)):
        x = expected[i, 0] + start[0]
        y = expected[i, 1] + start[1]
        across = NEAR * NEAR * (variance[i, 0] + wide)
        down = NEAR * NEAR * (variance[i, 1] + wide)
        for j in range(len(z)):
            if (z[j, 0] - x) ** 2 > across or (z[j, 1] - y) ** 2 > down:
                continue
            if abs(z[j, 2] - expected[i, 2]) < SIZES and abs(z[j, 3] - expected[i, 3]) < SIZES:
                target[count, 0] = i
                target[count, 1] = j
                count += 1
    error = np.empty((count, 4))
    own = np.empty((count, 4))
    place = np.empty((count, 2))
    for p in range(count):
        i = target[p, 0]
        j = target[p, 1]
        for k in range(4):
            error[p, k] = z[j, k] - expected[i, k]
            own[p, k] = variance[i, k]
        place[p, 0] = (expected[i, 0] - frame[0]) / frame[2]
        place[p, 1] = (expected[i, 1] - frame[1]) / frame[2]
    return target[:count, 0].copy(), error, own, place


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
) -> float:
    """The log-probability of the detections; writes what each pair counts to ``weight`` (P,), and
    sums by target.
    """
    target, error, variance, place = pairs
    precision = np.empty(len(target))
    total[:] = 0.0
    for p in range(len(target)):
        u = place[p, 0]
        v = place[p, 1]
        x = error[p, 0] - motion[0] - u * motion[2] + v * motion[3]
        y = error[p, 1] - motion[1] - v * motion[2] - u * motion[3]
        w = error[p, 2] - motion[2] / half
        h = error[p, 3] - motion[2] / half
        across = variance[p, 0] + wide
        down = variance[p, 1] + wide
        square = x * x / across + y * y / down + w * w / variance[p, 2] + h * h / variance[p, 3]
        tail = 1.0 + square / FREEDOM
        volume = math.sqrt(across * down * variance[p, 2] * variance[p, 3])
        weight[p] = detected[target[p]] / density * DENSITY / (volume * tail * tail * tail * tail)
        precision[p] = (FREEDOM + 4.0) / (FREEDOM + square)
        total[target[p]] += weight[p]
    evidence = 0.0
    for i in range(len(total)):
        total[i] += 1.0 - detected[i]
        evidence += math.log(total[i])
    for p in range(len(target)):
        weight[p] *= precision[p] / total[target[p]]
    return evidence


@njit(**INNER)
def _sum(pairs: Pairs, weight: F8, wide: float, half: float, information: F8, pull: F8) -> None:
    """Writes Σ w Bᵀ S⁻¹ B to ``information`` (4, 4) and Σ w Bᵀ S⁻¹ e to ``pull`` (4,)."""
    _, error, variance, place = pairs
    a = np.zeros((4, 4))
    b = np.zeros(4)
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
        pull[k] = b[k]
        for m in range(4):
            information[k, m] = a[min(k, m), max(k, m)]


@njit(**INNER)
def _invert(information: F8, spread: F8, out: F8) -> float:
    """The determinant of the information with that of a prior of variances ``spread`` (4,); its
    inverse goes to ``out``.
    """
    determinant = 1.0
    out[:] = information
    for k in range(4):
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
    """(2, 4) the sums of squared errors in variances, where nothing was known of the motion before,
    and of pairs.
    """
    target, error, variance, place = pairs
    free = np.empty(4)
    c = np.empty((4, 4))
    out = np.zeros((2, 4))
    free[:2] = (ANY_SHIFT * half) ** 2
    free[2:] = (ANY_ZOOM * half) ** 2
    _invert(information, free, c)
    motion = c @ pull
    for p in range(len(target)):
        u = place[p, 0]
        v = place[p, 1]
        x = error[p, 0] - motion[0] - u * motion[2] + v * motion[3]
        y = error[p, 1] - motion[1] - v * motion[2] - u * motion[3]
        w = error[p, 2] - motion[2] / half
        h = error[p, 3] - motion[2] / half
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
        out[1] += 1.0 - (1.0 - detected[i]) / total[i]
    return out
