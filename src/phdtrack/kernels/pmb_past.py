"""The past of the targets of the Poisson multi-Bernoulli filter, as it is seen later.

A hypothesis knows the one that it comes from in the frame before. Followed back from the best
hypotheses of today, these are the states that the targets had, and a target that is sure today was
there before, too.
"""

from __future__ import annotations

import math

import numpy as np

from phdtrack.kernels import F4, F8, I8, Records
from phdtrack.kernels.box import apart
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, MERGED
from phdtrack.kernels.gaussian import records
from phdtrack.kernels.small_arrays import first_not_below

# Of each target of a frame: the hypothesis that leads to the one that is best today, −1 for none;
# the greatest presence from that frame on.
TRACE = records("presence", "place")
# States that are reported: means (d, n), covariances (n, d, d), presences (n,), boxes (n, 4),
# measurements (n,) and labels (n,).
Columns = tuple[F8, F8, F8, F8, I8, I8]


@njit(**INNER)
def followed_back(
    trace: Records, after: Records, targets: Records, hypotheses: Records, ended: I8, frame: int
) -> Records:
    """The trace a frame earlier, with the targets that ended after it."""
    out = np.empty(targets.size, TRACE)
    for t in range(targets.size):
        out[t].place = -1
        out[t].presence = targets[t].presence
    for i in range(trace.size):
        if trace[i].place >= 0:
            p = after[trace[i].place].parent
        else:
            p = -1
        if p >= 0:
            found = out[hypotheses[p].target]
            found.place = p
            if trace[i].presence > found.presence:
                found.presence = trace[i].presence
    for e in range(len(ended)):
        if ended[e, 0] == frame:
            out[hypotheses[ended[e, 1]].target].place = ended[e, 1]
    return out


@njit(**MERGED)
def earlier(
    now: Records,
    before: Records,
    after: Records,
    targets: Records,
    hypotheses: Records,
    past: tuple[I8, int],
    present: bool,
    min_weight: float,
) -> tuple[Records, Records, bool]:
    """The traces a frame earlier, as seen now and as seen a frame ago, and whether both report the
    same states up to there.

    ``now``, ``before``, of `TRACE`, and ``after``, hypotheses, are of the frame after it; if that
    is the ``present`` one, ``before`` is of the frame itself. ``past`` (E, 2): frame and hypothesis
    of targets that have ended, and the number of the frame. ``min_weight``: presence from which a
    target is reported. Both report the same where all targets that are reported, or may be in an
    earlier frame, have the same hypotheses and are reported in both or in none: their pasts are the
    same.
    """
    ended, frame = past
    now = followed_back(now, after, targets, hypotheses, ended, frame)
    if not present:
        before = followed_back(before, after, targets, hypotheses, ended, frame)
    for t in range(targets.size):
        new = now[t]
        old = before[t]
        ever = targets[t].max_presence >= min_weight
        shown = new.presence >= min_weight
        was_shown = old.presence >= min_weight
        is_there = new.place >= 0 and (shown or ever)
        was_there = old.place >= 0 and (was_shown or ever)
        if is_there != was_there or (is_there and (new.place != old.place or shown != was_shown)):
            return now, before, False
    return now, before, True


@njit(**MERGED)
def best_trace(targets: Records) -> Records:
    """The best hypothesis of each target of the present, and its presence."""
    trace = np.empty(targets.size, TRACE)
    for t in range(targets.size):
        trace[t].place = targets[t].best
        trace[t].presence = targets[t].presence
    return trace


@njit(**MERGED)
def first_earlier(
    newest: tuple[Records, Records],
    then: tuple[Records, Records],
    past: tuple[I8, int],
    min_weight: float,
) -> tuple[Records, Records, Records, bool]:
    """The trace of the present, and what `earlier` gives of the frame before it; targets and
    hypotheses of both frames are given.
    """
    present = best_trace(newest[0])
    before = best_trace(then[0])
    now, before, same = earlier(
        present, before, newest[1], then[0], then[1], past, True, min_weight
    )
    return present, now, before, same


@njit(**MERGED)
def present_targets(trace: Records, min_weight: float) -> I8:
    """(n,) the targets of a `TRACE` whose presence is ``min_weight`` or more."""
    target = np.empty(trace.size, np.int64)
    n = 0 * trace.size
    for t in range(trace.size):
        if trace[t].place >= 0 and trace[t].presence >= min_weight:
            target[n] = t
            n += 1
    return target[:n]


@njit(**MERGED)
def of_targets(
    layer: tuple[Records, Records, F8, F8], trace: Records, target: I8
) -> tuple[F8, F8, F8, I8, I8]:
    """States of some targets (n,) of a frame: means (d, n), covariances (n, d, d) with the noises
    of each, presences (n,), measurements (n,) and labels (n,).
    """
    targets, hypotheses, mean, covariance = layer
    d = mean.shape[1]
    n = target.size
    at = np.empty(n, np.int64)
    out = np.empty((d, n))
    weight = np.empty(n)
    detection = np.empty(n, np.int64)
    label = np.empty(n, np.int64)
    for k in range(n):
        t = target[k]
        at[k] = trace[t].place
        weight[k] = trace[t].presence
        label[k] = targets[t].label
        detection[k] = hypotheses[at[k]].detection
        for a in range(d):
            out[a, k] = mean[at[k], a]
    return out, scaled(covariance, hypotheses, at), weight, detection, label


