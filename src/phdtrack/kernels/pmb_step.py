"""One frame of the Poisson multi-Bernoulli filter for the box model in one call: predict, update, new targets, merge.

It computes what predict, update and reduce of `filters.pmb` compute, to rounding, and a test holds it to that; but see
`kernels.pmb_rows` for what is left out of covariances.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gm_model import LOCAL, PLACES, BoxNumbers, D, M, Scene, box_numbers, crowding, sorted_boxes
from phdtrack.kernels.pmb_rows import ROW, gaussians, in_rows, left_alone, moved, paired, taken, told_alone
from phdtrack.kernels.pmb_update import BELIEVED, Pruning, Survivors, best_of, merged, survivors

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
B1 = NDArray[np.bool_]

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
    depth: float
    lost: float
    found: float


@njit(**INNER)
def _settings(t: F8) -> Settings:
    """From an array, which costs less to hand over than a tuple."""
    return Settings(t[0], t[1], t[2], t[3], t[4], t[5], t[6], t[7], t[8], t[9])


class Hypotheses(NamedTuple):
    """Targets and their hypotheses, in places that are counted on: of targets ``which`` each was, −1: new, ``exist`` and
    ``first``; of hypotheses ``weight``, ``rows`` (C, 14), ``static``, ``hidden``, ``detection`` and ``parent``."""

    which: I8
    exist: F8
    first: I8
    weight: F8
    rows: F8
    static: B1
    hidden: F8
    detection: I8
    parent: I8


@njit(**INNER)
def _room(targets: int, hypotheses: int) -> Hypotheses:
    """Places for so many."""
    return Hypotheses(
        np.empty(targets, np.int64), np.empty(targets), np.empty(targets + 1, np.int64), np.empty(hypotheses),
        np.empty((hypotheses, ROW)), np.empty(hypotheses, np.bool_), np.empty(hypotheses),
        np.empty(hypotheses, np.int64), np.empty(hypotheses, np.int64),
    )  # fmt: skip


@njit(**INNER)
def _predicted(exist: F8, first: I8, weight: F8, rows: F8, static: B1, hidden: F8, b: BoxNumbers, s: Settings) -> F8:
    """Predict targets in place; the probability (C,) that each hypothesis is detected."""
    seen = np.empty(weight.size)
    bordered = b.frame_width > 0.0 and b.frame_height > 0.0
    for t in range(exist.size):
        stay = 0.0
        for c in range(first[t], first[t + 1]):
            half_w, half_h = 0.5 * rows[c, 4], 0.5 * rows[c, 5]
            inside = -half_w < rows[c, 0] < b.frame_width + half_w and -half_h < rows[c, 1] < b.frame_height + half_h
            seen[c] = weight[c] * (b.survival if inside or not bordered else 0.0)
            stay += seen[c]
        exist[t] *= stay
        for c in range(first[t], first[t + 1]):
            if stay > 0.0:
                weight[c] = seen[c] / stay
            if static[c]:
                seen[c] = s.firing
                left_alone(rows, c, b)
                continue
            hidden[c] = hidden[c] * (1.0 - s.found) + (1.0 - hidden[c]) * s.lost
            seen[c] = (1.0 - hidden[c]) * b.p_detect
            moved(rows, c, b)
    return seen


@njit(**INNER)
def _densities(scene: Scene, b: BoxNumbers, crowded: F8, births: F8, given: F8) -> tuple[F8, F8]:
    """κ and γ̂ at the measurements, in the scene's order; ``given`` and ``births`` (N,) in theirs, or (0,): flat ones."""
    n = len(scene.boxes)
    kappa, born = np.empty(n), np.empty(n)
    for j in range(n):
        possible = True
        for a in range(M):
            possible &= b.low[a] <= scene.boxes[j, a] <= b.high[a]
        born[j] = b.p_detect * b.born * (crowded[j] if b.birth == LOCAL else 1.0) if possible else 0.0
        if births.size > 0:
            born[j] = births[scene.order[j]]
        if b.clutter == PLACES:
            kappa[j] = given[scene.order[j]]
        else:
            kappa[j] = b.false * (crowded[j] if b.clutter == LOCAL else 1.0)
    return kappa, born


