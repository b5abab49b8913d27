"""The scenes that M09's experiment learns: rendered and real ones, their first half to learn, the second to test."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from experiments.common import Case, Kept, mot15, need_data
from phdtrack.detect import make_detector
from phdtrack.simulate import build_scene, default_detector, default_look, render
from phdtrack.simulate.scenes import NAMED
from phdtrack.types import F8, Detections, DetectionTable, Frame, Image, SequenceInfo, Truth
from phdtrack.video import open_source

RENDERED = ("yard", "garden", "arcade")
PETS = "PETS09-S2L1"
REAL = (f"{PETS} change", f"{PETS} frcnn", f"{PETS} public")
# Nothing was chosen on these.
HELD_OUT = ("ADL-Rundle-6 frcnn", "KITTI-17 frcnn", "KITTI-17 public")
FRAMES, SHORT = 20_000, 1_500
# How far from a place where people enter an object begins that counts as entering there: mean body widths.
_ENTRY_MARGIN = 1.0
SEED = 1
# The frame that pictures show, and how many the detector is timed on.
SHOWN, LOOKS = 100, 200


@dataclass(frozen=True, slots=True)
class Footage:
    """A scene by its name, of how many frames (0: all there are), and the folder that keeps what was detected in it."""

    name: str
    frames: int = 0
    folder: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Halves:
    """A scene to learn from and to test on; ``entries`` (n, 4): boxes around the places where people enter."""

    train: Case
    test: Case
    entries: F8


def halves(footage: Footage) -> Halves:
    """What was detected in a scene, parted in the middle."""
    return _halves(footage.name, footage.frames, footage.folder)


@lru_cache(maxsize=4)
def _halves(name: str, frames: int, folder: str) -> Halves:
    if name in RENDERED:
        job = (name, frames)
        case, entries = Kept(rendered, Path(folder))(job) if folder else rendered(job)
    else:
        case, entries = filmed(name, folder)
    middle = case.info.frames // 2
    return Halves(stretch(case, 1, middle), stretch(case, middle + 1, case.info.frames), entries)


def rendered(job: tuple[str, int]) -> tuple[Case, F8]:
    """A named scene of so many frames, painted frame by frame, and what the change detector finds; the entries."""
    name, frames = job
    world = replace(NAMED[name], frames=frames)
    scene = build_scene(world, SEED, default_detector(world))
    table = detected(render(scene, np.random.default_rng(SEED), default_look(name)))
    width, height = float(scene.info.width), float(scene.info.height)
    margin = _ENTRY_MARGIN * float((scene.truth.xyxy[:, 2] - scene.truth.xyxy[:, 0]).mean())
    sides = np.array([[-np.inf, 0, margin, height], [width - margin, 0, np.inf, height]])
    doors = scene.doors + np.array([-margin, -margin, margin, margin])
    return Case(name, scene.info, scene.truth, table), np.concatenate([sides, doors])


def filmed(name: str, folder: str) -> tuple[Case, F8]:
    """A real sequence with its ``public`` or ``frcnn`` detections, or with those of the change detector on the video."""
    sequence, _, kind = name.rpartition(" ")
    case = replace(mot15(sequence, "frcnn" if kind == "change" else kind), name=name)
    if kind == "change":
        table = Kept(detected_in, Path(folder))(sequence) if folder else detected_in(sequence)
        case = replace(case, table=table)
    return case, border(case.info, case.truth)


def detected_in(sequence: str) -> DetectionTable:
    """What the change detector finds in the video of a MOT15 sequence."""
    return detected(open_source(video_of(sequence)))


def detected(frames: Iterable[Frame]) -> DetectionTable:
    """What the change detector, as shipped, finds in these frames."""
    detector = make_detector("change")
    found = [(frame.number, detector(frame)) for frame in frames]
    number = np.repeat([n for n, _ in found], [len(boxes) for _, boxes in found])
    parts = (np.concatenate([getattr(one, key) for _, one in found]) for key in ("xyxy", "confidence"))
    return DetectionTable(number, Detections.of(*parts))


def border(info: SequenceInfo, truth: Truth) -> F8:
    """(4, 4) the strips along the frame's borders in which a box's centre lies when somebody of usual size comes in."""
    size = truth.xyxy[~truth.distractor]
    across = _ENTRY_MARGIN * float((size[:, 2] - size[:, 0]).mean())
    down = _ENTRY_MARGIN * float((size[:, 3] - size[:, 1]).mean())
    width, height, far = float(info.width), float(info.height), np.inf
    return np.array(
        [
            [-far, -far, across, far],
            [width - across, -far, far, far],
            [-far, -far, far, down],
            [-far, height - down, far, far],
        ]
    )


def stretch(case: Case, first: int, last: int) -> Case:
    """The frames ``first`` … ``last`` of a case, numbered from 1."""
    truth, table = case.truth, case.table
    rows = np.flatnonzero((truth.frame >= first) & (truth.frame <= last))
    seen = np.arange(*np.searchsorted(table.frame, [first, last + 1]))
    return Case(
        case.name,
        replace(case.info, frames=last - first + 1),
        Truth(truth.frame[rows] - first + 1, truth.identity[rows], truth.xyxy[rows], truth.distractor[rows]),
        DetectionTable(table.frame[seen] - first + 1, table.detections.take(seen)),
    )


def picture(footage: Footage) -> Image:
    """(H, W, 3) a frame of a rendered scene, BGR."""
    return next(frame.image for frame in frames_of(footage) if frame.number == SHOWN)


def looking(footage: Footage) -> float:
    """Median seconds that the change detector takes for a frame of a scene that it sees, over the first of them."""
    detector, seconds = make_detector("change"), []
    for frame in itertools.islice(frames_of(footage), LOOKS):
        began = time.perf_counter()
        detector(frame)
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))


def frames_of(footage: Footage) -> Iterable[Frame]:
    """The pictures of a rendered scene, or of a real sequence's video."""
    if footage.name not in RENDERED:
        return open_source(video_of(footage.name.rpartition(" ")[0]))
    world = replace(NAMED[footage.name], frames=footage.frames)
    scene = build_scene(world, SEED, default_detector(world))
    return render(scene, np.random.default_rng(SEED), default_look(footage.name))


def video_of(sequence: str) -> Path:
    """The video of a MOT15 sequence."""
    return need_data() / "mot15" / sequence / f"{sequence}.mp4"
