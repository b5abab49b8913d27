"""One frame of the Poisson multi-Bernoulli filter for the box model in one call: predict, update, new targets, merge.

It computes what predict, update and reduce of `filters.pmb` compute, to rounding, and a test holds it to that. In the box
model the two axes and the two sizes do not mix, so that a covariance is two of position and velocity and two variances. What
else stands in one, where a camera that turns has mixed them or the initial one was given so, is left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gm_model import (
    DETECTION,
    FIXED,
    GIVEN,
    LOCAL,
    PLACES,
    BoxNumbers,
    D,
    Scene,
    box_numbers,
    cells,
    crowding,
    noise,
    sorted_boxes,
)
from phdtrack.kernels.pmb_update import Pruning, merged, survivors

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
B1 = NDArray[np.bool_]

NORM = 1.0 / (2.0 * math.pi) ** 2
TINY = float(np.finfo(np.float64).tiny)


class Settings(NamedTuple):
    """Those of `filters.pmb.PMB`; ``lost`` and ``found``: probabilities to get out of view and into it in this interval."""

    least: float
    share: float
    most: float
    merge: float
    gate: float
    sources: float
    firing: float
    lost: float
    found: float


@njit(**INNER)
def _settings(t: F8) -> Settings:
    """From an array, which costs less to hand over than a tuple."""
    return Settings(t[0], t[1], t[2], t[3], t[4], t[5], t[6], t[7], t[8])


@njit(**INNER)
def _moved(x: F8, p: F8, i: int, b: BoxNumbers) -> None:
    """Hypothesis i through f, in place."""
    dt = b.dt
    position, mixed = dt * dt * dt / 3.0 - min(dt, dt * dt * dt) / 12.0, dt * dt / 2.0
    for a in range(2):
        v, s = a + 2, a + 4
        unit = max(x[s, i], b.smallest) if b.scaled > 0.0 else 1.0
        a2, b2 = (b.acceleration * unit) ** 2, (b.resize * unit) ** 2
        x[a, i] += dt * x[v, i]
        p[i, a, a] += dt * (2.0 * p[i, v, a] + dt * p[i, v, v]) + a2 * position
        p[i, v, a] += dt * p[i, v, v] + a2 * mixed
        p[i, a, v] = p[i, v, a]
        p[i, v, v] += a2 * dt
        p[i, s, s] += b2 * dt


@njit(**INNER)
def _predicted(exist: F8, first: I8, weight: F8, x: F8, p: F8, static: B1, hidden: F8, b: BoxNumbers, s: Settings) -> F8:
    """Predict targets in place; the probability (C,) that each hypothesis is detected."""
    seen = np.empty(weight.size)
    bordered = b.frame_width > 0.0 and b.frame_height > 0.0
    for t in range(exist.size):
        stay = 0.0
        for c in range(first[t], first[t + 1]):
            half_w, half_h = 0.5 * x[4, c], 0.5 * x[5, c]
            inside = -half_w < x[0, c] < b.frame_width + half_w and -half_h < x[1, c] < b.frame_height + half_h
            seen[c] = weight[c] * (b.survival if inside or not bordered else 0.0)
            stay += seen[c]
        exist[t] *= stay
        for c in range(first[t], first[t + 1]):
            if stay > 0.0:
                weight[c] = seen[c] / stay
            if static[c]:
                seen[c] = s.firing
                continue
            hidden[c] = hidden[c] * (1.0 - s.found) + (1.0 - hidden[c]) * s.lost
            seen[c] = (1.0 - hidden[c]) * b.p_detect
            _moved(x, p, c, b)
    return seen


@njit(**INNER)
def _longer(point: I8, which: I8, density: F8, used: int, more: int) -> tuple[I8, I8, F8]:
    """The pairs, of which so many are used, copied into arrays that have room for ``more`` and for as many again."""
    a, b, c = np.empty(2 * used + more, np.int64), np.empty(2 * used + more, np.int64), np.empty(2 * used + more)
    for q in range(used):
        a[q], b[q], c[q] = point[q], which[q], density[q]
    return a, b, c


@njit(**INNER)
def _widest(boxes: F8, b: BoxNumbers) -> tuple[float, float]:
    """The largest variances of position that a measurement brings; 0 where they follow the state."""
    vx, vy = 0.0, 0.0
    if b.scaling == DETECTION or b.scaling == GIVEN:
        for j in range(len(boxes)):
            here = noise(b, 0.0, 0.0, boxes, j)
            vx, vy = max(vx, here[0]), max(vy, here[1])
    return vx, vy


@njit(**INNER)
def _paired(x: F8, p: F8, scene: Scene, b: BoxNumbers, gate: float) -> tuple[I8, I8, F8, int]:
    """Pairs (hypothesis, measurement in the scene's order) within the gate, with q(z), and how many there are."""
    boxes, start, nx, count = scene.boxes, scene.start, scene.nx, x.shape[1]
    own = not (b.scaling == DETECTION or b.scaling == GIVEN)
    widest = _widest(boxes, b)
    point, which, density = np.empty(4 * count + 16, np.int64), np.empty(4 * count + 16, np.int64), np.empty(4 * count + 16)
    found, limit = 0 * count, gate * gate
    for i in range(count):
        here = noise(b, x[4, i], x[5, i], boxes, 0)
        vx, vy = (here[0], here[1]) if own else widest
        half_x, half_y = gate * np.sqrt(p[i, 0, 0] + vx), gate * np.sqrt(p[i, 1, 1] + vy)
        left, right, top, bottom = cells(x[0, i], x[1, i], half_x, half_y, scene)
        for line in range(top, bottom + 1):
            low, high = start[line * nx + left], start[line * nx + right + 1]
            if found + high - low > point.size:
                point, which, density = _longer(point, which, density, found, high - low)
            for j in range(low, high):
                if not own:
                    here = noise(b, 0.0, 0.0, boxes, j)
                sx, sy = p[i, 0, 0] + here[0], p[i, 1, 1] + here[1]
                sw, sh = p[i, 4, 4] + here[2], p[i, 5, 5] + here[3]
                dx, dy, dw, dh = boxes[j, 0] - x[0, i], boxes[j, 1] - x[1, i], boxes[j, 2] - x[4, i], boxes[j, 3] - x[5, i]
                distance2 = dx * dx / sx + dy * dy / sy + dw * dw / sw + dh * dh / sh
                if distance2 <= limit:
                    point[found], which[found] = i, j
                    density[found] = NORM * np.exp(-0.5 * distance2) / np.sqrt(sx * sy * sw * sh)
                    found += 1
    return point, which, density, found


@njit(**INNER)
def _taken(x: F8, p: F8, i: int, boxes: F8, j: int, b: BoxNumbers, y: F8, q: F8, k: int) -> None:
    """Hypothesis i after measurement j, in the k-th place of ``y``, ``q``."""
    here = noise(b, x[4, i], x[5, i], boxes, j)
    for a in range(2):
        v, s = a + 2, a + 4
        total = p[i, a, a] + here[a]
        gain, push, step = p[i, a, a] / total, p[i, v, a] / total, boxes[j, a] - x[a, i]
        y[a, k], y[v, k] = x[a, i] + gain * step, x[v, i] + push * step
        q[k, a, a], q[k, v, a] = p[i, a, a] * here[a] / total, p[i, v, a] * here[a] / total
        q[k, a, v], q[k, v, v] = q[k, v, a], p[i, v, v] - push * p[i, v, a]
        total = p[i, s, s] + here[a + 2]
        gain = p[i, s, s] / total
        y[s, k], q[k, s, s] = x[s, i] + gain * (boxes[j, a + 2] - x[s, i]), p[i, s, s] * here[a + 2] / total


@njit(**INNER)
def _first(boxes: F8, j: int, b: BoxNumbers, y: F8, q: F8, k: int) -> None:
    """What measurement j tells alone, in the k-th place of ``y``, ``q``."""
    here = noise(b, boxes[j, 2], boxes[j, 3], boxes, j)
    size = np.sqrt(boxes[j, 2] * boxes[j, 3])
    speed = max(b.deviation_fixed if b.scaling == FIXED else b.deviation_scaled * size, 1e-6)
    for a in range(2):
        y[a, k], y[a + 2, k], y[a + 4, k] = boxes[j, a], 0.0, boxes[j, a + 2]
        q[k, a, a], q[k, a + 2, a + 2], q[k, a + 4, a + 4] = here[a], speed * speed, here[a + 2]


@njit(**INNER)
def _densities(scene: Scene, b: BoxNumbers, given: F8) -> tuple[F8, F8]:
    """κ and γ̂ = p_D γ at the measurements, in the scene's order; ``given`` (N,) κ in theirs, or (0,)."""
    n = len(scene.boxes)
    kappa, born = np.empty(n), np.empty(n)
    crowded = crowding(scene, b) if b.birth == LOCAL or b.clutter == LOCAL else kappa
    for j in range(n):
        dense = 1.0
        for a in range(4):
            if not b.low[a] <= scene.boxes[j, a] <= b.high[a]:
                dense = 0.0
        born[j] = dense * b.p_detect * b.born * (crowded[j] if b.birth == LOCAL else 1.0)
        if b.clutter == PLACES:
            kappa[j] = given[scene.order[j]]
        else:
            kappa[j] = b.false * (crowded[j] if b.clutter == LOCAL else 1.0)
    return kappa, born


@njit(**INNER)
def _hypotheses(
    source: I8, taken: I8, x: F8, p: F8, seen: F8, static: B1, hidden: F8, boxes: F8, b: BoxNumbers,
    y: F8, q: F8, still: B1, out: F8,
) -> None:  # fmt: skip
    """The hypotheses that survive, into the first places of ``y``, ``q``, ``still`` and ``out`` (hidden)."""
    for k in range(source.size):
        i = source[k]
        still[k], out[k] = static[i], 0.0
        if taken[k] >= 0:
            _taken(x, p, i, boxes, taken[k], b, y, q, k)
            continue
        for r in range(D):
            y[r, k], q[k, r, r] = x[r, i], p[i, r, r]
        for a in range(2):
            q[k, a, a + 2], q[k, a + 2, a] = p[i, a, a + 2], p[i, a + 2, a]
        if not static[i]:
            out[k] = min(hidden[i] / max(1.0 - seen[i], TINY), 1.0)


@njit(**ENTRY)
def pmb_box_step(
    exist: F8, first: I8, weight: F8, mean: F8, cov: F8, static: B1, hidden: F8, z: F8, given: F8, model: F8,
    settings: F8,
) -> tuple[I8, F8, I8, F8, F8, F8, B1, F8, I8, I8, F8, float, float]:  # fmt: skip
    """Predict, update, start new targets, prune and merge.

    Parameters
    ----------
    exist, first, weight, mean, cov, static, hidden : see `bernoullis.Layer`.
    z : (m, N) measurements.
    given : (N,) κ at the measurements where the model says that it is given, else (0,).
    model, settings : the values of `BoxNumbers`, without births that are given, and of `Settings`.

    Returns
    -------
    which target each was, −1: new, in the order of the measurements; then ``exist``, ``first``, ``weight``, ``mean``,
    ``cov``, ``static``, ``hidden``, ``detection``, ``parent``; table (2, N) of C(z) and κ(z) as `UpdateInfo` has them;
    the masses predicted, without births, and born.
    """
    b, s = box_numbers(model), _settings(settings)
    n = z.shape[1]
    exist, weight, x, p, hidden = exist.copy(), weight.copy(), mean.copy(), cov.copy(), hidden.copy()
    seen = _predicted(exist, first, weight, x, p, static, hidden, b, s)
    before = 0.0
    for t in range(exist.size):
        for c in range(first[t], first[t + 1]):
            if not static[c]:
                before += exist[t] * weight[c]
    if n > 0:
        scene = sorted_boxes(z)
        kappa, born = _densities(scene, b, given)
        point, which, density, pairs = _paired(x, p, scene, b, s.gate)
    else:
        scene = Scene(np.empty((0, 4)), first[:0], first[:0], 0.0, 0.0, 0.0, 0.0, n, n)
        kappa, born = np.empty(0), np.empty(0)
        point, which, density, pairs = first[:0], first[:0], weight[:0], 0 * n
    alone = np.empty(n)
    for j in range(n):
        alone[j] = max(kappa[j] + born[j], TINY)
    kept = survivors(exist, first, weight, seen, point, which, density, pairs, alone, Pruning(s.least, s.share, s.most))
    old, many, kinds = kept.target.size, kept.source.size, 2 if s.sources > 0.0 else 1
    room, targets = many + kinds * n, old + n
    y, q = np.empty((D, room)), np.zeros((room, D, D))
    still, out = np.empty(room, np.bool_), np.empty(room)
    _hypotheses(kept.source, kept.which, x, p, seen, static, hidden, scene.boxes, b, y, q, still, out)
    target, there, begin = np.empty(targets, np.int64), np.empty(targets), np.empty(targets + 1, np.int64)
    share, taken, parent = np.empty(room), np.empty(room, np.int64), np.empty(room, np.int64)
    for t in range(old):
        target[t], there[t], begin[t] = kept.target[t], kept.exist[t], kept.first[t]
    begin[old] = many
    for k in range(many):
        share[k], parent[k] = kept.weight[k], kept.source[k]
        taken[k] = scene.order[kept.which[k]] if kept.which[k] >= 0 else -1
    table, appeared, k, t = np.empty((2, n)), 0.0, many, old
    place = np.empty(n, np.int64)
    for j in range(n):
        place[scene.order[j]] = j
        table[0, j], table[1, j] = 0.0, 0.0
    # In the order of the measurements and not of the scene: labels follow it.
    for number in range(n):
        j = place[number]
        new = born[j] / alone[j]
        appeared += kept.own[j] * new * (1.0 - s.sources)
        table[1, number] = kept.own[j] * (kappa[j] / alone[j] + new * s.sources)
        table[0, number] = kappa[j] + born[j]
        if kept.own[j] * new < s.least:
            continue
        target[t], there[t] = -1, kept.own[j] * new
        for kind in range(kinds):
            _first(scene.boxes, j, b, y, q, k)
            still[k], out[k], taken[k], parent[k] = kind == 1, 0.0, number, -1
            share[k] = s.sources if kind == 1 else 1.0 - s.sources
            k += 1
        t += 1
        begin[t] = k
    t_of = 0 * n
    for e in range(pairs):
        while point[e] >= first[t_of + 1]:
            t_of += 1
        number = scene.order[which[e]]
        table[0, number] += exist[t_of] * weight[point[e]] * seen[point[e]] * density[e]
        if static[point[e]]:
            table[1, number] += kept.told[e]
    for number in range(n):
        total, false = table[0, number], table[1, number]
        table[0, number], table[1, number] = (1.0 - false) * total, false * total
    final, chosen, heavier = merged(begin[: t + 1], share[:k], y, q, still, s.merge * s.merge)
    m = chosen.size
    ym, qm = np.empty((D, m)), np.empty((m, D, D))
    kind_m, hidden_m, taken_m, parent_m = np.empty(m, np.bool_), np.empty(m), np.empty(m, np.int64), np.empty(m, np.int64)
    for i in range(m):
        c = chosen[i]
        kind_m[i], hidden_m[i], taken_m[i], parent_m[i] = still[c], out[c], taken[c], parent[c]
        for r in range(D):
            ym[r, i] = y[r, c]
            for e in range(D):
                qm[i, r, e] = q[c, r, e]
    return (
        target[:t].copy(), there[:t].copy(), final, heavier, ym, qm, kind_m, hidden_m, taken_m, parent_m, table, before,
        appeared,
    )  # fmt: skip
