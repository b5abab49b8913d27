"""The ways in which `phdtrack learn` is taught: births by tracks or by hand, false alarms by a person or by nobody."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phdtrack.commands.output import counted, progress
from phdtrack.context import RecursiveEM
from phdtrack.context.learning import Lesson, learn_births, learn_clutter
from phdtrack.context.prior import Sizes, anywhere, detected_sizes, humbled
from phdtrack.errors import InputError

if TYPE_CHECKING:
    from phdtrack.commands.label_inputs import Labelled
    from phdtrack.label import LabelStore
    from phdtrack.label.suggest import Evidence, Suggestions
    from phdtrack.protocols import AnyStages

_ONLY_BOXES = "false alarms stay uniform: a density of them is learned for boxes in the image only (motion.kind=box)"
# Frames, drawn at random, whose suggestions are taken where nobody labels: M09's false alarms were of as many.
UNATTENDED = 200
LIMITS = (
    "Nobody has looked at them. Who sits or stands in one place for nine tenths of the stretch, or for two thirds of it "
    "where he is seen every other time only, is taken for a false alarm there, and in a crowd so are people whom others "
    "hide (in a simulated one a quarter of what was taken were people, in streets 3 %). To look at them: phdtrack label "
    "suggests the same boxes."
)


@dataclass(frozen=True, slots=True, eq=False)
class Taught:
    """What was learned of one part, None for nothing; what is said of it; ``source``, where it comes from, in words."""

    lesson: Lesson | None
    sentence: str
    source: str = ""

    @property
    def gain(self) -> float:
        """Nats per unseen sample above the uniform density; NaN where that is not known."""
        return self.lesson.gain if self.lesson is not None else math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Classroom:
    """What is learned from: the detections, the ``stretch`` of frames, how to track, and the file of ``labels``."""

    found: Labelled
    stretch: range
    stages: AnyStages
    seed: int
    labels: Path

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of a frame in pixels."""
        return float(self.found.info.width), float(self.found.info.height)

    @property
    def of_boxes(self) -> bool:
        """Whether targets are boxes in the image, and not points in it or people on the ground."""
        return len(self.stages.model.sensor.observed) == 4

    def region(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Size and corner of what births are spread over: the frame, pixels, or a region of the ground, metres.

        Raises `InputError` where the ground has no region.
        """
        from phdtrack.models import PlaneSensor
        from phdtrack.models.region import EVERYWHERE

        sensor = self.stages.model.sensor
        if not isinstance(sensor, PlaneSensor):
            return self.size, (0.0, 0.0)
        if sensor.borders == EVERYWHERE:
            raise InputError("the ground has no region", where="births", cure="Give camera.file, or camera.region")
        left, low, right, high = sensor.borders
        return (right - left, high - low), (left, low)

    def sizes(self) -> Sizes:
        """The sizes that are detected in the stretch, widened."""
        from phdtrack.boxes import to_cxcywh

        table = self.found.table
        rows = slice(*np.searchsorted(table.frame, [self.stretch.start, self.stretch.stop]))
        return detected_sizes(to_cxcywh(table.detections.xyxy[rows])[2:])

    def humbled(self, lesson: Lesson) -> Lesson:
        """What was learned beside what might be anywhere; on the ground, where nothing has a size, as it is."""
        return replace(lesson, learned=humbled(lesson.learned, self.sizes())) if self.of_boxes else lesson

    def store(self) -> LabelStore | None:
        """The labels of these detections, where there are any. Raises `InputError` where they are of others."""
        from phdtrack.label import LabelStore

        return LabelStore.open(self.labels, self.found.source, self.found.digest, []) if self.labels.exists() else None

    def tracked(self, stages: AnyStages) -> Evidence:
        """What a tracker makes of the stretch."""
        from phdtrack.commands.tracked import tracked

        with progress("tracking", len(self.stretch)) as advance:
            return tracked(self.found.table, self.found.info.fps, stages, self.stretch, self.seed, advance)


def clutter_of_labels(room: Classroom) -> Taught:
    """False alarms from marks [M09 §IV]; why not, where there are none to learn from."""
    from phdtrack.label.session import false_boxes, looked_at

    if not room.of_boxes:
        return Taught(None, _ONLY_BOXES)
    store = room.store()
    if store is None:
        return Taught(None, f"false alarms stay uniform: nobody has marked any (phdtrack label, kept in {room.labels})")
    boxes, frames = false_boxes(store, room.found.table, room.stretch), len(looked_at(store, room.stretch))
    try:
        lesson = room.humbled(learn_clutter(boxes, frames, room.size, RecursiveEM()))
    except InputError as error:
        return Taught(None, f"false alarms stay uniform: {error}")
    told = f"{counted(lesson.learned.samples, 'box')} marked on {counted(frames, 'frame')}"
    return Taught(lesson, f"false alarms: {told}; {worth(lesson)}", f"{told} by a person.")


def clutter_unattended(room: Classroom) -> Taught:
    """False alarms from what would be suggested to a person; why not, where that is too little."""
    from phdtrack.label.session import sampled
    from phdtrack.label.suggest import TICKED, suggest

    if not room.of_boxes:
        return Taught(None, _ONLY_BOXES)
    frames = [room.stretch.start + k - 1 for k in sampled(len(room.stretch), UNATTENDED, room.seed)]
    found = suggest(room.tracked(room.stages), frames, room.found.info.fps)
    taken = np.flatnonzero(found.score >= TICKED)
    try:
        lesson = room.humbled(learn_clutter(_boxes(room, found, taken), len(frames), room.size, RecursiveEM()))
    except InputError as error:
        cure = "Look yourself: phdtrack label"
        return Taught(None, f"false alarms stay uniform: {InputError(error.problem, where=error.where, cure=cure)}")
    told = (
        f"{counted(lesson.learned.samples, 'box')} of {counted(len(frames), 'frame')} taken for false ({_why(found, taken)})"
    )
    return Taught(lesson, f"false alarms: {told}; {worth(lesson)}. {LIMITS}", f"{told}. {LIMITS}")


def births_of_tracks(room: Classroom, clutter: Lesson | None) -> Taught:
    """Births from the tracks that the tracker itself makes and that go somewhere [M09 §IV]; why not, where they cannot be.

    Behind learned false alarms, and with births anywhere: tracks that only the scene's false alarms make are no births.
    """
    from phdtrack.context.samples import births_in
    from phdtrack.models.learned_scene import ContextBirth, ContextClutter
    from phdtrack.types import Detections

    stages, info = room.stages, room.found.info
    if clutter is not None:
        alarms, births = clutter.learned, anywhere(room.sizes(), room.size)
        model = replace(
            stages.model,
            birth=ContextBirth(births.rate, births.density),
            clutter=ContextClutter(alarms.rate, alarms.density),
        )
        stages = replace(stages, model=model)
    rate = stages.model.rate
    tracks, shown = room.tracked(stages).tracks, None
    if not room.of_boxes:
        sensor = stages.model.sensor
        shown = sensor.measure(Detections.of(tracks.xyxy))[: len(sensor.observed)]
    states = births_in(tracks, info.fps, rate, shown)
    # Feet that no ground is under.
    states = states[:, np.isfinite(states).all(axis=0)]
    time = len(room.stretch) / info.fps * rate
    return _births(room, states, time, "track", f"began in {_frames(room)}", clutter)


def births_by_hand(room: Classroom, clutter: Lesson | None) -> Taught:
    """Births from marks on the clips about the frames that a person has looked at; why not, where they are too few."""
    from phdtrack.label.hand import birth_states, time_watched, watched

    if not room.of_boxes:
        return Taught(None, "births stay uniform: those marked by hand are boxes in the image (--births tracks)")
    store = room.store()
    if store is None:
        return Taught(None, f"births stay uniform: nobody has marked any (phdtrack label, kept in {room.labels})")
    table, info, rate = room.found.table, room.found.info, room.stages.model.rate
    states = birth_states(store, table, info, rate, room.stretch)
    seen = counted(len(watched(store, room.stretch)), "frame")
    unknown = int(np.isnan(states[2]).sum())
    told = f"marked by a person on {seen}" + (f" ({unknown} of unknown velocity)" if unknown else "")
    return _births(room, states, time_watched(store, table, info, rate, room.stretch), "birth", told, clutter)


def worth(lesson: Lesson) -> str:
    """What a lesson is worth, in words."""
    if not math.isfinite(lesson.gain):
        return "too few to tell what it is worth"
    return f"samples not learned from are {lesson.gain:+.2f} nats likelier than under a uniform density"


def _births(room: Classroom, states: np.ndarray, time: float, noun: str, where: str, clutter: Lesson | None) -> Taught:
    """Births from first states; where they are too few, anywhere: around each detection, as without a scene, people would
    be believed at once beside learned false alarms, whose density is that of a whole frame."""
    try:
        size, corner = room.region()
        lesson = room.humbled(learn_births(states, time, size, RecursiveEM(), corner))
    except InputError as error:
        if clutter is None or not room.of_boxes:
            return Taught(None, f"births stay uniform: {error}")
        told = "births may be anywhere in the frame, of the sizes that are detected"
        return Taught(Lesson(anywhere(room.sizes(), room.size), math.nan), f"{told}: {error}", f"{told.capitalize()}.")
    told = f"{counted(states.shape[1], noun)} {where}"
    return Taught(lesson, f"births: {told}; {worth(lesson)}", f"{told}.")


def _frames(room: Classroom) -> str:
    return counted(len(room.stretch), "frame")


def _boxes(room: Classroom, found: Suggestions, taken: np.ndarray) -> np.ndarray:
    """(4, n) centres and sizes of the suggested boxes ``taken``."""
    from phdtrack.boxes import to_cxcywh

    rows = np.searchsorted(room.found.table.frame, found.frame[taken]) + found.box[taken]
    return to_cxcywh(room.found.table.detections.xyxy[rows])


def _why(found: Suggestions, taken: np.ndarray) -> str:
    """How many were taken for which reason."""
    from phdtrack.label.suggest import REASONS

    many = Counter(REASONS[k] for k in found.reason[taken])
    places = len(np.unique(found.place[taken][found.place[taken] >= 0]))
    said = []
    if many["place"]:
        said.append(f"{many['place']} at {counted(places, 'place')} that fire too often")
    if many["rejected"]:
        said.append(f"{many['rejected']} that the filter rejected")
    return ", ".join(said)
