"""The Poisson multi-Bernoulli filter over the records of `kernels.gaussian` [W15].

A target t exists with probability r, as itself or as a source of static clutter, and has hypotheses i of weight w_i, which
are given its existence. With p_i the probability that hypothesis i is detected, q_i(z) = N(z; ẑ_i, S_i), γ̂(z) the density of
first detections and κ(z) that of false alarms,

    missed            1 − r Σ w_i p_i;  then it exists with probability r Σ w_i (1 − p_i) / (1 − r Σ w_i p_i)
    detected          r w_i p_i q_i(z), by hypothesis i
    nobody detected   κ(z) + γ̂(z):  a new target with r = γ̂/(κ + γ̂)

The odds of a pair (target, measurement) are ψ = Σ_i r w_i p_i q_i(z) / (missed · (κ + γ̂)). Belief propagation
(`kernels.marginals`) turns them into the probability of each pair over all one-to-one assignments. A hypothesis after the
update is a hypothesis before it with a measurement, or with none; r is the sum of the probabilities of all of a target.

Arrays count targets (T), hypotheses (C), measurements (N), births (B) or pairs (P). The hypotheses of target t are
offsets[t] … offsets[t + 1] − 1, the heaviest first after an update.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import (
    Expected,
    Measurements,
    NewTargets,
    Pairs,
    Predicted,
    gated,
    places_of,
    write_posteriors,
)
from phdtrack.kernels.marginals import beliefs

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
B1 = NDArray[np.bool_]

TINY = float(np.finfo(np.float64).tiny)
# A target that cannot be missed is missed with this probability: impossible, but comparable.
NEVER = 1e-15
# Deleted targets whose probability to exist was never as large are not kept for the past.
CONFIRMED = 0.05
# How well the place of static clutter can be known, as a share of what a single detection leaves unknown.
STATIC_SHARE = 0.5


class Layer(NamedTuple):
    """The targets of one frame.

    Attributes
    ----------
    r : (T,) probability that the target exists, as itself or as a source of static clutter.
    label : (T,) its number, rising, from 0, none given twice.
    offsets : (T + 1,) where its hypotheses begin.
    weight : (C,) probabilities of the hypotheses, which sum to one for each target.
    mean : (C, d).     covariance : (C, d, d).
    static : (C,) whether the hypothesis is a source of static clutter: it stays where it is, and is no target.
    occluded : (C,) probability that the target cannot be detected at present.
    detection : (C,) measurement of the frame that it took, −1 for none.
    parent : (C,) its hypothesis in the frame before; −1 where the target begins.
    best : (T,) the heaviest hypothesis that is not static, −1 where there is none.
    presence : (T,) probability that the target exists and is not static clutter.
    max_r : (T,) the greatest presence that it ever had.
    """

    r: F8
    label: I8
    offsets: I8
    weight: F8
    mean: F8
    covariance: F8
    static: B1
    occluded: F8
    detection: I8
    parent: I8
    best: I8
    presence: F8
    max_r: F8


class Settings(NamedTuple):
    """Those of `filters.PMB` that an update needs; ``gate`` in deviations, ``merge_distance`` 0 to merge nothing."""

    existence_threshold: float
    hypothesis_threshold: float
    max_hypotheses: float
    merge_distance: float
    gate: float
    static_clutter_prior: float
    static_detection_probability: float


class Summary(NamedTuple):
    """What an update learned: masses, measurements with κ + C = 0, and (N,) C(z) and κ(z) as `UpdateInfo` has them."""

    mass_predicted: float
    mass_born: float
    mass: float
    vanished: int
    evidence: F8
    clutter: F8


class Odds(NamedTuple):
    """Odds of pairs (target, measurement), of which there are ``edges``.

    Attributes
    ----------
    missed : (T,) probability that the target exists, given that it was missed.
    part : (P,) what each pair (hypothesis, measurement) adds to the odds of its target.
    edge : (P,) the pair (target, measurement) that it belongs to.
    target, measurement, odds : (edges or more,).
    """

    missed: F8
    part: F8
    edge: I8
    target: I8
    measurement: I8
    odds: F8
    edges: int


class Kept(NamedTuple):
    """Targets and hypotheses that are kept, in arrays that may be longer.

    Attributes
    ----------
    targets, hypotheses : how many there are, T' and K.
    target : (T',) the target before.     r : (T',).     offsets : (T' + 1,).
    source : (K,) the hypothesis before.     taken : (K,) the measurement, −1 for none.     weight : (K,).
    p_new : (N,) probability that a measurement is no earlier target's.
    pair : (P,) association probability of each pair (hypothesis, measurement).
    """

    targets: int
    hypotheses: int
    target: I8
    r: F8
    offsets: I8
    source: I8
    taken: I8
    weight: F8
    p_new: F8
    pair: F8


@njit(**INNER)
def copy_state(mean: F8, covariance: F8, i: int, out_mean: F8, out_covariance: F8, k: int) -> None:
    """Copy Gaussian i to place k. In loops: an assignment of rows would compile Numba's code for its error messages."""
    for a in range(mean.shape[1]):
        out_mean[k, a] = mean[i, a]
        for b in range(mean.shape[1]):
            out_covariance[k, a, b] = covariance[i, a, b]


@njit(**ENTRY)
def predicted_layer(layer: Layer, p: Predicted, occlude: float, reappear: float) -> tuple[F8, F8, F8, F8, F8, F8]:
    """r, weights, means, covariances, occlusion probabilities and presences of the targets after an interval.

    Parameters
    ----------
    layer : the targets before.
    p : their hypotheses after the motion.
    occlude, reappear : probabilities that a visible target is occluded after the interval, and an occluded one visible.
    """
    offsets, before, covariance, static, p_survive = layer.offsets, layer.mean, layer.covariance, layer.static, p.p_survive
    r, weight, presence = layer.r.copy(), layer.weight.copy(), np.zeros(layer.r.size)
    mean, cov, occluded = p.mean.copy(), p.covariance.copy(), layer.occluded.copy()
    for t in range(r.size):
        stay = 0.0
        for c in range(offsets[t], offsets[t + 1]):
            stay += weight[c] * p_survive[c]
        r[t] *= stay
        for c in range(offsets[t], offsets[t + 1]):
            if stay > 0.0:
                weight[c] *= p_survive[c] / stay
            if static[c]:
                copy_state(before, covariance, c, mean, cov, c)
            else:
                occluded[c] = occluded[c] * (1.0 - reappear) + (1.0 - occluded[c]) * occlude
                presence[t] += r[t] * weight[c]
    return r, weight, mean, cov, occluded, presence


@njit(**INNER)
def odds_of(r: F8, offsets: I8, weight: F8, p_detect: F8, pairs: Pairs, alone: F8) -> Odds:
    """How much likelier each target's detection by each measurement is than that it was missed.

    ``r``, ``offsets``, ``weight`` as in `Layer`, ``p_detect`` (C,) of hypotheses, ``alone`` (N,) κ + γ̂.
    """
    gaussian, measurement, log_density = pairs.gaussian, pairs.measurement, pairs.log_density
    count = gaussian.size
    missed, part, odds, edge = np.empty(r.size), np.empty(count), np.zeros(count), np.empty(count, np.int64)
    target, column, place = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(alone.size, np.int64)
    for j in range(place.size):
        place[j] = -1
    # A literal zero is a type of its own.
    found, q = 0 * count, 0 * count
    for t in range(r.size):
        detected, begun = 0.0, found
        for c in range(offsets[t], offsets[t + 1]):
            detected += weight[c] * p_detect[c]
        miss = max(1.0 - r[t] * detected, NEVER)
        missed[t] = min(max(r[t] * (1.0 - detected), 0.0) / miss, 1.0)
        while q < count and gaussian[q] < offsets[t + 1]:
            c, j = gaussian[q], measurement[q]
            if place[j] < begun:
                place[j], target[found], column[found] = found, t, j
                found += 1
            edge[q] = place[j]
            part[q] = r[t] * weight[c] * p_detect[c] * np.exp(log_density[q]) / (miss * alone[j])
            odds[edge[q]] += part[q]
            q += 1
    return Odds(missed, part, edge, target, column, odds, found)


@njit(**INNER)
def kept_hypotheses(r: F8, offsets: I8, weight: F8, p_detect: F8, pairs: Pairs, alone: F8, s: Settings) -> Kept:
    """Targets and hypotheses after the measurements, without those below the thresholds, heaviest hypotheses first.

    ``r``, ``offsets``, ``weight`` as in `Layer`, ``p_detect`` (C,) of hypotheses, ``alone`` (N,) κ + γ̂.
    """
    missed, part, edge, target, column, odds, edges = odds_of(r, offsets, weight, p_detect, pairs, alone)
    belief, nothing, p_new = beliefs(odds, target, column, edges, r.size, alone.size)
    gaussian, measurement = pairs.gaussian, pairs.measurement
    least, share, most = s.existence_threshold, s.hypothesis_threshold, int(s.max_hypotheses)
    count, room = gaussian.size, weight.size + gaussian.size
    pair, before, r_kept = np.zeros(count), np.empty(r.size, np.int64), np.empty(r.size)
    begins, source, taken = np.zeros(r.size + 1, np.int64), np.empty(room, np.int64), np.empty(room, np.int64)
    heavy, option, value = np.empty(room), np.empty(room, np.int64), np.empty(room)
    used, k, q = 0 * count, 0 * count, 0 * count
    for t in range(r.size):
        unseen, alive, options = 0.0, nothing[t] * missed[t], 0 * count
        exists = alive
        while q < count and gaussian[q] < offsets[t + 1]:
            if odds[edge[q]] > 0.0:
                pair[q] = belief[edge[q]] * part[q] / odds[edge[q]]
            option[options], value[options] = q, pair[q]
            exists += pair[q]
            options, q = options + 1, q + 1
        for c in range(offsets[t], offsets[t + 1]):
            unseen += weight[c] * (1.0 - p_detect[c])
        for c in range(offsets[t], offsets[t + 1]):
            option[options] = -1 - c
            value[options] = alive * weight[c] * (1.0 - p_detect[c]) / unseen if unseen > 0.0 else 0.0
            options += 1
        # A target whose probability has just risen may have begun, however rare births are beside false alarms.
        if exists < least and not exists > r[t]:
            continue
        # The heaviest in turn: there are few.
        total, first = 0.0, k
        while k - first < most:
            best = 0 * count
            for o in range(1, options):
                if value[o] > value[best]:
                    best = o
            if not value[best] > 0.0 or value[best] < share * exists:
                break
            o = option[best]
            heavy[k], total = value[best], total + value[best]
            source[k], taken[k] = (-1 - o, -1) if o < 0 else (gaussian[o], measurement[o])
            value[best] = -1.0
            k += 1
        if k == first:
            continue
        for i in range(first, k):
            heavy[i] /= total
        before[used], r_kept[used] = t, min(exists, 1.0)
        used += 1
        begins[used] = k
    return Kept(used, k, before, r_kept, begins, source, taken, heavy, p_new, pair)


@njit(**INNER)
def write_kept(layer: Layer, e: Expected, m: Measurements, first: F8, p_detect: F8, kept: Kept, out: Layer) -> None:
    """Write the kept hypotheses into the first places of ``out``; ``first`` (N, d, d) are covariances of new targets."""
    mean, covariance, static, occluded, parent = layer.mean, layer.covariance, layer.static, layer.occluded, layer.parent
    out_mean, out_cov, out_static, out_occluded = out.mean, out.covariance, out.static, out.occluded
    out_weight, out_detection, out_parent = out.weight, out.detection, out.parent
    source, taken, weight = kept.source, kept.taken, kept.weight
    write_posteriors(mean, covariance, e, m, source[: kept.hypotheses], taken[: kept.hypotheses], out_mean, out_cov, 0)
    for k in range(kept.hypotheses):
        i, j = source[k], taken[k]
        out_weight[k], out_static[k], out_detection[k], out_parent[k] = weight[k], static[i], j, parent[i]
        out_occluded[k] = 0.0 if j >= 0 or static[i] else min(occluded[i] / max(1.0 - p_detect[i], TINY), 1.0)
        if j < 0:
            copy_state(mean, covariance, i, out_mean, out_cov, k)
            continue
        if static[i]:
            # Were its place known better and better, a target that stands still would be explained by it better and better.
            for a in range(mean.shape[1]):
                out_cov[k, a, a] = max(out_cov[k, a, a], STATIC_SHARE * first[j, a, a])


@njit(**INNER)
def room_for(targets: int, hypotheses: int, d: int) -> Layer:
    """A layer to be filled in."""
    return Layer(
        np.empty(targets), np.empty(targets, np.int64), np.zeros(targets + 1, np.int64), np.empty(hypotheses),
        np.empty((hypotheses, d)), np.empty((hypotheses, d, d)), np.empty(hypotheses, np.bool_), np.zeros(hypotheses),
        np.empty(hypotheses, np.int64), np.empty(hypotheses, np.int64), np.empty(targets, np.int64), np.empty(targets),
        np.zeros(targets),
    )  # fmt: skip


@njit(**INNER)
def write_new(r_new: F8, new: NewTargets, prior: float, fresh: int, first: tuple[int, int], out: Layer) -> None:
    """Write the new targets, of r above 0, and their hypotheses from the ``first`` places of ``out`` on.

    They come in the order of the measurements and are labelled from ``fresh`` on; ``prior`` is that of static clutter.
    """
    new_mean, new_cov, kinds = new.mean, new.covariance, 2 if prior > 0.0 else 1
    r, label, offsets, weight, mean, cov = out.r, out.label, out.offsets, out.weight, out.mean, out.covariance
    static, detection, parent = out.static, out.detection, out.parent
    t, k = first
    for j in range(r_new.size):
        if r_new[j] > 0.0:
            r[t], label[t], offsets[t + 1] = r_new[j], fresh, k + kinds
            for kind in range(kinds):
                weight[k] = prior if kind == 1 else 1.0 - prior
                copy_state(new_mean, new_cov, j, mean, cov, k)
                static[k], detection[k], parent[k] = kind == 1, j, -1
                k += 1
            t, fresh = t + 1, fresh + 1


@njit(**INNER)
def find_best(layer: Layer) -> float:
    """The mass; writes each target's best hypothesis, its presence and the greatest ever."""
    r, offsets, weight, static = layer.r, layer.offsets, layer.weight, layer.static
    best, presence, max_r, mass = layer.best, layer.presence, layer.max_r, 0.0
    for t in range(r.size):
        total, best[t] = 0.0, -1
        for c in range(offsets[t], offsets[t + 1]):
            if not static[c]:
                total += weight[c]
                if best[t] < 0 or weight[c] > weight[best[t]]:
                    best[t] = c
        presence[t] = r[t] * total
        max_r[t] = max(max_r[t], presence[t])
        mass += presence[t]
    return mass


@njit(**INNER)
def merged(layer: Layer, limit: float) -> Layer:
    """The targets, with hypotheses counted as a heavier one of their target and kind that is within √limit deviations."""
    old_offsets, mean, cov, static = layer.offsets, layer.mean, layer.covariance, layer.static
    kept, weight = np.empty(static.size, np.int64), layer.weight.copy()
    offsets, k, d = old_offsets.copy(), 0 * static.size, mean.shape[1]
    for t in range(old_offsets.size - 1):
        begun = k
        for c in range(old_offsets[t], old_offsets[t + 1]):
            same = False
            for i in range(begun, k):
                heavier, distance2 = kept[i], 0.0
                for a in range(d):
                    step = mean[heavier, a] - mean[c, a]
                    distance2 += step * step / max(cov[heavier, a, a], 1e-12)
                same = static[heavier] == static[c] and distance2 < limit
                if same:
                    weight[heavier] += weight[c]
                    break
            if not same:
                kept[k] = c
                k += 1
        offsets[t + 1] = k
    if k == static.size:
        return layer
    out: Layer = room_for(old_offsets.size - 1, k, d)
    r, label, out_offsets, max_r = out.r, out.label, out.offsets, out.max_r
    old_r, old_label, old_max = layer.r, layer.label, layer.max_r
    for t in range(r.size):
        r[t], label[t], out_offsets[t + 1], max_r[t] = old_r[t], old_label[t], offsets[t + 1], old_max[t]
    out_weight, out_mean, out_cov, out_static = out.weight, out.mean, out.covariance, out.static
    out_occluded, out_detection, out_parent = out.occluded, out.detection, out.parent
    occluded, detection, parent = layer.occluded, layer.detection, layer.parent
    for i in range(k):
        c = kept[i]
        copy_state(mean, cov, c, out_mean, out_cov, i)
        out_weight[i], out_static[i], out_occluded[i] = weight[c], static[c], occluded[c]
        out_detection[i], out_parent[i] = detection[c], parent[c]
    find_best(out)
    return out


@njit(**ENTRY)
def merged_layer(layer: Layer, merge_distance: float) -> Layer:
    """`merged`, to be called from Python; ``merge_distance`` in deviations."""
    out: Layer = merged(layer, merge_distance * merge_distance)
    return out


@njit(**INNER)
def summary(
    layer: Layer, p_detect: F8, pairs: Pairs, kept: Kept, clutter: F8, density: F8, prior: float
) -> tuple[float, float, int, F8, F8]:
    """Masses predicted and born, measurements with κ + C = 0, C(z), κ(z); ``density`` is γ̂, ``prior`` of static clutter."""
    r, offsets, weight, static, presence = layer.r, layer.offsets, layer.weight, layer.static, layer.presence
    gaussian, measurement, log_density = pairs.gaussian, pairs.measurement, pairs.log_density
    p_new, association = kept.p_new, kept.pair
    born, vanished, total, false = 0.0, 0 * clutter.size, np.empty(clutter.size), np.empty(clutter.size)
    for j in range(clutter.size):
        total[j] = clutter[j] + density[j]
        p_target = p_new[j] * density[j] / max(total[j], TINY)
        born += p_target * (1.0 - prior)
        false[j] = p_new[j] * clutter[j] / max(total[j], TINY) + p_target * prior
    predicted, q = born, 0 * clutter.size
    for t in range(r.size):
        predicted += presence[t]
        while q < gaussian.size and gaussian[q] < offsets[t + 1]:
            i, j = gaussian[q], measurement[q]
            total[j] += r[t] * weight[i] * p_detect[i] * np.exp(log_density[q])
            if static[i]:
                false[j] += association[q]
            q += 1
    for j in range(clutter.size):
        vanished += total[j] == 0.0
        false[j] *= total[j]
        total[j] -= false[j]
    return predicted, born, vanished, total, false


@njit(**INNER)
def still_ended(layer: Layer, targets: int, target: I8, past: tuple[I8, int, int]) -> I8:
    """(2, E) frame and hypothesis of targets that were once confirmed and have been deleted within the history.

    ``target`` are those that are kept, of which there are ``targets``.
    """
    ended, frame, history = past
    max_r, best, parent = layer.max_r, layer.best, layer.parent
    out, k, t = np.empty((2, ended.shape[1] + best.size), np.int64), 0 * frame, 0 * frame
    for e in range(ended.shape[1]):
        if frame - ended[0, e] <= history:
            out[0, k], out[1, k] = ended[0, e], ended[1, e]
            k += 1
    for i in range(best.size):
        if t < targets and target[t] == i:
            t += 1
        elif max_r[i] >= CONFIRMED and best[i] >= 0 and parent[best[i]] >= 0:
            out[0, k], out[1, k] = frame - 1, parent[best[i]]
            k += 1
    return out[:, :k].copy()


@njit(**ENTRY)
def updated_layer(
    layer: Layer, e: Expected, m: Measurements, new: NewTargets, s: Settings, fresh: int, past: tuple[I8, int, int]
) -> tuple[Layer, Summary, I8]:
    """The targets after the measurements, with new ones, what was learned, and the targets that have ended [W15].

    Parameters
    ----------
    layer : the predicted targets.
    e : what their hypotheses say of measurements.
    m : the measurements and κ.
    new : what targets are whose first detections these measurements are.
    s : settings.
    fresh : the label that the next new target is given.
    past : (2, E) frame and hypothesis of targets that have ended, the number of this frame, and how many frames are kept.
    """
    static, occluded, seen, clutter, density = layer.static, layer.occluded, e.p_detect, m.clutter, new.density
    p_detect, alone, r_new = np.empty(static.size), np.empty(density.size), np.empty(density.size)
    for c in range(p_detect.size):
        p_detect[c] = s.static_detection_probability if static[c] else (1.0 - occluded[c]) * seen[c]
    for j in range(alone.size):
        alone[j] = max(clutter[j] + density[j], TINY)
    pairs = gated(e, m, places_of(m), s.gate, p_detect)
    kept = kept_hypotheses(layer.r, layer.offsets, layer.weight, p_detect, pairs, alone, s)
    prior, p_new, started = s.static_clutter_prior, kept.p_new, 0 * fresh
    for j in range(alone.size):
        p_target = density[j] / alone[j]
        r_new[j] = p_new[j] * p_target
        if r_new[j] < min(s.existence_threshold, 0.5 * p_target):
            r_new[j] = 0.0
        started += r_new[j] > 0.0
    targets, hypotheses = kept.targets, kept.hypotheses
    out = room_for(targets + started, hypotheses + (2 if prior > 0.0 else 1) * started, layer.mean.shape[1])
    r, label, offsets, max_r = out.r, out.label, out.offsets, out.max_r
    target, r_kept, begins, old_label, old_max = kept.target, kept.r, kept.offsets, layer.label, layer.max_r
    for t in range(targets):
        r[t], label[t], offsets[t + 1], max_r[t] = r_kept[t], old_label[target[t]], begins[t + 1], old_max[target[t]]
    write_kept(layer, e, m, new.covariance, p_detect, kept, out)
    write_new(r_new, new, prior, fresh, (targets, hypotheses), out)
    mass = find_best(out)
    predicted, born, vanished, evidence, false = summary(layer, p_detect, pairs, kept, clutter, density, prior)
    if s.merge_distance > 0.0:
        out = merged(out, s.merge_distance * s.merge_distance)
    return out, Summary(predicted, born, mass, vanished, evidence, false), still_ended(layer, targets, target, past)
