"""Labels of detections by their chains, and the logistic regression of scores that they train. See
`models.detection_scores`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Bool
from phdtrack.kernels.box import following, overlap_of
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, MERGED
from phdtrack.kernels.small_arrays import flags, floats


class Line(NamedTuple):
    """A Gaussian over (a, b): ``precision`` (2, 2), times mean (2,), and how many verdicts (2,)
    were true and false.
    """

    information: F8
    precision: F8
    verdicts: F8


class Steadiness(NamedTuple):
    """A Gaussian over (a, b) of the log odds a·x + b that what is followed is no lasting false
    alarm: ``precision`` (2, 2), times mean (2,); and ``breaks`` (2,): how many chains of targets
    have ended in a frame, and of how many.
    """

    information: F8
    precision: F8
    breaks: F8


# Scores are probabilities, log odds, or on another scale: then they are ranked.
PROBABILITY, LOGIT, RANK = range(3)
# Of m chains: x (m, L) of their detections that wait for a verdict, NaN where none does; whether
# these are followed (m, L); how long the chains are (m,); and x (m,) of their last detections.
Chains = tuple[F8, Bool, I8, F8]
# x (n,) of detections whose chain has lasted, and of those whose chain has ended, followed or not.
Verdicts = tuple[F8, F8, F8]


@njit(**MERGED)
def scaled(
    score: F8, low: float, high: float, logits: tuple[float, float], bound: float, least: float
) -> tuple[float, float, int, F8]:
    """Both ends and the kind of all scores, and x (n,) of those of a frame, NaN where they say
    nothing.

    Those before were between ``low`` and ``high``. ``logits``: the largest log odds, and those that
    say nothing; ``bound`` of log odds; ``least`` probability.
    """
    for s in score:
        if s < low:
            low = s
        if s > high:
            high = s
    if low >= 0.0 and high <= 1.0:
        kind = PROBABILITY
    elif low < 0.0 and high <= logits[0]:
        kind = LOGIT
    else:
        kind = RANK
    x = floats(score.size, math.nan)
    if low < high and kind != RANK:
        for j in range(score.size):
            s = score[j]
            if math.isnan(s):
                continue
            if kind == LOGIT:
                x[j] = min(max(s - logits[1], -bound), bound)
            else:
                share = min(max(s, least), 1.0 - least)
                x[j] = math.log(share / (1.0 - share))
    return low, high, kind, x


@njit(**INNER)
def _broken(waiting: F8, held: Bool, ended: Bool) -> tuple[F8, F8]:
    """x of the detections of chains (n, L) that have ``ended`` (n,): of those that were followed,
    ``held``, and of the others.
    """
    followed = np.empty(waiting.size)
    false = np.empty(waiting.size)
    b = f = 0 * waiting.size
    for i in range(waiting.shape[0]):
        for k in range(waiting.shape[1]):
            if not ended[i] or math.isnan(waiting[i, k]):
                continue
            if held[i, k]:
                followed[b] = waiting[i, k]
                b += 1
            else:
                false[f] = waiting[i, k]
                f += 1
    return followed[:b].copy(), false[:f].copy()


@njit(**MERGED)
def chained(
    before: F8, boxes: F8, x: F8, followed: Bool, chains: Chains, overlap: float
) -> tuple[Chains, Verdicts, Bool]:
    """The chains of detections after a frame, and its verdicts.

    ``before`` (n, 4) are the boxes of the frame before, with their ``chains``. ``boxes`` (m, 4),
    ``x`` (m,) and whether a target rests on each, ``followed`` (m,), are of this frame. Returns the
    m chains of these; x of what was true, as its chain has lasted for L frames, and of what was
    false, as its chain has ended before, those that were followed and the others; and which (n,) of
    the frame before end their chain.
    """
    waiting, held, length, _ = chains
    m = boxes.shape[0]
    most = waiting.shape[1]
    link = following(before, boxes, overlap)
    now = np.empty((m, most))
    known = np.empty((m, most), np.bool_)
    long = np.empty(m, np.int64)
    true = np.empty(m * most)
    t = 0 * m
    ended = flags(before.shape[0], True)
    for j in range(m):
        i = link[j]
        long[j] = 1
        for k in range(most):
            now[j, k] = math.nan
            known[j, k] = False
        if i >= 0:
            ended[i] = False
            long[j] = length[i] + 1
            for k in range(most):
                now[j, k] = waiting[i, k]
                known[j, k] = held[i, k]
        newest = (long[j] if long[j] < most else most) - 1
        now[j, newest] = x[j]
        known[j, newest] = followed[j]
        if long[j] >= most:
            for k in range(most):
                if not math.isnan(now[j, k]):
                    true[t] = now[j, k]
                    t += 1
                now[j, k] = math.nan
    broken, false = _broken(waiting, held, ended)
    return (now, known, long, x), (true[:t].copy(), broken, false), ended


@njit(**MERGED)
def neighbours(boxes: F8, counted: Bool, most: int) -> tuple[int, int]:
    """How many neighbours some of the boxes (n, 4) have in all among those that are ``counted``
    (n,), and how many these are: evenly spaced, about ``most`` of many.

    A neighbour is within ±1 box in position, and has 0.5 to 1.5 of the width and height
    (`models.volumes`).
    """
    count = 0
    asked = 0
    for i in range(0, boxes.shape[0], max(boxes.shape[0] // most, 1)):
        asked += 1
        width = boxes[i, 2] - boxes[i, 0]
        height = boxes[i, 3] - boxes[i, 1]
        x = boxes[i, 0] + boxes[i, 2]
        y = boxes[i, 1] + boxes[i, 3]
        for j in range(boxes.shape[0]):
            near = (
                j != i
                and counted[j]
                and abs(boxes[j, 0] + boxes[j, 2] - x) < 2.0 * width
                and abs(boxes[j, 1] + boxes[j, 3] - y) < 2.0 * height
            )
            if near:
                w = (boxes[j, 2] - boxes[j, 0]) / width
                h = (boxes[j, 3] - boxes[j, 1]) / height
                count += 0.5 < w < 1.5 and 0.5 < h < 1.5
    return count, asked


@njit(**INNER)
def _blended(before: F8, prior: F8, kept: float) -> F8:
    """The numbers (n,) before, of which ``kept`` remains, and the rest of a prior (n,)."""
    out = np.empty(before.size)
    for k in range(before.size):
        out[k] = kept * before[k] + (1 - kept) * prior[k]
    return out


# A row is not assigned as a whole: Numba would compile what it says of arrays of different shapes.
@njit(**INNER)
def _blended_square(before: F8, prior: F8, kept: float) -> F8:
    """`_blended` of matrices (2, 2)."""
    out = np.empty((2, 2))
    for r in range(2):
        for c in range(2):
            out[r, c] = kept * before[r, c] + (1 - kept) * prior[r, c]
    return out


@njit(**MERGED)
def newton(before: Line, true: F8, false: F8, prior: Line, remembered: float) -> tuple[F8, F8, F8]:
    """The line after one step of Newton's method with the verdicts on detections with these x; old
    ones are forgotten.
    """
    information, precision, verdicts = before
    start, own, first = prior
    n = true.size + false.size
    kept = max(1 - n / remembered, 0.0)
    information = _blended(information, start, kept)
    verdicts = _blended(verdicts, first, kept)
    precision = _blended_square(precision, own, kept)
    verdicts[0] += true.size
    verdicts[1] += false.size
    scale = precision[0, 0] * precision[1, 1] - precision[0, 1] * precision[0, 1]
    a = (precision[1, 1] * information[0] - precision[0, 1] * information[1]) / scale
    b = (precision[0, 0] * information[1] - precision[0, 1] * information[0]) / scale
    offset = b + math.log(verdicts[0] / verdicts[1])
    for k in range(n):
        x, label = (true[k], 1.0) if k < true.size else (false[k - true.size], 0.0)
        p = 1 / (1 + math.exp(-(a * x + offset)))
        curve = p * (1 - p)
        miss = label - p
        information[0] += curve * (a * x + b) * x + miss * x
        information[1] += curve * (a * x + b) + miss
        precision[0, 0] += curve * x * x
        precision[0, 1] += curve * x
        precision[1, 0] += curve * x
        precision[1, 1] += curve
    return information, precision, verdicts


@njit(**INNER)
def _mean_of(information: F8, precision: F8) -> tuple[float, float]:
    """The mean (a, b) of a Gaussian; a is not negative."""
    scale = precision[0, 0] * precision[1, 1] - precision[0, 1] * precision[0, 1]
    a = (precision[1, 1] * information[0] - precision[0, 1] * information[1]) / scale
    b = (precision[0, 0] * information[1] - precision[0, 1] * information[0]) / scale
    return (a if a > 0.0 else 0.0), b


@njit(**MERGED)
def steadier(
    before: Steadiness,
    x: F8,
    ended: Bool,
    prior: Steadiness,
    remembered: float,
    flicker: float,
) -> tuple[F8, F8, F8]:
    """`Steadiness` after a step of Fisher scoring with chains that may have ended [PMB (20)].

    ``x`` (n,) are those of their last detections, NaN for those that do not count, and ``ended``
    (n,) tells which chains this frame has ended. Old ones are forgotten, for the ``prior``.
    ``flicker``: the probability that a false alarm is missing where a target would be detected.
    """
    n = 0
    for i in range(x.size):
        n += not math.isnan(x[i])
    kept = max(1 - n / remembered, 0.0)
    information = _blended(before.information, prior.information, kept)
    breaks = _blended(before.breaks, prior.breaks, kept)
    precision = _blended_square(before.precision, prior.precision, kept)
    a, b = _mean_of(information, precision)
    of_target = breaks[0] / breaks[1]
    more = (1.0 - of_target) * flicker
    for i in range(x.size):
        if math.isnan(x[i]):
            continue
        log_odds = a * x[i] + b
        false = 1.0 / (1.0 + math.exp(log_odds))
        p = of_target + more * false
        slope = -more * false * (1.0 - false)
        if ended[i]:
            step = slope / p
            target = of_target * (1.0 - false) / p
            breaks[0] += target
        else:
            step = -slope / (1.0 - p)
            target = (1.0 - of_target) * (1.0 - false) / (1.0 - p)
        breaks[1] += target
        fisher = slope * slope / (p * (1.0 - p))
        information[0] += (fisher * log_odds + step) * x[i]
        information[1] += fisher * log_odds + step
        precision[0, 0] += fisher * x[i] * x[i]
        precision[0, 1] += fisher * x[i]
        precision[1, 0] += fisher * x[i]
        precision[1, 1] += fisher
    return information, precision, breaks


@njit(**ENTRY)
def levelled(
    score: F8,
    extent: tuple[float, float],
    level: float,
    rule: tuple[float, float, float, float],
    good: tuple[float, float],
) -> tuple[float, float, int, F8, float]:
    """The result of `scaled`, with x raised as far as the best scores are low, and their level.

    ``extent``, ``level``: of the scores before. ``rule``: the largest log odds, those that say
    nothing, the bound and the least probability of `scaled`. ``good``: the x that the best scores
    have at least, and frames after which the best before count for 37 %. Ranks have no level.
    """
    low, high, kind, x = scaled(score, extent[0], extent[1], (rule[0], rule[1]), rule[2], rule[3])
    if kind == RANK:
        return low, high, kind, x, level
    best = -np.inf
    known = False
    for j in range(x.size):
        if not math.isnan(x[j]):
            known = True
            best = max(best, x[j])
    if known:
        if best < level:
            best = level - (level - best) / good[1]
        level = best
        more = max(good[0] - level, 0.0)
        for j in range(x.size):
            x[j] += more
    return low, high, kind, x, level


@njit(**INNER)
def _is_beside(j: int, boxes: F8, targets: F8, overlap: float) -> bool:
    """Test if box ``j`` of the boxes (n, 4) overlaps one of the targets (t, 4) by more (IoU)."""
    most = 0.0
    for i in range(targets.shape[0]):
        most = max(most, overlap_of(boxes, j, targets, i))
    return most > overlap


@njit(**ENTRY)
def evidence_of(
    x: F8,
    lines: tuple[float, float, float, float],
    places: tuple[F8, F8, float],
    limit: float,
    of_lasting: float,
    ranked: bool,
    steady: tuple[F8, F8],
) -> tuple[F8, F8]:
    """Log odds (n,) of targets against false alarms, and against those that last; 0 for NaN.

    The first are within ``limit``. ``lines``: a and b for detections beside a target, and for the
    others. ``places``: boxes (n, 4) of the detections and (t, 4) of targets, and the overlap by
    which one lies beside a target. The second are ``of_lasting`` times what the first line says if
    scores are ``ranked``, else times x; if negative, no less than ``steady`` says, the information
    and the precision of `Steadiness`.
    """
    a, b = _mean_of(steady[0], steady[1])
    boxes, targets, overlap = places
    single = np.empty(x.size)
    lasting = np.empty(x.size)
    for j in range(x.size):
        if math.isnan(x[j]):
            single[j] = 0.0
            lasting[j] = 0.0
            continue
        single[j] = min(max(lines[0] * x[j] + lines[1], -limit), limit)
        claim = of_lasting * (single[j] if ranked else x[j])
        lasting[j] = max(claim, min(a * x[j] + b, 0.0))
        if not _is_beside(j, boxes, targets, overlap):
            single[j] = min(max(lines[2] * x[j] + lines[3], -limit), limit)
    return single, lasting


@njit(**INNER)
def _joined(first: F8, second: F8) -> F8:
    """Both, one after the other."""
    out = np.empty(first.size + second.size)
    for k in range(out.size):
        out[k] = first[k] if k < first.size else second[k - first.size]
    return out


@njit(**ENTRY)
def learned_frame(
    before: F8,
    boxes: F8,
    x: F8,
    followed: I8,
    chains: Chains,
    lines: tuple[Line, Line],
    prior: Line,
    steady: tuple[Steadiness, Steadiness],
    rule: tuple[float, float, int, float],
    same_kind: bool,
) -> tuple[
    Chains,
    tuple[Line, Line],
    bool,
    tuple[F8, F8, F8],
    tuple[int, int, int, int, int],
]:
    """The chains and the lines after a frame, whether there were verdicts on these, the steadiness,
    and counts: of boxes ``before`` that are alone, linked neither before nor now, and what
    `neighbours` counts of all boxes, and of those alone.

    ``before``, ``boxes``, ``x``, ``chains``: see `chained`. ``followed`` (t,): the detections that
    targets rest on, −1 for none. ``lines``, ``prior``: see `newton`; for the second, detections
    that were followed are true though their chain has ended. ``steady``: that before, and its
    prior. ``rule``: the overlap, how many verdicts are remembered, how many boxes are asked for
    neighbours, and the flicker of `steadier`. If scores are no longer of the ``same_kind``,
    verdicts wait anew.
    """
    overlap, remembered, most, flicker = rule
    rests = flags(len(boxes), False)
    for j in followed:
        if j >= 0:
            rests[j] = True
    after, verdicts, ended = chained(before, boxes, x, rests, chains, overlap)
    alone = 0
    lone = flags(ended.size, False)
    steadied = floats(ended.size, math.nan)
    for i in range(ended.size):
        lone[i] = ended[i] and chains[2][i] == 1
        alone += lone[i]
        if chains[2][i] >= chains[0].shape[1]:
            steadied[i] = chains[3][i]
    near = neighbours(boxes, flags(len(boxes), True), most)
    of_lone = neighbours(before, lone, most)
    counts = (alone, near[0], near[1], of_lone[0], of_lone[1])
    line, away = lines
    known = Steadiness(*steady[0])
    seen = known.information, known.precision, known.breaks
    true, broken, false = verdicts
    learned = same_kind and true.size + broken.size + false.size > 0
    if same_kind:
        seen = steadier(known, steadied, ended, Steadiness(*steady[1]), remembered, flicker)
    else:
        waiting = after[0]
        for j in range(waiting.shape[0]):
            for k in range(waiting.shape[1]):
                waiting[j, k] = math.nan
    if learned:
        line = newton(line, true, _joined(broken, false), prior, remembered)
        away = newton(away, _joined(true, broken), false, prior, remembered)
    return after, (line, away), learned, seen, counts
