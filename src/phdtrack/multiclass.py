"""Objects of several classes: each class, or several that are tracked together, is followed by a
pipeline of its own.

A detection is given to its class only, so that no track goes from one class to another. A class is
followed from the frame in which it is first seen, with the state that it would have had if it had
been tracked alone: the empty frames before (the last `_REPLAYED`) are gone through again. Where all
detections are of one class, this is `pipeline.advance`.

Detectors confuse some classes, as car and truck. Those are tracked together, and the class of a
track is the one with the largest likelihood: a detection counts by its score, and is of another
class with a probability that is the same for all, so that it is the class with the largest sum of
scores. A corrected track has one class, an online row the best one by then.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from phdtrack import pipeline
from phdtrack.detect.convert import MAX_CLASSES, LeftOut, Limits
from phdtrack.kernels.grid import uncrowded
from phdtrack.pipeline import TrackingState
from phdtrack.protocols import AnyStages, FrameMemory
from phdtrack.types import F8, I8, STILL, Bool, Detections, Step, Tracks

# Empty frames that a class seen for the first time has been through: what is learned of them is the
# same with more.
_REPLAYED = 250
# Frames of which is remembered whose detections they were; a loop may be endless.
_MOST_KEPT = 100_000
# Identities that are remembered, those seen last.
_MOST_NAMED = 10_000
# A score counts as a probability; one that is none counts a little.
_LEAST_SCORE = 0.01


class Seed(NamedTuple):
    """The state of PCG64, NumPy's usual generator."""

    state: int
    increment: int
    has_word: int
    word: int

    @classmethod
    def of(cls, rng: np.random.Generator) -> Seed:
        """Of a generator."""
        held: Any = rng.bit_generator.state
        return cls(
            held["state"]["state"], held["state"]["inc"], held["has_uint32"], held["uinteger"]
        )

    def generator(self) -> np.random.Generator:
        """A generator that goes on from here."""
        rng = np.random.default_rng(0)
        inside = {"state": self.state, "inc": self.increment}
        held = {
            "bit_generator": "PCG64",
            "state": inside,
            "has_uint32": self.has_word,
            "uinteger": self.word,
        }
        rng.bit_generator.state = held
        return rng


class SavedPipeline(NamedTuple):
    """What a state holds of a class; see `_ClassPipeline`."""

    seed: Seed
    state: TrackingState
    together: bool
    rows: dict[int, I8]
    labels: dict[int, tuple[I8, F8]]
    sums: dict[tuple[int, int], float]


class SavedPipelines(NamedTuple):
    """What a state holds of all classes, besides the lanes of ``kinds``; see `ClassPipelines`."""

    kinds: tuple[int, ...]
    past: tuple[tuple[int, float, F8, bool], ...]
    names: dict[tuple[int, int], int]
    alone: int
    highest: int


