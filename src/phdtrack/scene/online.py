"""Learning births and false alarms while tracking [M09 §VI], with forgetting, and a guard against what has become wrong.

Frames wait for their labels (`scene.labelling`). Every few seconds those that are due are labelled, what was learned before
is scored on them, and the online mixtures of births, of false alarms and of objects' detections learn from them.

**The guard.** A density is in use only while it explains new samples better than what would be used without it. For births
that is p(z|b) against p(z|o), the ratio by which births around detections are weighted (`models.scene`). False alarms are
added to those of the model, which are no density over the image; p(z|c) is compared with the uniform density.

**Regimes.** A scene may be told that it is now in another regime, such as night: each regime has its own mixtures.

Everything is a value: a state goes in and comes out, and the same frames give the same state.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from phdtrack.scene.files import LearnedDensity, Scene, TrackedObjects
from phdtrack.scene.labelling import Labels, PendingFrames, label
from phdtrack.scene.mixture import OBSERVED, SceneDensity, marginal
from phdtrack.scene.online_mixture import Batch, OnlineMixture
from phdtrack.scene.training import detected_sizes, measurement_volume, state_volume
from phdtrack.types import F8, Step

# Something is learned after this part of the memory, and after so many seconds at least.
BATCHES, MIN_INTERVAL = 30.0, 1.0
FIRST = "first"
# Frames per second that rates per frame of a scene file are taken for, until frames are counted.
FRAMES_PER_SECOND = 25.0


@dataclass(frozen=True, slots=True)
class OnlineLearning:
    """How a scene is learned online.

    Parameters
    ----------
    width, height : of the image, pixels.
    rate : time units per second, of births.
    memory : seconds after which a sample counts for 37 %.
    delay : seconds until a detection is labelled.
    detection : p_D.
    """

    width: float
    height: float
    rate: float
    memory: float
    delay: float
    detection: float

    def interval(self, known: float) -> float:
        """Seconds between two times of learning in a regime of ``known`` seconds: at first more often."""
        return max(MIN_INTERVAL, min(self.memory, known) / BATCHES)


@dataclass(frozen=True, slots=True, eq=False)
class LearnedParts:
    """Births, false alarms and objects' detections as densities; None where nothing is known."""

    births: LearnedDensity | None
    clutter: LearnedDensity | None
    objects: LearnedDensity | None

    @property
    def birth_gain(self) -> Callable[[F8], F8] | None:
        """Gives log p(z|b)/p(z|o) of states (6, k), nats; None where one of the two is not known."""
        if self.births is None or self.objects is None:
            return None
        births, objects = marginal(self.births.density, OBSERVED), self.objects.density

        def gain(x: F8) -> F8:
            z = np.ascontiguousarray(x[list(OBSERVED)])
            out: F8 = _log(births, z) - _log(objects, z)
            return out

        return gain


@dataclass(frozen=True, slots=True, eq=False)
class Batches:
    """New samples of births, false alarms and objects' detections from the last ``seconds``."""

    births: Batch
    clutter: Batch
    objects: Batch
    seconds: float

    @classmethod
    def of(cls, labels: Labels, rate: float) -> Batches:
        """The samples in labels, with ``rate`` time units per second."""
        possible, seen, per_second = labels.false > 0, labels.false < 1, labels.frames / labels.seconds
        return cls(
            Batch(labels.births, np.ones(labels.births.shape[1]), labels.seconds * rate, rate),
            Batch(labels.box[:, possible], labels.false[possible], labels.frames, per_second),
            Batch(labels.box[:, seen], 1 - labels.false[seen], labels.frames, per_second),
            labels.seconds,
        )


@dataclass(frozen=True, eq=False)
class Regime:
    """One state of the scene: its name, its online mixtures, and the seconds for which it was active (``clock``)."""

    name: str
    births: OnlineMixture
    clutter: OnlineMixture
    objects: OnlineMixture
    clock: float = 0.0

    @cached_property
    def known(self) -> LearnedParts:
        """What is known, with the shrinkage prior over the sizes that were detected."""
        size = np.hstack([self.clutter.recent.samples[2:], self.objects.recent.samples[2:]])
        if not size.shape[1]:
            return LearnedParts(None, None, None)
        sizes = detected_sizes(size)
        return LearnedParts(*(part.learned(sizes) for part in (self.births, self.clutter, self.objects)))

    @property
    def births_used(self) -> bool:
        """Whether births are in use: they are trusted, and it is known where objects are."""
        return self.births.trusted and len(self.objects.density) > 0

    @property
    def trusted(self) -> bool:
        """Whether anything is in use."""
        return self.births_used or self.clutter.trusted

    @property
    def used(self) -> LearnedParts:
        """What is in use, with objects."""
        births, clutter = self.births_used, self.clutter.trusted
        known = self.known
        return LearnedParts(known.births if births else None, known.clutter if clutter else None, known.objects)

    def decided(self, new: Batches, memory: float) -> Regime:
        """With births and false alarms scored on new samples, and in use or not by the evidence; ``memory`` in seconds."""
        gain = self.known.birth_gain
        births = self.births if gain is None else self.births.scored(new.births, memory, gain)
        return replace(self, births=births.decided(), clutter=self.clutter.scored(new.clutter, memory).decided())

    def updated(self, new: Batches, memory: float) -> Regime:
        """After learning from new samples; ``memory`` in seconds."""
        now = self.clock + new.seconds
        return Regime(
            self.name,
            self.births.updated(new.births, now, memory),
            self.clutter.updated(new.clutter, now, memory),
            self.objects.updated(new.objects, now, memory),
            now,
        )


