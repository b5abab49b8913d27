"""The Poisson multi-Bernoulli filter over the records of `kernels.gaussian` [W15].

A target t exists with probability r, as itself or as a source of static clutter, and has hypotheses i of weight w_i, which
are given its existence. With p_i the probability that hypothesis i is detected, q_i(z) = N(z; ẑ_i, S_i), γ̂(z) the density of
first detections and κ(z) that of false alarms,

    missed            1 − r Σ w_i p_i;  then it exists with probability r Σ w_i (1 − p_i) / (1 − r Σ w_i p_i)
    detected          r w_i p_i q_i(z), by hypothesis i
    no earlier target κ(z) + γ̂(z):  a new target with r = γ̂/(κ + γ̂)

The odds of a pair (target, measurement) are ψ = Σ_i r w_i p_i q_i(z) / (missed · (κ + γ̂)). Belief propagation
(`kernels.marginals`) turns them into the probability of each pair over all one-to-one assignments. A hypothesis after the
update is a hypothesis before it with a measurement, or with none; r is the sum of the probabilities of all of a target.

Arrays count targets (T), hypotheses (C), measurements (N) or pairs of a hypothesis and a measurement (P).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
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
Records = NDArray[np.void]

TINY = float(np.finfo(np.float64).tiny)
# A target that cannot be missed is missed with this probability: impossible, but comparable.
NEVER = 1e-15
# Deleted targets whose probability to exist was never as large are not kept for the past.
CONFIRMED = 0.05
# How well the place of static clutter can be known, as a share of the variances by which the sensor resolves states. Were it
# known better and better, a target that stands still would be explained by it better and better.
STATIC_SHARE = 0.5

# A target: the probabilities that it exists, and that it does and is not static clutter (its presence), and the greatest
# presence that it ever had; its label, rising, from 0, none given twice; its hypotheses begin … end − 1, and the heaviest of
# them that is not static, −1 where there is none.
TARGET = np.dtype([(name, "f8") for name in ("r", "presence", "max_presence")] + [
    (name, "i8") for name in ("label", "begin", "end", "best")
])  # fmt: skip
# A hypothesis: its weight, which sum to one for each target; the probability that the target cannot be detected at present;
# its target; the measurement of the frame that it took, −1 for none; its hypothesis in the frame before, −1 where the target
# begins; whether it is a source of static clutter: it stays where it is, and is no target.
HYPOTHESIS = np.dtype([(name, "f8") for name in ("weight", "occluded")] + [
    (name, "i8") for name in ("target", "detection", "parent", "static")
])  # fmt: skip


class Layer(NamedTuple):
    """The targets of one frame.

    Attributes
    ----------
    targets : (T,) of `TARGET`, by label.
    hypotheses : (C,) of `HYPOTHESIS`, by target; the heaviest first after an update.
    mean : (C, d).     covariance : (C, d, d).
    """

    targets: Records
    hypotheses: Records
    mean: F8
    covariance: F8


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


class Options(NamedTuple):
    """What targets may be after an update, those of a target together, the heaviest first.

    Attributes
    ----------
    exists : (T,) probability that the target exists.     kept : (T,) how many of its options are kept.
    source : (K,) the hypothesis before.     taken : (K,) the measurement, −1 for none.     weight : (K,) not normalised.
    """

    exists: F8
    kept: I8
    source: I8
    taken: I8
    weight: F8


@njit(**INNER)
def copy_gaussian(mean: F8, covariance: F8, i: int, out_mean: F8, out_covariance: F8, k: int) -> None:
    """Copy Gaussian i to place k. In loops: an assignment of rows would compile Numba's code for its error messages."""
    for a in range(mean.shape[1]):
        out_mean[k, a] = mean[i, a]
        for b in range(mean.shape[1]):
            out_covariance[k, a, b] = covariance[i, a, b]


