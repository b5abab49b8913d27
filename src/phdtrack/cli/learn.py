"""``phdtrack learn``: where people enter this scene, and where the detector is wrong in it, for `track --scene`.

Births come from tracks or marks, false alarms from marks or suggestions.

Where a person has marked false alarms, a run with these false alarms in its model shows which of them are followed all the
same: flickering light moves as little as a person who stands. Tracks that stay among them are no births, and `phdtrack
track --scene` withholds them.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.associate.rejection import without_false_tracks
from phdtrack.cli import options as given
from phdtrack.cli.inputs import NO_PICTURE
from phdtrack.cli.label import Labelled, labels_file, to_label, tracked
from phdtrack.cli.options import SourceOptions, option
from phdtrack.cli.output import Output, counted, progress
from phdtrack.config import build, load
from phdtrack.errors import InputError
from phdtrack.label import LabelStore
from phdtrack.label.samples import Marks, sampled
from phdtrack.label.suggestions import TICKED, Evidence, suggest
from phdtrack.models import PlaneSensor
from phdtrack.models.scene import FalseAlarmRatio, with_scene
from phdtrack.models.volumes import EVERYWHERE
from phdtrack.protocols import AnyStages
from phdtrack.report.pages import render
from phdtrack.scene import LearnedDensity, Scene, TrackedObjects, write_scene
from phdtrack.scene.training import FALSE_BOXES, OBJECT_BOXES, Training, births_in, learn_births, learn_boxes, with_prior
from phdtrack.types import F8, Detections, Tracks
from phdtrack.video import open_source

_ONLY_BOXES = "a density of them is learned for boxes in the image only (motion.kind=box)"
# Frames, drawn at random, whose suggestions are taken where no person labels: M09's false alarms were of as many.
UNATTENDED = 200
LIMITS = (
    "No person has checked them. A person who sits or stands in one place for nine tenths of the stretch, or for two thirds "
    "of it while detected in every other frame only, is taken for a false alarm there, and so are people hidden by others "
    "in a crowd (in a simulated one a quarter of what was taken were people, in streets 3 %). To check them: phdtrack "
    "label suggests the same boxes."
)


def learn(
    source: SourceOptions,
    output: Output,
    labels: given.Labels = None,
    births: Annotated[
        str, option("--births", "FROM", "tracks: where the tracker's tracks begin; hand: marked with `phdtrack label`.")
    ] = "tracks",
    clutter: Annotated[
        str,
        option("--clutter", "FROM", "labels: marked with `phdtrack label`; unattended: suggested, not checked by anybody."),
    ] = "labels",
    first: Annotated[int, option("--first", "N", "Learn from this frame on.", min=1)] = 1,
    last: Annotated[int, option("--last", "N", "Learn up to this frame; 0: all.", min=0)] = 0,
    out: Annotated[Path | None, option("--out", "FILE", "Where to write the scene; default: SOURCE.scene.json.")] = None,
    overwrite: given.Overwrite = False,
    config: given.Config = None,
    sets: given.Sets = None,
    preset: given.Preset = "",
    seed: given.Seed = 0,
) -> None:
    """Learn where people enter and where the detector is wrong: births from the tracker's own tracks, or marked by hand;
    false alarms from the marks that a person made (`phdtrack label`), or unattended."""
    for name, value, known in (("--births", births, ("tracks", "hand")), ("--clutter", clutter, ("labels", "unattended"))):
        if value not in known:
            raise InputError(f"expected {' or '.join(known)}, got {value!r}", where=name)
    file = labels or labels_file(source)
    if labels is not None and not labels.exists() and (clutter == "labels" or births == "hand"):
        raise InputError("there is no such file of labels", where=labels, cure="Make one: phdtrack label")
    target = out or file.with_name(file.name.removesuffix(".labels.sqlite") + ".scene.json")
    if target.exists() and not overwrite:
        raise InputError("this file is there already", where=target, cure="Say --overwrite, or choose another --out")
    settings = load(config, sets or (), preset)
    found = to_label(source, settings.detector, file, output)
    stretch = range(first, min(last or found.info.frames, found.info.frames) + 1)
    if not stretch:
        raise InputError(f"there are no frames from {first} to {stretch.stop - 1}", where="--first", cure="Begin earlier")
    marks = None
    if file.exists() and (clutter == "labels" or births == "hand"):
        marks = Marks(LabelStore.open(file, found.name, found.digest, []), found.table, found.info, stretch)
    data = TrainingData(found, stretch, build(settings, found.info), seed, file, marks)
    frames = open_source(source.source, fps=source.fps) if source.source else ()
    picture = next((frame.image for frame in frames), NO_PICTURE)
    scene, born, alarms = data.train(births, clutter, output)
    write_scene(target, scene)
    page = target.with_name(target.name.removesuffix(".json") + ".html")
    use = f"phdtrack track {source.source or f'--detections {source.detections}'} --scene {target}"
    words = {"title": "Learned scene", "command": use}
    text = render("scene.html", scene=scene, births=born, alarms=alarms, image=picture, **words)
    page.write_text(text, encoding="utf-8")
    output.say(f"{target}, with its maps in {page}; use it: {use}")
    output.document(
        {
            "scene": str(target),
            "report": str(page),
            "gain": {"births": born.gain, "clutter": alarms.gain},
            "births": births,
            "clutter": clutter,
            "followed": None if scene.followed is None else scene.followed.share,
        }
    )


class Lesson(NamedTuple):
    """What was learned of one part, None for nothing; what is said of it; ``source``, where it comes from, in words."""

    training: Training | None
    sentence: str
    source: str = ""

    @property
    def learned(self) -> LearnedDensity | None:
        """Rate and density."""
        return None if self.training is None else self.training.learned

    @property
    def gain(self) -> float:
        """Nats per unseen sample above the uniform density; NaN where that is not known."""
        return math.nan if self.training is None else self.training.gain


@dataclass(frozen=True, slots=True, eq=False)
class TrainingData:
    """What is learned from: the detections, the ``stretch`` of frames, how to track, and a person's marks.

    ``marks`` is None where there are none; ``labels`` is the file in which they were looked for.
    """

    found: Labelled
    stretch: range
    stages: AnyStages
    seed: int
    labels: Path
    marks: Marks | None

    def train(self, births: str, clutter: str, output: Output) -> tuple[Scene, Lesson, Lesson]:
        """What was learned of a scene, and of births and of false alarms apart.

        ``births`` and ``clutter`` are as the options have them. Raises `InputError` where nothing could be learned.
        """
        unattended, followed = clutter == "unattended", None
        alarms = self._lesson("false alarms", self._unattended_clutter if unattended else self._marked_clutter)
        if unattended and alarms.training is not None:
            alarms = Lesson(alarms.training, f"{alarms.sentence}. {LIMITS}", f"{alarms.source} {LIMITS}")
        output.say(alarms.sentence)
        marked = None if unattended else alarms.training
        tracks = self._tracked(alarms.training).tracks if marked is not None or births == "tracks" else None
        if marked is not None and tracks is not None and self.marks is not None:
            tracks, followed, sentence = self._without_followed(self.marks, marked, tracks)
            output.say(sentence)
        if tracks is None or births == "hand":
            born = self._lesson("births", self._marked_births)
        else:
            born = self._lesson("births", partial(self._births_of_tracks, tracks))
        output.say(born.sentence)
        info, source = self.found.info, self.found.name
        if born.training is None and alarms.training is None:
            raise InputError("nothing could be learned", where=source, cure="Mark false detections, or learn longer")
        gains = {"births gain": born.gain, "clutter gain": alarms.gain}
        notes: dict[str, float | int | str] = {name: value for name, value in gains.items() if math.isfinite(value)}
        notes |= {"births from": births, "clutter from": clutter, "first": self.stretch.start, "last": self.stretch.stop - 1}
        rate = self.stages.model.rate
        scene = Scene(info.width, info.height, rate, source, born.learned, alarms.learned, notes, followed)
        return scene, born, alarms

    def _lesson(self, part: str, learn: Callable[[], tuple[Training, str]]) -> Lesson:
        """What ``learn`` gives, with what it says of it and its gain on unseen samples; why nothing, where it fails."""
        try:
            training, text = learn()
            training = self._with_prior(training)
        except InputError as error:
            return Lesson(None, f"{part} stay as shipped: {error}")
        gain = "too few samples to measure the gain"
        if math.isfinite(training.gain):
            gain = f"samples not learned from are {training.gain:+.2f} nats likelier than under a uniform density"
        return Lesson(training, f"{part}: {text}; {gain}", f"{text}.")

    def _marked_clutter(self) -> tuple[Training, str]:
        """False alarms from marks [M09 §IV]."""
        marks = self._marks(_ONLY_BOXES)
        frames = len(marks.looked_at)
        training = learn_boxes(marks.false_boxes, frames, self._size, FALSE_BOXES)
        marked = f"{counted(training.learned.samples, 'box')} marked by a person on {counted(frames, 'frame')}"
        return training, marked

    def _unattended_clutter(self) -> tuple[Training, str]:
        """False alarms from what would be suggested to a person."""
        if not self._of_boxes:
            raise InputError(_ONLY_BOXES)
        frames = [self.stretch.start + k - 1 for k in sampled(len(self.stretch), UNATTENDED, self.seed)]
        taken = [one for one in suggest(self._tracked(), frames, self.found.info.fps) if one.score >= TICKED]
        table = self.found.table
        rows = np.searchsorted(table.frame, [one.frame for one in taken]) + np.array([one.box for one in taken], np.int64)
        try:
            training = learn_boxes(to_cxcywh(table.detections.xyxy[rows]), len(frames), self._size, FALSE_BOXES)
        except InputError as error:
            raise InputError(error.problem, where=error.where, cure="Look yourself: phdtrack label") from None
        many = f"{counted(training.learned.samples, 'box')} of {counted(len(frames), 'frame')}"
        reasons, places = Counter(one.reason for one in taken), {one.place for one in taken if one.place >= 0}
        why = []
        if reasons["place"]:
            why.append(f"{reasons['place']} at {counted(len(places), 'place')} that fire too often")
        if reasons["rejected"]:
            why.append(f"{reasons['rejected']} that the filter rejected")
        return training, f"{many} taken for false ({', '.join(why)})"

    def _without_followed(self, marks: Marks, alarms: Training, tracks: Tracks) -> tuple[Tracks, TrackedObjects | None, str]:
        """The tracks of a run that knew the marked false alarms, but for those that stay among them; which of the false
        alarms it followed all the same, None where that is not known; and a sentence about it."""
        try:
            objects = self._with_prior(learn_boxes(marks.object_boxes, len(marks.looked_at), self._size, OBJECT_BOXES))
        except InputError as error:
            return tracks, None, f"no track is held back: {error}"
        followed = TrackedObjects(marks.share_followed(tracks), objects.learned)
        text = f"the tracker follows {100 * followed.share:.2g} % of the false alarms although it knows them"
        kept = without_false_tracks(tracks, FalseAlarmRatio(alarms.learned, followed))
        return kept, followed, f"{text}; tracks that stay among them are held back"

    def _births_of_tracks(self, tracks: Tracks) -> tuple[Training, str]:
        """Births from the tracks that the tracker itself makes and that go somewhere [M09 §IV]."""
        fps, model, shown = self.found.info.fps, self.stages.model, None
        if not self._of_boxes:
            shown = model.sensor.measure(Detections.of(tracks.xyxy))[: len(model.sensor.observed)]
        states = births_in(tracks, fps, model.rate, shown)
        # Feet that no ground is under.
        states = states[:, np.isfinite(states).all(axis=0)]
        text = f"{counted(states.shape[1], 'track')} began in {counted(len(self.stretch), 'frame')}"
        return self._births(states, len(self.stretch) / fps * model.rate), text

    def _marked_births(self) -> tuple[Training, str]:
        """Births from marks on the clips about the frames that a person has looked at."""
        marks, rate = self._marks("those marked by hand are boxes in the image (--births tracks)"), self.stages.model.rate
        states, frames = marks.birth_states(rate), len(marks.watched)
        text = f"{counted(states.shape[1], 'birth')} marked by a person on {counted(frames, 'frame')}"
        unknown = int(np.isnan(states[2]).sum())
        text += f" ({unknown} of unknown velocity)" if unknown else ""
        return self._births(states, marks.time_watched(rate)), text

    def _births(self, states: F8, time: float) -> Training:
        """Births from their states, seen in ``time``: over the frame in pixels, or a region of the ground in metres.

        Raises `InputError` where there are too few, or the ground has no region.
        """
        sensor = self.stages.model.sensor
        if not isinstance(sensor, PlaneSensor):
            return learn_births(states, time, self._size)
        if sensor.borders == EVERYWHERE:
            raise InputError("the ground has no region", where="births", cure="Give camera.file, or camera.region")
        left, low, right, high = sensor.borders
        return learn_births(states, time, (right - left, high - low), (left, low))

    @property
    def _size(self) -> tuple[float, float]:
        """Width and height of a frame in pixels."""
        return float(self.found.info.width), float(self.found.info.height)

    @property
    def _of_boxes(self) -> bool:
        """Whether targets are boxes in the image, and not points in it or people on the ground."""
        return len(self.stages.model.sensor.observed) == 4

    def _marks(self, otherwise: str) -> Marks:
        """The marks. Raises `InputError` where there are none, or with ``otherwise`` where targets are no boxes."""
        if not self._of_boxes:
            raise InputError(otherwise)
        if self.marks is None:
            raise InputError(f"no marks were found (phdtrack label, kept in {self.labels})")
        return self.marks

    def _tracked(self, alarms: Training | None = None) -> Evidence:
        """What a tracker makes of the stretch that knows these false alarms."""
        stages = self.stages
        if alarms is not None:
            # Jmax is of learned births, and there are none yet.
            stages = replace(stages, model=with_scene(stages.model, None, alarms.learned, None, particles=1))
        with progress("tracking", len(self.stretch)) as advance:
            return tracked(self.found.table, self.found.info.fps, stages, self.stretch, self.seed, advance)

    def _with_prior(self, training: Training) -> Training:
        """What was learned, and a little of any size detected in the stretch; on the ground, without sizes, as it is."""
        if not self._of_boxes:
            return training
        table = self.found.table
        rows = slice(*np.searchsorted(table.frame, [self.stretch.start, self.stretch.stop]))
        sizes = to_cxcywh(table.detections.xyxy[rows])[2:]
        return replace(training, learned=with_prior(training.learned, sizes))
