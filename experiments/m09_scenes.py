"""The scenes of M09's experiment, rendered and real: one half for training, the other for
testing.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from experiments.cases import annotated
from experiments.common import Case, detections_in, mot15, need_data
from phdtrack.detect import make_detector
from phdtrack.simulate import NAMED, Rendered, Scene, default_detector, default_look, make_scene
from phdtrack.types import F8, DetectionTable, Frame, Image, SequenceInfo, Truth
from phdtrack.video import open_source

RENDERED = ("yard", "garden", "arcade")
PETS = "PETS09-S2L1"
REAL = (f"{PETS} change", f"{PETS} frcnn", f"{PETS} public")
# The learning was not tuned on these. The filter's own values were chosen on MOT15, including
# ADL-Rundle-6.
HELD_OUT = ("ADL-Rundle-6 frcnn", "KITTI-17 frcnn", "KITTI-17 public")
# M09's own experiment has one more, without detections of others.
INDOOR = "OneLeaveShop1cor change"
FRAMES = 20_000
SHORT = 600
# Largest distance of an object's first detection to an entrance at which it counts as entering
# there, in mean body widths.
_ENTRY_MARGIN = 1.0
SEED = 1
# The frame in the pictures, and the number of frames for timing the detector.
SHOWN = 100
LOOKS = 200


@dataclass(frozen=True, slots=True, eq=False)
class Halves:
    """A scene to learn from and to test on; ``entries`` (n, 4): boxes around the places where
    people enter.
    """

    name: str
    train: Case
    test: Case
    entries: F8

    @property
    def frames(self) -> int:
        """The number of frames of both halves."""
        return self.train.info.frames + self.test.info.frames

    def tested_on(self, seed: int, seeds: int) -> Halves:
        """The scene with the frames of the second half that a seed (from 1) is tested on: its share
        of a rendered scene, all frames of a real one.
        """
        if self.name not in RENDERED or seeds == 1:
            return self
        edges = np.linspace(0, self.test.info.frames, seeds + 1).astype(np.int64).tolist()
        return replace(self, test=stretch(self.test, edges[seed - 1] + 1, edges[seed]))


def halves(job: tuple[str, int]) -> Halves:
    """The detections of the scene of that name, split in the middle; for rendered scenes the given
    number of frames.
    """
    name, frames = job
    case, entries = rendered(name, frames) if name in RENDERED else filmed(name)
    middle = case.info.frames // 2
    return Halves(
        name, stretch(case, 1, middle), stretch(case, middle + 1, case.info.frames), entries
    )


def simulated(name: str, frames: int) -> Scene:
    """A named scene with this number of frames."""
    world = replace(NAMED[name], frames=frames)
    return make_scene(world, SEED, default_detector(world))


def rendered(name: str, frames: int) -> tuple[Case, F8]:
    """A named scene, rendered frame by frame, with the detections of the change detector, and its
    entries.
    """
    scene = simulated(name, frames)
    width = float(scene.info.width)
    height = float(scene.info.height)
    margin = _ENTRY_MARGIN * float((scene.truth.xyxy[:, 2] - scene.truth.xyxy[:, 0]).mean())
    sides = np.array([[-np.inf, 0, margin, height], [width - margin, 0, np.inf, height]])
    doors = scene.doors + np.array([-margin, -margin, margin, margin])
    table = detections_in(frames_of(name, frames))
    return Case(name, scene.info, scene.truth, table), np.concatenate([sides, doors])


def filmed(name: str) -> tuple[Case, F8]:
    """A real sequence with its ``public`` or ``frcnn`` detections, or with those of the change
    detector on the video.
    """
    if name == INDOOR:
        info, truth = annotated(name.partition(" ")[0])
        case = Case(name, info, truth, detections_in(frames_of(name, 0)))
        return case, border(case.info, case.truth)
    sequence, _, kind = name.rpartition(" ")
    case = replace(mot15(sequence, "frcnn" if kind == "change" else kind), name=name)
    if kind == "change":
        case = replace(case, table=detections_in(frames_of(name, 0)))
    return case, border(case.info, case.truth)


def border(info: SequenceInfo, truth: Truth) -> F8:
    """(4, 4) strips along the frame's borders that contain the box's centre when a person of usual
    size enters.
    """
    size = truth.xyxy[~truth.distractor]
    across = _ENTRY_MARGIN * float((size[:, 2] - size[:, 0]).mean())
    down = _ENTRY_MARGIN * float((size[:, 3] - size[:, 1]).mean())
    width = float(info.width)
    height = float(info.height)
    far = np.inf
    sides = [[-far, -far, across, far], [width - across, -far, far, far]]
    return np.array([*sides, [-far, -far, far, down], [-far, height - down, far, far]])


def stretch(case: Case, first: int, last: int) -> Case:
    """The frames ``first`` … ``last`` of a case, numbered from 1."""
    truth = case.truth
    table = case.table
    rows = np.flatnonzero((truth.frame >= first) & (truth.frame <= last))
    seen = np.arange(*np.searchsorted(table.frame, [first, last + 1]))
    return Case(
        case.name,
        replace(case.info, frames=last - first + 1),
        Truth(
            truth.frame[rows] - first + 1,
            truth.identity[rows],
            truth.xyxy[rows],
            truth.distractor[rows],
        ),
        DetectionTable(table.frame[seen] - first + 1, table.detections.select(seen)),
    )


def picture(scene: Halves) -> Image:
    """(H, W, 3) a frame of a rendered scene, BGR."""
    return next(
        frame.image for frame in frames_of(scene.name, scene.frames) if frame.number == SHOWN
    )


def detector_seconds(scene: Halves) -> float:
    """Median seconds of the change detector per frame of a scene, over its first frames."""
    detector = make_detector("change")
    seconds = []
    for frame in itertools.islice(frames_of(scene.name, scene.frames), LOOKS):
        began = time.perf_counter()
        detector(frame)
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))


def frames_of(name: str, frames: int) -> Iterable[Frame]:
    """The pictures of a rendered scene, or of a real sequence's video."""
    if name in RENDERED:
        return Rendered(simulated(name, frames), np.random.default_rng(SEED), default_look(name))
    sequence = name.rpartition(" ")[0]
    if name == INDOOR:
        return open_source(Path(need_data(), "caviar", f"{sequence}.mpg"))
    return open_source(Path(need_data(), "mot15", sequence, f"{sequence}.mp4"))