@dataclass(frozen=True, slots=True)
class ClassSettings:
    """How classes are tracked.

    Attributes
    ----------
    usual : the stages of classes that have none of their own, before the first detection, too.
    own : the stages of the others, by class; of classes that are tracked together by the first.
    first : the first class of those that each class is tracked together with.
    only : the classes that are tracked; empty: all.
    least : by class the least score, and the least length of a box's longer side in pixels, that
        are tracked.
    apart : False: classes are not looked at.
    names : what they are called.
    limits : how many detections a frame may have.
    """

    usual: AnyStages
    own: Mapping[int, AnyStages] = field(default_factory=dict)
    first: Mapping[int, int] = field(default_factory=dict)
    only: tuple[int, ...] = ()
    least: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    apart: bool = True
    names: Mapping[int, str] = field(default_factory=dict)
    limits: Limits = field(default_factory=Limits)

    def stages(self, kind: int) -> AnyStages:
        """The stages of a class."""
        return self.own.get(kind, self.usual)

    def of(self, detections: Detections) -> I8:
        """(N,) the class that each detection is tracked as: of those that are tracked together the
        first.
        """
        if self.apart:
            label = detections.class_id
        else:
            label = np.zeros_like(detections.class_id)
        for one, other in self.first.items() if self.apart else ():
            label = np.where(detections.class_id == one, other, label)
        return label

    def wanted(self, detections: Detections) -> Bool:
        """(N,) whether each detection is tracked."""
        label = detections.class_id
        good = np.ones(len(detections), np.bool_)
        if self.only:
            good &= np.isin(label, self.only)
        for one, (score, side) in self.least.items():
            size = (detections.xyxy[:, 2:] - detections.xyxy[:, :2]).max(axis=1, initial=0.0)
            good &= (label != one) | ((detections.confidence >= score) & (size >= side))
        return good

    def taken(self, found: Detections, seen: Collection[int] = ()) -> tuple[I8, LeftOut]:
        """(k,) which detections are tracked, and how many others there are; ``seen`` are the
        classes of earlier frames.
        """
        rows, out = self.limits.plausible(found)
        wanted = rows[self.wanted(found.select(rows))]
        known = wanted[self._among_classes(found.select(wanted), seen)]
        out = out._replace(unwanted=len(rows) - len(wanted), classes=len(wanted) - len(known))
        wanted = known
        apart = wanted[self._uncrowded(found.select(wanted))]
        best = apart[self.limits.best(found.confidence[apart])]
        return best, out._replace(crowded=len(wanted) - len(apart), surplus=len(apart) - len(best))

    def _among_classes(self, found: Detections, seen: Collection[int]) -> Bool:
        """(N,) whether the class of each detection is seen already, or one of those that there is
        room for.
        """
        label = self.of(found)
        best = dict.fromkeys(label[np.argsort(-found.confidence, kind="stable")].tolist())
        known = [*seen, *(kind for kind in best if kind not in seen)]
        if len(known) <= MAX_CLASSES:
            return np.ones(len(found), np.bool_)
        return np.isin(label, known[:MAX_CLASSES])

    def _uncrowded(self, found: Detections) -> Bool:
        """(N,) whether each detection is one of the best in its place, of those of its class."""
        most = self.limits.max_in_one_place
        kept = np.ones(len(found), np.bool_)
        if len(found) <= most:
            return kept
        label = self.of(found)
        for kind in np.unique(label).tolist():
            order = np.flatnonzero(label == kind)
            order = order[np.argsort(-found.confidence[order], kind="stable")]
            sensor = self.stages(kind).model.sensor
            z = sensor.measure(found.select(order))
            reach = np.subtract(*sensor.gate(z)[::-1]) / 2
            # A foot above the horizon is in no place.
            known = np.isfinite(z).all(axis=0) & np.isfinite(reach).all(axis=0)
            at = np.ascontiguousarray(z[:2, known])
            half = np.ascontiguousarray(reach[:, known])
            kept[order[known]] = uncrowded(at, half, most)
        return kept


