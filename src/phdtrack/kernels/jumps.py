"""Targets whose velocity is not what was expected: new ones that are fast, and those that turn at
once.

The velocity of a target is a mixture: with a small probability it is new, of any direction and
much wider than usual. That hypothesis is written out only where it can matter: for a target that
none of the measurements is near, with a measurement in reach that is near no target.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, Bool, Records
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import INNER
from phdtrack.kernels.gaussian import Expected, copy_gaussian
from phdtrack.kernels.small_arrays import flags, floats

# Squared deviations within which a measurement is near a target: 99 % of four components.
NEAR = 13.3
# Deviations of the new velocity within which a measurement is in reach.
REACH = 3.0
# A velocity is unknown if its variance is at least this share of that of a new target.
UNKNOWN = 0.5


class Jumps(NamedTuple):
    """How velocities may be new.

    ``interval`` in time units; ``fast``: the probability that a new target is fast; ``turn``: that
    the velocity of another is new after the interval; ``speed`` (C, 2): deviations of a usual
    unknown velocity; ``wide``: how many times as large those of a new one are.
    """

    interval: float
    fast: float
    turn: float
    speed: F8
    wide: float


@njit(**INNER)
def jumping(
    targets: Records,
    mean: F8,
    covariance: F8,
    pairs: Records,
    e: Expected,
    z: F8,
    jumps: Jumps,
    least: float,
) -> tuple[Bool, bool]:
    """(T,) which targets none of the measurements ``z`` (N, r) is near, and one that is near no
    target in reach of a new velocity; and whether there is one. Targets that have one with less
    than the ``least`` probability are left out.
    """
    near = flags(len(targets), False)
    explained = flags(len(z), False)
    t = 0 * len(z)
    for q in range(pairs.size):
        while pairs[q].gaussian >= targets[t].end:
            t += 1
        if pairs[q].distance2 < NEAR:
            near[t] = True
            explained[pairs[q].measurement] = True
    out = flags(len(targets), False)
    some = False
    left = np.empty(2)
    right = np.empty(2)
    for t in range(len(targets)):
        c = targets[t].best
        if near[t] or c < 0 or targets[t].r * _share(covariance, c, c, jumps) < least:
            continue
        for axis in range(2):
            left[axis], right[axis] = _reach(mean, covariance, c, axis, e, jumps)
        for j in range(len(z)):
            across = left[0] < z[j, 0] < right[0]
            if not explained[j] and across and left[1] < z[j, 1] < right[1]:
                out[t] = True
                some = True
                break
    return out, some


@njit(**INNER)
def _reach(
    mean: F8, covariance: F8, c: int, axis: int, e: Expected, jumps: Jumps
) -> tuple[float, float]:
    """The lowest and the highest position along an axis that hypothesis c reaches with a new
    velocity.
    """
    row = e.rows[axis]
    middle = mean[c, row] - jumps.interval * mean[c, row + 2]
    wide = jumps.wide * jumps.interval * jumps.speed[c, axis]
    reach = REACH * np.sqrt(covariance[c, row, row] + wide * wide)
    return middle - reach, middle + reach


@njit(**INNER)
def with_jumps(
    before: tuple[Records, Records, F8, F8], jump: Bool, e: Expected, jumps: Jumps
) -> tuple[Records, Records, F8, F8, Expected]:
    """The targets, hypotheses, means and covariances with one hypothesis more for each target that
    may ``jump`` (T,), and the measurements that they predict [PMB (15)]. The sensor is linear.
    """
    targets, hypotheses, mean, covariance = before
    count = len(hypotheses)
    for t in range(len(targets)):
        count += jump[t]
    d = mean.shape[1]
    out = targets.copy()
    more = np.empty(count, hypotheses.dtype)
    more_mean = np.empty((count, d))
    more_cov = np.empty((count, d, d))
    noise = np.empty((count if len(e.noise) else 0, e.noise.shape[1], e.noise.shape[2]))
    p_detect = np.empty(count)
    k = 0 * count
    for t in range(len(targets)):
        target = targets[t]
        begin = k
        for c in range(target.begin, target.end + jump[t]):
            own = c if c < target.end else target.best
            more[k] = hypotheses[own]
            copy_gaussian(mean, covariance, own, more_mean, more_cov, k)
            p_detect[k] = e.p_detect[own]
            for a in range(noise.shape[1] if len(noise) else 0):
                for b in range(noise.shape[2]):
                    noise[k, a, b] = e.noise[own, a, b]
            k += 1
        out[t].begin = begin
        out[t].end = k
        if target.best >= 0:
            out[t].best = begin + target.best - target.begin
        if jump[t]:
            _write_jump(more, more_mean, more_cov, (out[t].best, k - 1), target.best, jumps)
    expected = Expected(e.rows, more_mean, more_cov, more_cov, noise, p_detect)
    return out, more, more_mean, more_cov, expected


@njit(**INNER)
def of_jumped(targets: Records, jump: Bool, value: F8) -> F8:
    """(C,) the ``value`` (C,) of hypotheses that have a new velocity, after `with_jumps`; 0 of
    others.
    """
    out: F8 = floats(len(value), 0.0)
    for t in range(len(targets)):
        if jump[t]:
            c = targets[t].end - 1
            out[c] = value[c]
    return out


@njit(**INNER)
def merged_pairs(pairs: Records, more: Records, targets: Records, jump: Bool) -> Records:
    """The ``pairs`` of the hypotheses before `with_jumps`, and ``more`` of those that it added, in
    the order of the hypotheses after it.
    """
    out = np.empty(len(pairs) + len(more), pairs.dtype)
    count = 0 * len(pairs)
    q = 0 * len(pairs)
    r = 0 * len(pairs)
    added = 0 * len(pairs)
    for t in range(len(targets)):
        end = targets[t].end - jump[t]
        while q < len(pairs) and pairs[q].gaussian + added < end:
            out[count] = pairs[q]
            out[count].gaussian = pairs[q].gaussian + added
            count += 1
            q += 1
        added += jump[t]
        while r < len(more) and more[r].gaussian < targets[t].end:
            out[count] = more[r]
            count += 1
            r += 1
    return out


@njit(**INNER)
def _share(covariance: F8, c: int, old: int, jumps: Jumps) -> float:
    """The probability that the velocity of hypothesis c is new; ``old``: its place in
    ``jumps.speed``.
    """
    if covariance[c, 2, 2] > UNKNOWN * jumps.speed[old, 0] ** 2:
        return jumps.fast
    return jumps.turn


@njit(**INNER)
def _write_jump(
    hypotheses: Records, mean: F8, cov: F8, places: tuple[int, int], old: int, jumps: Jumps
) -> None:
    """Give the hypothesis at the second of the ``places``, a copy of that at the first, a new
    velocity, and its part of the weight. ``old``: the place of both in ``jumps.speed``.
    """
    c, k = places
    share = _share(cov, c, old, jumps)
    hypotheses[k].weight = share * hypotheses[c].weight
    hypotheses[k].occluded = 0.0
    hypotheses[c].weight -= hypotheses[k].weight
    dt = jumps.interval
    for a in range(2):
        variance = (jumps.wide * jumps.speed[old, a]) ** 2
        mean[k, a] -= dt * mean[k, a + 2]
        mean[k, a + 2] = 0.0
        for b in range(mean.shape[1]):
            cov[k, a + 2, b] = 0.0
            cov[k, b, a + 2] = 0.0
            if b != a:
                cov[k, a, b] = 0.0
                cov[k, b, a] = 0.0
        cov[k, a, a] += variance * dt * dt
        cov[k, a, a + 2] = variance * dt
        cov[k, a + 2, a] = variance * dt
        cov[k, a + 2, a + 2] = variance
