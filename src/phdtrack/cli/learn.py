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
from pathlib import Path
from typing import Annotated

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
from phdtrack.label.suggestions import REASONS, TICKED, Evidence, Suggestions, suggest
from phdtrack.models import PlaneSensor
from phdtrack.models.scene import FalseAlarmRatio, with_scene
from phdtrack.models.volumes import EVERYWHERE
from phdtrack.protocols import AnyStages
from phdtrack.report.pages import SceneTraining, render
from phdtrack.scene import LearnedDensity, Scene, TrackedObjects, write_scene
from phdtrack.scene.training import (
    Training,
    births_in,
    learn_births,
    learn_clutter,
    learn_objects,
    with_prior,
)
from phdtrack.types import F8, I8, Detections, Image, Tracks
from phdtrack.video import open_source

_ONLY_BOXES = "a density of them is learned for boxes in the image only (motion.kind=box)"
# Frames, drawn at random, whose suggestions are taken where no person labels: M09's false alarms were of as many.
UNATTENDED = 200
LIMITS = (
    "No person has checked them. A person who sits or stands in one place for nine tenths of the stretch, or for two thirds "
    "of it while detected in every other frame only, is taken for a false alarm there, and so are people whom others hide "
    "in a crowd (in a simulated one a quarter of what was taken were people, in streets 3 %). To check them: phdtrack "
    "label suggests the same boxes."
)