@dataclass(slots=True)
class _ClassPipeline:
    """What is held of a class, or of those that are tracked together.

    ``rows``: in frames with other detections, which of them were its; ``labels``: classes and
    scores in a frame, of several classes only; ``sums``: of scores, by online identity and class.
    """

    stages: AnyStages
    rng: np.random.Generator
    state: TrackingState
    together: bool = False
    rows: dict[int, I8] = field(default_factory=dict)
    labels: dict[int, tuple[I8, F8]] = field(default_factory=dict)
    sums: dict[tuple[int, int], float] = field(default_factory=dict)

    @classmethod
    def begin(cls, stages: AnyStages, seed: int, *, together: bool = False) -> _ClassPipeline:
        """Before the first frame."""
        rng = np.random.default_rng(seed)
        return cls(stages, rng, pipeline.start(stages, rng), together)

    def advance(self, found: Detections, number: int, time: float, warp: F8) -> Step:
        """What a frame brought."""
        self.state, step = pipeline.advance(
            self.stages, self.state, found, number, time, self.rng, warp
        )
        if self.together and len(found):
            remember(
                self.labels, number, (found.class_id, np.clip(found.confidence, _LEAST_SCORE, 1.0))
            )
        return step

    @property
    def oldest(self) -> int:
        """The number of the first frame that is remembered; 0 if that is not known."""
        association = self.state.association
        return association.oldest_frame if isinstance(association, FrameMemory) else 0

    def votes(
        self, rows: Tracks, sums: dict[tuple[int, int], float]
    ) -> dict[tuple[int, int], float]:
        """``sums`` of scores by identity and class, with those of the detections that the rows rest
        on.
        """
        places = zip(
            rows.frame.tolist(), rows.identity.tolist(), rows.detection.tolist(), strict=True
        )
        for frame, identity, detection in places:
            if detection >= 0 and frame in self.labels:
                label, score = self.labels[frame]
                key = identity, int(label[detection])
                # Those that are used come last.
                sums[key] = sums.pop(key, 0.0) + float(score[detection])
        return sums

    def classed(self, rows: Tracks, kind: int, sums: Mapping[tuple[int, int], float]) -> I8:
        """(M,) the class of each row."""
        if not self.together:
            return np.full(len(rows), kind)
        best: dict[int, tuple[float, int]] = {}
        for (identity, label), total in sums.items():
            best[identity] = max(best.get(identity, (0.0, kind)), (total, label))
        return np.array([best.get(one, (0.0, kind))[1] for one in rows.identity.tolist()], np.int64)


