"""Learning while tracking: births and false alarms follow the scene, and what has become wrong is dropped [M09 §VII].

Frames wait until it is known what became of their detections (`verdict`). Every so often those that are due are judged, and
what they teach is asked of every mode, then learned by the active one (`modes`), with a memory of some minutes (`part`,
`recent`). Beside births and false alarms it is learned where objects are detected at all: boxes that are no false alarms.

**The guard.** What explains new samples no better than what would be used without it is not used until it does (`evidence`).
Of births that is p(z|b) against p(z|o), by which they are laid over those that are shipped (`models.learned_scene`): the
likelihood of the new ones, as there are as many of either. False alarms come to those that are shipped, which are no density
over the image; whether anything is known of where they come is asked against the uniform one. Out of use is as shipped.

Everything is a value: a state goes in and comes out, and the same frames give the same state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.scene import modes as mode_by
from phdtrack.scene.modes import Lesson, Mode
from phdtrack.scene.part import Batch, Part
from phdtrack.scene.samples import measurement_volume, state_volume
from phdtrack.scene.scene_file import Followed, Learned, Scene
from phdtrack.scene.verdict import Verdict, Watch, judged, look_of
from phdtrack.types import Step

# Parts of the memory after which is learned anew, and seconds at least.
_BATCHES, _SHORTEST = 30, 1.0
FIRST = "first"
_NAMES = (FIRST, "second", "third", "fourth")


@dataclass(frozen=True, slots=True)
class Following:
    """How a scene is followed.

    Parameters
    ----------
    width, height : of the image, pixels.
    rate : time units a second, of births.
    memory : seconds after which a sample counts for 37 %.
    wait : seconds until a detection is judged.
    detection : p_D, probability that an object is detected.
    switch : whether modes are chosen by evidence; otherwise by the name that `advance` is given.
    most : modes at most that are opened by evidence.
    """

    width: float
    height: float
    rate: float
    memory: float
    wait: float
    detection: float
    switch: bool = False
    most: int = 4

    def interval(self, known: float) -> float:
        """Seconds between two times of learning in a mode that was active for ``known`` seconds: at first more often."""
        return max(_SHORTEST, min(self.memory, known) / _BATCHES)


@dataclass(frozen=True, slots=True)
class Relearned:
    """What was learned of the scene with frame ``number``, at ``time`` seconds, where learning goes on while tracking.

    Attributes
    ----------
    mode : name of the mode that learns (day, night).
    births, clutter : their rates: births per time unit, false alarms per frame.
    birth_gain, clutter_gain : nats by which samples that were not learned yet were likelier than under another density: as
        detections of objects, and under a uniform one.
    births_used, clutter_used : whether what was learned is in use; otherwise that part of the model is as without learning.
    said : what has changed, in sentences; mostly nothing.
    """

    number: int
    time: float
    mode: str
    births: float
    clutter: float
    birth_gain: float
    clutter_gain: float
    births_used: bool
    clutter_used: bool
    said: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """What is known of a scene, and the frames that wait; ``learned``: when something was last learned, ``last``: what."""

    modes: tuple[Mode, ...]
    active: int = 0
    watch: Watch = field(default_factory=Watch)
    learned: float = math.nan
    last: Relearned | None = None

    @property
    def mode(self) -> Mode:
        """The active one."""
        return self.modes[self.active]


def begin(rule: Following, scenes: tuple[Scene, ...] = ()) -> Knowledge:
    """Knowing nothing, or what was learned before: each scene is a mode, the first of them is active."""
    return Knowledge(tuple(_mode(rule, scene) for scene in scenes) or (_new(rule, FIRST),))


def named(rule: Following, state: Knowledge, name: str) -> Knowledge:
    """With the mode of this name active; a new one where there is none."""
    names = [mode.name for mode in state.modes]
    if name in names:
        return replace(state, active=names.index(name))
    return replace(state, modes=(*state.modes, _new(rule, name)), active=len(names))


def advance(rule: Following, state: Knowledge, step: Step) -> Knowledge:
    """Take in one frame, and learn where it is time to. Frames that nobody observed teach nothing."""
    begun = step.time if math.isnan(state.learned) else state.learned
    if step.detections.observed:
        watch = state.watch
        watch = Watch((*watch.looks, look_of(step)), watch.place, watch.met, watch.sightings)
        state = Knowledge(state.modes, state.active, watch, state.learned, state.last)
    if step.time < begun + rule.interval(state.mode.clock) or not state.watch.looks:
        return state if state.learned == begun else replace(state, learned=begun)
    watch, verdict = judged(state.watch, step.time - rule.wait, rule.detection, rule.rate)
    state = replace(state, watch=watch, learned=step.time)
    return _learned(rule, state, _lesson(rule, verdict), step) if verdict.frames else state


def _lesson(rule: Following, verdict: Verdict) -> Lesson:
    """A verdict as samples, births per time unit, false alarms per frame."""
    possible, seen = verdict.false > 0, verdict.false < 1
    per_second = verdict.frames / verdict.seconds
    births = Batch(verdict.births, np.ones(verdict.births.shape[1]), verdict.seconds * rule.rate, rule.rate)
    clutter = Batch(verdict.box[:, possible], verdict.false[possible], verdict.frames, per_second)
    objects = Batch(verdict.box[:, seen], 1 - verdict.false[seen], verdict.frames, per_second)
    return Lesson(births, clutter, objects, verdict.seconds)


def _learned(rule: Following, state: Knowledge, lesson: Lesson, step: Step) -> Knowledge:
    """Ask all modes, choose one, and have it learn."""
    before = state.mode
    every = tuple(mode_by.asked(mode, lesson, rule.memory) for mode in state.modes)
    active, said = state.active, list[str]()
    if rule.switch:
        every, active = _chosen(rule, every, active, lesson)
        if every[active].name != before.name:
            said.append(f"mode {every[active].name} after {before.name}")
    own = mode_by.judged(every[active])
    if own.name == before.name:
        said.extend(_turned(before, own))
    own = mode_by.taught(own, lesson, rule.memory)
    every = (*every[:active], own, *every[active + 1 :])
    if rule.switch:
        every, active = _merged(every, active, said)
    return replace(state, modes=every, active=active, last=_told(every[active], step, tuple(said)))


def _chosen(rule: Following, modes: tuple[Mode, ...], active: int, lesson: Lesson) -> tuple[tuple[Mode, ...], int]:
    """The modes and which is active now: another, or a new one where the active one has lost and no other fits."""
    own, better = modes[active], mode_by.best([mode.evidence for mode in modes], active)
    new = own.trusted and own.lost and len(modes) < rule.most
    # One that has just become better is about to be chosen.
    new = new and active == better == mode_by.best([mode.newest for mode in modes], active)
    if own.young(rule.memory) or (better == active and not new):
        return modes, active
    # The last samples that it learned were not its own.
    cleared = mode_by.unlearned(own, lesson.seconds)
    modes = (*modes[:active], cleared, *modes[active + 1 :])
    if new:
        return (*modes, mode_by.forked(cleared, _fresh(modes))), len(modes)
    return modes, better


def _fresh(modes: tuple[Mode, ...]) -> str:
    """A name that no mode has."""
    names = {mode.name for mode in modes}
    return next(name for name in (*_NAMES, *map(str, range(5, len(modes) + 6))) if name not in names)


def _merged(modes: tuple[Mode, ...], active: int, said: list[str]) -> tuple[tuple[Mode, ...], int]:
    """Without a mode that is the same as the active one."""
    own = modes[active]
    for k, mode in enumerate(modes):
        if k != active and own.trusted and mode_by.alike(own, mode):
            said.append(f"mode {own.name} is {mode.name}")
            kept = replace(own, name=mode.name) if k < active else own
            rest = tuple(kept if j == active else modes[j] for j in range(len(modes)) if j != k)
            return rest, active - (k < active)
    return modes, active


def _turned(before: Mode, now: Mode) -> list[str]:
    """What is in use now and was not, or no longer is."""
    said = []
    for what, old, new, than in (
        ("births", before.births, now.births, "as any detection of an object"),
        ("false alarms", before.clutter, now.clutter, "under uniform ones"),
    ):
        if new.trusted != old.trusted:
            gain = f"the last samples are {new.newest.mean:+.2f} nats likelier than {than}"
            said.append(f"learned {what} {'in use' if new.trusted else 'out of use: as without learning'} ({gain})")
    return said


def _told(mode: Mode, step: Step, said: tuple[str, ...]) -> Relearned:
    births, clutter = mode.births, mode.clutter
    return Relearned(
        step.number,
        step.time,
        mode.name,
        births.rate,
        clutter.rate,
        births.evidence.mean,
        clutter.evidence.mean,
        mode.births_used,
        clutter.trusted,
        said,
    )


def _new(rule: Following, name: str) -> Mode:
    """A mode that knows nothing. Births may be as fast as the image is wide in a second."""
    fastest = max(rule.width, rule.height) / rule.rate
    births = Part.unknown(*state_volume(rule.width, rule.height, fastest))
    boxes = Part.unknown(*measurement_volume(rule.width, rule.height))
    return Mode(name, births, boxes, boxes)


def _mode(rule: Following, scene: Scene) -> Mode:
    """What was learned before. False alarms a second are those of 25 frames, until frames are counted."""
    new = _new(rule, str(scene.notes.get("mode", FIRST)))
    objects = None if scene.followed is None else scene.followed.objects
    return replace(
        new,
        births=_known(new.births, scene.births, rule.memory, rule.rate),
        clutter=_known(new.clutter, scene.clutter, rule.memory, 25.0),
        objects=_known(new.objects, objects, rule.memory, 25.0),
    )


def _known(unknown: Part, learned: Learned | None, memory: float, rate: float) -> Part:
    """The part of a mode that nothing is ``unknown`` of, with what was learned before; any size may come."""
    if learned is None:
        return unknown
    part = Part.of(learned, memory, rate)
    return replace(part, density=replace(part.density, low=unknown.density.low, high=unknown.density.high))


def scene_of(rule: Following, mode: Mode, source: str) -> Scene:
    """What of a mode is in use, as it is written to a file. Which false alarms are followed nobody has seen."""
    used = mode.used
    followed = None if used.objects is None else Followed(0.0, used.objects)
    return Scene(
        round(rule.width),
        round(rule.height),
        rule.rate,
        source,
        used.births,
        used.clutter,
        {"mode": mode.name},
        followed,
    )