@njit(**INNER)
def _kept(kept: Survivors, rows: F8, seen: F8, static: B1, hidden: F8, scene: Scene, b: BoxNumbers, out: Hypotheses) -> None:
    """The targets and hypotheses that survive, into the first places."""
    out.first[0] = 0
    for t in range(kept.target.size):
        out.which[t], out.exist[t], out.first[t + 1] = kept.target[t], kept.exist[t], kept.first[t + 1]
    for k in range(kept.source.size):
        i, j = kept.source[k], kept.which[k]
        out.weight[k], out.parent[k], out.static[k], out.hidden[k] = kept.weight[k], i, static[i], 0.0
        out.detection[k] = scene.order[j] if j >= 0 else -1
        if j >= 0:
            taken(rows, i, scene.boxes, j, b, out.rows, k)
            continue
        for r in range(ROW):
            out.rows[k, r] = rows[i, r]
        if not static[i]:
            out.hidden[k] = min(hidden[i] / max(1.0 - seen[i], TINY), 1.0)


@njit(**INNER)
def _started(
    own: F8, alone: F8, born: F8, states: F8, scene: Scene, b: BoxNumbers, s: Settings, out: Hypotheses, t: int, k: int
) -> tuple[int, int]:
    """New targets behind the first t, and k hypotheses; how many there are of both then.

    They come in the order of the measurements and not of the scene: labels follow it.
    """
    n, kinds = own.size, 2 if s.sources > 0.0 else 1
    place = np.empty(n, np.int64)
    for j in range(n):
        place[scene.order[j]] = j
    for number in range(n):
        j = place[number]
        new = born[j] / alone[j]
        exist = own[j] * new
        if not exist >= min(s.least, 0.5 * new) or not exist > 0.0:
            continue
        out.which[t], out.exist[t] = -1, exist
        for kind in range(kinds):
            out.static[k], out.hidden[k], out.detection[k], out.parent[k] = kind == 1, 0.0, number, -1
            out.weight[k] = s.sources if kind == 1 else 1.0 - s.sources
            if len(states) == 0:
                told_alone(scene.boxes, j, b, out.rows, k)
            else:
                for r in range(ROW):
                    out.rows[k, r] = states[number, r]
            k += 1
        t += 1
        out.first[t] = k
    return t, k


@njit(**INNER)
def _table(
    exist: F8, first: I8, weight: F8, seen: F8, static: B1, point: I8, which: I8, density: F8, pairs: int, kept: Survivors,
    kappa: F8, born: F8, alone: F8, order: I8, sources: float,
) -> tuple[F8, float]:  # fmt: skip
    """(2, N) C(z) and κ(z) as `UpdateInfo` has them, by measurement, and the mass born."""
    n = kappa.size
    table, appeared = np.empty((2, n)), 0.0
    for j in range(n):
        new, number = born[j] / alone[j], order[j]
        appeared += kept.own[j] * new * (1.0 - sources)
        table[0, number] = kappa[j] + born[j]
        table[1, number] = kept.own[j] * (kappa[j] / alone[j] + new * sources)
    t = 0 * n
    for e in range(pairs):
        while point[e] >= first[t + 1]:
            t += 1
        number = order[which[e]]
        table[0, number] += exist[t] * weight[point[e]] * seen[point[e]] * density[e]
        if static[point[e]]:
            table[1, number] += kept.told[e]
    for number in range(n):
        total, false = table[0, number], table[1, number]
        table[0, number], table[1, number] = (1.0 - false) * total, false * total
    return table, appeared


@njit(**INNER)
def _given_up(ended: I8, believed: F8, best: I8, which: I8, old: int, depth: float) -> I8:
    """(2, E) the targets that have ended, seen from a frame later, with those believed in that end now."""
    out, k, t = np.empty((2, ended.shape[1] + best.size), np.int64), 0 * old, 0 * old
    for e in range(ended.shape[1]):
        if ended[0, e] + 1 <= depth:
            out[0, k], out[1, k] = ended[0, e] + 1, ended[1, e]
            k += 1
    for i in range(best.size):
        if t < old and which[t] == i:
            t += 1
        elif believed[i] >= BELIEVED and best[i] >= 0:
            out[0, k], out[1, k] = 1, best[i]
            k += 1
    return out[:, :k].copy()


