"""Learning a scene from its first half, as in M09: false alarms from marks, births from tracks or
from marks.

The truth makes the marks: on 40 random frames each detection that overlaps no annotated box by 0.3
is marked as false; on every frame of the half the first detection of each person who enters is
marked as a birth. Marks go through the file of labels, like those of the labelling page.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from experiments.common import Case, followed, with_scene
from experiments.delays import first_output_delays
from experiments.m09_scenes import Halves
from phdtrack import config
from phdtrack.arrays import iou, to_cxcywh
from phdtrack.associate.rejection import FalseTrackRejection, without_false_tracks
from phdtrack.errors import InputError
from phdtrack.label import Label, LabelStore
from phdtrack.label.samples import REACH, Marks, shuffled
from phdtrack.models.scene import FalseAlarmRatio
from phdtrack.protocols import AnyStages
from phdtrack.scene import LearnedDensity, TrackedObjects
from phdtrack.scene.training import (
    FALSE_BOXES,
    OBJECT_BOXES,
    Training,
    births_in,
    learn_births,
    learn_boxes,
    with_prior,
)
from phdtrack.types import F8, I8, Tracks

MARKED = 40
# IoU with the annotated boxes below which a detection is false, and from which it is an object's.
OBJECT = 0.5
# As in the defaults: largest number of particles per detection, odds of a false alarm below which a
# track is confirmed at once, minimum rows of a track.
MOST = 500
SURE = 0.1
SHORTEST = 5


@dataclass(frozen=True, slots=True, eq=False)
class LearnedScene:
    """The learned densities; births from fewer than ten tracks or marks are None.

    ``seen``: the tracked false alarms and objects, None if too few. ``gains``: held-out nats above
    uniform, of clutter, births, and manual births; NaN if nothing was learned. ``entered``: number
    of people who entered in the first half.
    """

    clutter: LearnedDensity
    seen: TrackedObjects | None
    births: LearnedDensity | None
    hand: LearnedDensity | None
    gains: tuple[float, float, float]
    entered: int


def learn(job: tuple[Halves, int]) -> LearnedScene:
    """Learn everything that the runs of a scene need; the seed is that of the marked frames and the
    particles.
    """
    case = job[0].train
    seed = job[1]
    stages = config.build(config.load(preset="mot15"), case.info)
    rate = stages.model.rate
    with TemporaryDirectory() as folder:
        marks = Marks(
            marked_false(case, Path(folder) / "false.sqlite", seed), case.table, case.info
        )
        clutter = learned_alarms(case, marks)
        run = followed(with_learned(stages, None, clutter.learned, None), case, seed).corrected
        seen = learned_followed(run, case, marks)
        entries = Marks(marked_births(case, Path(folder) / "births.sqlite"), case.table, case.info)
        by_hand = entries.birth_states(rate)
        watched = entries.time_watched(rate)
    births = own_births(
        without_false_tracks(run, FalseAlarmRatio(clutter.learned, seen)) if seen else run,
        case,
        rate,
    )
    hand = as_lesson(by_hand, watched, case)
    gains = tuple(lesson.gain if lesson else np.nan for lesson in (clutter, births, hand))
    return LearnedScene(
        clutter.learned,
        seen,
        births.learned if births else None,
        hand.learned if hand else None,
        (gains[0], gains[1], gains[2]),
        by_hand.shape[1],
    )


def with_learned(
    stages: AnyStages,
    births: LearnedDensity | None,
    clutter: LearnedDensity | None,
    seen: TrackedObjects | None,
) -> AnyStages:
    """The stages with the learned densities of a scene; None: the defaults."""
    model = with_scene(stages.model, births, clutter, seen, MOST)
    if clutter is None or seen is None:
        return replace(stages, model=model)
    return replace(
        stages,
        model=model,
        associator=FalseTrackRejection(
            stages.associator, FalseAlarmRatio(clutter, seen, births), SURE, SHORTEST
        ),
    )


def own_births(tracks: Tracks, case: Case, rate: float) -> Training | None:
    """Births from the tracker's own tracks [M09 §IV]; None if there are too few."""
    return as_lesson(
        births_in(tracks, case.info.fps, rate), case.info.frames / case.info.fps * rate, case
    )


def learned_alarms(case: Case, marks: Marks) -> Training:
    """False alarms from marks."""
    return false_alarms(marks.false_boxes, len(marks.looked_at), case)


def false_alarms(boxes: F8, frames: int, case: Case) -> Training:
    """False alarms from boxes (4, n) marked on a number of frames."""
    return with_sizes(
        learn_boxes(boxes, frames, (float(case.info.width), float(case.info.height)), FALSE_BOXES),
        case,
    )


def learned_followed(tracks: Tracks, case: Case, marks: Marks) -> TrackedObjects | None:
    """The tracked false alarms and objects, from the marked and unmarked detections; None if too
    few are unmarked.
    """
    size = (float(case.info.width), float(case.info.height))
    frames = len(marks.looked_at)
    try:
        objects = learn_boxes(marks.object_boxes, frames, size, OBJECT_BOXES)
    except InputError:
        return None
    return TrackedObjects(marks.share_followed(tracks), with_sizes(objects, case).learned)


def as_lesson(states: F8, time_units: float, case: Case) -> Training | None:
    """Births from first states; None if there are too few."""
    try:
        lesson = learn_births(states, time_units, (float(case.info.width), float(case.info.height)))
    except InputError:
        return None
    return with_sizes(lesson, case)


def with_sizes(lesson: Training, case: Case) -> Training:
    """The samples with the shrinkage prior over the detected sizes."""
    return replace(
        lesson, learned=with_prior(lesson.learned, to_cxcywh(case.table.detections.xyxy)[2:])
    )


def marked_false(case: Case, path: Path, seed: int, count: int = MARKED) -> LabelStore:
    """Labels in which every detection without an object is marked as false, on ``count`` random
    frames.
    """
    store = LabelStore.open(path, case.name, "truth", shuffled(case.info.frames, seed)[:count])
    store.mark_false(case.table, case.truth)
    return store


def marked_births(case: Case, path: Path) -> LabelStore:
    """Labels in which the first detection of everybody is marked as a birth, on clips that cover
    all frames.
    """
    last = case.info.frames
    store = LabelStore.open(
        path, case.name, "truth", list(range(1 + REACH, last + REACH, 2 * REACH))
    )
    number, box = first_boxes(case)
    for frame, index in zip(number.tolist(), box.tolist(), strict=True):
        store.mark(frame, [Label(frame, index, "birth")])
    for frame, _ in store.frames():
        store.finish(frame)
    return store


def first_boxes(case: Case) -> tuple[I8, I8]:
    """(G,) frame and index of the first detection of each object that is ever detected."""
    found = first_output_delays(case.truth, Tracks.empty(), case.table, OBJECT)
    seen = found.detected > 0
    boxes = []
    for identity, frame in zip(
        found.identity[seen].tolist(), found.detected[seen].tolist(), strict=True
    ):
        own = case.truth.xyxy[(case.truth.frame == frame) & (case.truth.identity == identity)]
        boxes.append(int(np.argmax(iou(own, case.table.at(frame).xyxy)[0])))
    return found.detected[seen], np.array(boxes, np.int64)