def learn(
    source: SourceOptions,
    output: Output,
    labels: given.Labels = None,
    births: Annotated[
        str, option("--births", "FROM", "tracks: the tracker's own; hand: marked with `phdtrack label`.")
    ] = "tracks",
    clutter: Annotated[
        str, option("--clutter", "FROM", "labels: marked with `phdtrack label`; unattended: suggested, unchecked.")
    ] = "labels",
    first: Annotated[int, option("--first", "N", "Learn from this frame on.", min=1)] = 1,
    last: Annotated[int, option("--last", "N", "Learn up to this frame; 0: all.", min=0)] = 0,
    out: Annotated[Path | None, option("--out", "FILE", "Default: SOURCE.scene.json.")] = None,
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
    stretch = range(first, min(last or found.last, found.last) + 1)
    if not stretch:
        raise InputError(f"there are no frames from {first} to {stretch.stop - 1}", where="--first", cure="Begin earlier")
    data = TrainingData(found, stretch, build(settings, found.info), seed, file)
    frames = open_source(source.source, fps=source.fps) if source.source else ()
    picture = next((frame.image for frame in frames), NO_PICTURE)
    training, lead = train(data, births, clutter, picture, output)
    write_scene(target, training.scene)
    page = target.with_name(target.name.removesuffix(".json") + ".html")
    use = f"phdtrack track {source.source or f'--detections {source.detections}'} --scene {target}"
    text = render("scene.html", title="Learned scene", training=training, lead=lead, command=use)
    page.write_text(text, encoding="utf-8")
    output.say(f"{target}, with its maps in {page}; use it: {use}")
    followed = training.scene.followed
    output.document(
        {
            "scene": str(target),
            "report": str(page),
            "gain": {"births": training.births_gain, "clutter": training.clutter_gain},
            "births": births,
            "clutter": clutter,
            "followed": None if followed is None else followed.share,
        }
    )


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """What was learned of one part, None for nothing; what is said of it; ``source``, where it comes from, in words."""

    lesson: Training | None
    sentence: str
    source: str = ""

    @property
    def learned(self) -> LearnedDensity | None:
        """Rate and density."""
        return None if self.lesson is None else self.lesson.learned

    @property
    def gain(self) -> float:
        """Nats per unseen sample above the uniform density; NaN where that is not known."""
        return math.nan if self.lesson is None else self.lesson.gain


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
        sensor = self.stages.model.sensor
        if not isinstance(sensor, PlaneSensor):
            return self.size, (0.0, 0.0)
        if sensor.borders == EVERYWHERE:
            raise InputError("the ground has no region", where="births", cure="Give camera.file, or camera.region")
        left, low, right, high = sensor.borders
        return (right - left, high - low), (left, low)

    def with_prior(self, lesson: Training) -> Training:
        """What was learned, and a little of any size detected in the stretch; on the ground, without sizes, as it is."""
        if not self.of_boxes:
            return lesson
        table = self.found.table
        rows = slice(*np.searchsorted(table.frame, [self.stretch.start, self.stretch.stop]))
        sizes = to_cxcywh(table.detections.xyxy[rows])[2:]
        return replace(lesson, learned=with_prior(lesson.learned, sizes))

    def marks(self) -> Marks | None:
        """A person's marks on these detections, where there are any. Raises `InputError` where they are on others."""
        if not self.labels.exists():
            return None
        store = LabelStore.open(self.labels, self.found.name, self.found.digest, [])
        return Marks(store, self.found.table, self.found.info, self.stretch)

    def no_marks(self) -> InputError:
        """To raise where there are no labels."""
        return InputError(f"no marks were found (phdtrack label, kept in {self.labels})")

    def tracked(self, alarms: Training | None = None) -> Evidence:
        """What a tracker makes of the stretch that knows these false alarms."""
        stages = self.stages
        if alarms is not None:
            # Jmax is of learned births, and there are none yet.
            stages = replace(stages, model=with_scene(stages.model, None, alarms.learned, None, particles=1))
        with progress("tracking", len(self.stretch)) as advance:
            return tracked(self.found.table, self.found.info.fps, stages, self.stretch, self.seed, advance)


def clutter_of_labels(data: TrainingData) -> Trained:
    """False alarms from marks [M09 §IV]; why not, where there are none to learn from."""
    marks = data.marks()

    def learned() -> tuple[Training, str]:
        if not data.of_boxes:
            raise InputError(_ONLY_BOXES)
        if marks is None:
            raise data.no_marks()
        frames = len(marks.looked_at)
        lesson = learn_clutter(marks.false_boxes, frames, data.size)
        return lesson, f"{counted(lesson.learned.samples, 'box')} marked on {counted(frames, 'frame')}"

    return _trained(data, "false alarms", learned, by=" by a person")


def clutter_unattended(data: TrainingData) -> Trained:
    """False alarms from what would be suggested to a person; why not, where that is too little."""

    def learned() -> tuple[Training, str]:
        if not data.of_boxes:
            raise InputError(_ONLY_BOXES)
        frames = [data.stretch.start + k - 1 for k in sampled(len(data.stretch), UNATTENDED, data.seed)]
        found = suggest(data.tracked(), frames, data.found.info.fps)
        taken = np.flatnonzero(found.score >= TICKED)
        rows = np.searchsorted(data.found.table.frame, found.frame[taken]) + found.box[taken]
        try:
            boxes = to_cxcywh(data.found.table.detections.xyxy[rows])
            lesson = learn_clutter(boxes, len(frames), data.size)
        except InputError as error:
            raise InputError(error.problem, where=error.where, cure="Look yourself: phdtrack label") from None
        many = f"{counted(lesson.learned.samples, 'box')} of {counted(len(frames), 'frame')}"
        return lesson, f"{many} taken for false ({_why(found, taken)})"

    made = _trained(data, "false alarms", learned)
    if made.lesson is None:
        return made
    return replace(made, sentence=f"{made.sentence}. {LIMITS}", source=f"{made.source} {LIMITS}")


def _why(found: Suggestions, taken: I8) -> str:
    """How many were taken for which reason."""
    many, places = Counter(REASONS[k] for k in found.reason[taken]), found.place[taken]
    count = len(np.unique(places[places >= 0]))
    said = [f"{many['place']} at {counted(count, 'place')} that fire too often"] if many["place"] else []
    return ", ".join([*said, *([f"{many['rejected']} that the filter rejected"] if many["rejected"] else [])])


def without_followed(data: TrainingData, alarms: Training, tracks: Tracks) -> tuple[Tracks, TrackedObjects | None, str]:
    """The tracks of a run that knew the marked false alarms, but for those that stay among them; which of the false alarms
    it followed all the same, None where that is not known; and a sentence about it."""
    marks = data.marks()
    if marks is None:
        return tracks, None, ""
    try:
        objects = data.with_prior(learn_objects(marks.object_boxes, len(marks.looked_at), data.size))
    except InputError as error:
        return tracks, None, f"no track is held back: {error}"
    followed = TrackedObjects(marks.share_followed(tracks), objects.learned)
    text = f"the tracker follows {100 * followed.share:.2g} % of the false alarms although it knows them"
    kept = without_false_tracks(tracks, FalseAlarmRatio(alarms.learned, followed))
    return kept, followed, f"{text}; tracks that stay among them are held back"


def births_of_tracks(data: TrainingData, tracks: Tracks) -> Trained:
    """Births from the tracks that the tracker itself makes and that go somewhere [M09 §IV]; why not, if they are too few."""
    info, model, shown = data.found.info, data.stages.model, None
    if not data.of_boxes:
        shown = model.sensor.measure(Detections.of(tracks.xyxy))[: len(model.sensor.observed)]
    states = births_in(tracks, info.fps, model.rate, shown)
    # Feet that no ground is under.
    states = states[:, np.isfinite(states).all(axis=0)]
    text = f"{counted(states.shape[1], 'track')} began in {counted(len(data.stretch), 'frame')}"
    return _trained(data, "births", lambda: _births(data, states, len(data.stretch) / info.fps * model.rate, text))


def births_by_hand(data: TrainingData) -> Trained:
    """Births from marks on the clips about the frames that a person has looked at; why not, where they are too few."""
    marks = data.marks()

    def learned() -> tuple[Training, str]:
        if not data.of_boxes:
            raise InputError("those marked by hand are boxes in the image (--births tracks)")
        if marks is None:
            raise data.no_marks()
        rate = data.stages.model.rate
        states, frames = marks.birth_states(rate), len(marks.watched)
        text = f"{counted(states.shape[1], 'birth')} marked by a person on {counted(frames, 'frame')}"
        unknown = int(np.isnan(states[2]).sum())
        text += f" ({unknown} of unknown velocity)" if unknown else ""
        return _births(data, states, marks.time_watched(rate), text)

    return _trained(data, "births", learned)


def _births(data: TrainingData, states: F8, time: float, text: str) -> tuple[Training, str]:
    size, corner = data.region()
    return learn_births(states, time, size, corner), text


def _trained(data: TrainingData, part: str, learned: Callable[[], tuple[Training, str]], by: str = "") -> Trained:
    """What ``learned`` gives, with what it says of it and its gain on unseen samples; why nothing, where it fails."""
    try:
        lesson, text = learned()
        lesson = data.with_prior(lesson)
    except InputError as error:
        return Trained(None, f"{part} stay as shipped: {error}")
    gain = "too few samples to measure the gain"
    if math.isfinite(lesson.gain):
        gain = f"samples not learned from are {lesson.gain:+.2f} nats likelier than under a uniform density"
    return Trained(lesson, f"{part}: {text}; {gain}", f"{text}{by}.")


def train(data: TrainingData, births: str, clutter: str, picture: Image, output: Output) -> tuple[SceneTraining, str]:
    """What was learned of a scene, and a summary of it in words.

    Parameters
    ----------
    data : what is learned from.
    births : ``tracks`` or ``hand``.
    clutter : ``labels`` or ``unattended``.
    picture : a frame, as the ground of the report's maps; empty where there is none.
    output : where to say what is learned and what is not.

    Raises
    ------
    InputError : nothing could be learned.
    """
    alarms, followed = clutter_unattended(data) if clutter == "unattended" else clutter_of_labels(data), None
    output.say(alarms.sentence)
    marked, tracks = clutter == "labels" and alarms.lesson is not None, None
    if marked or births == "tracks":
        tracks = data.tracked(alarms.lesson).tracks
    if marked and alarms.lesson is not None and tracks is not None:
        tracks, followed, sentence = without_followed(data, alarms.lesson, tracks)
        output.say(*filter(None, [sentence]))
    born = births_by_hand(data) if tracks is None or births == "hand" else births_of_tracks(data, tracks)
    output.say(born.sentence)
    if born.lesson is None and alarms.lesson is None:
        raise InputError("nothing could be learned", where=data.found.name, cure="Mark false detections, or learn longer")
    gains = {"births gain": born.gain, "clutter gain": alarms.gain}
    notes: dict[str, float | int | str] = {name: value for name, value in gains.items() if math.isfinite(value)}
    notes |= {"births from": births, "clutter from": clutter, "first": data.stretch.start, "last": data.stretch.stop - 1}
    info, name, rate = data.found.info, data.found.name, data.stages.model.rate
    scene = Scene(info.width, info.height, rate, name, born.learned, alarms.learned, notes, followed)
    lead = " ".join(
        f"{part}: {counted(len(learned.density), 'place')} from {counted(learned.samples, 'sample')}."
        for part, learned in (("Births", scene.births), ("False alarms", scene.clutter))
        if learned is not None
    )
    return SceneTraining(scene, picture, born.gain, alarms.gain, born.source, alarms.source), lead