@njit(**INNER)
def _labels(label: I8, believed: F8, presence: F8, which: I8, fresh: int) -> tuple[I8, F8, int]:
    """Labels, the greatest presence ever, and the label that is free next."""
    name, most = np.empty(which.size, np.int64), np.empty(which.size)
    for t in range(which.size):
        if which[t] >= 0:
            name[t], most[t] = label[which[t]], max(believed[which[t]], presence[t])
        else:
            name[t], most[t] = fresh, presence[t]
            fresh += 1
    return name, most, fresh


@njit(**ENTRY)
def pmb_box_step(
    exist: F8, label: I8, first: I8, weight: F8, mean: F8, cov: F8, static: B1, hidden: F8, best: I8, believed: F8,
    ended: I8, fresh: int, z: F8, births: F8, states: F8, given: F8, model: F8, settings: F8,
) -> tuple[
    F8, I8, I8, F8, F8, F8, B1, F8, I8, I8, I8, F8, F8, I8, int, F8, float, float, float, int
]:  # fmt: skip
    """Predict, update, start new targets, prune and merge.

    Parameters
    ----------
    exist, label, first, weight, mean, cov, static, hidden, best, believed : see `bernoullis.Layer`.
    ended, fresh : see `bernoullis.Bernoullis`.
    z : (m, N) measurements.
    births, states : where births are given γ̂ (N,) at the measurements and (N, 14) what begins there, else (0,), (0, 14).
    given : (N,) κ at the measurements where the model says that it is given, else (0,).
    model, settings : the values of `BoxNumbers` and of `Settings`.

    Returns
    -------
    ``exist``, ``label``, ``first``, ``weight``, ``mean``, ``cov``, ``static``, ``hidden``, ``detection``, ``parent``,
    ``best``, ``presence``, ``believed``; ``ended``, ``fresh``; table (2, N) of C(z) and κ(z) as `UpdateInfo` has them; the
    masses predicted, without births, born, and after the update; the number of measurements with κ + C = 0.
    """
    b, s = box_numbers(model), _settings(settings)
    n = z.shape[1]
    exist, weight, rows, hidden = exist.copy(), weight.copy(), in_rows(mean, cov), hidden.copy()
    seen = _predicted(exist, first, weight, rows, static, hidden, b, s)
    before, after, vanished = 0.0, 0.0, 0 * n
    for t in range(exist.size):
        for c in range(first[t], first[t + 1]):
            if not static[c]:
                before += exist[t] * weight[c]
    if n > 0:
        scene = sorted_boxes(z)
        point, which, density, pairs = paired(rows, scene, b, s.gate)
    else:
        scene = Scene(np.empty((0, 4)), first[:0], first[:0], 0.0, 0.0, 0.0, 0.0, n, n)
        point, which, density, pairs = first[:0], first[:0], weight[:0], 0 * n
    crowded = crowding(scene, b) if n > 0 and (b.birth == LOCAL or b.clutter == LOCAL) else weight
    kappa, born = _densities(scene, b, crowded, births, given)
    alone = np.empty(n)
    for j in range(n):
        alone[j] = max(kappa[j] + born[j], TINY)
    kept = survivors(exist, first, weight, seen, point, which, density, pairs, alone, Pruning(s.least, s.share, s.most))
    old, many = kept.target.size, kept.source.size
    out = _room(old + n, many + 2 * n)
    _kept(kept, rows, seen, static, hidden, scene, b, out)
    t, k = _started(kept.own, alone, born, states, scene, b, s, out, old, many)
    table, appeared = _table(
        exist, first, weight, seen, static, point, which, density, pairs, kept, kappa, born, alone, scene.order,
        s.sources,
    )  # fmt: skip
    begin, chosen, heavier = merged(out.first[: t + 1], out.weight[:k], out.rows, D, out.static, s.merge * s.merge)
    there, kind = out.exist[:t].copy(), out.static[chosen]
    front, presence = best_of(there, begin, heavier, kind)
    name, most, fresh = _labels(label, believed, presence, out.which[:t], fresh)
    for i in range(t):
        after += presence[i]
    for j in range(n):
        vanished += table[0, j] + table[1, j] == 0.0
    mean, cov = gaussians(out.rows, chosen)
    return (
        there, name, begin, heavier, mean, cov, kind, out.hidden[chosen], out.detection[chosen], out.parent[chosen], front,
        presence, most, _given_up(ended, believed, best, out.which, old, s.depth), fresh, table, before, appeared, after,
        vanished,
    )  # fmt: skip
