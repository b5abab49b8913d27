"""Scene training from tracks, from a person's marks, or from suggestions [M09 §IV].

If a person has marked false alarms, a run with these in its model shows which of them are tracked
all the same: flickering light moves as little as a standing person. Tracks that stay among them are
no births, and `associate.rejection` withholds them.
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
from phdtrack.clock import Clock
from phdtrack.errors import InputError
from phdtrack.label.samples import Marks, shuffled
from phdtrack.label.suggestions import TICKED, Evidence, suggest
from phdtrack.models.clutter import BoxClutter
from phdtrack.models.scene import FalseAlarmRatio, SceneClutter, in_one_volume
from phdtrack.multiclass import ClassSettings
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

# Frames, drawn at random, whose suggestions are used if no person labels: as many as in M09.
UNATTENDED = 200
LIMITS = (
    "No person has checked them. A person who sits or stands in one place for nine tenths of the"
    " stretch, or for two thirds of it while detected in every other frame only, is taken for a"
    " false alarm there, and so are people hidden by others in a crowd (in a simulated one a"
    " quarter of what was taken were people, in streets 3 %). To check them: phdtrack label"
    " suggests the same boxes."
)


class TrainingResult(NamedTuple):
    """The learned births or false alarms, None for nothing; their ``gain`` over the
    uniform density in nats per unseen sample, NaN if it is not known; a ``sentence`` about it; and
    its ``source`` in words.
    """

    learned: LearnedDensity | None
    gain: float
    sentence: str
    source: str = ""


class Trained(NamedTuple):
    """The scene, the results for births and for false alarms, and all sentences about them."""

    scene: Scene
    births: TrainingResult
    alarms: TrainingResult
    sentences: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SceneTraining:
    """The material of scene training.

    Attributes
    ----------
    source : name of the video or of the file of detections.
    info, table : the sequence and its detections.
    stretch : the frames to learn from.
    classes, seed : the stages of each class, and the seed.
    marks, labels : a person's marks, None if there are none, and their file.
    advance : called with the number of frames tracked.
    clock : the times of the frames; None for a constant rate.
    background : whether a background detector finds the detections.
    """

    source: str
    info: SequenceInfo
    table: DetectionTable
    stretch: range
    classes: ClassSettings
    seed: int
    marks: Marks | None
    labels: Path
    advance: Callable[[int], object]
    clock: Clock | None = None
    background: bool = False

    def train(self, births: str, clutter: str) -> Trained:
        """The scene from ``births`` of "tracks" or marked by "hand", and ``clutter`` of "labels" or
        "unattended".

        Raises `InputError` if targets are not boxes in the image.
        """
        if len(self.stages.model.sensor.observed) != 4:
            problem = "a scene is learned for boxes in the image only"
            raise InputError(problem, where="motion.kind", cure="Use motion.kind=box")
        if clutter == "unattended":
            alarms = self._trained("false alarms", self._unattended_clutter, LIMITS)
            marked = None
        else:
            alarms = self._trained("false alarms", self._marked_clutter)
            marked = alarms.learned
        sentences = [alarms.sentence]
        tracks = Tracks.empty()
        followed = None
        if births == "tracks" or marked is not None:
            tracks = self._tracked(alarms.learned).tracks
        if marked is not None:
            tracks, followed, sentence = self._without_followed(marked, tracks)
            sentences.append(sentence)
        born = self._trained(
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

    def _trained(
        self, part: str, learn: Callable[[], tuple[Training, str]], limits: str = ""
    ) -> TrainingResult:
        """The result of ``learn``, with a sentence and its gain on unseen samples; if it fails, the
        reason.
        """
        try:
            training, text = learn()
            learned = self._with_prior(training.learned)
        except InputError as error:
            reason = ". ".join(filter(None, (error.problem, error.cure)))
            return TrainingResult(None, math.nan, f"{part} not learned, defaults kept: {reason}")
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
        """False alarms from the suggestions that a person would get."""
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
        """The tracks of a run that knew the marked false alarms, without those that stay among
        them; the false alarms that it tracked all the same, None if that is not known; and a
        sentence.
        """
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
        """The density of tracked detections, in place of marked objects, to which birth places are
        compared. None with too few detections; no track is held back.
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
        """Births from the moving tracks of the tracker itself [M09 §IV]. Raises `InputError` if no
        place is likelier than others: the default births are better then.
        """
        clock = self._times
        rate = self.stages.model.rate
        states = births_in(tracks, clock, rate)
        text = f"{counted(states.shape[1], 'track')} began in {counted(len(self.stretch), 'frame')}"
        training = learn_births(states, clock.passed(self.stretch) * rate, self._size)
        if not training.learned.density.has_places:
            problem = f"{text}, and no place is likelier than others"
            raise InputError(problem, where="learning births", cure="Learn from a longer stretch")
        return training, text

    def _marked_births(self) -> tuple[Training, str]:
        """Births from marks on the clips around done frames."""
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
    def stages(self) -> AnyStages:
        """The stages of classes without stages of their own."""
        return self.classes.usual

    @property
    def _times(self) -> Clock:
        """The times of the frames."""
        return self.clock or Clock.constant(self.info.fps)

    @property
    def _size(self) -> tuple[float, float]:
        """Width and height of a frame in pixels."""
        return float(self.info.width), float(self.info.height)

    @property
    def _marked(self) -> Marks:
        """The marks. Raises `InputError` if there are none."""
        if self.marks is None:
            raise InputError(f"no marks were found (phdtrack label, kept in {self.labels})")
        return self.marks

    def _tracked(self, alarms: LearnedDensity | None = None) -> Evidence:
        """The evidence of a tracker that knows these false alarms."""
        classes = self.classes
        if alarms is not None:
            own = {code: _with_alarms(stages, alarms) for code, stages in classes.own.items()}
            classes = replace(classes, usual=_with_alarms(self.stages, alarms), own=own)
        evidence = Evidence.of(
            self.table, self._times, self.stretch, classes, self.seed, self.advance
        )
        return replace(evidence, frame_size=self._size, background=self.background)

    def _with_prior(self, learned: LearnedDensity) -> LearnedDensity:
        """The learned density, mixed with a little of all sizes detected in the stretch."""
        table = self.table
        rows = slice(*np.searchsorted(table.frame, [self.stretch.start, self.stretch.stop]))
        return with_prior(learned, to_cxcywh(table.detections.xyxy[rows])[2:])


def _with_alarms(stages: AnyStages, alarms: LearnedDensity) -> AnyStages:
    """The stages with a model of these false alarms."""
    model = stages.model
    own = 0.0
    if isinstance(model.clutter, BoxClutter):
        own = model.clutter.clutter_per_detection
    learned = SceneClutter(alarms.rate, alarms.density, own)
    birth, clutter = in_one_volume(model.birth, learned)
    return replace(stages, model=replace(model, birth=birth, clutter=clutter))