@njit(**ENTRY)
def predicted_layer(layer: Layer, p: Predicted, noise: F8, occlude: float, reappear: float) -> Layer:
    """The targets after an interval; static clutter stays where it is.

    Parameters
    ----------
    layer : the targets before.
    p : their hypotheses after the motion.
    noise : (d, C) deviations by which the sensor resolves them, `Sensor.noise`.
    occlude, reappear : probabilities that a visible target is occluded after the interval, and an occluded one visible.
    """
    targets, hypotheses = layer.targets.copy(), layer.hypotheses.copy()
    mean, cov, p_survive, old_mean, old_cov = p.mean.copy(), p.covariance.copy(), p.p_survive, layer.mean, layer.covariance
    for t in range(targets.size):
        target = targets[t]
        stay = presence = 0.0
        for c in range(target.begin, target.end):
            stay += hypotheses[c].weight * p_survive[c]
        target.r *= stay
        for c in range(target.begin, target.end):
            h = hypotheses[c]
            h.parent, h.detection = c, -1
            if stay > 0.0:
                h.weight *= p_survive[c] / stay
            if h.static:
                copy_gaussian(old_mean, old_cov, c, mean, cov, c)
                for a in range(mean.shape[1]):
                    least = STATIC_SHARE * noise[a, c] * noise[a, c]
                    cov[c, a, a] = cov[c, a, a] if cov[c, a, a] > least else least
            else:
                h.occluded = h.occluded * (1.0 - reappear) + (1.0 - h.occluded) * occlude
                presence += target.r * h.weight
        target.presence = presence
    return Layer(targets, hypotheses, mean, cov)


@njit(**INNER)
def associated(layer: Layer, p_detect: F8, pairs: Pairs, alone: F8, evidence: F8) -> tuple[F8, F8, F8]:
    """(P,) probability of each pair; (T,) that a target exists and was missed; (N,) that a measurement is no target's.

    ``p_detect`` (C,) of hypotheses, ``alone`` (N,) κ + γ̂. Adds Σ r w p q to ``evidence`` (N,).
    """
    targets, hypotheses, gaussian, measurement = layer.targets, layer.hypotheses, pairs.gaussian, pairs.measurement
    count, log_density = gaussian.size, pairs.log_density
    part, odds, missed = np.empty(count), np.empty(count), np.empty(targets.size)
    edge, first, second = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    place = np.empty(alone.size, np.int64)
    for j in range(place.size):
        place[j] = -1
    # A literal zero is a type of its own.
    edges, q = 0 * count, 0 * count
    for t in range(targets.size):
        target, detected, begun = targets[t], 0.0, edges
        for c in range(target.begin, target.end):
            detected += hypotheses[c].weight * p_detect[c]
        miss = max(1.0 - target.r * detected, NEVER)
        missed[t] = min(max(target.r * (1.0 - detected), 0.0) / miss, 1.0)
        while q < count and gaussian[q] < target.end:
            c, j = gaussian[q], measurement[q]
            joint = target.r * hypotheses[c].weight * p_detect[c] * np.exp(log_density[q])
            evidence[j] += joint
            if place[j] < begun:
                place[j], first[edges], second[edges], odds[edges] = edges, t, j, 0.0
                edges += 1
            part[q], edge[q] = joint / (miss * alone[j]), place[j]
            odds[place[j]] += part[q]
            q += 1
    belief, nothing, p_new = beliefs(odds, first, second, edges, targets.size, alone.size)
    for t in range(targets.size):
        missed[t] *= nothing[t]
    for q in range(count):
        if odds[edge[q]] > 0.0:
            part[q] = belief[edge[q]] * part[q] / odds[edge[q]]
    return part, missed, p_new