@dataclass(frozen=True, slots=True)
class SceneUpdate:
    """What was learned with frame ``number``, at ``time`` seconds.

    Attributes
    ----------
    regime : name of the regime that learned.
    births, clutter : rates: births per time unit, false alarms per frame.
    birth_gain, clutter_gain : nats by which new samples were likelier than as detections of objects, and than uniform ones.
    births_used, clutter_used : whether each is in use; otherwise that part of the model is as without learning.
    changes : what came into use or fell out of it, in sentences.
    """

    number: int
    time: float
    regime: str
    births: float
    clutter: float
    birth_gain: float
    clutter_gain: float
    births_used: bool
    clutter_used: bool
    changes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class OnlineScene:
    """What is known of a scene, and the frames that wait for labels.

    ``learned``: seconds at which something was last learned, NaN before; ``last``: what.
    """

    regimes: tuple[Regime, ...]
    active: int = 0
    pending: PendingFrames = field(default_factory=PendingFrames)
    learned: float = math.nan
    last: SceneUpdate | None = None

    @property
    def regime(self) -> Regime:
        """The active one."""
        return self.regimes[self.active]


def begin(rule: OnlineLearning, scenes: tuple[Scene, ...] = ()) -> OnlineScene:
    """Knowing nothing, or what was learned before: each scene is a regime, the first of them is active."""
    return OnlineScene(tuple(_of_scene(rule, scene) for scene in scenes) or (_unknown(rule, FIRST),))


def named(rule: OnlineLearning, state: OnlineScene, name: str) -> OnlineScene:
    """With the regime of this name active; a new one, which knows nothing, where there is none."""
    names = [regime.name for regime in state.regimes]
    if name in names:
        return replace(state, active=names.index(name))
    return replace(state, regimes=(*state.regimes, _unknown(rule, name)), active=len(names))


def advance(rule: OnlineLearning, state: OnlineScene, step: Step) -> OnlineScene:
    """Take in one frame, and learn when it is time to. Frames that were not observed teach nothing."""
    begun = step.time if math.isnan(state.learned) else state.learned
    pending = state.pending.joined(step)
    if step.time < begun + rule.interval(state.regime.clock) or not pending.frames:
        return replace(state, pending=pending, learned=begun)
    pending, labels = label(pending, step.time - rule.delay, rule.detection, rule.rate)
    state = replace(state, pending=pending, learned=step.time)
    return _learned(rule, state, labels, step) if labels.frames else state


def scene_of(rule: OnlineLearning, regime: Regime, source: str) -> Scene:
    """What is in use of a regime, as it is written to a file. Which false alarms become tracks is not known."""
    used = regime.used
    objects = None if used.objects is None else TrackedObjects(0.0, used.objects)
    size = round(rule.width), round(rule.height)
    return Scene(*size, rule.rate, source, used.births, used.clutter, {"mode": regime.name}, objects)


def _learned(rule: OnlineLearning, state: OnlineScene, labels: Labels, step: Step) -> OnlineScene:
    """Score what is known on new samples, decide what is in use, and learn from them."""
    new, before = Batches.of(labels, rule.rate), state.regime
    decided = before.decided(new, rule.memory)
    regime = decided.updated(new, rule.memory)
    last = SceneUpdate(
        step.number,
        step.time,
        regime.name,
        regime.births.rate,
        regime.clutter.rate,
        regime.births.evidence.mean,
        regime.clutter.evidence.mean,
        regime.births_used,
        regime.clutter.trusted,
        _changes(before, decided),
    )
    regimes = (*state.regimes[: state.active], regime, *state.regimes[state.active + 1 :])
    return replace(state, regimes=regimes, last=last)


def _changes(before: Regime, now: Regime) -> tuple[str, ...]:
    """What came into use or fell out of it, in sentences."""
    changes = []
    for what, old, new, than in (
        ("births", before.births, now.births, "as any detection of an object"),
        ("false alarms", before.clutter, now.clutter, "under uniform ones"),
    ):
        if new.trusted != old.trusted:
            gain = f"the last samples are {new.newest.mean:+.2f} nats likelier than {than}"
            changes.append(f"learned {what} {'in use' if new.trusted else 'out of use: as without learning'} ({gain})")
    return tuple(changes)


def _unknown(rule: OnlineLearning, name: str) -> Regime:
    """A regime that knows nothing. Births may be as fast as the image is wide in a second."""
    births = OnlineMixture.unknown(*state_volume(rule.width, rule.height, max(rule.width, rule.height) / rule.rate))
    boxes = OnlineMixture.unknown(*measurement_volume(rule.width, rule.height))
    return Regime(name, births, boxes, boxes)


def _of_scene(rule: OnlineLearning, scene: Scene) -> Regime:
    """What was learned before; any size may come."""

    def known(unknown: OnlineMixture, learned: LearnedDensity | None, rate: float) -> OnlineMixture:
        if learned is None:
            return unknown
        part = OnlineMixture.of(learned, rule.memory, rate)
        return replace(part, density=replace(part.density, low=unknown.density.low, high=unknown.density.high))

    new = _unknown(rule, str(scene.notes.get("mode", FIRST)))
    objects = None if scene.followed is None else scene.followed.objects
    return Regime(
        new.name,
        known(new.births, scene.births, rule.rate),
        known(new.clutter, scene.clutter, FRAMES_PER_SECOND),
        known(new.objects, objects, FRAMES_PER_SECOND),
    )


def _log(p: SceneDensity, z: F8) -> F8:
    """(k,) log p at boxes (4, k), nowhere below its uniform part."""
    out: F8 = np.where(p.contains(z), np.logaddexp.reduce(p.log_parts(z), axis=0), math.log(p.flat))
    return out
