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
from phdtrack.kernels.gm_model import (
    LOCAL,
    PLACES,
    BoxNumbers,
    D,
    Scene,
    around_each,
    box_numbers,
    crowding,
    possible,
    sorted_boxes,
)
from phdtrack.kernels.pmb_rows import MIXED, ROW, VARIANCE, left_alone, moved, paired, taken, told_alone
from phdtrack.kernels.pmb_update import BELIEVED, Pruning, Survivors, best_of, merged, survivors

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
B1 = NDArray[np.bool_]

TINY = float(np.finfo(np.float64).tiny)
# The probability to be hidden stands behind a row.
HIDDEN = ROW


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
    ``first``; of hypotheses ``weight``, ``rows`` (C, 15), ``static``, and ``origin`` (C, 2) detection and parent."""

    which: I8
    exist: F8
    first: I8
    weight: F8
    rows: F8
    static: B1
    origin: I8


@njit(**INNER)
def _room(targets: int, hypotheses: int) -> Hypotheses:
    """Places for so many."""
    return Hypotheses(
        np.empty(targets, np.int64), np.empty(targets), np.empty(targets + 1, np.int64), np.empty(hypotheses),
        np.empty((hypotheses, ROW + 1)), np.empty(hypotheses, np.bool_), np.empty((hypotheses, 2), np.int64),
    )  # fmt: skip


@njit(**INNER)
def _in_rows(mean: F8, cov: F8, hidden: F8) -> F8:
    """(C, 15) of means (d, C), covariances (C, d, d) and (C,)."""
    rows = np.empty((hidden.size, ROW + 1))
    for i in range(hidden.size):
        # As many axes as there are and not 6: the compiler would write the loop out.
        for r in range(mean.shape[0]):
            rows[i, r], rows[i, VARIANCE + r] = mean[r, i], cov[i, r, r]
        rows[i, MIXED], rows[i, MIXED + 1], rows[i, HIDDEN] = cov[i, 2, 0], cov[i, 3, 1], hidden[i]
    return rows


@njit(**INNER)
def _predicted(exist: F8, first: I8, weight: F8, rows: F8, static: B1, b: BoxNumbers, s: Settings) -> tuple[F8, float]:
    """Predict targets in place; the probability (C,) that each hypothesis is detected, and the mass of who is no source."""
    seen, mass = np.empty(weight.size), 0.0
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
            rows[c, HIDDEN] = rows[c, HIDDEN] * (1.0 - s.found) + (1.0 - rows[c, HIDDEN]) * s.lost
            seen[c] = (1.0 - rows[c, HIDDEN]) * b.p_detect
            mass += exist[t] * weight[c]
            moved(rows, c, b)
    return seen, mass


@njit(**INNER)
def _densities(scene: Scene, b: BoxNumbers, births: F8, given: F8) -> tuple[F8, F8, F8]:
    """κ, γ̂ and what they are together at the measurements, in the scene's order.

    ``given`` (N,) and ``births`` (N, 15) are in theirs, or of length 0: flat ones, or those around each measurement.
    """
    n = len(scene.boxes)
    kappa, born, alone = np.empty(n), np.empty(n), np.empty(n)
    around = around_each(b)
    crowded = crowding(scene, b) if around else alone
    for j in range(n):
        number, near = scene.order[j], crowded[j] if around else 0.0
        kappa[j] = b.false * (near if b.clutter == LOCAL or b.clutter == PLACES else 1.0)
        if b.clutter == PLACES:
            kappa[j] += given[number]
        flat = b.p_detect * b.born * (near if b.birth == LOCAL or b.birth == PLACES else 1.0)
        if b.birth == PLACES:
            born[j] = flat * births[number, ROW]
        elif len(births) > 0:
            born[j] = births[number, ROW]
        else:
            born[j] = flat if possible(b, scene.boxes, j) else 0.0
        alone[j] = max(kappa[j] + born[j], TINY)
    return kappa, born, alone


@njit(**INNER)
def _kept(kept: Survivors, rows: F8, seen: F8, static: B1, scene: Scene, b: BoxNumbers, out: Hypotheses) -> None:
    """The targets and hypotheses that survive, into the first places."""
    out.first[0] = 0
    for t in range(kept.targets):
        out.which[t], out.exist[t], out.first[t + 1] = kept.target[t], kept.exist[t], kept.first[t + 1]
    for k in range(kept.hypotheses):
        i, j = kept.source[k], kept.which[k]
        out.weight[k], out.static[k], out.origin[k, 0], out.origin[k, 1] = kept.weight[k], static[i], -1, i
        if j >= 0:
            out.origin[k, 0], out.rows[k, HIDDEN] = scene.order[j], 0.0
            taken(rows, i, scene.boxes, j, b, out.rows, k)
            continue
        for r in range(rows.shape[1]):
            out.rows[k, r] = rows[i, r]
        out.rows[k, HIDDEN] = 0.0 if static[i] else min(rows[i, HIDDEN] / max(1.0 - seen[i], TINY), 1.0)


@njit(**INNER)
def _started(
    kept: Survivors, alone: F8, born: F8, states: F8, scene: Scene, b: BoxNumbers, s: Settings, out: Hypotheses
) -> tuple[int, int]:
    """New targets behind those kept, and hypotheses; how many there are of both then.

    They come in the order of the measurements and not of the scene: labels follow it.
    """
    n, kinds, t, k = alone.size, 2 if s.sources > 0.0 else 1, kept.targets, kept.hypotheses
    place = np.empty(n, np.int64)
    for j in range(n):
        place[scene.order[j]] = j
    for number in range(n):
        j = place[number]
        new = born[j] / alone[j]
        exist = kept.own[j] * new
        if not exist >= min(s.least, 0.5 * new) or not exist > 0.0:
            continue
        out.which[t], out.exist[t] = -1, exist
        for kind in range(kinds):
            out.static[k], out.origin[k, 0], out.origin[k, 1] = kind == 1, number, -1
            out.weight[k] = s.sources if kind == 1 else 1.0 - s.sources
            if len(states) == 0:
                told_alone(scene.boxes, j, b, out.rows, k)
            else:
                for r in range(states.shape[1]):
                    out.rows[k, r] = states[number, r]
            out.rows[k, HIDDEN] = 0.0
            k += 1
        t += 1
        out.first[t] = k
    return t, k


@njit(**INNER)
def _table(
    exist: F8, first: I8, weight: F8, seen: F8, static: B1, point: I8, which: I8, density: F8, pairs: int, kept: Survivors,
    kappa: F8, born: F8, alone: F8, order: I8, sources: float,
) -> tuple[F8, float, int]:  # fmt: skip
    """(2, N) C(z) and κ(z) as `UpdateInfo` has them, by measurement, the mass born, and how many have κ + C = 0."""
    n = kappa.size
    table, appeared, vanished = np.empty((2, n)), 0.0, 0 * n
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
        vanished += table[0, number] + table[1, number] == 0.0
    return table, appeared, vanished


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
def _chosen(out: Hypotheses, kept: I8, heavier: F8, dim: int) -> tuple[F8, F8, F8, I8, B1]:
    """Of those ``kept`` (C,) the means (d, C), covariances (C, d, d), (2, C) weight and probability to be hidden, (2, C)
    detection and parent, and (C,) whether static."""
    mean, cov = np.empty((dim, kept.size)), np.empty((kept.size, dim, dim))
    shares, origin, static = np.empty((2, kept.size)), np.empty((2, kept.size), np.int64), np.empty(kept.size, np.bool_)
    for k in range(kept.size):
        i = kept[k]
        shares[0, k], shares[1, k], static[k] = heavier[i], out.rows[i, HIDDEN], out.static[i]
        origin[0, k], origin[1, k] = out.origin[i, 0], out.origin[i, 1]
        for r in range(dim):
            for c in range(dim):
                cov[k, r, c] = 0.0
            mean[r, k], cov[k, r, r] = out.rows[i, r], out.rows[i, VARIANCE + r]
        for a in range(2):
            cov[k, a, a + 2], cov[k, a + 2, a] = out.rows[i, MIXED + a], out.rows[i, MIXED + a]
    return mean, cov, shares, origin, static


@njit(**INNER)
def _named(
    out: Hypotheses, begin: I8, weight: F8, static: B1, label: I8, believed: F8, fresh: int
) -> tuple[F8, I8, float, int]:
    """(3, T) probability to be there, presence and its greatest ever, (2, T) label and best hypothesis; the mass of all who
    are present, and the label that is free next."""
    targets = begin.size - 1
    told, name, mass = np.empty((3, targets)), np.empty((2, targets), np.int64), 0.0
    best, presence = best_of(out.exist[:targets], begin, weight, static)
    for t in range(targets):
        told[0, t], told[1, t], told[2, t] = out.exist[t], presence[t], presence[t]
        name[0, t], name[1, t] = fresh, best[t]
        mass += presence[t]
        before = out.which[t]
        if before < 0:
            fresh += 1
        else:
            name[0, t], told[2, t] = label[before], max(believed[before], presence[t])
    return told, name, mass, fresh


@njit(**ENTRY)
def pmb_box_step(
    exist: F8, label: I8, first: I8, weight: F8, mean: F8, cov: F8, static: B1, hidden: F8, best: I8, believed: F8,
    ended: I8, fresh: int, z: F8, births: F8, given: F8, model: F8, settings: F8,
) -> tuple[F8, I8, I8, F8, F8, F8, B1, I8, I8, int, F8, F8]:  # fmt: skip
    """Predict, update, start new targets, prune and merge.

    Parameters
    ----------
    exist, label, first, weight, mean, cov, static, hidden, best, believed : see `bernoullis.Layer`.
    ended, fresh : see `bernoullis.Bernoullis`.
    z : (m, N) measurements.
    births : (N, 15) where births are given, or are by place, see `pmb_births`, else (0, 15).
    given : (N,) what comes to κ at the measurements where the model says that it is by place, else (0,).
    model, settings : the values of `BoxNumbers` and of `Settings`.

    Returns
    -------
    (3, T) ``exist``, ``presence``, ``believed``; (2, T) ``label``, ``best``; ``first``; (2, C) ``weight``, ``hidden``;
    ``mean``; ``cov``; ``static``; (2, C) ``detection``, ``parent``; ``ended``; ``fresh``; (2, N) C(z) and κ(z) as
    `UpdateInfo` has them; (4,) the masses predicted, without births, born, and after the update, and the number of
    measurements with κ + C = 0. Every array that is handed over takes time to compile: there are few.
    """
    b, s, total = box_numbers(model), _settings(settings), np.empty(4)
    exist, weight, rows = exist.copy(), weight.copy(), _in_rows(mean, cov, hidden)
    seen, total[0] = _predicted(exist, first, weight, rows, static, b, s)
    scene = sorted_boxes(z)
    point, which, density, pairs = paired(rows, scene, b, s.gate)
    kappa, born, alone = _densities(scene, b, births, given)
    kept = survivors(exist, first, weight, seen, point, which, density, pairs, alone, Pruning(s.least, s.share, s.most))
    out = _room(kept.targets + alone.size, kept.hypotheses + 2 * alone.size)
    _kept(kept, rows, seen, static, scene, b, out)
    t, k = _started(kept, alone, born, births, scene, b, s, out)
    table, total[1], total[3] = _table(
        exist, first, weight, seen, static, point, which, density, pairs, kept, kappa, born, alone, scene.order,
        s.sources,
    )  # fmt: skip
    begin, chosen, heavier = merged(out.first[: t + 1], out.weight[:k], out.rows, D, out.static, s.merge * s.merge)
    mean, cov, shares, origin, kind = _chosen(out, chosen, heavier, mean.shape[0])
    told, name, total[2], fresh = _named(out, begin, shares[0], kind, label, believed, fresh)
    gone = _given_up(ended, believed, best, out.which, kept.targets, s.depth)
    return told, name, begin, shares, mean, cov, kind, origin, gone, fresh, table, total
