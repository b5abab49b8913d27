"""``phdtrack label`` and ``phdtrack learn``: a person, or the tracker itself, teaches where people enter a scene and where
the detector is wrong in it.

`label` is a page on which false detections, and births, are marked on frames drawn at random. `learn` makes a scene of the
marks, or of the tracker's own tracks and of what would be suggested to a person, for `phdtrack track --scene`.

Where a person has marked false alarms, a run with these false alarms in its model shows which of them are followed all the
same: flickering light moves as little as a person who stands. Tracks that stay among them are no births, and `phdtrack
track --scene` withholds them.
"""

from __future__ import annotations

import hashlib
import json
import math
import webbrowser
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import cv2
import numpy as np
import typer

from phdtrack import __version__, pipeline
from phdtrack.arrays import to_cxcywh
from phdtrack.associate.rejection import without_false_tracks
from phdtrack.cli import options as given
from phdtrack.cli.inputs import NO_PICTURE, Inputs, ahead, comes_again, open_inputs, write_detected
from phdtrack.cli.options import DEFAULT_DETECTOR, SourceOptions, option
from phdtrack.cli.output import Advance, Output, counted, progress
from phdtrack.config import Settings, build, load
from phdtrack.errors import InputError
from phdtrack.formats import read_detections
from phdtrack.label import LabelStore
from phdtrack.label.samples import Marks, clip, last_frame, sampled
from phdtrack.label.suggestions import TICKED, Background, Evidence, Suggestion, kept, suggest
from phdtrack.models import PlaneSensor
from phdtrack.models.scene import FalseAlarmRatio, with_scene
from phdtrack.models.volumes import EVERYWHERE
from phdtrack.protocols import AnyStages
from phdtrack.report.pages import render, write_text
from phdtrack.scene import LearnedDensity, Scene, TrackedObjects, write_scene
from phdtrack.scene.training import FALSE_BOXES, OBJECT_BOXES, Training, births_in, learn_births, learn_boxes, with_prior
from phdtrack.types import F8, Detections, DetectionTable, SequenceInfo, Tracks
from phdtrack.video import open_source

_CLIP_WIDTH = 640
_ONLY_BOXES = "a density of them is learned for boxes in the image only (motion.kind=box)"
# Frames, drawn at random, whose suggestions are taken where no person labels: M09's false alarms were of as many.
UNATTENDED = 200
LIMITS = (
    "No person has checked them. A person who sits or stands in one place for nine tenths of the stretch, or for two thirds "
    "of it while detected in every other frame only, is taken for a false alarm there, and so are people hidden by others "
    "in a crowd (in a simulated one a quarter of what was taken were people, in streets 3 %). To check them: phdtrack "
    "label suggests the same boxes."
)


def label(
    source: SourceOptions,
    labels: given.Labels = None,
    frames: Annotated[int, option("N", "How many frames to draw.", min=1)] = 40,
    seed: Annotated[int, option("N", "Seed of the draw.", min=0)] = 0,
    port: Annotated[int, option("N", "Port of the page; 0: any that is free.", min=0, max=65535)] = 0,
    host: Annotated[str, option("NAME", "Address to listen on; other machines need the printed token.")] = "127.0.0.1",
    suggest: Annotated[bool, typer.Option("--suggest/--no-suggest", help="Look for detections that may be false.")] = True,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
    config: given.Config = None,
    sets: given.Sets = None,
) -> None:
    """Mark false detections and births on frames drawn at random: the page says how. Every click is kept at once.

    Meanwhile a tracker looks for detections that may be false and suggests them. Ctrl-C ends.
    """
    try:
        from phdtrack.label.page import Session, label_app, listen, serve
    except ModuleNotFoundError as error:
        problem = f"the page needs the package {error.name}"
        raise InputError(problem, where="phdtrack label", cure="pip install 'phdtrack[web]'") from error
    output, settings = Output(), load(config, sets or ())
    file = labels or labels_file(source)
    found = to_label(source, settings.detector, file, output)
    store = LabelStore.open(file, found.name, found.digest, sampled(found.info.frames, frames, seed))
    numbers = [number for number, _ in store.frames()]
    pictures = _stills(source, numbers, {frame for number in numbers for frame in clip(number, found.info.frames)})
    address = listen(host, port)
    kept = file.with_name(file.name.removesuffix(".sqlite") + ".suggestions.json")
    work = Background(partial(_suggestions, found, settings, numbers, kept)) if suggest else None
    session = Session(store, found.table, pictures, found.info, work)
    state = store.progress()
    output.say(f"{counted(state.frames, 'frame')}, {state.done} of them looked at; the marks are kept in {file}")
    output.say(f"the page: {address.url}   (Ctrl-C ends)")
    if browser:
        webbrowser.open(address.url)
    serve(label_app(session), address)
    state = store.progress()
    looked = f"{state.done} of {counted(state.frames, 'frame')} looked at"
    output.say(f"{looked}, {state.false} false, {counted(state.births, 'birth')}: {file}")