@njit(**INNER)
def options_kept(layer: Layer, p_detect: F8, pairs: Pairs, probability: F8, missed: F8, s: Settings) -> Options:
    """The options of each target that are above the thresholds; none of targets that are deleted.

    ``p_detect`` (C,) of hypotheses, ``probability`` (P,) and ``missed`` (T,) as of `associated`.
    """
    targets, hypotheses, gaussian, measurement = layer.targets, layer.hypotheses, pairs.gaussian, pairs.measurement
    exists, count, room = np.empty(targets.size), np.empty(targets.size, np.int64), hypotheses.size + gaussian.size
    source, taken, weight = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
    q, k = 0 * room, 0 * room
    for t in range(targets.size):
        target, first, end, total, unseen = targets[t], k, k, missed[t], 0.0
        begun = q
        for c in range(target.begin, target.end):
            unseen += hypotheses[c].weight * (1.0 - p_detect[c])
        while q < gaussian.size and gaussian[q] < target.end:
            total, q = total + probability[q], q + 1
        # First those with a measurement, then those without, each sorted in, the heaviest first.
        for o in range(q - begun + target.end - target.begin):
            i, j, value, place = begun + o, -1, 0.0, end
            if i < q:
                i, j, value = gaussian[i], measurement[i], probability[i]
            else:
                i += target.begin - q
                if unseen > 0.0:
                    value = missed[t] * hypotheses[i].weight * (1.0 - p_detect[i]) / unseen
            while place > k and weight[place - 1] < value:
                source[place], taken[place], weight[place] = source[place - 1], taken[place - 1], weight[place - 1]
                place -= 1
            source[place], taken[place], weight[place] = i, j, value
            end += 1
        exists[t], least = min(total, 1.0), s.hypothesis_threshold * total
        # A target whose probability has just risen may have begun, however rare births are beside false alarms.
        if total >= s.existence_threshold or total > target.r:
            while k < end and k - first < s.max_hypotheses and weight[k] > 0.0 and weight[k] >= least:
                k += 1
        count[t] = k - first
    return Options(exists, count, source[:k], taken[:k], weight[:k])


@njit(**INNER)
def heavier_like(hypotheses: Records, mean: F8, cov: F8, begin: int, k: int, limit: float) -> int:
    """The first of the hypotheses begin … k − 1 of the kind of k and within √``limit`` of its own deviations; k for none."""
    for i in range(begin, k):
        distance2 = 0.0
        for a in range(mean.shape[1]):
            step = mean[i, a] - mean[k, a]
            distance2 += step * step / max(cov[i, a, a], 1e-12)
        if hypotheses[i].static == hypotheses[k].static and distance2 < limit:
            return i
    return k


@njit(**INNER)
def write_kept(layer: Layer, p_detect: F8, options: Options, limit: float, out: Layer) -> tuple[int, int]:
    """Write the targets that are kept into the first places of ``out``; how many targets and hypotheses there are.

    ``out`` has the Gaussians of the options with a measurement. Hypotheses within √``limit`` deviations of a heavier one are
    counted as that one. ``p_detect`` (C,) of hypotheses.
    """
    targets, hypotheses, mean, cov = out
    old_targets, old, old_mean, old_cov = layer
    exists, count, source, taken, weight = options
    number, k, end = 0 * count.size, 0 * count.size, 0 * count.size
    for t in range(count.size):
        total, begin, option, end = 0.0, k, end, end + count[t]
        for i in range(option, end):
            total += weight[i]
        for i in range(option, end):
            c, j, h = source[i], taken[i], hypotheses[k]
            h.static, h.parent, h.detection, h.target, h.occluded = old[c].static, old[c].parent, j, number, 0.0
            if j < 0:
                copy_gaussian(old_mean, old_cov, c, mean, cov, k)
                if not h.static:
                    h.occluded = min(old[c].occluded / max(1.0 - p_detect[c], TINY), 1.0)
            elif k < i:
                copy_gaussian(mean, cov, i, mean, cov, k)
            heavier = heavier_like(hypotheses, mean, cov, begin, k, limit)
            if heavier < k:
                hypotheses[heavier].weight += weight[i] / total
            else:
                h.weight = weight[i] / total
                k += 1
        if k > begin:
            before = old_targets[t]
            write_target(targets, hypotheses, number, before.label, exists[t], before.max_presence, begin, k)
            number += 1
    return number, k


