"""One frame of the GM-PHD filter for the box model in one call: predict, births, update, prune.

It computes what predict and update of `filters.gm_phd` compute, to rounding, and a test holds it to that. It is faster
because nothing that the pruning would drop is ever made, because a Gaussian that meets several measurements is factored
once, and because there is no Python between the steps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.gm_model import (
    DETECTION,
    ENTRIES,
    GIVEN,
    LOCAL,
    NOWHERE,
    ROWS,
    BoxNumbers,
    D,
    M,
    Scene,
    cells,
    crowding,
    entry,
    newborn,
    noise,
    predicted,
    sorted_boxes,
)

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

NORM = 1.0 / (2.0 * math.pi) ** 2
# The reciprocal of anything smaller may overflow.
SMALLEST = float(np.finfo(np.float64).tiny)


Numbers = tuple[float, ...]


class Limits(NamedTuple):
    """Settings of the filter that the step needs: see `filters.gm_phd.GMPHD`."""

    gate: float
    region: float
    prune: float
    skip_empty: float


@njit(cache=True)
def _innovation(x: F8, p: F8, box: F8, b: BoxNumbers, s: F8, w: F8) -> float:
    """Root L of H P Hᵀ + R in ``s`` (its diagonal inverted), W = L⁻¹ H P in ``w``; 1/√det."""
    variance = noise(b, x[4], x[5], box)
    scale = 1.0
    for a in range(M):
        for c in range(a + 1):
            value = p[entry(ROWS[a], ROWS[c])]
            if a == c:
                value += variance[a]
            for t in range(c):
                value -= s[a, t] * s[c, t]
            if a == c:
                s[a, a] = 1.0 / np.sqrt(value) if value > 0.0 else np.nan
                scale *= s[a, a]
            else:
                s[a, c] = value * s[c, c]
        for r in range(D):
            value = p[entry(max(ROWS[a], r), min(ROWS[a], r))]
            for t in range(a):
                value -= s[a, t] * w[t, r]
            w[a, r] = value * s[a, a]
    return scale


@njit(cache=True)
def _widest(boxes: F8, b: BoxNumbers) -> tuple[float, float]:
    """The largest variances of position that a measurement brings; 0 where they follow the state."""
    vx, vy = 0.0, 0.0
    if b.scaling == DETECTION or b.scaling == GIVEN:
        for j in range(len(boxes)):
            here = noise(b, 0.0, 0.0, boxes[j])
            vx, vy = max(vx, here[0]), max(vy, here[1])
    return vx, vy


@njit(cache=True)
def _rectangles(x: F8, p: F8, first: int, last: int, scene: Scene, b: BoxNumbers, gate: float) -> tuple[I8, F8, int, int]:
    """For the Gaussians ``first`` to ``last``: the cells of their gates (n, 4), half widths (n, 2); how many pairs, at
    most, and Gaussians with any."""
    n = last - first
    touched, half = np.empty((n, 4), np.int64), np.empty((n, 2))
    boxes, start, nx = scene.boxes, scene.start, scene.nx
    vx, vy = _widest(boxes, b)
    own = not (b.scaling == DETECTION or b.scaling == GIVEN)
    pairs, meeting = 0, 0
    for k in range(n):
        i = first + k
        if own:
            here = noise(b, x[i, 4], x[i, 5], boxes[0])
            vx, vy = here[0], here[1]
        half[k, 0], half[k, 1] = gate * np.sqrt(p[i, entry(0, 0)] + vx), gate * np.sqrt(p[i, entry(1, 1)] + vy)
        left, right, top, bottom = cells(x[i, 0], x[i, 1], half[k, 0], half[k, 1], scene)
        touched[k, 0], touched[k, 1], touched[k, 2], touched[k, 3] = left, right, top, bottom
        count = 0
        for line in range(top, bottom + 1):
            count += start[line * nx + right + 1] - start[line * nx + left]
        pairs += count
        meeting += count > 0
    return touched, half, pairs, meeting


@njit(cache=True)
def paired(x: F8, p: F8, first: int, last: int, scene: Scene, b: BoxNumbers, gate: float) -> tuple[I8, F8, F8]:
    """The pairs (Gaussian, measurement) within the gate, d² ≤ gate², of the Gaussians ``first`` to ``last``.

    Returns (P, 3) Gaussian, measurement, place of W; (P, 6) d², density N(z; Hm, S), y; (Q, M, D) the W's.
    """
    touched, half, most, meeting = _rectangles(x, p, first, last, scene, b, gate)
    boxes, start, nx = scene.boxes, scene.start, scene.nx
    own = not (b.scaling == DETECTION or b.scaling == GIVEN)
    index, value = np.empty((most, 3), np.int64), np.empty((most, 2 + M))
    roots = np.empty(((meeting if own else most) + 1, M, D))
    s, found, slot, scale = np.empty((M, M)), 0, -1, 0.0
    limit = gate * gate
    for k in range(last - first):
        i = first + k
        made = False
        for line in range(touched[k, 2], touched[k, 3] + 1):
            for j in range(start[line * nx + touched[k, 0]], start[line * nx + touched[k, 1] + 1]):
                if abs(boxes[j, 0] - x[i, 0]) > half[k, 0] or abs(boxes[j, 1] - x[i, 1]) > half[k, 1]:
                    continue
                if not (made and own):
                    slot += 1
                    scale = _innovation(x[i], p[i], boxes[j], b, s, roots[slot])
                    made = True
                distance2 = 0.0
                for a in range(M):
                    y = boxes[j, a] - x[i, ROWS[a]]
                    for t in range(a):
                        y -= s[a, t] * value[found, 2 + t]
                    y *= s[a, a]
                    value[found, 2 + a] = y
                    distance2 += y * y
                if distance2 <= limit:
                    index[found, 0], index[found, 1], index[found, 2] = i, j, slot
                    value[found, 0], value[found, 1] = distance2, NORM * scale * np.exp(-0.5 * distance2)
                    found += 1
                elif not own:
                    slot -= 1
    return index[:found], value[:found], roots


@njit(cache=True)
def _posterior(x: F8, p: F8, y: F8, w: F8, mean: F8, cov: F8) -> None:
    """m + Wᵀ y and P − Wᵀ W into ``mean`` and ``cov``."""
    for r in range(D):
        value = x[r]
        for a in range(M):
            value += w[a, r] * y[a]
        mean[r] = value
        for c in range(r + 1):
            value = p[entry(r, c)]
            for a in range(M):
                value -= w[a, r] * w[a, c]
            cov[entry(r, c)] = value


@njit(cache=True)
def _with_room(w: F8, x: F8, p: F8, used: int, more: int) -> tuple[F8, F8, F8]:
    """The same arrays, copied into longer ones where they have no room for ``more``."""
    if used + more <= w.size:
        return w, x, p
    size = used + more
    wider, longer, larger = np.empty(size), np.empty((size, D)), np.empty((size, ENTRIES))
    for i in range(used):
        wider[i] = w[i]
        for r in range(D):
            longer[i, r] = x[i, r]
        for e in range(ENTRIES):
            larger[i, e] = p[i, e]
    return wider, longer, larger


@njit(cache=True)
def _given(weight: F8, mean: F8, cov: F8, w: F8, x: F8, p: F8, used: int) -> int:
    """Put a mixture, (B,), (d, B), (B, 21) triangles, behind the first ``used`` Gaussians; how many there are then."""
    for k in range(weight.size):
        w[used] = weight[k]
        for r in range(D):
            x[used, r] = mean[r, k]
        for e in range(ENTRIES):
            p[used, e] = cov[k, e]
        used += 1
    return used


@njit(cache=True)
def _covered(index: I8, value: F8, w: F8, n: int, region: float) -> F8:
    """(n,) M(z): the mass of the Gaussians within ``region`` of each measurement."""
    out = np.zeros(n)
    for q in range(len(index)):
        if value[q, 0] <= region:
            out[index[q, 1]] += w[index[q, 0]]
    return out


@njit(cache=True)
def _birth_density(scene: Scene, b: BoxNumbers, crowded: F8) -> F8:
    """(N,) γ at each measurement, for the interval; 0 where a size is not positive."""
    out = np.empty(crowded.size)
    for j in range(crowded.size):
        possible = scene.boxes[j, 2] > 0.0 and scene.boxes[j, 3] > 0.0
        density = b.born * crowded[j] if b.birth == LOCAL else b.born
        out[j] = density if possible else 0.0
    return out


@njit(cache=True)
def _shares(index: I8, value: F8, w: F8, p_detect: float, evidence: F8) -> F8:
    """(P,) p_D w q(z) of each pair, added to ``evidence`` (N,), C(z)."""
    seen = np.empty(len(index))
    for q in range(len(index)):
        seen[q] = p_detect * w[index[q, 0]] * value[q, 1]
        evidence[index[q, 1]] += seen[q]
    return seen


@njit(cache=True)
def _posteriors(
    index: I8, value: F8, roots: F8, seen: F8, explained: F8, prune: float, w: F8, x: F8, p: F8, used: int
) -> tuple[F8, F8, F8, int]:
    """Append the posteriors of the pairs that are no lighter than ``prune``; the arrays, and how many are in use."""
    count = 0
    for q in range(len(index)):
        if seen[q] * explained[index[q, 1]] >= prune:
            count += 1
    w, x, p = _with_room(w, x, p, used, count)
    for q in range(len(index)):
        share = seen[q] * explained[index[q, 1]]
        if share >= prune:
            i = index[q, 0]
            w[used] = share
            _posterior(x[i], p[i], value[q, 2:], roots[index[q, 2]], x[used], p[used])
            used += 1
    return w, x, p, used


@njit(cache=True)
def _sum(w: F8, first: int, last: int) -> float:
    """The sum of ``w`` from ``first`` to before ``last``."""
    total = 0.0
    for i in range(first, last):
        total += w[i]
    return total


@njit(cache=True)
def box_step(
    weight: F8, mean: F8, cov: F8, z: F8, born_weight: F8, born_mean: F8, born_cov: F8, model: Numbers, settings: Numbers
) -> tuple[F8, F8, F8, F8, F8, float, float, float, int]:
    """Predict, births and update: the Gaussians that pruning would leave.

    Parameters
    ----------
    weight, mean, cov : (J,), (d, J), (J, d, d) the mixture before the frame.
    z : (m, N) measurements.
    born_weight, born_mean, born_cov : a mixture of births that is given, (B,), (d, B), (B, 21) triangles.
    model, settings : the values of `BoxNumbers` and of `Limits`, as plain tuples.

    Returns
    -------
    weight, x, cov : (K,), (K, d), (K, 21) triangles; evidence, clutter : (N,); the masses predicted (with births), born,
    and after the update (before anything is dropped); the number of measurements with κ + C = 0.

    Raises
    ------
    ValueError : the position of a measurement is NaN or infinite.
    """
    b, limits = BoxNumbers(*model), Limits(*settings)
    n, given = z.shape[1], born_weight.size
    # A literal zero is a type of its own, for which the functions below would be compiled once more.
    none = 0 * n
    room = 2 * weight.size + 3 * n + given + 8
    w, x, p = np.empty(room), np.empty((room, D)), np.empty((room, ENTRIES))
    old = predicted(weight, mean, cov, b, w, x, p)
    evidence, kappa, vanished = np.zeros(n), np.zeros(n), none
    used = _given(born_weight, born_mean, born_cov, w, x, p, old)
    missed = 1.0 - b.p_detect
    if n == 0:
        before, born = _sum(w, none, used), _sum(w, old, used)
        if limits.skip_empty > 0.0:
            missed = 1.0
        for i in range(used):
            w[i] *= missed
        return w[:used], x[:used], p[:used], evidence, kappa, before, born, missed * before, vanished
    scene = sorted_boxes(z)
    crowded = crowding(scene, b) if b.birth == LOCAL or b.clutter == LOCAL else np.zeros(n)
    index, value, roots = paired(x, p, none, old, scene, b, limits.gate)
    if b.birth != NOWHERE:
        covered = _covered(index, value, w, n, limits.region)
        used = newborn(scene, b, _birth_density(scene, b, crowded), covered, w, x, p, used)
    born_index, born_value, born_roots = paired(x, p, old, used, scene, b, limits.gate)
    total = np.zeros(n)
    seen = _shares(index, value, w, b.p_detect, total)
    born_seen = _shares(born_index, born_value, w, b.p_detect, total)
    explained = np.zeros(n)
    before, born = _sum(w, none, used), _sum(w, old, used)
    after = missed * before
    for j in range(n):
        clutter = b.false * crowded[j] if b.clutter == LOCAL else b.false
        evidence[scene.order[j]], kappa[scene.order[j]] = total[j], clutter
        if clutter + total[j] >= SMALLEST:
            explained[j] = 1.0 / (clutter + total[j])
        else:
            vanished += 1
        after += total[j] * explained[j]
    priors = used
    w, x, p, used = _posteriors(index, value, roots, seen, explained, limits.prune, w, x, p, used)
    w, x, p, used = _posteriors(born_index, born_value, born_roots, born_seen, explained, limits.prune, w, x, p, used)
    for i in range(priors):
        w[i] *= missed
    return w[:used], x[:used], p[:used], evidence, kappa, before, born, after, vanished