@dataclass(frozen=True, slots=True)
class Labelled:
    """A sequence to label: the ``name`` of the video or of the detections, and a ``digest`` of the detections."""

    name: str
    info: SequenceInfo
    table: DetectionTable
    digest: str


def to_label(source: SourceOptions, parameters: dict[str, Any], labels: Path, output: Output) -> Labelled:
    """The detections of everything that the options name; a detector's are kept in a file beside ``labels``.

    Without either the default detector looks. So a detector runs once, and the marked boxes are the same when a
    person goes on another day. Raises `InputError` as `open_inputs`, and where there is nothing to label.
    """
    if source.source and not comes_again(source.source):
        raise InputError("frames of a camera come once only", where=source.source, cure="Record a video and label that")
    inputs = open_inputs(source, parameters)
    output.warn(inputs.warnings)
    table = read_detections(source.detections or _kept_detections(source, parameters, labels, inputs, output))
    if len(table) == 0:
        raise InputError("there are no detections to label", where=inputs.name)
    digest = hashlib.sha256(table.frame.tobytes() + table.detections.xyxy.round(3).tobytes()).hexdigest()[:32]
    return Labelled(inputs.name, replace(inputs.info, frames=last_frame(inputs.info, table)), table, digest)


def _kept_detections(
    source: SourceOptions, parameters: dict[str, Any], labels: Path, inputs: Inputs, output: Output
) -> Path:
    """The file of what the detector sees, by its name and settings; it appears when it is whole."""
    more = [parameters, source.max_width, str(source.mask or ""), source.fps]
    digest = hashlib.sha256(json.dumps(more, sort_keys=True, default=str).encode()).hexdigest()[:8]
    path = labels.with_name(f"{labels.stem}.{source.detector or DEFAULT_DETECTOR}-{digest}.detections.csv")
    if path.exists():
        output.note(f"the detections are those of {path}")
        return path
    part = path.with_name(path.name + ".part")
    try:
        for _ in write_detected(inputs, part):
            pass
        return part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _stills(source: SourceOptions, numbers: Collection[int], around: Collection[int]) -> dict[int, bytes]:
    """The frames ``numbers`` of a video as JPEG, and those ``around`` them as small ones; it is read up to the last."""
    kept = dict[int, bytes]()
    if not source.source or not numbers:
        return kept
    last = max(around)
    frames = islice(open_source(source.source, fps=source.fps), last)
    with progress("reading frames", last) as advance, ahead(frames) as pictures:
        for frame in pictures:
            whole, (height, width) = frame.number in numbers, frame.image.shape[:2]
            if whole or frame.number in around:
                small = not whole and width > _CLIP_WIDTH
                image = cv2.resize(frame.image, (_CLIP_WIDTH, round(height * _CLIP_WIDTH / width))) if small else frame.image
                _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 92 if whole else 80])
                kept[frame.number] = data.tobytes()
            advance(frame.number)
    return kept


def _suggestions(
    found: Labelled, settings: Settings, frames: list[int], file: Path, advance: Callable[[float], None]
) -> list[Suggestion]:
    """What may be false on these frames, by a tracker's run over everything; kept in ``file`` for the next time."""

    def made() -> list[Suggestion]:
        stages, whole = build(settings, found.info), range(1, found.info.frames + 1)
        evidence = tracked(found.table, found.info.fps, stages, whole, 0, lambda count: advance(count / found.info.frames))
        return suggest(evidence, frames, found.info.fps)

    decides = [__version__, found.digest, found.info.fps, found.info.frames, sorted(frames), settings.as_dict()]
    return kept(file, hashlib.sha256(json.dumps(decides, default=str).encode()).hexdigest(), made)


