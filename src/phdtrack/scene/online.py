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
from dataclasses import dataclass, field, replace
from functools import cached_property

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

Batches = tuple[Batch, Batch, Batch]
"""New births, false alarms and objects' detections."""


@dataclass(frozen=True, eq=False)
class Regime:
    """One state of the scene: its name, and its online mixtures of births, false alarms and objects' detections."""

    name: str
    births: OnlineMixture
    clutter: OnlineMixture
    objects: OnlineMixture

    @cached_property
    def known(self) -> tuple[LearnedDensity | None, LearnedDensity | None, LearnedDensity | None]:
        """Births, false alarms and objects, with the shrinkage prior over sizes; None where nothing is known."""
        sizes = np.hstack([self.clutter.samples[2:], self.objects.samples[2:]])
        if not sizes.shape[1]:
            return None, None, None
        return self.births.learned(sizes), self.clutter.learned(sizes), self.objects.learned(sizes)

    @property
    def births_used(self) -> bool:
        """Whether births are in use: they are trusted, and it is known where objects are."""
        return self.births.trusted and len(self.objects.density) > 0

    @property
    def trusted(self) -> bool:
        """Whether anything is in use."""
        return self.births_used or self.clutter.trusted

    def updated(self, new: Batches) -> Regime:
        """After learning from new samples, with births and false alarms in use or not by how well they explained them."""
        births, _, objects = self.known
        scored = self.births
        if births is not None and objects is not None:
            there, anywhere = marginal(births.density, OBSERVED), objects.density

            def gain(x: F8) -> F8:
                """log p(z|b)/p(z|o) of states (6, k), nats; neither is below its uniform part anywhere."""
                z = x[list(OBSERVED)]
                return np.asarray(np.log(there(z, there.flat)) - np.log(anywhere(z, anywhere.flat)))

            scored = self.births.scored(new[0], gain)
        parts = zip((scored, self.clutter.scored(new[1]), self.objects), new, strict=True)
        return Regime(self.name, *(part.updated(batch) for part, batch in parts))


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

    def begin(self, scenes: tuple[Scene, ...] = ()) -> OnlineScene:
        """Knowing nothing, or what was learned before: each scene is a regime, the first of them is active."""
        return OnlineScene(tuple(self._of_scene(scene) for scene in scenes) or (self._unknown(FIRST),))

    def named(self, state: OnlineScene, name: str) -> OnlineScene:
        """With the regime of this name active; a new one, which knows nothing, where there is none."""
        names = [regime.name for regime in state.regimes]
        if name in names:
            return replace(state, active=names.index(name))
        return replace(state, regimes=(*state.regimes, self._unknown(name)), active=len(names))

    def advance(self, state: OnlineScene, step: Step) -> OnlineScene:
        """Take in one frame, and learn when it is time to. Frames that were not observed teach nothing."""
        begun = step.time if math.isnan(state.learned) else state.learned
        pending, before = state.pending.joined(step), state.regime
        # At first more often.
        interval = max(MIN_INTERVAL, min(self.memory, before.births.clock) / BATCHES)
        if step.time < begun + interval or not pending.frames:
            return replace(state, pending=pending, learned=begun)
        pending, labels = label(pending, step.time - self.delay, self.detection, self.rate)
        state = replace(state, pending=pending, learned=step.time)
        if not labels.frames:
            return state
        regime = before.updated(_batches(labels, self.rate))
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
            _changes(before, regime),
        )
        regimes = (*state.regimes[: state.active], regime, *state.regimes[state.active + 1 :])
        return replace(state, regimes=regimes, last=last)

    def scene(self, regime: Regime, source: str) -> Scene:
        """What is in use of a regime, as it is written to a file. Which false alarms become tracks is not known."""
        births, clutter, objects = regime.known
        births, clutter = births if regime.births_used else None, clutter if regime.clutter.trusted else None
        followed = None if objects is None else TrackedObjects(0.0, objects)
        size = round(self.width), round(self.height)
        return Scene(*size, self.rate, source, births, clutter, {"mode": regime.name}, followed)

    def _unknown(self, name: str) -> Regime:
        """A regime that knows nothing. Births may be as fast as the image is wide in a second."""
        speed = max(self.width, self.height) / self.rate
        boxes = OnlineMixture.unknown(measurement_volume(self.width, self.height), self.memory)
        births = OnlineMixture.unknown(state_volume((self.width, self.height), speed), self.memory)
        return Regime(name, births, boxes, boxes)

    def _of_scene(self, scene: Scene) -> Regime:
        """What was learned before; any size may come."""
        new = self._unknown(str(scene.notes.get("mode", FIRST)))
        objects = scene.followed.objects if scene.followed is not None else None
        return Regime(
            new.name,
            new.births.known(scene.births, self.rate),
            new.clutter.known(scene.clutter, FRAMES_PER_SECOND),
            new.objects.known(objects, FRAMES_PER_SECOND),
        )


def _batches(labels: Labels, rate: float) -> Batches:
    """New births, false alarms and objects' detections in labels, with ``rate`` time units per second."""
    possible, seen, per_second = labels.false > 0, labels.false < 1, labels.frames / labels.seconds
    return (
        Batch(labels.births, np.ones(labels.births.shape[1]), labels.seconds * rate, rate),
        Batch(labels.box[:, possible], labels.false[possible], labels.frames, per_second),
        Batch(labels.box[:, seen], 1 - labels.false[seen], labels.frames, per_second),
    )


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