class ClassPipelines:
    """The pipelines of the classes that were seen so far: what a `Tracker` holds.

    Parameters
    ----------
    kinds : how classes are tracked.
    seed : of each pipeline's randomness.
    """

    def __init__(self, kinds: ClassSettings, seed: int) -> None:
        self.kinds = kinds
        self._seed = seed
        self._lanes: dict[int, _ClassPipeline] = {}
        # Follows the frames before the first detection.
        self._blank = _ClassPipeline.begin(kinds.usual, seed)
        self._past: deque[tuple[int, float, F8, bool]] = deque(maxlen=_REPLAYED)
        # Identities of a class in terms of those of all. Up to `_alone` the first class had them
        # for itself.
        self._names: dict[tuple[int, int], int] = {}
        self._alone = self.highest = 0  # the highest that was given online

    @property
    def state(self) -> TrackingState:
        """The state of the class that was seen first."""
        return next(iter(self._lanes.values()), self._blank).state

    @property
    def states(self) -> dict[int, TrackingState]:
        """The states of all classes."""
        return {kind: lane.state for kind, lane in self._lanes.items()}

    @property
    def oldest(self) -> int:
        """The number of the first frame that any of them remembers."""
        return min(lane.oldest for lane in self._lanes.values() or (self._blank,))

    def skip(self, count: int) -> None:
        """Leave out as many identities, as another run may have given them."""
        self.highest += count
        if len(self._lanes) <= 1:
            lane = next(iter(self._lanes.values()), self._blank)
            lane.state = replace(lane.state, association=_skipped(lane.state.association, count))

    @property
    def drawn(self) -> bool:
        """Whether anything was drawn at random."""
        fresh = np.random.default_rng(self._seed).bit_generator
        used = [lane.rng.bit_generator for lane in (*self._lanes.values(), self._blank)]
        # What a generator has drawn moves its state on; what it has spawned it counts.
        return any(
            one.state != fresh.state or getattr(one.seed_seq, "n_children_spawned", 0) > 0
            for one in used
        )

    def advance(self, detections: Detections, number: int, time: float, warp: F8 = STILL) -> Step:
        """Everything that a frame brought, of all classes; identities are one's own among all of
        them.

        Parameters
        ----------
        detections, number, time, warp : as `pipeline.advance` has them, which says what is raised.
        """
        label = self.kinds.of(detections)
        gone_through = dict[int, _ClassPipeline]()
        for kind in np.unique(label).tolist():
            if kind not in self._lanes:
                self._open(kind, gone_through)
        lanes = self._lanes or {0: self._blank}
        if len(lanes) == 1:
            ((kind, lane),) = lanes.items()
            step = lane.advance(detections, number, time, warp)
            tracks = self._given(kind, lane, step.tracks)
        else:
            index = {kind: np.flatnonzero(label == kind) for kind in lanes}
            steps = {
                k: lane.advance(detections.select(index[k]), number, time, warp)
                for k, lane in lanes.items()
            }
            for kind, lane in lanes.items():
                remember(lane.rows, number, index[kind])
            tracks = Tracks.concatenate(
                [self._given(kind, lanes[kind], one.tracks) for kind, one in steps.items()]
            )
            step = pipeline.merged(list(steps.values()), list(index.values()), detections)
        for lane in lanes.values():
            if lane.rows or lane.labels:
                forget(lane.rows, lane.oldest)
                forget(lane.labels, lane.oldest)
        self._past.append((number, time, warp, detections.observed))
        return replace(step, tracks=tracks)

    def flush(self) -> Tracks:
        """The online rows that the output delay holds back."""
        lanes = self._lanes or {0: self._blank}
        return Tracks.concatenate(
            [
                self._given(k, lane, pipeline.flush(lane.stages, lane.state))
                for k, lane in lanes.items()
            ]
        )

    def finish(self) -> Tracks:
        """The corrected tracks of all classes, with identities from 1 in the order of their first
        rows.
        """
        lanes = self._lanes or {0: self._blank}
        parts = list[Tracks]()
        used = 0
        for kind, lane in lanes.items():
            rows = pipeline.finish(lane.stages, lane.state)
            label = lane.classed(rows, kind, lane.votes(rows, {}) if lane.together else {})
            rows = input_rows(rows, lane.rows)
            parts.append(replace(rows, identity=rows.identity + used, class_id=label))
            used += int(rows.identity.max(initial=0))
        if len(parts) == 1:
            return parts[0]
        rows = Tracks.concatenate(parts)
        _, first, place = np.unique(rows.identity, return_index=True, return_inverse=True)
        rank = np.empty(len(first), np.int64)
        rank[np.argsort(first, kind="stable")] = np.arange(1, len(first) + 1)
        return Tracks.concatenate([replace(rows, identity=rank[place])])

    def saved(self) -> tuple[SavedPipelines, tuple[SavedPipeline, ...]]:
        """Everything that decides what comes next: values that no later frame changes."""
        whole = SavedPipelines(
            tuple(self._lanes), tuple(self._past), dict(self._names), self._alone, self.highest
        )
        return whole, tuple(_saved(lane) for lane in self._lanes.values() or (self._blank,))

    def restore(self, whole: Any, lanes: Any, where: str) -> None:
        """Go on from what was `saved`, packed and read again. Raises `InputError` where it is of
        other settings.
        """
        from phdtrack.state import unpack

        found: SavedPipelines = unpack(whole, SavedPipelines, where=where)
        kinds, past, self._names, self._alone, self.highest = found
        made = [_restored(self.kinds.stages(k) if kinds else self.kinds.usual, one, f"{where}, class {k}")
                for k, one in zip(kinds or (0,), lanes, strict=True)]  # fmt: skip
        self._blank = made[0]
        self._lanes = dict(zip(kinds, made, strict=False))
        self._past = deque(past, maxlen=_REPLAYED)

    def _open(self, kind: int, gone_through: dict[int, _ClassPipeline]) -> None:
        """Follow a class from now on: the empty frames so far lie behind it.

        They are gone through once in a frame for classes of the same stages; ``gone_through`` is
        added to.
        """
        stages = self.kinds.stages(kind)
        together = kind in self.kinds.first.values() and self.kinds.apart
        if not self._lanes and stages is self.kinds.usual:
            self._blank.together = together
            self._lanes[kind] = self._blank
            return
        before = gone_through.get(id(stages))
        if before is None:
            before = gone_through[id(stages)] = _ClassPipeline.begin(stages, self._seed)
            for number, time, warp, observed in self._past:
                before.advance(Detections.empty(observed=observed), number, time, warp)
        lane = _ClassPipeline(stages, copy.deepcopy(before.rng), before.state, together)
        if len(self._lanes) == 1:
            self._alone = self.highest
        else:
            self._alone = self._alone
        self._lanes[kind] = lane

    def _given(self, kind: int, lane: _ClassPipeline, rows: Tracks) -> Tracks:
        """Online rows with the class, with detections as they were given, and with identities among
        all classes.
        """
        if lane.together:
            newest(lane.votes(rows, lane.sums))
        label = lane.classed(rows, kind, lane.sums)
        identity = rows.identity
        if len(self._lanes) <= 1:
            self.highest = max(self.highest, int(identity.max(initial=0)))
            return replace(rows, class_id=label)
        mine = next(iter(self._lanes)) == kind
        for one in sorted({one for one in identity.tolist() if not (mine and one <= self._alone)}):
            known = self._names.pop((kind, one), 0)
            self.highest += not known
            # Those that are used come last.
            self._names[kind, one] = known or self.highest
        newest(self._names)
        named = np.array([self._names.get((kind, one), one) for one in identity.tolist()], np.int64)
        return replace(input_rows(rows, lane.rows), identity=named, class_id=label)


