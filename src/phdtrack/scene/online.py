"""Learning births and false alarms while tracking [M09 §VI], with forgetting, and a guard against what has become wrong.

Frames wait for their labels (`scene.labelling`). Every few seconds those that are due are labelled, what was learned before
is scored on them, and births, false alarms and objects' detections are learned from them (`scene.online_mixture`).

**The guard.** A density is in use only while it explains new samples, before it learns them, better than what would be used
without it: the mean over recent samples of log p(x) − log q(x) must exceed two standard errors. For births q is p(z|o), by
which births around detections are weighted (`models.scene`). False alarms are added to those of the model, which are no
density over the image; there q is uniform.

**Regimes.** A user may say that the scene is now in another regime, such as night: each regime has its own mixtures.

Everything is a value: a state goes in and comes out, and the same frames give the same state.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from phdtrack.scene.files import LearnedDensity, Scene, TrackedObjects
from phdtrack.scene.labelling import Labels, PendingFrames, label
from phdtrack.scene.mixture import OBSERVED, marginal
from phdtrack.scene.online_mixture import Batch, OnlineMixture
from phdtrack.scene.training import measurement_volume, state_volume
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


class Known(NamedTuple):
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
        # Neither is below its uniform part anywhere.
        return lambda x: np.asarray(
            np.log(births(x[list(OBSERVED)], births.flat)) - np.log(objects(x[list(OBSERVED)], objects.flat))
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
    def known(self) -> Known:
        """What is known, with the shrinkage prior over the sizes that were detected."""
        sizes = np.hstack([self.clutter.samples[2:], self.objects.samples[2:]])
        if not sizes.shape[1]:
            return Known(None, None, None)
        return Known(*(part.learned(sizes) for part in (self.births, self.clutter, self.objects)))

    @property
    def births_used(self) -> bool:
        """Whether births are in use: they are trusted, and it is known where objects are."""
        return self.births.trusted and len(self.objects.density) > 0

    @property
    def trusted(self) -> bool:
        """Whether anything is in use."""
        return self.births_used or self.clutter.trusted

    @property
    def used(self) -> Known:
        """What is in use, with objects."""
        births, clutter, objects = self.known
        return Known(births if self.births_used else None, clutter if self.clutter.trusted else None, objects)

    def scored(self, births: Batch, clutter: Batch, memory: float) -> Regime:
        """With births and false alarms in use or not by the evidence of new samples; ``memory`` in seconds."""
        gain = self.known.birth_gain
        scored = self.births.decided() if gain is None else self.births.scored(births, memory, gain)
        return replace(self, births=scored, clutter=self.clutter.scored(clutter, memory))

    def updated(self, new: tuple[Batch, Batch, Batch], seconds: float, memory: float) -> Regime:
        """After learning from new births, false alarms and objects of the last ``seconds``; ``memory`` in seconds."""
        now, parts = self.clock + seconds, (self.births, self.clutter, self.objects)
        births, clutter, objects = (part.updated(batch, now, memory) for part, batch in zip(parts, new, strict=True))
        return Regime(self.name, births, clutter, objects, now)


def batches(labels: Labels, rate: float) -> tuple[Batch, Batch, Batch]:
    """New births, false alarms and objects' detections in labels, with ``rate`` time units per second."""
    possible, seen, per_second = labels.false > 0, labels.false < 1, labels.frames / labels.seconds
    return (
        Batch(labels.births, np.ones(labels.births.shape[1]), labels.seconds * rate, rate),
        Batch(labels.box[:, possible], labels.false[possible], labels.frames, per_second),
        Batch(labels.box[:, seen], 1 - labels.false[seen], labels.frames, per_second),
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
    pending, before = state.pending.joined(step), state.regime
    if step.time < begun + rule.interval(before.clock) or not pending.frames:
        return replace(state, pending=pending, learned=begun)
    pending, labels = label(pending, step.time - rule.delay, rule.detection, rule.rate)
    state = replace(state, pending=pending, learned=step.time)
    if not labels.frames:
        return state
    new = batches(labels, rule.rate)
    scored = before.scored(*new[:2], rule.memory)
    regime = scored.updated(new, labels.seconds, rule.memory)
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
        _changes(before, scored),
    )
    regimes = (*state.regimes[: state.active], regime, *state.regimes[state.active + 1 :])
    return replace(state, regimes=regimes, last=last)


def scene_of(rule: OnlineLearning, regime: Regime, source: str) -> Scene:
    """What is in use of a regime, as it is written to a file. Which false alarms become tracks is not known."""
    births, clutter, objects = regime.used
    followed = None if objects is None else TrackedObjects(0.0, objects)
    size = round(rule.width), round(rule.height)
    return Scene(*size, rule.rate, source, births, clutter, {"mode": regime.name}, followed)


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
    new = _unknown(rule, str(scene.notes.get("mode", FIRST)))
    objects = scene.followed.objects if scene.followed is not None else None
    return Regime(
        new.name,
        new.births.known(scene.births, rule.memory, rule.rate),
        new.clutter.known(scene.clutter, rule.memory, FRAMES_PER_SECOND),
        new.objects.known(objects, rule.memory, FRAMES_PER_SECOND),
    )