def labels_file(source: SourceOptions) -> Path:
    """The file of labels that goes with a video, or with detections."""
    path = Path(source.source) if source.source else source.detections
    if path is None:
        raise InputError("nothing to label", where="SOURCE", cure="Name a video, or say --detections FILE")
    return path.with_name(f"{path.stem if path.is_file() else path.name}.labels.sqlite")


def tracked(table: DetectionTable, fps: float, stages: AnyStages, frames: range, seed: int, advance: Advance) -> Evidence:
    """What a tracker makes of the detections of ``frames``; ``advance`` is called with the number of frames done.

    A filter that says nothing of false alarms (`filters.none`) leaves all probabilities at 0.
    """
    rows = np.arange(*np.searchsorted(table.frame, [frames.start, frames.stop]))
    rng, clutter = np.random.default_rng(seed), []
    given = ((number, (number - 1) / fps, table.at(number)) for number in frames)
    for after, step in pipeline.run(stages, given, rng):
        state, found = after, step.info.clutter_probability
        clutter.append(found if len(found) else np.zeros(len(step.detections)))
        advance(len(clutter))
    stretch = DetectionTable(table.frame[rows], table.detections.take(rows))
    return Evidence(stretch, frames.start, frames.stop - 1, np.concatenate(clutter), pipeline.finish(stages, state))


