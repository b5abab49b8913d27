"""The Poisson multi-Bernoulli filter over the records of `kernels.gaussian` [W15; PMB (1), (3),
(4), (7)–(14)].

A target t exists with probability r, as itself or as a source of static clutter, and has hypotheses
i of weight w_i, which are given its existence. With p_i the probability that hypothesis i is
detected, q_i(z) = N(z; ẑ_i, S_i), λ̂(z) the density of first detections and κ(z) that of false
alarms,

    missed             1 − r Σ w_i p_i;  then it exists with probability
                       r Σ w_i (1 − p_i) / (1 − r Σ w_i p_i)
    detected           r w_i p_i q_i(z), by hypothesis i
    no earlier target  κ(z) + λ̂(z):  a new target with r = λ̂/(κ + λ̂)

The odds of a pair (target, measurement) are ψ = Σ_i r w_i p_i q_i(z) / (missed · (κ + λ̂)). Belief
propagation (`kernels.association`) turns them into the probability of each pair over all one-to-one
assignments. A hypothesis after the update is a hypothesis before it with a measurement, or with
none; r is the sum of the probabilities of all of a target. Docstrings have the numbers of the
equations in docs/methods.md, Poisson multi-Bernoulli, as tags: PMB and the number.

Arrays count targets (T), hypotheses (C), measurements (N) or pairs of a hypothesis and a
measurement (P).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from phdtrack.kernels import F4, F8, I8, Bool, Records
from phdtrack.kernels.appearance import (
    Looks,
    Pasts,
    named,
    pair_ratios,
    past_directions,
    pasts_after,
)
from phdtrack.kernels.association import EDGE, beliefs
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import INNER, MERGED
from phdtrack.kernels.gaussian import (
    PAIR,
    Expected,
    Measurements,
    NewTargets,
    Predicted,
    copy_gaussian,
    gated,
    records,
    write_posteriors,
)
from phdtrack.kernels.jumps import Jumps, jumping, merged_pairs, of_jumped, with_jumps
from phdtrack.kernels.small_arrays import flags, minus_ones
from phdtrack.kernels.verdicts import DOUBTFUL, write_verdicts

TINY = float(np.finfo(np.float64).tiny)
# Log odds of what is certain, in double precision.
CERTAIN = 40.0
# Largest log odds that scores alone give: so much is forgotten again when they change.
LIMIT = 8.0
# A target whose scores have raised these log odds by so much is genuine for good: lower ones later
# say that it is hidden.
PROVED = 3.0
# A target that cannot be missed is missed with this probability: impossible, but comparable.
NEVER = 1e-15
# A new velocity is tried if, as a share of the threshold of existence, so probable.
UNLIKELY = 0.003
# Deleted targets whose probability to exist was never as large are not kept for the past.
CONFIRMED = 0.05
# How well the place of static clutter can be known, as a share of the variances by which the sensor
# resolves states. Were it known better and better, a target that stands still would be explained by
# it better and better.
STATIC_SHARE = 0.1

# A target: the probabilities that it exists, and that it does and is no clutter (its presence), and
# the greatest presence that it ever had; its label, rising, from 0, unique; its hypotheses begin …
# end − 1, and the heaviest of them that moves, −1 where there is none.
TARGET = records("r presence max_presence", "label begin end best")
# A hypothesis: its weight, which sum to one for each target; the probability that the target cannot
# be detected at present; the log odds that it is genuine, and no static or lasting clutter; its
# target; the measurement of the frame that it took, −1 for none; its hypothesis in the frame
# before, −1 where the target begins; whether it stands still, as static clutter does and some
# targets. How many times the model's the variances of its noises are, of the first two components
# of a measurement and of two others, and the degrees of freedom of that; which of the factors its
# acceleration has; which of the pasts of `kernels.appearance` is its own, −1 for none.
HYPOTHESIS = records(
    "weight occluded genuine position_scale size_scale freedom",
    "target detection parent static motion past",
)


class Layer(NamedTuple):
    """The targets of one frame.

    ``targets`` (T,) of `TARGET`, by label; ``hypotheses`` (C,) of `HYPOTHESIS`, by target, the
    heaviest first after an update, with ``mean`` (C, d) and ``covariance`` (C, d, d).
    """

    targets: Records
    hypotheses: Records
    mean: F8
    covariance: F8


class Scores(NamedTuple):
    """The evidence of the scores of a frame's measurements.

    ``odds`` (N,): p(s|target)/p(s|false alarm). ``log_odds`` (N,): log p(s|target)/p(s|lasting
    false alarm). ``prior``: log odds that a new target is genuine, and no lasting false alarm;
    `CERTAIN` where there are none. ``missing``: the probabilities that a target that is visible and
    a lasting false alarm are not detected; 0 and 0 where this is not known.
    """

    odds: F8
    log_odds: F8
    prior: float
    missing: tuple[float, float]


class Settings(NamedTuple):
    """The settings of `filters.PMB` that an update needs; ``gate`` in deviations,
    ``merge_distance`` 0 to merge nothing. ``standing_prior``: the probability that what is first
    detected stands still; ``standing_genuine``: the log odds that it is then a target.
    ``detection_odds``: how many times the sensor's the odds of p_D are; ``standing_odds``: those of
    targets that stand still.
    """

    existence_threshold: float
    hypothesis_threshold: float
    max_hypotheses: float
    merge_distance: float
    gate: float
    standing_prior: float
    standing_genuine: float
    detection_odds: float
    standing_odds: float
    static_detection_probability: float
    noise_freedom: float
    motions: int


@njit(**MERGED)
def predicted_layer(
    layer: Layer,
    p: Predicted,
    noise: F8,
    occlude: float,
    reappear: float,
    stand: float,
    freedom: tuple[float, float],
    genuine: tuple[float, float],
) -> Layer:
    """The targets after an interval, ``p`` their hypotheses after the motion; what stands still
    stays where it is [PMB (1)].

    ``noise`` (d, C): deviations by which the sensor resolves them, `Sensor.noise`. ``occlude``,
    ``reappear``: probabilities that a visible target is occluded after the interval, and an
    occluded one visible. ``stand``: the logarithm of the probability that a target that stands
    still still does. ``freedom``: the degrees of freedom with which a target's noises begin, 0
    where they are the model's, and the part of what is known of them that is kept; in place of the
    rest they are the model's again.
    ``genuine``: the log odds with which a target is genuine before its scores are known, and the
    part kept of the evidence of scores.
    """
    start, kept = freedom
    prior, remembered = genuine
    before, old, old_mean, old_cov = layer
    moved_mean, moved_cov, p_survive = p
    targets = np.empty(before.size, TARGET)
    hypotheses = np.empty(old.size, HYPOTHESIS)
    mean = np.empty(old_mean.shape)
    cov = np.empty(old_cov.shape)
    for t in range(targets.size):
        targets[t] = before[t]
        target = targets[t]
        stay = 0.0
        for c in range(target.begin, target.end):
            stay += old[c].weight * p_survive[c]
        target.r *= stay
        for c in range(target.begin, target.end):
            hypotheses[c] = old[c]
            h = hypotheses[c]
            h.parent = c
            h.detection = -1
            if start > 0.0:
                known = kept * h.freedom
                h.freedom = known + (1.0 - kept) * start
                h.position_scale = 1.0 + (h.position_scale - 1.0) * known / h.freedom
                h.size_scale = 1.0 + (h.size_scale - 1.0) * known / h.freedom
            if stay > 0.0:
                h.weight *= p_survive[c] / stay
            if h.static:
                copy_gaussian(old_mean, old_cov, c, mean, cov, c)
                for a in range(old_mean.shape[1]):
                    least = STATIC_SHARE * noise[a, c] * noise[a, c]
                    cov[c, a, a] = cov[c, a, a] if cov[c, a, a] > least else least
            else:
                copy_gaussian(moved_mean, moved_cov, c, mean, cov, c)
                if h.genuine < prior + PROVED:
                    h.genuine = prior + remembered * (h.genuine - prior)
            h.occluded = h.occluded * (1.0 - reappear) + (1.0 - h.occluded) * occlude
        _depart(target, hypotheses, stand)
        target.presence = _presence(target, hypotheses)
    return Layer(targets, hypotheses, mean, cov)


@njit(**INNER)
def _presence(target: Any, hypotheses: Records) -> float:
    """The probability that a target exists and is no clutter."""
    presence = 0.0
    for c in range(target.begin, target.end):
        presence += target.r * hypotheses[c].weight * probability(hypotheses[c].genuine)
    return presence


@njit(**INNER)
def _depart(target: Any, hypotheses: Records, stand: float) -> None:
    """Move the weight of a standing target that begins to move by now to its hypotheses that move
    [PMB (11)]. ``stand``: the logarithm of the probability that it does not.
    """
    depart = -math.expm1(stand)
    moving = 0.0
    moves = 0.0
    for c in range(target.begin, target.end):
        h = hypotheses[c]
        if not h.static:
            moving += h.weight
    if not moving > 0.0:
        return
    for c in range(target.begin, target.end):
        h = hypotheses[c]
        if h.static:
            genuine = probability(h.genuine)
            part = h.weight * genuine * depart
            moves += part
            h.weight -= part
            if genuine < 1.0:
                h.genuine = _within(h.genuine + stand)
    for c in range(target.begin, target.end):
        h = hypotheses[c]
        if not h.static:
            h.weight += moves * h.weight / moving


@njit(**MERGED)
def updated_layer(
    layer: Layer,
    e: Expected,
    m: Measurements,
    new: NewTargets,
    scores: Scores,
    s: Settings,
    fresh: int,
    jumps: Jumps,
    appearance: tuple[Pasts, Looks] | None,
) -> tuple[
    Layer,
    tuple[float, float, float, F8, F8, int, float],
    I8,
    F8,
    tuple[float, float, float],
    I8,
    tuple[Records, F4] | None,
]:
    """The targets after the measurements, with new ones, and what was learned [PMB (3), (4),
    (7)–(10), (12)–(15)].

    Parameters
    ----------
    layer, e : the predicted targets, and the measurements that they predict.
    m, scores : the measurements with κ(z), and what their scores say.
    new : the targets whose first detections these would be, which are labelled from ``fresh`` on.
    s : settings of the filter.
    jumps : how velocities may be new.
    appearance : what hypotheses have seen of their targets, and what the measurements look like;
        None where this is not known: then nothing that compares it is compiled.

    Returns
    -------
    The targets; of `types.UpdateInfo` the predicted, the newborn and the updated mass, C(z), the
    probabilities of false alarms, ``vanished`` and ``detected``; the best hypothesis of the frame
    before of each target that was once confirmed and has been deleted; (T,) the probabilities with
    which deleted targets exist, 0 of others; what `_detections` counts; `types.UpdateInfo.sure`;
    and `Pasts` after the frame.
    """
    layer = Layer(*layer)
    e = Expected(*e)
    m = Measurements(*m)
    new = NewTargets(*new)
    scores = Scores(*scores)
    s = Settings(*s)
    jumps = Jumps(*jumps)
    targets, hypotheses, mean, covariance = layer
    count = len(targets)
    p_detect, visible, tails, genuine = _detection_terms(hypotheses, e.p_detect, s)
    # Gate
    pairs = _gated(e, m, s.gate, p_detect, tails)
    # Give new velocities to targets that nothing is near
    jump = flags(count, False)
    if len(jumps.speed) > 0:
        least = UNLIKELY * s.existence_threshold
        jump, some = jumping(targets, mean, covariance, pairs, e, m.z, jumps, least)
        if some:
            targets, hypotheses, mean, covariance, e = with_jumps(
                (targets, hypotheses, mean, covariance), jump, e, jumps
            )
            layer = Layer(targets, hypotheses, mean, covariance)
            p_detect, visible, tails, genuine = _detection_terms(hypotheses, e.p_detect, s)
            more = _gated(e, m, s.gate, of_jumped(targets, jump, p_detect), tails)
            pairs = merged_pairs(pairs, more, targets, jump)
    # Associate
    exists = np.empty(count)
    measured = np.empty((3, len(m.z)))
    directions, compared = _compared(appearance, pairs, hypotheses, count)
    born, vanished, started = _associate(
        (targets, hypotheses, p_detect),
        genuine,
        pairs,
        compared,
        exists,
        m.clutter,
        new.density,
        scores,
        s,
        measured,
    )
    counted = _detections(
        (targets, hypotheses, p_detect), genuine, visible, e.p_detect, pairs, exists
    )
    predicted, detected = _expected(targets, hypotheses, p_detect)
    # Update each hypothesis with each of its measurements, and keep the most probable
    options = np.empty(len(hypotheses) + len(pairs), PAIR)
    kept = np.empty(count, np.int64)
    k = _choose((targets, hypotheses, p_detect), pairs, exists, jump, s, options, kept)
    room = k + (1 + s.motions) * started
    out = Layer(
        np.empty(count + started, TARGET),
        np.empty(room, HYPOTHESIS),
        np.empty((room, mean.shape[1])),
        np.empty((room, mean.shape[1], mean.shape[1])),
    )
    write_posteriors(mean, covariance, e, m, options[:k], out.mean, out.covariance)
    gone = np.empty(count, np.int64)
    t, k, lost, mass = _write_kept(
        (layer, visible), exists, kept, options, scores, s, len(m.period) > 2, out, gone
    )
    for i in range(count):
        if kept[i] > 0:
            exists[i] = 0.0
    # Add the new targets
    k, mass = _write_new(measured[2], (new.mean, new.covariance), scores, s, fresh, t, k, mass, out)
    return (
        Layer(out.targets[: t + started], out.hypotheses[:k], out.mean[:k], out.covariance[:k]),
        (born + predicted, born, mass, measured[0], measured[1], vanished, detected),
        gone[:lost],
        exists,
        counted,
        _sure(targets, compared[1]),
        _pasts(appearance, directions, out.hypotheses[:k]),
    )


@njit(**INNER)
def _compared(
    appearance: tuple[Pasts, Looks] | None, pairs: Records, hypotheses: Records, count: int
) -> tuple[F4, tuple[F8, I8]]:
    """The directions of the pasts; and the log-likelihood ratios of the pairs, and room for
    `write_verdicts` on ``count`` targets, all empty where nothing is known.
    """
    verdicts = np.empty(0, np.int64)
    ratio = np.empty(0)
    directions = np.empty((0, 0), np.float32)
    # If the argument is None, Numba leaves this out, and compiles nothing that is called here.
    if appearance is not None:
        pasts = Pasts(*appearance[0])
        looks = named(appearance[1])
        directions = past_directions(pasts, looks)
        ratio = pair_ratios(pairs, hypotheses, pasts, looks, directions)
        verdicts = np.empty(count if len(looks.mean) > 0 else 0, np.int64)
    return directions, (ratio, verdicts)


@njit(**INNER)
def _pasts(
    appearance: tuple[Pasts, Looks] | None, directions: F4, hypotheses: Records
) -> tuple[Records, F4] | None:
    """The `Pasts` of the updated hypotheses; those of before where nothing is seen, None where
    nothing is known.
    """
    if appearance is not None:
        pasts = Pasts(*appearance[0])
        looks = named(appearance[1])
        after: tuple[Records, F4] = pasts.rows, pasts.looks
        if len(looks.free) > 0:
            after = pasts_after(hypotheses, pasts, looks, directions)
        return after
    return None


@njit(**INNER)
def _sure(targets: Records, verdicts: I8) -> I8:
    """`types.UpdateInfo.sure` by the ``verdicts`` on targets."""
    out = np.empty((verdicts.size, 2), np.int64)
    n = 0
    for t in range(verdicts.size):
        if verdicts[t] != DOUBTFUL and targets[t].presence >= 0.5:
            out[n, 0] = targets[t].label
            out[n, 1] = verdicts[t]
            n += 1
    return out[:n]


@njit(**INNER)
def _gated(e: Expected, m: Measurements, gate: float, active: F8, tails: F8) -> Records:
    """The pairs of `gaussian.gated`."""
    pairs: Records
    pairs = gated(e.rows, e.z, e.covariance, e.noise, m.z, m.noise, m.period, gate, active, tails)
    return pairs


@njit(**INNER)
def _expected(targets: Records, hypotheses: Records, p_detect: F8) -> tuple[float, float]:
    """The mass of the targets, and how many of the measurements they are expected to have."""
    mass = 0.0
    detected = 0.0
    for t in range(targets.size):
        mass += targets[t].presence
        for c in range(targets[t].begin, targets[t].end):
            detected += targets[t].r * hypotheses[c].weight * p_detect[c]
    return mass, detected


@njit(**INNER)
def _detections(
    before: tuple[Records, Records, F8],
    genuine: F8,
    visible: F8,
    p_detect: F8,
    pairs: Records,
    exists: F8,
) -> tuple[float, float, float]:
    """Number of detections of targets that move and are not occluded, of chances to detect them,
    and of detections that the sensor's ``p_detect`` (C,) expects [PMB (14)].

    ``before``, ``genuine``, ``pairs`` and ``exists`` are as of `_associate`, after it. What stands
    still may be clutter and tells nothing.
    """
    targets, hypotheses, own = before
    hits = 0.0
    chances = 0.0
    expected = 0.0
    for q in range(pairs.size):
        c = pairs[q].gaussian
        if not hypotheses[c].static:
            weight = pairs[q].weight * genuine[c]
            hits += weight
            chances += weight
            expected += weight * p_detect[c]
    for t in range(targets.size):
        target = targets[t]
        unseen = 0.0
        for c in range(target.begin, target.end):
            unseen += hypotheses[c].weight * (1.0 - own[c])
        if unseen > 0.0:
            for c in range(target.begin, target.end):
                h = hypotheses[c]
                if not h.static:
                    # Missed, and yet not occluded.
                    missed = h.weight * (1.0 - h.occluded - visible[c])
                    weight = exists[t] / unseen * missed * genuine[c]
                    chances += weight
                    expected += weight * p_detect[c]
    return hits, chances, expected


@njit(**INNER)
def _detection_terms(hypotheses: Records, p_detect: F8, s: Settings) -> tuple[F8, F8, F8, F8]:
    """(C,) p_D of each hypothesis, which may be occluded or static clutter [PMB (12)]; (C,) p_D of
    a target that may be occluded; (C, 3) what is known of its noises, (0, 3) if they are the
    model's; and (C,) the probability that it is genuine.

    ``p_detect`` (C,) is the sensor's.
    """
    own = np.empty(len(hypotheses))
    visible = np.empty(len(hypotheses))
    genuine = np.empty(len(hypotheses))
    tails = np.empty((len(hypotheses) if s.noise_freedom > 0.0 else 0, 3))
    for c in range(len(hypotheses)):
        h = hypotheses[c]
        odds = s.standing_odds if h.static else s.detection_odds
        p = odds * p_detect[c] / (1.0 + (odds - 1.0) * p_detect[c])
        visible[c] = (1.0 - h.occluded) * p
        own[c] = visible[c]
        genuine[c] = probability(h.genuine)
        if h.static:
            clutter = (1.0 - genuine[c]) * s.static_detection_probability
            own[c] = genuine[c] * visible[c] + clutter
        if s.noise_freedom > 0.0:
            tails[c, 0] = h.position_scale
            tails[c, 1] = h.size_scale
            tails[c, 2] = h.freedom
    return own, visible, tails, genuine


@njit(**INNER)
def _associate(
    before: tuple[Records, Records, F8],
    genuine: F8,
    pairs: Records,
    appearance: tuple[F8, I8],
    exists: F8,
    clutter: F8,
    density: F8,
    scores: Scores,
    s: Settings,
    measured: F8,
) -> tuple[float, int, int]:
    """Write the probability of each pair as its weight, and those that a target exists and was
    missed into ``exists`` (T,); compute the new targets [PMB (7)].

    ``before`` are the targets, their hypotheses and the p_D of these, ``genuine`` (C,) the
    probabilities that these are no clutter; ``clutter`` and ``density`` (N,) are κ and λ̂.
    ``appearance``: the log-likelihood ratios (P,) of the pairs, (0,) for none, and (T,) for
    `write_verdicts`, (0,) where none are wanted. Writes into ``measured`` (3, N) C(z), the
    probability of a false alarm, and the probability that a new target exists. Returns the mass of
    new targets, how many measurements have κ + C = 0, and how many begin a target.
    """
    evidence = measured[0]
    false_alarm = measured[1]
    r_new = measured[2]
    first = np.empty(clutter.size)
    prior = probability(scores.prior)
    static = s.standing_prior * (1.0 - probability(s.standing_genuine))
    for j in range(clutter.size):
        first[j] = density[j] * (1.0 + prior * (scores.odds[j] - 1.0))
        evidence[j] = clutter[j] + first[j]
    p_new = _weigh(before, genuine, pairs, appearance, exists, scores.odds, evidence)
    born = 0.0
    vanished = 0
    started = 0
    for j in range(clutter.size):
        alone = clutter[j] + first[j]
        alone = alone if alone > TINY else TINY
        p_target = first[j] / alone
        r_new[j] = p_new[j] * p_target
        p_real = (1.0 - static) * probability(after_score(scores.prior, scores, j))
        born += p_new[j] * p_target * p_real
        false_alarm[j] = p_new[j] * (clutter[j] / alone + p_target * (1.0 - p_real))
        if r_new[j] < s.existence_threshold and r_new[j] < 0.5 * p_target:
            r_new[j] = 0.0
        started += r_new[j] > 0.0
    for q in range(pairs.size):
        share = 1.0 - genuine[pairs[q].gaussian]
        false_alarm[pairs[q].measurement] += pairs[q].weight * share
    for j in range(clutter.size):
        if evidence[j] == 0.0:
            vanished += 1
            false_alarm[j] = 1.0
        evidence[j] -= clutter[j]
    return born, vanished, started


@njit(**INNER)
def _weigh(
    before: tuple[Records, Records, F8],
    genuine: F8,
    pairs: Records,
    appearance: tuple[F8, I8],
    missed: F8,
    odds: F8,
    evidence: F8,
) -> F8:
    """(N,) probability that a measurement is no target's, by the odds ψ of the pairs [PMB (4)]; the
    others are written as by `_associate`.

    ``odds`` (N,) are p(s|target)/p(s|false alarm). ``evidence`` is κ + λ̂, to which Σ r w p q
    p(s)/p(s|false alarm) is added; a lasting false alarm has the scores of false alarms.
    """
    targets, hypotheses, p_detect = before
    ratio, verdicts = appearance
    edges = np.empty(pairs.size, EDGE)
    by_motion = np.empty(pairs.size)
    place = minus_ones(evidence.size)
    edge_of = np.empty(pairs.size, np.int64)
    alone = _at_least(evidence, TINY)
    # A literal zero is a type of its own.
    count = 0 * pairs.size
    q = 0 * pairs.size
    for t in range(targets.size):
        target = targets[t]
        begun = count
        miss, missed[t] = _missed(target, hypotheses, p_detect)
        while q < pairs.size and pairs[q].gaussian < target.end:
            pair = pairs[q]
            c = pair.gaussian
            j = pair.measurement
            scored = 1.0 + genuine[c] * (odds[j] - 1.0)
            joint = (
                target.r * hypotheses[c].weight * p_detect[c] * np.exp(pair.log_density) * scored
            )
            if place[j] < begun:
                place[j] = count
                _write_edge(edges[count], t, j)
                by_motion[count] = 0.0
                count += 1
            by_motion[place[j]] += joint / (miss * alone[j])
            if len(ratio) > 0:
                joint *= np.exp(ratio[q])
            evidence[j] += joint
            pair.weight = joint / (miss * alone[j])
            edge_of[q] = place[j]
            edges[place[j]].odds += pair.weight
            q += 1
    write_verdicts(edges[:count], by_motion, alone.size, verdicts)
    p_new: F8
    nothing, p_new = beliefs(edges[:count], targets.size, alone.size)
    for t in range(targets.size):
        missed[t] *= nothing[t]
    _share(edges, edge_of, pairs)
    return p_new


@njit(**INNER)
def _at_least(numbers: F8, least: float) -> F8:
    """The numbers (n,), none below ``least``."""
    out = np.empty(numbers.size)
    for j in range(numbers.size):
        out[j] = numbers[j] if numbers[j] > least else least
    return out


@njit(**INNER)
def _write_edge(edge: Any, target: int, measurement: int) -> None:
    """Begin the edge of a target and a measurement."""
    edge.target = target
    edge.measurement = measurement
    edge.odds = 0.0


@njit(**INNER)
def _share(edges: Records, edge_of: I8, pairs: Records) -> None:
    """Share the probability of each edge among its pairs, by their odds."""
    for q in range(pairs.size):
        edge = edges[edge_of[q]]
        if edge.odds > 0.0:
            pairs[q].weight = edge.mu * pairs[q].weight / edge.odds


@njit(**INNER)
def _missed(target: Any, hypotheses: Records, p_detect: F8) -> tuple[float, float]:
    """The probability that a target is not detected, 1 − r Σ w p, and that it then exists
    [PMB (3)].
    """
    detected = 0.0
    for c in range(target.begin, target.end):
        detected += hypotheses[c].weight * p_detect[c]
    miss = 1.0 - target.r * detected
    if miss <= NEVER:
        miss = NEVER
    if detected >= 1.0:
        return miss, 0.0
    exists = target.r * (1.0 - detected) / miss
    return miss, exists if exists < 1.0 else 1.0


@njit(**INNER)
def _choose(
    before: tuple[Records, Records, F8],
    pairs: Records,
    exists: F8,
    jump: Bool,
    s: Settings,
    options: Records,
    kept: I8,
) -> int:
    """Write the options of each target that are above the thresholds, the heaviest first, and the
    probability that it exists [PMB (10)]; how many options there are.

    An option is a `PAIR` of the hypothesis before and its measurement, −1 for none; its weight is
    not normalised. ``kept`` (T,) becomes how many options each target has, and ``exists`` (T,), as
    by `_associate`, the probability that it exists.
    """
    targets, hypotheses, p_detect = before
    q = 0 * pairs.size
    k = 0 * pairs.size
    # A literal number is a type of its own.
    none = q - 1
    for t in range(targets.size):
        target = targets[t]
        total = exists[t]
        unseen = 0.0
        begun = q
        end = k
        for c in range(target.begin, target.end):
            unseen += hypotheses[c].weight * (1.0 - p_detect[c])
        while q < pairs.size and pairs[q].gaussian < target.end:
            total = total + pairs[q].weight
            q = q + 1
        if unseen > 0.0:
            unseen = exists[t] / unseen
        exists[t] = total if total < 1.0 else 1.0
        kept[t] = 0
        # A target whose probability has just risen may have begun, however rare births are. One
        # with a new velocity is judged by its next measurement, which that velocity predicts.
        least_r = s.existence_threshold * (UNLIKELY if jump[t] else 1.0)
        if not (total >= least_r or total > target.r):
            continue
        # What stands still may go, so that the hypotheses that move are compared with each other.
        stands = _standing(target, hypotheses, p_detect, pairs[begun:q], unseen)
        least = s.hypothesis_threshold * (total - stands), s.hypothesis_threshold * total
        for i in range(begun, q):
            pair = pairs[i]
            if pair.weight >= least[hypotheses[pair.gaussian].static] and pair.weight > 0.0:
                end = _sorted_in(
                    options,
                    (k, end),
                    (pair.gaussian, pair.measurement),
                    (pair.weight, pair.distance2, pair.first),
                )
        for c in range(target.begin, target.end):
            weight = unseen * hypotheses[c].weight * (1.0 - p_detect[c])
            if weight >= least[hypotheses[c].static] and weight > 0.0:
                end = _sorted_in(options, (k, end), (c, none), (weight, 0.0, 0.0))
        kept[t] = end - k if end - k < s.max_hypotheses else int(s.max_hypotheses)
        k += kept[t]
    return k


@njit(**INNER)
def _standing(
    target: Any, hypotheses: Records, p_detect: F8, pairs: Records, unseen: float
) -> float:
    """The probability that a target exists and stands still: of ``pairs``, its measurements, and of
    a miss, which has ``unseen`` times the prior probability of the hypothesis to be missed.
    """
    total = 0.0
    for c in range(target.begin, target.end):
        if hypotheses[c].static:
            total += unseen * hypotheses[c].weight * (1.0 - p_detect[c])
            for q in range(pairs.size):
                if pairs[q].gaussian == c:
                    total += pairs[q].weight
    return total


@njit(**INNER)
def _sorted_in(
    options: Records,
    span: tuple[int, int],
    names: tuple[int, int],
    values: tuple[float, float, float],
) -> int:
    """Write an option among those of the ``span``, the heaviest first; the end of the span then.

    ``names`` are its hypothesis and measurement; ``values`` its weight, and d² of all components
    and of the first two.
    """
    begin, end = span
    place = end
    while place > begin and options[place - 1].weight < values[0]:
        options[place] = options[place - 1]
        place -= 1
    option = options[place]
    option.gaussian = names[0]
    option.measurement = names[1]
    option.weight = values[0]
    option.distance2 = values[1]
    option.first = values[2]
    return end + 1


@njit(**INNER)
def probability(log_odds: float) -> float:
    """The probability that corresponds to these log odds."""
    p: float = 1.0 / (1.0 + np.exp(-log_odds)) if log_odds < CERTAIN else 1.0
    return p


@njit(**INNER)
def after_score(genuine: float, scores: Scores, j: int) -> float:
    """The log odds that a target is genuine, after the score of measurement j."""
    if scores.prior >= CERTAIN:
        return genuine
    log_odds = scores.log_odds[j]
    if genuine >= scores.prior + PROVED and log_odds < 0.0:
        return genuine
    after: float = _within(genuine + log_odds)
    return after


@njit(**INNER)
def _after_miss(genuine: float, occluded: float, scores: Scores) -> float:
    """The log odds that a target that moves is genuine, after it was missed [PMB (21)]."""
    of_target, of_false = scores.missing
    if genuine >= scores.prior + PROVED or not of_target > 0.0:
        return genuine
    visible = 1.0 - occluded
    ratio = (occluded + visible * of_target) / (occluded + visible * of_false)
    after: float = _within(genuine + math.log(ratio))
    return after


@njit(**INNER)
def _within(log_odds: float) -> float:
    """Log odds of evidence that may change again, at most `LIMIT` in size."""
    return LIMIT if log_odds > LIMIT else -LIMIT if log_odds < -LIMIT else log_odds


@njit(**INNER)
def heavier_like(hypotheses: Records, mean: F8, cov: F8, begin: int, k: int, limit: float) -> int:
    """The first of the hypotheses begin … k − 1 of the kind of k and within √``limit`` of its own
    deviations; k for none.
    """
    for i in range(begin, k):
        distance2 = 0.0
        for a in range(mean.shape[1]):
            step = mean[i, a] - mean[k, a]
            variance = cov[i, a, a]
            distance2 += step * step / (variance if variance > 1e-12 else 1e-12)
        h = hypotheses[i]
        other = hypotheses[k]
        if h.static == other.static and h.motion == other.motion and distance2 < limit:
            return i
    return k


@njit(**INNER)
def _write_kept(
    before: tuple[Layer, F8],
    exists: F8,
    kept: I8,
    options: Records,
    scores: Scores,
    s: Settings,
    sizes: bool,
    out: Layer,
    gone: I8,
) -> tuple[int, int, int, float]:
    """Write the targets that are kept into the first places of ``out``; how many targets and
    hypotheses there are.

    ``before`` are the predicted targets, with the p_D of each as a target; ``out`` has the
    Gaussians of the options with a measurement. Hypotheses within `Settings.merge_distance` of a
    heavier one are counted as that one. ``sizes``: measurements have four components; of two the
    noise of all is theirs. The others are as of `_choose`. Of deleted targets that were once
    confirmed the best hypothesis of the frame before is written into ``gone`` (T,). Returns also
    how many these are, and the mass of the targets.
    """
    targets, hypotheses, mean, cov = out
    (old_targets, old, old_mean, old_cov), visible = before
    limit = s.merge_distance * s.merge_distance
    number = 0 * exists.size
    k = 0 * kept.size
    end = 0 * kept.size
    lost = 0
    mass = 0.0
    for t in range(kept.size):
        begin = k
        option = end
        end = end + kept[t]
        target = old_targets[t]
        total = 0.0
        for i in range(option, end):
            total += options[i].weight
        for i in range(option, end):
            c = options[i].gaussian
            _write_hypothesis(hypotheses[k], old[c], options[i], visible[c], scores, s, sizes)
            hypotheses[k].target = number
            if options[i].measurement < 0:
                copy_gaussian(old_mean, old_cov, c, mean, cov, k)
            elif k < i:
                copy_gaussian(mean, cov, i, mean, cov, k)
            weight = options[i].weight / total
            heavier = heavier_like(hypotheses, mean, cov, begin, k, limit)
            if heavier < k:
                hypotheses[heavier].weight += weight
            else:
                hypotheses[k].weight = weight
                k += 1
        if k > begin:
            mass += write_target(
                targets, hypotheses, number, target.label, exists[t], target.max_presence, begin, k
            )
            number += 1
        elif target.max_presence >= CONFIRMED and target.best >= 0 and old[target.best].parent >= 0:
            gone[lost] = old[target.best].parent
            lost += 1
    return number, k, lost, mass


@njit(**INNER)
def _write_hypothesis(
    h: Any, before: Any, option: Any, visible: float, scores: Scores, s: Settings, sizes: bool
) -> None:
    """Write what becomes of a hypothesis ``before`` with an option, except target and weight
    [PMB (13)].

    ``visible`` is p_D of a target that may be occluded.
    """
    h.static = before.static
    h.motion = before.motion
    h.past = before.past
    h.parent = before.parent
    h.occluded = 0.0
    h.detection = option.measurement
    h.freedom = before.freedom
    h.position_scale = before.position_scale
    h.size_scale = before.size_scale
    h.genuine = before.genuine
    if option.measurement < 0:
        # Bayes: a miss is certain if the target is occluded.
        missed = 1.0 - visible if 1.0 - visible > TINY else TINY
        h.occluded = before.occluded / missed if before.occluded < missed else 1.0
        if h.static:
            h.genuine = _within(
                h.genuine + math.log(missed / (1.0 - s.static_detection_probability))
            )
        elif scores.prior < CERTAIN:
            h.genuine = _after_miss(h.genuine, before.occluded, scores)
        return
    if h.static:
        seen = visible if visible > NEVER else NEVER
        h.genuine = _within(h.genuine + math.log(seen / s.static_detection_probability))
    h.genuine = after_score(h.genuine, scores, option.measurement)
    if h.freedom > 0.0:
        # Two components each, which are two observations of a variance [WH97 §10.8].
        n = h.freedom
        first = option.first
        second = option.distance2 - first if sizes else first
        h.position_scale = (n * h.position_scale + first) / (n + 2.0)
        h.size_scale = (n * h.size_scale + second) / (n + 2.0)
        h.freedom = n + 2.0


@njit(**INNER)
def write_target(
    targets: Records,
    hypotheses: Records,
    t: int,
    label: int,
    r: float,
    max_presence: float,
    begin: int,
    end: int,
) -> float:
    """Write target t, whose hypotheses are written; its presence. ``max_presence`` is the greatest
    before.
    """
    target = targets[t]
    total = 0.0
    best = -1
    for c in range(begin, end):
        h = hypotheses[c]
        total += h.weight * probability(h.genuine)
        if not h.static and (best < 0 or h.weight > hypotheses[best].weight):
            best = c
    target.label = label
    target.r = r
    target.begin = begin
    target.end = end
    target.best = best
    target.presence = r * total
    if r * total > max_presence:
        target.max_presence = r * total
    else:
        target.max_presence = max_presence
    return r * total


@njit(**INNER)
def _write_new(
    r_new: F8,
    new: tuple[F8, F8],
    scores: Scores,
    s: Settings,
    fresh: int,
    t: int,
    k: int,
    mass: float,
    out: Layer,
) -> tuple[int, float]:
    """Write the new targets, of r above 0, from places t and k of ``out`` on; how many hypotheses
    there are, and the mass.

    They come in the order of the measurements and are labelled from ``fresh`` on.
    """
    targets, hypotheses, mean, cov = out
    new_mean, new_cov = new
    prior = s.standing_prior
    for j in range(r_new.size):
        if r_new[j] > 0.0:
            begin = k
            for motion in range(s.motions + (prior > 0.0)):
                h = hypotheses[k]
                static = motion == s.motions
                if static:
                    h.weight = prior
                else:
                    h.weight = (1.0 - prior) / s.motions
                h.static = static
                h.occluded = 0.0
                h.motion = 0 if static else motion
                h.position_scale = 1.0
                h.size_scale = 1.0
                h.freedom = s.noise_freedom
                h.target = t
                h.detection = j
                h.parent = -1
                h.past = -1
                h.genuine = s.standing_genuine if static else after_score(scores.prior, scores, j)
                copy_gaussian(new_mean, new_cov, j, mean, cov, k)
                k += 1
            mass += write_target(targets, hypotheses, t, fresh, r_new[j], 0.0, begin, k)
            t = t + 1
            fresh = fresh + 1
    return k, mass