@njit(**INNER)
def write_target(
    targets: Records, hypotheses: Records, t: int, label: int, r: float, max_presence: float, begin: int, end: int
) -> None:
    """Write target t, whose hypotheses are written; ``max_presence`` is the greatest before."""
    target, total, best = targets[t], 0.0, -1
    for c in range(begin, end):
        h = hypotheses[c]
        if not h.static:
            total += h.weight
            if best < 0 or h.weight > hypotheses[best].weight:
                best = c
    target.label, target.r, target.begin, target.end, target.best = label, r, begin, end, best
    target.presence, target.max_presence = r * total, r * total if r * total > max_presence else max_presence


@njit(**INNER)
def write_new(r_new: F8, new: NewTargets, prior: float, fresh: int, t: int, k: int, out: Layer) -> int:
    """Write the new targets, of r above 0, from places t and k of ``out`` on; how many hypotheses there are then.

    They come in the order of the measurements and are labelled from ``fresh`` on; ``prior`` is that of static clutter.
    """
    targets, hypotheses, mean, cov = out
    new_mean, new_cov = new.mean, new.covariance
    for j in range(r_new.size):
        if r_new[j] > 0.0:
            begin = k
            for kind in range(2 if prior > 0.0 else 1):
                h = hypotheses[k]
                h.weight, h.static, h.occluded = prior if kind == 1 else 1.0 - prior, kind == 1, 0.0
                h.target, h.detection, h.parent = t, j, -1
                copy_gaussian(new_mean, new_cov, j, mean, cov, k)
                k += 1
            write_target(targets, hypotheses, t, fresh, r_new[j], 0.0, begin, k)
            t, fresh = t + 1, fresh + 1
    return k


