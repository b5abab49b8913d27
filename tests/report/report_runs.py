"""Hand-made runs for the tests of the report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.kernels.appearance import UNKNOWN
from phdtrack.report import About, Recorder, RunRecord
from phdtrack.report.appearance_worth import BINS, AppearanceWorth, Returned
from phdtrack.types import (
    Detections,
    Estimates,
    Frame,
    SequenceInfo,
    Step,
    Tracks,
    Truth,
    UpdateInfo,
)

WIDE = 160
HIGH = 120
# No pairs, and an identity that was given back.
NONE = np.zeros(BINS, np.int64)
BACK = Returned(4, 30, 80, 12.4, 5.0)


def step(
    number: int, boxes: np.ndarray, clutter: float = 0.25, cardinality: tuple[float, ...] = ()
) -> Step:
    """A step with a detection and an estimate at each of the boxes (n, 4), each detection clutter
    with this probability.
    """
    n = len(boxes)
    held = np.array(cardinality, dtype=np.float64)
    info = UpdateInfo(
        float(n),
        0.1,
        n * (1 - clutter),
        np.full(n, 1 - clutter),
        np.full(n, clutter),
        np.full(n, clutter),
        cardinality=held,
    )
    estimates = Estimates(np.zeros((6, n)), np.zeros((n, 6, 6)), np.ones(n), boxes, np.arange(n))
    return Step(
        number,
        number / 10,
        Detections.of(boxes),
        info,
        estimates,
        Tracks.empty(),
        (0.004, 0.002, 0.001),
    )


def tracks_of(boxes_by_frame: dict[int, np.ndarray]) -> Tracks:
    """Identity k + 1 for row k of each frame; every third frame predicted."""
    parts = [
        Tracks(
            np.full(len(boxes), number),
            np.arange(1, len(boxes) + 1),
            boxes,
            np.ones(len(boxes)),
            np.full(len(boxes), -1 if number % 3 == 0 else 0),
            np.ones(len(boxes), np.bool_),
        )
        for number, boxes in boxes_by_frame.items()
    ]
    return Tracks.concatenate(parts)


def walkers(frames: int, objects: int, info: SequenceInfo) -> dict[int, np.ndarray]:
    """Boxes that cross the frame."""
    size = np.array([info.width, info.height]) / 8
    out = {}
    for number in range(1, frames + 1):
        share = number / (frames + 1)
        centre = np.stack(
            [np.full(objects, share), (np.arange(objects) + 1) / (objects + 1)], axis=1
        )
        centre = centre * (info.width, info.height)
        out[number] = np.concatenate([centre - size / 2, centre + size / 2], axis=1)
    return out


def run_record(
    frames: int = 12,
    objects: int = 2,
    *,
    about: About | None = None,
    info: SequenceInfo | None = None,
    video: bool = True,
    truth: bool = True,
    cardinality: tuple[float, ...] = (),
) -> RunRecord:
    """A run of ``objects`` walkers over a noisy picture."""
    info = info or SequenceInfo(WIDE, HIGH, 10.0, frames, "walk")
    rng = np.random.default_rng(3)
    picture = rng.integers(0, 255, (info.height, info.width, 3), dtype=np.uint8)
    boxes = walkers(frames, objects, info)
    tracks = tracks_of(boxes)
    annotated = (
        Truth(tracks.frame, tracks.identity, tracks.xyxy, np.zeros(len(tracks), np.bool_))
        if truth
        else None
    )
    recorder = Recorder(info, annotated)
    for number, here in boxes.items():
        recorder.add(
            Frame(number, 0.0, picture) if video else None,
            step(number, here, cardinality=cardinality),
            0.003,
        )
    return recorder.record(
        tracks, about or About(title="Walk", command="phdtrack track walk.mp4", seed=4)
    )


def worth(**changes) -> AppearanceWorth:
    """Some worth: 200 pairs of one object, of which 150 are more alike than 400 of two."""
    same = NONE.copy()
    other = NONE.copy()
    same[[60, 80]] = 50, 150
    other[[60, 40]] = 100, 300
    law = UNKNOWN._replace(weight=0.4, same=0.6, same_deviation=0.1, other_deviation=0.2)
    made = AppearanceWorth(same, other, 2.0, 1.5, -0.7, 900, 300, law, unused=False)
    return replace(made, **changes)