@njit(**INNER)
def _boxes_of(trace: Records, target: I8, mean: F8) -> tuple[F8, I8]:
    """(n, 4) the boxes of some targets, and (n,) their order by left sides."""
    n = target.size
    boxes = np.empty((n, 4))
    order = np.empty(n, np.int64)
    for k in range(n):
        c = trace[target[k]].place
        for a in range(2):
            half = 0.5 * mean[c, 4 + a]
            boxes[k, a] = mean[c, a] - half
            boxes[k, 2 + a] = mean[c, a] + half
        q = k
        while q > 0 and boxes[order[q - 1], 0] > boxes[k, 0]:
            order[q] = order[q - 1]
            q -= 1
        order[q] = k
    return boxes, order


@njit(**INNER)
def _reported(
    layer: tuple[Records, Records, F8, F8], trace: Records, min_weight: float, overlap: float
) -> Columns:
    """The result of `reported_boxes`, for kernels, which share it."""
    target = present_targets(trace, min_weight)
    boxes, order = _boxes_of(trace, target, layer[2])
    if overlap < 1.0 and target.size > 1:
        left = apart(boxes, order, overlap)
        n = left.size
        if n < target.size:
            for k in range(n):
                target[k] = target[left[k]]
                for a in range(4):
                    boxes[k, a] = boxes[left[k], a]
            target = target[:n]
            boxes = boxes[:n]
    mean, covariance, weight, detection, label = of_targets(layer, trace, target)
    return mean, covariance, weight, boxes.copy(), detection, label


@njit(**ENTRY)
def reported_boxes(
    layer: tuple[Records, Records, F8, F8], trace: Records, min_weight: float, overlap: float
) -> Columns:
    """The boxes that are reported of a frame, in one call: means, covariances, presences, boxes (n,
    4), measurements and labels, as of `of_targets`.

    Targets of less presence than ``min_weight`` are left out, and those that overlap one before
    them by more than ``overlap`` (IoU); 1: none is.
    """
    columns: Columns = _reported(layer, trace, min_weight, overlap)
    return columns


@njit(**ENTRY)
def reported_frames(
    newest: tuple[Records, Records, F8, F8],
    then: tuple[Records, Records, F8, F8],
    past: tuple[I8, int],
    min_weight: float,
    overlap: float,
) -> tuple[Columns, Columns, tuple[Records, Records], bool]:
    """The columns of `reported_boxes` of the present and of the frame before it, in one call; the
    traces of that frame, as seen now and as seen a frame ago; and whether both report the same
    states up to there: then the second columns are empty.
    """
    present, now, before, same = first_earlier(
        (newest[0], newest[1]), (then[0], then[1]), past, min_weight
    )
    shown = now[:0] if same else now
    return (
        _reported(newest, present, min_weight, overlap),
        _reported(then, shown, min_weight, overlap),
        (now, before),
        same,
    )


@njit(**MERGED)
def scaled(covariance: F8, hypotheses: Records, at: I8) -> F8:
    """(n, d, d) covariances of the hypotheses ``at`` (n,), with the noises that they have; sizes
    come last in a state.
    """
    d = covariance.shape[1]
    out = np.empty((at.size, d, d))
    root = np.empty(d)
    for k in range(at.size):
        of = hypotheses[at[k]]
        for a in range(d):
            root[a] = math.sqrt(of.position_scale if a < 4 else of.size_scale)
        for a in range(d):
            for b in range(d):
                out[k, a, b] = root[a] * covariance[at[k], a, b] * root[b]
    return out


@njit(**ENTRY)
def looks_of_targets(
    targets: Records, hypotheses: Records, tag: I8, pasts: Records, looks: F4
) -> tuple[F4, F8, I8]:
    """(n, D) what the best hypotheses of targets look like by their pasts, and (n,) of how many
    independent descriptors that is the mean, 0 where it is not known; and (T,) all labels.

    Parameters
    ----------
    targets, hypotheses : all of them.
    tag : (n,) labels of some targets.
    pasts, looks : the columns of `kernels.appearance.Pasts`.
    """
    label = np.empty(targets.size, np.int64)
    for t in range(targets.size):
        label[t] = targets[t].label
    out = np.zeros((tag.size, looks.shape[2]), np.float32)
    count = np.zeros(tag.size)
    for k in range(tag.size):
        past = hypotheses[targets[first_not_below(label, tag[k])].best].past
        if past >= 0:
            count[k] = pasts[past].number
            for d in range(looks.shape[2]):
                out[k, d] = looks[past, 0, d]
    return out, count, label
