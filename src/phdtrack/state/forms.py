"""What a saved state must be before anything goes on from it: types from the annotations, shapes
and ranges from a table.

Compiled code does not look where it writes. So everything that is read is checked here: `FORMS`
says of each record what its arrays and numbers are, `RELATIONS` how they fit each other, and
`reading` makes the records.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

# What the arrays and numbers of each record are: ``name:shape:least..largest:more``, of an array of
# records ``name.column``. Shapes are of letters, each the same length in all of a record; ``d`` and
# ``m``, components of states and of measurements, are the same everywhere (``d?``: or 0, where
# there are none). Bounds are numbers, or names of lengths and of other fields. More: ``up`` and
# ``rise`` for what never falls and what always grows; ``cov``, ``cov0`` for covariances whose
# variances are above 0, or at least; ``inf`` and ``nan`` for what may be that: all else is finite.
FORMS: dict[str, str] = {
    "Particles": "state:d,L:-far..far weight:L:0..many start:S:0..L:up",
    "ParticleBlocks": "state:d,L:-far..far start:B+1:0..L:up unit::0..many share:S:0..many",
    "GaussianMixture": "weight:J:0..many mean:d,J:-far..far covariance:J,d,d::cov",
    "Cardinalised": "cardinality:N:0..2",
    "Layer": "targets:T targets.r:T:0..1 targets.presence:T:0..1 targets.max_presence:T:0..1 targets.label:T:0..:rise "
    "targets.begin:T:0..C targets.end:T:0..C targets.best:T:-1..C-1 hypotheses:C hypotheses.weight:C:0..1 "
    "hypotheses.occluded:C:0..1 hypotheses.genuine:C:-99..99 hypotheses.position_scale:C:1e-9..1e99 "
    "hypotheses.size_scale:C:1e-9..1e99 hypotheses.freedom:C:0..1e9 hypotheses.target:C:0..T-1 hypotheses.detection:C:-1.. "
    "hypotheses.parent:C:-1.. hypotheses.static:C:0..1 hypotheses.motion:C:0.. mean:C,d:-far..far covariance:C,d,d::cov",
    "Bernoullis": "ended:E,2:0.. next_label::0.. frame::0..",
    "Nodes": "mean:L,d:-far..far covariance:L,d,d::cov r:L:0..1 detection:L:-1.. parent:L:-1.. label:L:0.. missed:L:0.. "
    "survival:L:0..1",
    "Cluster": "leaf:H,T:-1.. weight:H:0..1",
    "Hypotheses": "lone:n:0.. next_label::0..",
    "JointSamples": "state:d,S:-far..far chance:n,N:0..1 label:n:0..fresh-1:rise fresh::0..",
    "Estimates": "state:d?,n:-far..far covariance:n,d?,d?::cov0 weight:n:0..many xyxy:n,4:-far..far detection:n:-1.. "
    "tag:t:0..",
    "Links": "later:l:0.. earlier:l:0.. gain:l",
    "Moment": "number::1.. time::0.. first::0.. z:m,N:-far..far warp:w,3:-far..far",
    "History": "forgotten::0..",
    "Window": "column::0..row row::0.. next:C:-2.. column_price:C since:R:0.. previous:R:-1.. gain:R row_price:R "
    "start:R+1:0..E:up target:E:0.. edge_gain:E mean:R,d?:-far..far covariance:R,d?,d?::cov0",
    "Identities": "identity:A:1..:rise last:A:0.. length:A:1.. gain:A confirmed:A missed:A:0.. confidence:A:0..1 "
    "state:d?,A:-far..far",
    "Given": "first::0.. track:V:1..used returned:2,32:0.. used::0..",
    "GraphState": "vertices::0.. time::0..",
    "LabelTable": "label:a:0..:rise identity:a:0.. states:a:0.. last:a::inf confirmed:a",
    "Followed": "label:n:0..:rise last:n age:n:0.. xyxy:n,4:-far..far speed:n,4 verdicts:2,64:0..",
    "LabelledState": "time::0.. used::0..",
    "RejectionState": "identity:a:1..:rise least:2,a::inf",
    "Shown": "identity:n:1.. seen:n,4:-far..far filtered:n,4:-far..far",
    "ShareState": "sums:2,4",
    "CameraState": "mean:n,d?:-far..far covariance:n,d?,d?::cov0 velocity:4:-far..far excess:2,4 weight:2,4:0.. "
    "scale:4:0.01..10 pairs:4:0.. left:4:-far..far",
    "ExpectedTargets": "state:d?,n:-far..far covariance:n,d?,d?::cov0 existence:n:0..1 hidden:n:0.. separate:n:0..",
    "TrackingState": "number::0.. targets:d?,n:-far..far",
    "Line": "information:2 precision:2,2 verdicts:2:0..",
    "ScoresSeen": "scores:s boxes:k,4:-far..far waiting:k,6::nan length:k:0..",
    "HeldFrame": "number::1.. xyxy:N,4:-far..far",
    "SavedCamera": "number::1.. people:h,w:0.. clutter:h,w:0.. minutes:n,4:0..",
    "Seed": "state::0..4e38 increment::0..4e38 has_word::0..1 word::0..4294967295",
    "SavedPipelines": "alone::0..highest highest::0..",
}  # fmt: skip
# Largest size of a coordinate (a target that is followed for a month without a detection may be far
# away), expected number of targets, and number.
SYMBOLS = {"far": 1e12, "-far": -1e12, "many": 1e6}
LARGEST = 1e60
# Detections in a frame.
_MOST = 1 << 31


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """What a state must fit: the ``stages`` that it is of, and ``sizes`` that are known."""

    stages: Any
    sizes: dict[str, int]

    @classmethod
    def of(cls, stages: Any) -> World:
        """Of these stages."""
        associator = stages.associator
        while type(associator).__name__ == "FalseTrackRejection":
            associator = associator.associator
        return cls(
            stages, {"d": stages.model.motion.dim, "delay": getattr(associator, "output_delay", 0)}
        )


def _within(index: Any, low: int, high: int) -> bool:
    """Whether all are from ``low`` on and below ``high``."""
    return not len(index) or bool(index.min() >= low and index.max() < high)


def _rises(values: Any) -> bool:
    """Whether each is above the one before."""
    return all(a < b for a, b in pairwise(values))


def _tiles(start: Any, count: int) -> bool:
    """Whether these ascending places cut so many elements into parts."""
    return len(start) > 0 and start[0] == 0 and start[-1] == count


def _layer(r: Any, w: World) -> bool:
    """Targets have hypotheses that follow each other, one at least."""
    t = r.targets
    h = r.hypotheses
    ends = np.concatenate([[0], t["end"]])
    owned = (ends[:-1] == t["begin"]).all() and (t["end"] > t["begin"]).all() and ends[-1] == len(h)
    good = owned and (np.repeat(np.arange(len(t)), t["end"] - t["begin"]) == h["target"]).all()
    best = ((t["best"] == -1) | ((t["best"] >= t["begin"]) & (t["best"] < t["end"]))).all()
    return bool(good and best) and _within(
        h["motion"], 0, len(getattr(w.stages.filter, "acceleration_factors", (1.0,)))
    )


def _bernoullis(r: Any, w: World) -> bool:
    """Parents are in the layer before, and targets that ended in theirs; all labels were given."""
    if not r.layers or any(
        len(x.targets) and x.targets["label"][-1] >= r.next_label for x in r.layers
    ):
        return False
    parents = all(
        _within(b.hypotheses["parent"], -1, len(a.hypotheses)) for a, b in pairwise(r.layers)
    )
    back = r.frame - r.ended[:, 0]
    size = np.array([len(x.hypotheses) for x in r.layers[::-1]])
    inside = (back >= 0) & (back < len(size))
    return parents and bool((r.ended[inside, 1] < size[back[inside]]).all())


def _hypotheses(r: Any, w: World) -> bool:
    """Parents are in the layer before; hypotheses hold all leaves, each of one cluster."""
    if (
        not r.layers
        or len(r.steps) != len(r.layers)
        or any(not _within(x.label, 0, r.next_label) for x in r.layers)
    ):
        return False
    if (
        any(not (0 <= dt < LARGEST and _is_warp(warp)) for dt, warp in r.steps)
        or (r.layers[0].parent >= 0).any()
    ):
        return False
    held = [r.lone, *(np.unique(x.leaf[x.leaf >= 0]) for x in r.clusters)]
    whole = all(
        len(x.weight) and x.weight.sum() > 0 and x.leaf.shape[1] and _within(x.leaf, -1, len(r))
        for x in r.clusters
    )
    apart = np.concatenate(held)
    once = _within(apart, 0, len(r)) and len(np.unique(apart)) == len(apart) == len(r)
    return whole and once and all(_within(b.parent, -1, len(a)) for a, b in pairwise(r.layers))


def _is_warp(warp: Any) -> bool:
    """Whether it is a finite homography, or stands for none."""
    known = (
        isinstance(warp, np.ndarray) and warp.dtype == np.float64 and warp.shape in ((0, 3), (3, 3))
    )
    return (
        known
        and bool((np.abs(warp) < SYMBOLS["far"]).all())
        and (not len(warp) or abs(np.linalg.det(warp)) > 1e-30)
    )


def _history(r: Any, w: World) -> bool:
    """Chunks of moments, one after the other."""
    moments = list(iter(r))
    if r.forgotten >= (moments[0].number if moments else 1):
        return False
    whole = all(len(chunk) == 32 for chunk in r.full) and len(r.recent) < 64
    return whole and _rises([m.number for m in moments]) and _rises([m.time for m in moments])


def _graph(r: Any, w: World) -> bool:
    """Links and identities name vertices that there are, and only earlier ones; the matching is
    one.
    """
    x = r.window
    given = r.given
    n = r.vertices
    moments = list(iter(r.history))
    firsts = [m.first for m in moments] + [n]
    if moments and r.time != moments[-1].time:
        return False
    if any(
        m.first + len(m.estimates) != after for m, after in zip(moments, firsts[1:], strict=True)
    ):
        return False
    if (
        x.row + len(x.since) != n
        or x.column + len(x.next) != n
        or not _tiles(x.start, len(x.target))
    ):
        return False
    onward = np.flatnonzero(x.next >= 0)
    linked = np.flatnonzero(x.previous >= 0)
    earlier = x.previous[linked]
    if not (_within(earlier, x.column, n) and _within(x.next[onward], x.row, n)) or len(
        onward
    ) != len(linked):
        return False
    rows = np.repeat(x.row + np.arange(len(x.since)), np.diff(x.start))
    if (
        (x.next[earlier - x.column] != x.row + linked).any()
        or (earlier >= x.row + linked).any()
        or (x.target >= rows).any()
    ):
        return False
    if any(
        (m.final.earlier >= m.final.later).any() or not _within(m.final.later, 0, n)
        for m in moments
    ):
        return False
    # Rows were given up to the delay.
    due = max(0, len(r.history) - w.sizes["delay"]) - r.history.forgotten
    if (
        due < 0
        or given.first + len(given.track) != firsts[due]
        or given.first > min(x.column, firsts[due])
    ):
        return False
    held = all(m.final.earlier.min(initial=given.first) >= given.first for m in moments[due:])
    known = np.isin(given.track, given.known.identity).all() and _within(
        given.known.identity, 1, given.used + 1
    )
    return bool(held and known) and _within(
        given.known.last, given.first, given.first + len(given.track)
    )


def _labelled(r: Any, w: World) -> bool:
    """States have labels, and those whose rows may still change are in the table."""
    moments = [*iter(r.history), *r.recent]
    names = [m.estimates.tag for m in moments]
    if moments and r.time != moments[-1].time:
        return False
    if any(
        len(x) != len(m.estimates) or m.first or len(np.unique(x)) < len(x)
        for x, m in zip(names, moments, strict=True)
    ):
        return False
    if moments:
        open_ = moments[-max(len(r.recent), w.sizes["delay"]) :]
    else:
        open_ = []
    tags = np.concatenate([np.zeros(0, np.int64), *names[len(names) - len(open_) :]])
    grows = _rises([m.number for m in moments]) and _rises([m.time for m in moments])
    return (
        grows
        and bool(np.isin(tags, r.table.label).all())
        and _within(r.table.identity, 0, r.used + 1)
    )


def held_moments(association: Any) -> Iterator[Any]:
    """The frames that an associator's state remembers, the oldest first; none of one that is not
    ours.
    """
    while type(association).__name__ == "RejectionState":
        association = association.inner
    name = type(association).__name__
    if name in ("GraphState", "LabelledState"):
        yield from association.history
    if name == "LabelledState":
        yield from association.recent


def _tracking(r: Any, w: World) -> bool:
    """Detections that are named were in their frames; what comes later is there as soon as it is
    used.
    """
    moments = list(held_moments(r.association))
    counts = {m.number: m.z.shape[1] for m in moments}
    if (
        not (abs(r.pace[1]) <= 700 * r.pace[0] < LARGEST)
        or (moments[-1].number if moments else 0) != r.number
    ):
        return False
    if r.given:
        late = [m.z.shape[1] for m in moments[-len(r.given) :]]
    else:
        late = []
    if len(late) != len(r.given) or any(g.dtype != np.int64 or g.ndim != 1 for g in r.given):
        return False
    if not all(_within(g, 0, count) for g, count in zip(r.given, late, strict=True)):
        return False
    # In the filter's terms.
    there = [len(g) or count for g, count in zip(r.given, late, strict=True)][::-1]
    if type(r.intensity).__name__ in ("Bernoullis", "Hypotheses"):
        layers = r.intensity.layers
    else:
        layers = ()
    for k, layer in enumerate(layers[::-1]):
        if type(r.intensity).__name__ == "Hypotheses":
            found = layer.detection
        else:
            found = layer.hypotheses["detection"]
        if k < len(there):
            most = there[k]
        elif k < len(moments):
            most = moments[-1 - k].z.shape[1]
        else:
            most = 0
        if not _within(found, -1, most):
            return False
    return r.shown is None or all(
        counts.get(number) == len(xyxy) for number, _, xyxy in r.shown.waiting
    )


def _shares(r: Any, w: World) -> bool:
    """Frames come one after the other."""
    boxes = all(
        isinstance(x, np.ndarray) and x.dtype == np.float64 and x.shape[1:] == (4,)
        for _, _, x in r.waiting
    )
    last = [one.time for one in r.last if len(one.identity)]
    times = [*last, *(time for _, time, _ in r.waiting)]
    return (
        len(r.last) == 2
        and boxes
        and _rises(times)
        and all(len(x) == 0 or np.isfinite(x).all() for _, _, x in r.waiting)
    )


def _scores(r: Any, w: World) -> bool:
    """Numbers that are divided by are none of them 0."""
    low, high = r.extent
    alone, seen = r.alone
    line = r.line
    line = (
        line is None or line.precision[0, 0] * line.precision[1, 1] - line.precision[0, 1] ** 2 > 0
    )
    return (
        bool(line)
        and (low <= high or (low, high) == (math.inf, -math.inf))
        and 0 <= alone < LARGEST
        and 0 < seen < LARGEST
    )


def _blocks(r: Any, w: World) -> bool:
    """Blocks are of 256 at most, of the type that the filter works in, and not of more targets than
    anybody follows.
    """
    kind = np.float32 if len(w.stages.model.sensor.observed) == 4 else np.float64
    count = r.state.shape[1]
    shared = len(r.share) == 0 or (len(r.share) == count and r.share.dtype == kind)
    small = _tiles(r.start, count) and bool((np.diff(r.start) <= 256).all())
    return small and shared and r.state.dtype == kind and r.mass <= SYMBOLS["many"]


def _lane(r: Any, w: World) -> bool:
    """Detections that rows may name have a class, and a place among all."""
    counts = {m.number: m.z.shape[1] for m in held_moments(r.state.association)}
    rows = all(
        one.ndim == 1 and counts.get(k, len(one)) == len(one) and _within(one, 0, _MOST)
        for k, one in r.rows.items()
    )
    return rows and all(
        kind.ndim == score.ndim == 1
        and len(kind) == len(score) == counts.get(k, len(kind))
        and (score > 0).all()
        and (score <= 1).all()
        for k, (kind, score) in r.labels.items()
    )


RELATIONS: dict[str, Callable[[Any, World], Any]] = {
    "Particles": lambda r, w: not len(r.start) or _tiles(r.start, len(r.weight)),
    "ParticleBlocks": _blocks,
    "Cardinalised": lambda r, w: (
        len(r.cardinality)
        and r.cardinality.min() >= 0
        and abs(r.cardinality.sum() - 1) < 1e-3
        and (r.mass > 0 or len(r.intensity) == 0)
    ),
    "Layer": _layer,
    "Bernoullis": _bernoullis,
    "Hypotheses": _hypotheses,
    "JointSamples": lambda r, w: (
        r.state.shape[1] == r.chance.size
        and r.chance.shape[1] == getattr(w.stages.filter, "samples", 0)
    ),
    "Estimates": lambda r, w: len(r.tag) in (0, len(r.weight)),
    "Moment": lambda r, w: _within(r.estimates.detection, -1, r.z.shape[1]) and _is_warp(r.warp),
    "History": _history,
    "GraphState": _graph,
    "LabelledState": _labelled,
    "ShareState": _shares,
    "TrackingState": _tracking,
    "ScoresSeen": _scores,
    "SavedPipeline": _lane,
    "SavedPipelines": lambda r, w: (
        _rises([frame[0] for frame in r.past])
        and _rises([frame[1] for frame in r.past])
        and all(_is_warp(f[2]) for f in r.past)
    ),
    "SavedCamera": lambda r, w: (
        {len(r.places)}
        == {
            len(r.watch.counts),
            *(len(x) for v in r.watch.visitors.values() for x in (v.net, v.since, v.dwelled)),
        }
        and all(a <= b for a, b in pairwise([r.mapped, *(frame.time for frame in r.held), r.time]))
    ),
    "Seed": lambda r, w: max(r.state, r.increment) < 1 << 128 and r.increment % 2,
}