def learn(
    source: SourceOptions,
    output: Output,
    labels: given.Labels = None,
    births: Annotated[str, option("FROM", "tracks: where tracks begin; hand: marked with `phdtrack label`.")] = "tracks",
    clutter: Annotated[str, option("FROM", "labels: marked with `phdtrack label`; unattended: not checked.")] = "labels",
    first: Annotated[int, option("N", "Learn from this frame on.", min=1)] = 1,
    last: Annotated[int, option("N", "Learn up to this frame; 0: all.", min=0)] = 0,
    out: Annotated[Path | None, option("FILE", "Where to write the scene; default: SOURCE.scene.json.")] = None,
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
    file, by_hand = labels or labels_file(source), clutter == "labels" or births == "hand"
    if labels is not None and by_hand and not labels.exists():
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
    if by_hand and file.exists():
        marks = Marks(LabelStore.open(file, found.name, found.digest, []), found.table, found.info, stretch)
    data = TrainingData(found, stretch, build(settings, found.info), seed, file, marks)
    scene, born, alarms = data.train(births, clutter, output)
    write_scene(target, scene)
    frames = open_source(source.source, fps=source.fps) if source.source else ()
    picture = next((frame.image for frame in frames), NO_PICTURE)
    page = target.with_name(target.name.removesuffix(".json") + ".html")
    use = f"phdtrack track {source.source or f'--detections {source.detections}'} --scene {target}"
    words = {"title": "Learned scene", "command": use}
    write_text(page, render("scene.html", scene=scene, births=born, alarms=alarms, image=picture, **words))
    output.say(f"{target}, with its maps in {page}; use it: {use}")
    output.document(
        {
            "scene": str(target),
            "report": str(page),
            "gain": {"births": born.gain, "clutter": alarms.gain},
            "births": births,
            "clutter": clutter,
            "followed": scene.followed and scene.followed.share,
        }
    )


class Lesson(NamedTuple):
    """What was learned of births or of false alarms, None for nothing, and its ``gain`` in nats per unseen sample above the
    uniform density, NaN where that is not known; what is said of it; ``source``, where it comes from, in words."""

    learned: LearnedDensity | None
    gain: float
    sentence: str
    source: str = ""


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
        if clutter == "unattended":
            alarms, marked = self._lesson("false alarms", self._unattended_clutter, LIMITS), None
        else:
            alarms = self._lesson("false alarms", self._marked_clutter)
            marked = alarms.learned
        output.say(alarms.sentence)
        tracks, followed = Tracks.empty(), None
        if births == "tracks" or marked is not None:
            tracks = self._tracked(alarms.learned).tracks
        if marked is not None:
            tracks, followed, sentence = self._without_followed(marked, tracks)
            output.say(sentence)
        born = self._lesson("births", self._marked_births if births == "hand" else partial(self._births_of_tracks, tracks))
        output.say(born.sentence)
        info, source = self.found.info, self.found.name
        if born.learned is None and alarms.learned is None:
            raise InputError("nothing could be learned", where=source, cure="Mark false detections, or learn longer")
        gains = {"births gain": born.gain, "clutter gain": alarms.gain}
        notes: dict[str, float | int | str] = {name: value for name, value in gains.items() if math.isfinite(value)}
        notes |= {"births from": births, "clutter from": clutter, "first": self.stretch.start, "last": self.stretch.stop - 1}
        rate = self.stages.model.rate
        scene = Scene(info.width, info.height, rate, source, born.learned, alarms.learned, notes, followed)
        return scene, born, alarms

    def _lesson(self, part: str, learn: Callable[[], tuple[Training, str]], limits: str = "") -> Lesson:
        """What ``learn`` gives, with what it says of it and its gain on unseen samples; why nothing, where it fails."""
        try:
            training, text = learn()
            learned = self._with_prior(training.learned)
        except InputError as error:
            return Lesson(None, math.nan, f"{part} stay as shipped: {error}")
        gain = "too few samples to measure the gain"
        if math.isfinite(training.gain):
            gain = f"samples not learned from are {training.gain:+.2f} nats likelier than under a uniform density"
        sentence = f"{part}: {text}; {gain}"
        return Lesson(learned, training.gain, f"{sentence}. {limits}" if limits else sentence, f"{text}. {limits}".strip())

    def _marked_clutter(self) -> tuple[Training, str]:
        """False alarms from marks [M09 §IV]."""
        marks = self._marks(_ONLY_BOXES)
        frames = len(marks.looked_at)
        training = learn_boxes(marks.false_boxes, frames, self._size, FALSE_BOXES)
        return training, f"{counted(training.learned.samples, 'box')} marked by a person on {counted(frames, 'frame')}"

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
        reasons, places = Counter(one.reason for one in taken), {one.place for one in taken if one.place >= 0}
        why = []
        if reasons["place"]:
            why.append(f"{reasons['place']} at {counted(len(places), 'place')} that fire too often")
        if reasons["rejected"]:
            why.append(f"{reasons['rejected']} that the filter rejected")
        many = f"{counted(training.learned.samples, 'box')} of {counted(len(frames), 'frame')}"
        return training, f"{many} taken for false ({', '.join(why)})"

    def _without_followed(self, alarms: LearnedDensity, tracks: Tracks) -> tuple[Tracks, TrackedObjects | None, str]:
        """The tracks of a run that knew the marked false alarms, but for those that stay among them; which of the false
        alarms it followed all the same, None where that is not known; and a sentence about it."""
        marks = self._marks(_ONLY_BOXES)
        try:
            training = learn_boxes(marks.object_boxes, len(marks.looked_at), self._size, OBJECT_BOXES)
            followed = TrackedObjects(marks.share_followed(tracks), self._with_prior(training.learned))
        except InputError as error:
            return tracks, None, f"no track is held back: {error}"
        text = f"the tracker follows {100 * followed.share:.2g} % of the false alarms although it knows them"
        kept = without_false_tracks(tracks, FalseAlarmRatio(alarms, followed))
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
        states = marks.birth_states(rate)
        text = f"{counted(states.shape[1], 'birth')} marked by a person on {counted(len(marks.watched), 'frame')}"
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

    def _tracked(self, alarms: LearnedDensity | None = None) -> Evidence:
        """What a tracker makes of the stretch that knows these false alarms."""
        stages = self.stages
        if alarms is not None:
            # Jmax is of learned births, and there are none yet.
            stages = replace(stages, model=with_scene(stages.model, None, alarms, None, particles=1))
        with progress("tracking", len(self.stretch)) as advance:
            return tracked(self.found.table, self.found.info.fps, stages, self.stretch, self.seed, advance)

    def _with_prior(self, learned: LearnedDensity) -> LearnedDensity:
        """What was learned, and a little of any size detected in the stretch; on the ground, without sizes, as it is."""
        if not self._of_boxes:
            return learned
        table = self.found.table
        rows = slice(*np.searchsorted(table.frame, [self.stretch.start, self.stretch.stop]))
        return with_prior(learned, to_cxcywh(table.detections.xyxy[rows])[2:])
