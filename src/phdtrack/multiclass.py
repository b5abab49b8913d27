"""Objects of several classes: each class, or several that are tracked together, is followed by a
pipeline of its own.

A detection is given to its class only, so that no track goes from one class to another. A class is
followed from the frame in which it is first seen, with the state that it would have had if it had
been tracked alone: the empty frames before (the last `_REPLAYED`) are gone through again. If all
detections are of one class, this is `pipeline.advance`.

Detectors confuse some classes, as car and truck. Those are tracked together, and the class of a
track is the one with the largest likelihood: a detection counts by its score, and is of another
class with a probability that is the same for all, so that it is the class with the largest sum of
scores. A corrected track has one class, an online row the best one by then.
"""

from __future__ import annotations

import copy
import pickle
from collections import deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from phdtrack import pipeline
from phdtrack.detect.convert import MAX_CLASSES, DiscardedBoxes, Limits
from phdtrack.kernels.grid import may_be_crowded, uncrowded
from phdtrack.kernels.second_compiler import SECOND
from phdtrack.models.warp import joined
from phdtrack.pipeline import TrackingState
from phdtrack.protocols import AnyStages
from phdtrack.types import F8, I8, STILL, Bool, Detections, Exchange, Return, Step, Tracks

# Empty frames that a class seen for the first time has been through: more teach nothing else.
_REPLAYED = 250
# Sums of scores that are kept, of the identities seen last; a loop may be endless.
_MAX_VOTES = 10_000
# A score counts as a probability; one that is none counts a little.
_LEAST_SCORE = 0.01

# Sums of scores by identity and class.
Votes = dict[tuple[int, int], float]


class Seed(NamedTuple):
    """The state of PCG64, NumPy's usual generator."""

    state: int
    increment: int
    has_word: int
    word: int

    @classmethod
    def of(cls, rng: np.random.Generator) -> Seed:
        """The state of a generator."""
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
    """The saved state of a class; see `_ClassPipeline`."""

    seed: Seed
    state: TrackingState
    together: bool
    waiting: tuple[tuple[int, I8, I8, F8], ...]
    votes: dict[tuple[int, int], float]
    highest: int


class SavedPipelines(NamedTuple):
    """The saved state besides the pipelines of the ``classes``; see `ClassPipelines`."""

    classes: tuple[int, ...]
    past: tuple[tuple[int, float, F8, bool], ...]
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
    apart : False: classes make no difference.
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

    def stages(self, label: int) -> AnyStages:
        """The stages of a class."""
        return self.own.get(label, self.usual)

    def tracked_as(self, detections: Detections) -> I8:
        """(N,) the class that each detection is tracked as: the first of those that are tracked
        together.
        """
        if not self.apart:
            return np.zeros_like(detections.class_id)
        labels = detections.class_id
        for label, first in self.first.items():
            labels = np.where(detections.class_id == label, first, labels)
        return labels

    def selected(self, detections: Detections) -> Detections:
        """The detections of classes that are tracked, with enough score and size."""
        if not (self.only or self.least):
            return detections
        labels = detections.class_id
        good = np.ones(len(detections), np.bool_)
        if self.only:
            good &= np.isin(labels, self.only)
        for label, (score, side) in self.least.items():
            size = (detections.xyxy[:, 2:] - detections.xyxy[:, :2]).max(axis=1, initial=0.0)
            good &= (labels != label) | ((detections.confidence >= score) & (size >= side))
        return _only(detections, good)

    def within_limits(
        self, detections: Detections, known: Collection[int] = ()
    ) -> tuple[Detections, DiscardedBoxes]:
        """The detections that are tracked, and how many others there are.

        Parameters
        ----------
        detections : of a frame.
        known : the classes of earlier frames.
        """
        rows, out = self.limits.plausible(detections)
        plausible = detections if len(rows) == len(detections) else detections.select(rows)
        selected = self.selected(plausible)
        of_classes = self._among_classes(selected, known)
        apart = self._uncrowded(of_classes)
        best = apart
        if len(apart) > self.limits.max_detections:
            best = apart.select(self.limits.best(apart.confidence))
        if best is detections:
            return best, out
        return best, out._replace(
            unwanted=len(plausible) - len(selected),
            classes=len(selected) - len(of_classes),
            crowded=len(of_classes) - len(apart),
            surplus=len(apart) - len(best),
        )

    def _among_classes(self, detections: Detections, known: Collection[int]) -> Detections:
        """The detections whose class is known, or one of those that there is room for."""
        labels = self.tracked_as(detections)
        if len({*known, *labels.tolist()}) <= MAX_CLASSES:
            return detections
        best = dict.fromkeys(labels[np.argsort(-detections.confidence, kind="stable")].tolist())
        every = [*known, *(label for label in best if label not in known)]
        return _only(detections, np.isin(labels, every[:MAX_CLASSES]))

    def _uncrowded(self, detections: Detections) -> Detections:
        """The detections that are among the best in their place, of those of their class."""
        most = self.limits.max_in_one_place
        if len(detections) <= most:
            return detections
        kept: Bool | None = None
        labels = self.tracked_as(detections)
        distinct = _distinct(labels)
        for label in distinct:
            rows = np.arange(len(detections))
            if len(distinct) > 1:
                rows = np.flatnonzero(labels == label)
            if len(rows) <= most:
                continue
            own = detections if len(distinct) == 1 else detections.select(rows)
            sensor = self.stages(label).model.sensor
            z = sensor.measure(own)
            low, high = sensor.gate(z)
            half = (high - low) / 2
            # Of its own, so that only streams with crowds compile the rest, for 1.5 seconds.
            if not may_be_crowded(np.ascontiguousarray(z[:2]), half, most):
                continue
            order = np.argsort(-own.confidence, kind="stable")
            # A foot above the horizon is in no place.
            known = np.asarray(np.isfinite(z).all(axis=0) & np.isfinite(half).all(axis=0))
            order = order[known[order]]
            if kept is None:
                kept = np.ones(len(detections), np.bool_)
            kept[rows[order]] = uncrowded(
                np.ascontiguousarray(z[:2, order]), np.ascontiguousarray(half[:, order]), most
            )
        return detections if kept is None else _only(detections, kept)