def input_rows(rows: Tracks, kept: Mapping[int, I8]) -> Tracks:
    """The rows with their detections counted among more: in frame k, number i is ``kept[k][i]``."""
    if not kept:
        return rows
    detection = rows.detection.copy()
    for number in kept.keys() & set(rows.frame.tolist()):
        at = (rows.frame == number) & (detection >= 0)
        detection[at] = kept[number][detection[at]]
    return replace(rows, detection=detection)


def remember(kept: dict[int, Any], number: int, value: Any) -> None:
    """Keep the value of a frame; the oldest go.

    Parameters
    ----------
    kept : values by number of the frame, which is changed.
    number, value : of this frame.
    """
    kept[number] = value
    if len(kept) > _MOST_KEPT:
        del kept[next(iter(kept))]


def _skipped(association: Any, count: int) -> Any:
    """An associator's state that leaves out as many identities; of one's own it stays."""
    # By name: nothing is loaded for it.
    match type(association).__name__:
        case "RejectionState":
            return replace(association, inner=_skipped(association.inner, count))
        case "GraphState":
            return replace(
                association, given=replace(association.given, used=association.given.used + count)
            )
        case "LabelledState":
            return replace(association, used=association.used + count)
    return association


def forget(kept: dict[int, Any], before: int) -> None:
    """Drop what is of frames before that one."""
    while kept and next(iter(kept)) < before:
        del kept[next(iter(kept))]


def newest(kept: dict[tuple[int, int], Any]) -> None:
    """Drop all but the last `_MOST_NAMED`."""
    while len(kept) > _MOST_NAMED:
        del kept[next(iter(kept))]


def _saved(lane: _ClassPipeline) -> SavedPipeline:
    """What `_restored` makes the lane of."""
    return SavedPipeline(
        Seed.of(lane.rng),
        lane.state,
        lane.together,
        dict(lane.rows),
        dict(lane.labels),
        dict(lane.sums),
    )


def _restored(stages: AnyStages, packed: Any, where: str) -> _ClassPipeline:
    """The lane with these stages. Raises `InputError` where what was packed is of others."""
    from phdtrack.state import unpack

    like = _saved(_ClassPipeline.begin(stages, 0))
    found: SavedPipeline = unpack(packed, SavedPipeline, like, where)
    return _ClassPipeline(stages, found.seed.generator(), *found[1:])
