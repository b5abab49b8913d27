"""What `phdtrack learn` learns a scene from: births from tracks or marks, false alarms from marks or suggestions.

Where a person has marked false alarms, a run with these false alarms in its model shows which of them are followed all the
same: flickering light moves as little as a person who stands. Tracks that stay among them are no births, and `phdtrack
track --scene` withholds them.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phdtrack.cli.output import counted, progress
from phdtrack.errors import InputError
from phdtrack.scene import RecursiveEM, TrackedObjects
from phdtrack.scene.training import Sizes, Training, detected_sizes, learn_births, learn_clutter, learn_objects, with_prior

if TYPE_CHECKING:
    from phdtrack.cli.label import Labelled
    from phdtrack.label import LabelStore
    from phdtrack.label.suggestions import Evidence, Suggestions
    from phdtrack.protocols import AnyStages
    from phdtrack.types import Tracks

_ONLY_BOXES = "false alarms stay as shipped: a density of them is learned for boxes in the image only (motion.kind=box)"
# Frames, drawn at random, whose suggestions are taken where no person labels: M09's false alarms were of as many.
UNATTENDED = 200
LIMITS = (
    "No person has checked them. A person who sits or stands in one place for nine tenths of the stretch, or for two thirds "
    "of it while detected in every other frame only, is taken for a false alarm there, and so are people whom others hide "
    "in a crowd (in a simulated one a quarter of what was taken were people, in streets 3 %). To check them: phdtrack "
    "label suggests the same boxes."
)


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """What was learned of one part, None for nothing; what is said of it; ``source``, where it comes from, in words."""

    lesson: Training | None
    sentence: str
    source: str = ""

    @property
    def gain(self) -> float:
        """Nats per unseen sample above the uniform density; NaN where that is not known."""
        return self.lesson.gain if self.lesson is not None else math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """The ``tracks`` of a run that knew the false alarms, without false tracks; which of the false alarms it ``followed``,
    None where that is not known; and a ``sentence`` about it."""

    tracks: Tracks
    followed: TrackedObjects | None = None
    sentence: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingData:
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
        from phdtrack.arrays import to_cxcywh

        table = self.found.table
        rows = slice(*np.searchsorted(table.frame, [self.stretch.start, self.stretch.stop]))
        return detected_sizes(to_cxcywh(table.detections.xyxy[rows])[2:])

    def with_prior(self, lesson: Training) -> Training:
        """What was learned beside what might be anywhere; on the ground, where nothing has a size, as it is."""
        return replace(lesson, learned=with_prior(lesson.learned, self.sizes())) if self.of_boxes else lesson

    def store(self) -> LabelStore | None:
        """The labels of these detections, where there are any. Raises `InputError` where they are of others."""
        from phdtrack.label import LabelStore

        return LabelStore.open(self.labels, self.found.source, self.found.digest, []) if self.labels.exists() else None

    def tracked(self, alarms: Training | None = None) -> Evidence:
        """What a tracker makes of the stretch that knows these false alarms."""
        from phdtrack.cli.label import tracked
        from phdtrack.models.scene import with_scene

        stages = self.stages
        if alarms is not None:
            # Jmax is of learned births, and there are none yet.
            stages = replace(stages, model=with_scene(stages.model, None, alarms.learned, None, particles=1))
        with progress("tracking", len(self.stretch)) as advance:
            return tracked(self.found.table, self.found.info.fps, stages, self.stretch, self.seed, advance)


def clutter_of_labels(data: TrainingData) -> Trained:
    """False alarms from marks [M09 §IV]; why not, where there are none to learn from."""
    from phdtrack.label.session import false_boxes, looked_at

    if not data.of_boxes:
        return Trained(None, _ONLY_BOXES)
    store = data.store()
    if store is None:
        return Trained(None, f"false alarms stay as shipped: no marks were found (phdtrack label, kept in {data.labels})")
    boxes, frames = false_boxes(store, data.found.table, data.stretch), len(looked_at(store, data.stretch))
    try:
        lesson = data.with_prior(learn_clutter(boxes, frames, data.size, RecursiveEM()))
    except InputError as error:
        return Trained(None, f"false alarms stay as shipped: {error}")
    text = f"{counted(lesson.learned.samples, 'box')} marked on {counted(frames, 'frame')}"
    return Trained(lesson, f"false alarms: {text}; {gain_in_words(lesson)}", f"{text} by a person.")


def clutter_unattended(data: TrainingData) -> Trained:
    """False alarms from what would be suggested to a person; why not, where that is too little."""
    from phdtrack.label.session import sampled
    from phdtrack.label.suggestions import TICKED, suggest

    if not data.of_boxes:
        return Trained(None, _ONLY_BOXES)
    frames = [data.stretch.start + k - 1 for k in sampled(len(data.stretch), UNATTENDED, data.seed)]
    found = suggest(data.tracked(), frames, data.found.info.fps)
    taken = np.flatnonzero(found.score >= TICKED)
    try:
        lesson = data.with_prior(learn_clutter(_boxes(data, found, taken), len(frames), data.size, RecursiveEM()))
    except InputError as error:
        cure = "Look yourself: phdtrack label"
        return Trained(None, f"false alarms stay as shipped: {InputError(error.problem, where=error.where, cure=cure)}")
    text = (
        f"{counted(lesson.learned.samples, 'box')} of {counted(len(frames), 'frame')} taken for false ({_why(found, taken)})"
    )
    return Trained(lesson, f"false alarms: {text}; {gain_in_words(lesson)}. {LIMITS}", f"{text}. {LIMITS}")


def watched_tracks(data: TrainingData, alarms: Training | None, *, marked: bool) -> Watched:
    """One run behind the false alarms that were learned; ``marked``: a person looked at them, so that it shows what of them
    is followed all the same. Tracks that stay among these are not believed."""
    from phdtrack.associate.rejection import without_false_tracks
    from phdtrack.label.session import looked_at, object_boxes, share_followed
    from phdtrack.models.scene import FalseAlarmRatio

    tracks, store = data.tracked(alarms).tracks, data.store() if marked else None
    if alarms is None or store is None:
        return Watched(tracks)
    boxes, frames = object_boxes(store, data.found.table, data.stretch), len(looked_at(store, data.stretch))
    try:
        objects = data.with_prior(learn_objects(boxes, frames, data.size, RecursiveEM()))
    except InputError as error:
        return Watched(tracks, None, f"no track is held back: {error}")
    followed = TrackedObjects(share_followed(store, tracks, data.stretch), objects.learned)
    text = f"the tracker follows {100 * followed.share:.2g} % of the false alarms although it knows them"
    kept = without_false_tracks(tracks, FalseAlarmRatio(alarms.learned, followed))
    return Watched(kept, followed, f"{text}; tracks that stay among them are held back")


def births_of_tracks(data: TrainingData, tracks: Tracks) -> Trained:
    """Births from the tracks that the tracker itself makes and that go somewhere [M09 §IV]; why not, if they are too few."""
    from phdtrack.scene.training import births_in
    from phdtrack.types import Detections

    info, rate, shown = data.found.info, data.stages.model.rate, None
    if not data.of_boxes:
        sensor = data.stages.model.sensor
        shown = sensor.measure(Detections.of(tracks.xyxy))[: len(sensor.observed)]
    states = births_in(tracks, info.fps, rate, shown)
    # Feet that no ground is under.
    states = states[:, np.isfinite(states).all(axis=0)]
    time = len(data.stretch) / info.fps * rate
    return _births(data, states, time, "track", f"began in {counted(len(data.stretch), 'frame')}")


def births_by_hand(data: TrainingData) -> Trained:
    """Births from marks on the clips about the frames that a person has looked at; why not, where they are too few."""
    from phdtrack.label.births import birth_states, time_watched, watched

    if not data.of_boxes:
        return Trained(None, "births stay as shipped: those marked by hand are boxes in the image (--births tracks)")
    store = data.store()
    if store is None:
        return Trained(None, f"births stay as shipped: no marks were found (phdtrack label, kept in {data.labels})")
    table, info, rate = data.found.table, data.found.info, data.stages.model.rate
    states = birth_states(store, table, info, rate, data.stretch)
    seen = counted(len(watched(store, data.stretch)), "frame")
    unknown = int(np.isnan(states[2]).sum())
    text = f"marked by a person on {seen}" + (f" ({unknown} of unknown velocity)" if unknown else "")
    return _births(data, states, time_watched(store, table, info, rate, data.stretch), "birth", text)


def gain_in_words(lesson: Training) -> str:
    """How much likelier unseen samples are than under a uniform density, in words."""
    if not math.isfinite(lesson.gain):
        return "too few samples to measure the gain"
    return f"samples not learned from are {lesson.gain:+.2f} nats likelier than under a uniform density"


def _births(data: TrainingData, states: np.ndarray, time: float, noun: str, where: str) -> Trained:
    """Births from first states; why not, where they are too few."""
    try:
        size, corner = data.region()
        lesson = data.with_prior(learn_births(states, time, size, RecursiveEM(), corner))
    except InputError as error:
        return Trained(None, f"births stay as shipped: {error}")
    text = f"{counted(states.shape[1], noun)} {where}"
    return Trained(lesson, f"births: {text}; {gain_in_words(lesson)}", f"{text}.")


def _boxes(data: TrainingData, found: Suggestions, taken: np.ndarray) -> np.ndarray:
    """(4, n) centres and sizes of the suggested boxes ``taken``."""
    from phdtrack.arrays import to_cxcywh

    rows = np.searchsorted(data.found.table.frame, found.frame[taken]) + found.box[taken]
    return to_cxcywh(data.found.table.detections.xyxy[rows])


def _why(found: Suggestions, taken: np.ndarray) -> str:
    """How many were taken for which reason."""
    from phdtrack.label.suggestions import REASONS

    many = Counter(REASONS[k] for k in found.reason[taken])
    places = len(np.unique(found.place[taken][found.place[taken] >= 0]))
    said = []
    if many["place"]:
        said.append(f"{many['place']} at {counted(places, 'place')} that fire too often")
    if many["rejected"]:
        said.append(f"{many['rejected']} that the filter rejected")
    return ", ".join(said)