@dataclass(slots=True)
class _ClassPipeline:
    """The pipeline of a class, or of those that are tracked together.

    ``waiting`` and ``votes`` are of several classes only: number, rows, classes and scores of the
    frames whose online rows are still to come, and the sums of scores of the online tracks.
    ``highest`` is the highest identity that it has given or must not give.
    """

    stages: AnyStages
    rng: np.random.Generator
    state: TrackingState
    together: bool = False
    waiting: tuple[tuple[int, I8, I8, F8], ...] = ()
    votes: Votes = field(default_factory=dict)
    highest: int = 0

    @classmethod
    def begin(cls, stages: AnyStages, seed: int, *, together: bool = False) -> _ClassPipeline:
        """The pipeline before the first frame."""
        rng = np.random.default_rng(seed)
        return cls(stages, rng, pipeline.start(stages, rng), together)

    def advance(
        self, label: int, detections: Detections, number: int, time: float, warp: F8, highest: int
    ) -> Step:
        """The step of a frame, whose tracks have classes.

        Parameters
        ----------
        label : the class.
        detections, number, time, warp : see `pipeline.advance`.
        highest : new tracks have higher identities.
        """
        if self.highest < highest:
            associator = self.stages.associator
            numbered = associator.numbered_after(self.state.association, highest)
            self.state = replace(self.state, association=numbered)
            self.highest = highest
        self.state, step = pipeline.advance(
            self.stages, self.state, detections, number, time, self.rng, warp
        )
        rows = step.tracks
        self.highest = max((self.highest, *rows.identity.tolist()))
        if not self.together:
            # Rows are of class 0 at first.
            return replace(step, tracks=_with_class(rows, label)) if label else step
        if detections.observed:
            frame = (number, detections.row, detections.class_id, detections.confidence)
            self.waiting = (*self.waiting, frame)
        self._count(rows, self.votes)
        while len(self.votes) > _MAX_VOTES:
            del self.votes[next(iter(self.votes))]
        # Without tracks no row tells which frames are done; those that are forgotten are.
        oldest = self.stages.associator.oldest(self.state.association)
        until = max(int(rows.frame.max(initial=0)), oldest - 1)
        self.waiting = tuple(frame for frame in self.waiting if frame[0] > until)
        return replace(step, tracks=_with_best_class(rows, label, self.votes))

    def flush(self, label: int) -> Tracks:
        """The online rows that the output delay holds back, with classes."""
        rows = pipeline.flush(self.stages, self.state)
        if not self.together:
            return _with_class(rows, label)
        votes = dict(self.votes)
        self._count(rows, votes)
        return _with_best_class(rows, label, votes)

    def finish(self, label: int) -> Tracks:
        """The corrected tracks, with classes."""
        rows = pipeline.finish(self.stages, self.state)
        if not self.together:
            return _with_class(rows, label)
        measured = self.stages.associator.measurements(self.state.association)
        votes: Votes = {}
        detected = np.flatnonzero(rows.detection >= 0)
        column = measured.columns(rows)[detected]
        _vote(rows.identity[detected], measured.class_id[column], measured.score[column], votes)
        return _with_best_class(rows, label, votes)

    def _count(self, rows: Tracks, votes: Votes) -> None:
        """Add the scores of the detections that online rows rest on to the votes."""
        for number, row, labels, score in self.waiting:
            here = np.flatnonzero((rows.frame == number) & (rows.detection >= 0))
            column = np.searchsorted(row, rows.detection[here])
            _vote(rows.identity[here], labels[column], score[column], votes)