@njit(**INNER)
def still_ended(layer: Layer, count: I8, past: tuple[I8, int, int]) -> I8:
    """(E, 2) frame and hypothesis of targets that were once confirmed and have been deleted within the history.

    ``count`` (T,) is how many hypotheses are kept of each target.
    """
    ended, frame, history = past
    out, k = np.empty((len(ended) + count.size, 2), np.int64), 0 * frame
    for e in range(len(ended)):
        if frame - ended[e, 0] <= history:
            out[k, 0], out[k, 1] = ended[e, 0], ended[e, 1]
            k += 1
    for t in range(count.size):
        target = layer.targets[t]
        if count[t] == 0 and target.max_presence >= CONFIRMED and target.best >= 0:
            parent = layer.hypotheses[target.best].parent
            if parent >= 0:
                out[k, 0], out[k, 1] = frame - 1, parent
                k += 1
    return out[:k]


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
    s : settings; hypotheses of a target that become the same are one.
    fresh : the label that the next new target is given.
    past : (E, 2) frame and hypothesis of targets that have ended, the number of this frame, and how many frames are kept.
    """
    hypotheses, clutter, density, prior = layer.hypotheses, m.clutter, new.density, s.static_clutter_prior
    n = density.size
    p_detect, alone, evidence, false, r_new = np.empty(hypotheses.size), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for c in range(p_detect.size):
        h = hypotheses[c]
        p_detect[c] = s.static_detection_probability if h.static else (1.0 - h.occluded) * e.p_detect[c]
    for j in range(n):
        evidence[j] = clutter[j] + density[j]
        alone[j] = max(evidence[j], TINY)
    pairs = gated(e, m, places_of(m), s.gate, p_detect)
    probability, missed, p_new = associated(layer, p_detect, pairs, alone, evidence)
    options = options_kept(layer, p_detect, pairs, probability, missed, s)
    born, started, vanished, predicted, mass = 0.0, 0 * fresh, 0 * fresh, 0.0, 0.0
    for j in range(n):
        p_target = density[j] / alone[j]
        r_new[j] = p_new[j] * p_target
        born += p_new[j] * density[j] / alone[j] * (1.0 - prior)
        false[j] = p_new[j] * clutter[j] / alone[j] + p_new[j] * density[j] / alone[j] * prior
        if r_new[j] < min(s.existence_threshold, 0.5 * p_target):
            r_new[j] = 0.0
        started += r_new[j] > 0.0
    room, d = options.source.size + 2 * started, layer.mean.shape[1]
    mean, cov = np.empty((room, d)), np.empty((room, d, d))
    write_posteriors(layer.mean, layer.covariance, e, m, options.source, options.taken, mean, cov, 0)
    out = Layer(np.empty(layer.targets.size + started, TARGET), np.empty(room, HYPOTHESIS), mean, cov)
    t, k = write_kept(layer, p_detect, options, s.merge_distance * s.merge_distance, out)
    k = write_new(r_new, new, prior, fresh, t, k, out)
    out = Layer(out.targets[: t + started], out.hypotheses[:k], out.mean[:k], out.covariance[:k])
    for q in range(probability.size):
        if hypotheses[pairs.gaussian[q]].static:
            false[pairs.measurement[q]] += probability[q]
    for j in range(n):
        vanished += evidence[j] == 0.0
        false[j] *= evidence[j]
        evidence[j] -= false[j]
    for i in range(layer.targets.size):
        predicted += layer.targets[i].presence
    for i in range(out.targets.size):
        mass += out.targets[i].presence
    info = Summary(born + predicted, born, mass, vanished, evidence, false)
    return out, info, still_ended(layer, options.kept, past)


class Trace(NamedTuple):
    """Which hypothesis of a frame leads to the one that is best today, for each of its targets: ``place`` (T,), −1 for none,
    and ``presence`` (T,), the greatest from that frame on."""

    place: I8
    presence: F8


@njit(**INNER)
def followed_back(trace: Trace, after: Records, then: Layer, ended: I8, frame: int) -> Trace:
    """The trace a frame earlier, with the targets that ended after it."""
    targets, hypotheses = then.targets, then.hypotheses
    place, presence = np.empty(targets.size, np.int64), np.empty(targets.size)
    for t in range(place.size):
        place[t], presence[t] = -1, targets[t].presence
    for i in range(trace.place.size):
        p = after[trace.place[i]].parent if trace.place[i] >= 0 else -1
        if p >= 0:
            t = hypotheses[p].target
            place[t], presence[t] = p, max(trace.presence[i], presence[t])
    for e in range(len(ended)):
        if ended[e, 0] == frame:
            place[hypotheses[ended[e, 1]].target] = ended[e, 1]
    return Trace(place, presence)


@njit(**ENTRY)
def earlier(
    now: Trace, before: Trace, after: Layer, then: Layer, past: tuple[I8, int], present: bool, min_weight: float
) -> tuple[Trace, Trace, bool]:
    """The traces a frame earlier, as seen now and as seen a frame ago, and whether both report the same up to there.

    Parameters
    ----------
    now, before : traces of the frame after it.
    after, then : the targets of the frame after it, and of the frame.
    past : (E, 2) frame and hypothesis of targets that have ended, and the number of the frame.
    present : the frame after it is the present one: ``before`` is given of the frame itself.
    min_weight : presence from which a target is reported. Both report the same where all targets that are reported, or
        may be in an earlier frame, have the same hypotheses and are reported in both or in none: their pasts are the same.
    """
    ended, frame = past
    now = followed_back(now, after.hypotheses, then, ended, frame)
    if not present:
        before = followed_back(before, after.hypotheses, then, ended, frame)
    for t in range(now.place.size):
        seen, was_seen, ever = now.presence[t] >= min_weight, before.presence[t] >= min_weight, then.targets[t].max_presence
        one = now.place[t] >= 0 and (seen or ever >= min_weight)
        other = before.place[t] >= 0 and (was_seen or ever >= min_weight)
        if one != other or (one and (now.place[t] != before.place[t] or seen != was_seen)):
            return now, before, False
    return now, before, True
