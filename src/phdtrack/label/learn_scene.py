"""A scene from a tracker's own tracks, a person's marks, and what would be suggested to a person
[M09 §IV].

Where a person has marked false alarms, a run with these false alarms in its model shows which of
them are followed all the same: flickering light moves as little as a person who stands. Tracks that
stay among them are no births, and `associate.rejection` withholds them.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.associate.rejection import without_false_tracks
from phdtrack.errors import InputError
from phdtrack.label.samples import Marks, shuffled
from phdtrack.label.suggestions import TICKED, Evidence, suggest
from phdtrack.models.clutter import BoxClutter
from phdtrack.models.scene import FalseAlarmRatio, SceneClutter, in_one_volume
from phdtrack.protocols import AnyStages
from phdtrack.report.pages import counted
from phdtrack.scene import LearnedDensity, Scene, TrackedObjects
from phdtrack.scene.training import (
    FALSE_BOXES,
    OBJECT_BOXES,
    Training,
    births_in,
    learn_births,
    learn_boxes,
    with_prior,
)
from phdtrack.types import DetectionTable, SequenceInfo, Tracks

# Frames, drawn at random, whose suggestions are taken where no person labels: M09's false alarms
# were of as many.
UNATTENDED = 200
LIMITS = (
    "No person has checked them. A person who sits or stands in one place for nine tenths of the"
    " stretch, or for two thirds of it while detected in every other frame only, is taken for a"
    " false alarm there, and so are people hidden by others in a crowd (in a simulated one a"
    " quarter of what was taken were people, in streets 3 %). To check them: phdtrack label"
    " suggests the same boxes."
)


class TrainingResult(NamedTuple):
    """What was learned of births or of false alarms, None for nothing, and its ``gain`` in nats per
    unseen sample above the uniform density, NaN where that is not known; what is said of it;
    ``source``, where it comes from, in words."""

    learned: LearnedDensity | None
    gain: float
    sentence: str
    source: str = ""


class Trained(NamedTuple):
    """The scene, what was learned of births and of false alarms, and everything that is said of it,
    in order.
    """

    scene: Scene
    births: TrainingResult
    alarms: TrainingResult
    sentences: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SceneTraining:
    """What is learned from.

    Attributes
    ----------
    source : name of the video or of the file of detections.
    info, table : the sequence and its detections.
    stretch : the frames to learn from.
    stages, seed : how to track.
    marks, labels : a person's, None where there are none, and the file in which they were looked
        for.
    advance : is called with the number of frames tracked.
    """

    source: str
    info: SequenceInfo
    table: DetectionTable
    stretch: range
    stages: AnyStages
    seed: int
    marks: Marks | None
    labels: Path
    advance: Callable[[int], object]

    def train(self, births: str, clutter: str) -> Trained:
        """The scene from ``births`` of "tracks" or marked by "hand", and ``clutter`` of "labels" or
        "unattended".

        Raises `InputError` where targets are not boxes in the image.
        """
        if len(self.stages.model.sensor.observed) != 4:
            problem = "a scene is learned for boxes in the image only"
            raise InputError(problem, where="motion.kind", cure="Use motion.kind=box")
        if clutter == "unattended":
            alarms = self._lesson("false alarms", self._unattended_clutter, LIMITS)
            marked = None
        else:
            alarms = self._lesson("false alarms", self._marked_clutter)
            marked = alarms.learned
        sentences = [alarms.sentence]
        tracks = Tracks.empty()
        followed = None
        if births == "tracks" or marked is not None:
            tracks = self._tracked(alarms.learned).tracks
        if marked is not None:
            tracks, followed, sentence = self._without_followed(marked, tracks)
            sentences.append(sentence)
        born = self._lesson(
            "births",
            self._marked_births if births == "hand" else partial(self._births_of_tracks, tracks),
        )
        if births == "tracks" and born.learned is not None and followed is None:
            followed = self._objects_of_tracks(tracks)
        gains = {"births gain": born.gain, "clutter gain": alarms.gain}
        notes: dict[str, float | int | str] = {
            name: value for name, value in gains.items() if math.isfinite(value)
        }
        notes |= {
            "births from": births,
            "clutter from": clutter,
            "first": self.stretch.start,
            "last": self.stretch.stop - 1,
        }
        size = (self.info.width, self.info.height)
        rate = self.stages.model.rate
        scene = Scene(*size, rate, self.source, born.learned, alarms.learned, notes, followed)
        return Trained(scene, born, alarms, (*sentences, born.sentence))

    def _lesson(
        self, part: str, learn: Callable[[], tuple[Training, str]], limits: str = ""
    ) -> TrainingResult:
        """What ``learn`` gives, with what it says of it and its gain on unseen samples; why
        nothing, where it fails.
        """
        try:
            training, text = learn()
            learned = self._with_prior(training.learned)
        except InputError as error:
            return TrainingResult(None, math.nan, f"{part} stay as shipped: {error}")
        gain = "too few samples to measure the gain"
        if math.isfinite(training.gain):
            gain = (
                f"samples not learned from are {max(0.0, training.gain):+.2f} nats likelier than"
                " under a uniform density"
            )
        if not learned.density.has_places:
            text += "; nothing was learned of where, as no place is likelier than others"
        sentence = f"{part}: {text}; {gain}"
        return TrainingResult(
            learned,
            training.gain,
            f"{sentence}. {limits}" if limits else sentence,
            f"{text}. {limits}".strip(),
        )

    def _marked_clutter(self) -> tuple[Training, str]:
        """False alarms from marks [M09 §IV]."""
        marks = self._marked
        frames = len(marks.looked_at)
        training = learn_boxes(marks.false_boxes, frames, self._size, FALSE_BOXES)
        text = (
            f"{counted(training.learned.samples, 'box', 'boxes')} marked by a person on"
            f" {counted(frames, 'frame')}"
        )
        if missed := len(marks.missed):
            objects = marks.object_boxes.shape[1]
            share = 100 * (1 - missed / objects)
            text += (
                f", where the detector missed {missed} of {counted(objects, 'object')} (it detects"
                f" {share:.0f} %)"
            )
        return training, text

    def _unattended_clutter(self) -> tuple[Training, str]:
        """False alarms from what would be suggested to a person."""
        frames = [
            self.stretch.start + k - 1 for k in shuffled(len(self.stretch), self.seed)[:UNATTENDED]
        ]
        taken = [one for one in suggest(self._tracked(), frames) if one.score >= TICKED]
        table = self.table
        rows = np.searchsorted(table.frame, [one.frame for one in taken]) + np.array(
            [one.box for one in taken], np.int64
        )
        try:
            training = learn_boxes(
                to_cxcywh(table.detections.xyxy[rows]), len(frames), self._size, FALSE_BOXES
            )
        except InputError as error:
            raise InputError(
                error.problem, where=error.where, cure="Look yourself: phdtrack label"
            ) from None
        reasons = Counter(one.reason for one in taken)
        places = {one.place for one in taken if one.place >= 0}
        why = []
        if reasons["place"]:
            why.append(f"{reasons['place']} at {counted(len(places), 'place')} that fire too often")
        if reasons["rejected"]:
            why.append(f"{reasons['rejected']} that the filter rejected")
        many = (
            f"{counted(training.learned.samples, 'box', 'boxes')} of"
            f" {counted(len(frames), 'frame')}"
        )
        return training, f"{many} taken for false ({', '.join(why)})"

    def _without_followed(
        self, alarms: LearnedDensity, tracks: Tracks
    ) -> tuple[Tracks, TrackedObjects | None, str]:
        """The tracks of a run that knew the marked false alarms, but for those that stay among
        them; which of the false alarms it followed all the same, None where that is not known; and
        a sentence about it."""
        marks = self._marked
        try:
            training = learn_boxes(
                marks.object_boxes, len(marks.looked_at), self._size, OBJECT_BOXES
            )
            followed = TrackedObjects(
                marks.share_followed(tracks), self._with_prior(training.learned)
            )
        except InputError as error:
            return tracks, None, f"no track is held back: {error}"
        text = (
            f"the tracker follows {100 * followed.share:.2g} % of the false alarms although it"
            " knows them"
        )
        kept = without_false_tracks(tracks, FalseAlarmRatio(alarms, followed))
        return kept, followed, f"{text}; tracks that stay among them are held back"

    def _objects_of_tracks(self, tracks: Tracks) -> TrackedObjects | None:
        """Where the tracks' detections are, in place of objects that a person has marked: births
        are likelier or rarer there only in relation to them. None with too few detections; no track
        is held back.
        """
        frames = [
            self.stretch.start + k - 1 for k in shuffled(len(self.stretch), self.seed)[:UNATTENDED]
        ]
        detected = tracks.select((tracks.detection >= 0) & np.isin(tracks.frame, frames))
        try:
            training = learn_boxes(to_cxcywh(detected.xyxy), len(frames), self._size, OBJECT_BOXES)
        except InputError:
            return None
        return TrackedObjects(0.0, self._with_prior(training.learned))

    def _births_of_tracks(self, tracks: Tracks) -> tuple[Training, str]:
        """Births from the tracks that the tracker itself makes and that go somewhere [M09 §IV].
        Raises `InputError` if they show no place: nobody has looked, and births that are as
        likely everywhere as before are better left as they are.
        """
        fps = self.info.fps
        rate = self.stages.model.rate
        states = births_in(tracks, fps, rate)
        text = f"{counted(states.shape[1], 'track')} began in {counted(len(self.stretch), 'frame')}"
        training = learn_births(states, len(self.stretch) / fps * rate, self._size)
        if not training.learned.density.has_places:
            problem = f"{text}, and no place is likelier than others"
            raise InputError(problem, where="learning births", cure="Learn from a longer stretch")
        return training, text

    def _marked_births(self) -> tuple[Training, str]:
        """Births from marks on the clips about the frames that a person has looked at."""
        marks = self._marked
        rate = self.stages.model.rate
        states = marks.birth_states(rate)
        text = (
            f"{counted(states.shape[1], 'birth')} marked by a person on"
            f" {counted(len(marks.watched), 'frame')}"
        )
        unknown = int(np.isnan(states[2]).sum())
        text += f" ({unknown} of unknown velocity)" if unknown else ""
        return learn_births(states, marks.time_watched(rate), self._size), text

    @property
    def _size(self) -> tuple[float, float]:
        """Width and height of a frame in pixels."""
        return float(self.info.width), float(self.info.height)

    @property
    def _marked(self) -> Marks:
        """The marks. Raises `InputError` where there are none."""
        if self.marks is None:
            raise InputError(f"no marks were found (phdtrack label, kept in {self.labels})")
        return self.marks

    def _tracked(self, alarms: LearnedDensity | None = None) -> Evidence:
        """What a tracker makes of the stretch that knows these false alarms."""
        model = self.stages.model
        stages = self.stages
        if alarms is not None:
            if isinstance(model.clutter, BoxClutter):
                own = model.clutter.clutter_per_detection
            else:
                own = 0.0
            birth, clutter = in_one_volume(
                model.birth, SceneClutter(alarms.rate, alarms.density, own)
            )
            stages = replace(stages, model=replace(model, birth=birth, clutter=clutter))
        return Evidence.of(self.table, self.info.fps, self.stretch, stages, self.seed, self.advance)

    def _with_prior(self, learned: LearnedDensity) -> LearnedDensity:
        """What was learned, and a little of any size detected in the stretch."""
        table = self.table
        rows = slice(*np.searchsorted(table.frame, [self.stretch.start, self.stretch.stop]))
        return with_prior(learned, to_cxcywh(table.detections.xyxy[rows])[2:])