class ClassPipelines:
    """The pipelines of the classes that were seen so far: what a `Tracker` holds.

    Parameters
    ----------
    classes : how classes are tracked.
    seed : of each pipeline's randomness.
    """

    def __init__(self, classes: ClassSettings, seed: int) -> None:
        self.classes = classes
        self._seed = seed
        self._pipelines: dict[int, _ClassPipeline] = {}
        # Follows the frames before the first detection.
        self._blank = _ClassPipeline.begin(classes.usual, seed)
        self._past: deque[tuple[int, float, F8, bool]] = deque(maxlen=_REPLAYED)
        # Identities are one's own among all classes; new ones are higher than this.
        self.highest = 0
        SECOND.offer(lambda: pickle.dumps((classes, seed)))

    @property
    def _all(self) -> dict[int, _ClassPipeline]:
        """The pipelines by class; before the first detection the one that follows empty frames."""
        return self._pipelines or {0: self._blank}

    @property
    def state(self) -> TrackingState:
        """The state of the class that was seen first."""
        return next(iter(self._all.values())).state

    @property
    def states(self) -> dict[int, TrackingState]:
        """The states of all classes."""
        return {label: one.state for label, one in self._pipelines.items()}

    @property
    def labels(self) -> Collection[int]:
        """The classes that have been seen."""
        return self._pipelines.keys()

    @property
    def several(self) -> bool:
        """True if detections of several classes have been seen that are tracked apart."""
        return len(self._pipelines) > 1

    @property
    def oldest(self) -> int:
        """The number of the first frame that any of them remembers."""
        return min(
            one.stages.associator.oldest(one.state.association) for one in self._all.values()
        )

    def skip(self, count: int) -> None:
        """Leave out as many identities, which another run may have used."""
        self.highest += count

    @property
    def drawn(self) -> bool:
        """True if anything was drawn at random."""
        fresh = np.random.default_rng(self._seed).bit_generator
        used = [one.rng.bit_generator for one in (*self._pipelines.values(), self._blank)]
        # What a generator has drawn moves its state on; what it has spawned it counts.
        return any(
            one.state != fresh.state or getattr(one.seed_seq, "n_children_spawned", 0) > 0
            for one in used
        )

    def advance(self, detections: Detections, number: int, time: float, warp: F8 = STILL) -> Step:
        """Everything that a frame brought, of all classes.

        Parameters
        ----------
        detections, number, time, warp : see `pipeline.advance`, also for errors.
        """
        labels = self.classes.tracked_as(detections)
        if detections.observed:
            self._open(_distinct(labels))
        pipelines = self._all
        steps = list[Step]()
        for label, one in pipelines.items():
            own = detections if len(pipelines) == 1 else detections.select(labels == label)
            steps.append(one.advance(label, own, number, time, warp, self.highest))
            self.highest = one.highest
        if self._past and not self._past[-1][3]:
            # Frames without detection change nothing but the camera's place.
            warp = joined([self._past.pop()[2], warp])
        self._past.append((number, time, warp, detections.observed))
        if len(steps) == 1:
            return steps[0]
        tracks = Tracks.concatenate([step.tracks for step in steps])
        return replace(pipeline.merged(steps, detections), tracks=tracks)

    @property
    def returns(self) -> tuple[Return, ...]:
        """The identities that targets of all classes have taken again, oldest first."""
        found = [
            each
            for one in self._all.values()
            for each in one.stages.associator.returns(one.state.association)
        ]
        return tuple(sorted(found, key=lambda each: each.time))

    @property
    def exchanges(self) -> tuple[Exchange, ...]:
        """The identities that targets of all classes have exchanged, oldest first."""
        found = [
            each
            for one in self._all.values()
            for each in one.stages.associator.exchanges(one.state.association)
        ]
        return tuple(sorted(found, key=lambda each: each.frame))

    def flush(self) -> Tracks:
        """The online rows that the output delay holds back, with the identities that later frames
        would give them.
        """
        parts = [one.flush(label) for label, one in self._all.items()]
        if len(parts) == 1:
            return parts[0]
        fresh = list[tuple[int, int, int]]()
        for k, rows in enumerate(parts):
            identity, first = np.unique(rows.identity, return_index=True)
            new = identity > self.highest
            frames = rows.frame[first[new]].tolist()
            fresh += [(f, k, i) for f, i in zip(frames, identity[new].tolist(), strict=True)]
        names = {(k, i): self.highest + n for n, (_, k, i) in enumerate(sorted(fresh), start=1)}
        return Tracks.concatenate(
            [
                replace(
                    rows, identity=_integers(names.get((k, i), i) for i in rows.identity.tolist())
                )
                for k, rows in enumerate(parts)
            ]
        )

    def finish(self) -> Tracks:
        """The corrected tracks of all classes, with identities from 1 in the order of their first
        rows.
        """
        parts = list[Tracks]()
        used = 0
        for label, one in self._all.items():
            rows = one.finish(label)
            parts.append(replace(rows, identity=rows.identity + used))
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
        whole = SavedPipelines(tuple(self._pipelines), tuple(self._past), self.highest)
        return whole, tuple(_saved(one) for one in self._all.values())

    def restore(self, whole: Any, packed: Any, where: str) -> None:
        """Continue from what was `saved`, packed and read again. Raises `InputError` if it is of
        other settings.

        Parameters
        ----------
        whole, packed : the state of all classes, and that of each.
        where : the place of the state, for error messages.
        """
        from phdtrack.state import unpack

        held: SavedPipelines = unpack(whole, SavedPipelines, where=where)
        made = list[_ClassPipeline]()
        for k, one in enumerate(packed):
            stages = self.classes.usual
            if held.classes:
                stages = self.classes.stages(held.classes[k])
            made.append(_restored(stages, one, f"{where}, pipeline {k}"))
        self._blank = made[0]
        self._pipelines = dict(zip(held.classes, made, strict=False))
        self._past = deque(held.past, maxlen=_REPLAYED)
        self.highest = held.highest

    def _open(self, labels: list[int]) -> None:
        """Follow new classes from now on, with the empty frames so far behind them.

        Classes with the same stages go through these once.
        """
        replayed = dict[int, _ClassPipeline]()
        for label in labels:
            if label in self._pipelines:
                continue
            stages = self.classes.stages(label)
            together = label in self.classes.first.values() and self.classes.apart
            if not self._pipelines and stages is self.classes.usual:
                self._blank.together = together
                self._pipelines[label] = self._blank
                continue
            before = replayed.get(id(stages))
            if before is None:
                before = replayed[id(stages)] = _ClassPipeline.begin(stages, self._seed)
                for number, time, warp, observed in self._past:
                    empty = Detections.empty(observed=observed)
                    before.advance(label, empty, number, time, warp, 0)
            rng = copy.deepcopy(before.rng)
            self._pipelines[label] = _ClassPipeline(stages, rng, before.state, together)


def _distinct(labels: I8) -> list[int]:
    """The different labels, ascending; by a set, as hardly any frame has many."""
    return sorted(set(labels.tolist()))


def _only(detections: Detections, chosen: Bool) -> Detections:
    """The ``chosen`` detections (N,); all of them uncopied."""
    return detections if chosen.all() else detections.select(chosen)


def _integers(values: Iterable[int]) -> I8:
    """An array of these numbers."""
    return np.fromiter(values, np.int64)


def _with_class(rows: Tracks, label: int) -> Tracks:
    """The rows, all of one class."""
    return rows.with_class(np.full(len(rows), label))


def _with_best_class(rows: Tracks, label: int, votes: Votes) -> Tracks:
    """The rows, each of the class with the most votes for its identity; ``label`` without any."""
    best: dict[int, tuple[float, int]] = {}
    for (identity, candidate), total in votes.items():
        best[identity] = max(best.get(identity, (0.0, label)), (total, candidate))
    labels = (best.get(identity, (0.0, label))[1] for identity in rows.identity.tolist())
    return rows.with_class(_integers(labels))


def _vote(identity: I8, labels: I8, score: F8, votes: Votes) -> None:
    """Add the scores (M,) of detections of these classes to the votes for these identities."""
    weight = np.clip(score, _LEAST_SCORE, 1.0)
    for key in zip(identity.tolist(), labels.tolist(), weight.tolist(), strict=True):
        # Those that are used come last.
        votes[key[:2]] = votes.pop(key[:2], 0.0) + key[2]


def _saved(one: _ClassPipeline) -> SavedPipeline:
    """The record from which `_restored` makes the pipeline."""
    return SavedPipeline(
        Seed.of(one.rng), one.state, one.together, one.waiting, dict(one.votes), one.highest
    )


def _restored(stages: AnyStages, packed: Any, where: str) -> _ClassPipeline:
    """The pipeline with these stages. Raises `InputError` if what was packed is of others."""
    from phdtrack.state import unpack

    like = _saved(_ClassPipeline.begin(stages, 0))
    held: SavedPipeline = unpack(packed, SavedPipeline, like, where)
    return _ClassPipeline(stages, held.seed.generator(), *held[1:])
