"""The one loop: a frame's way through detector and tracker to whoever observes it.

`track`, `count`, `groups`, `batch`, `compare`, `live`, `label` and `learn` all go through
`track_frame`, and so the same detections and settings give the same tracks.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from phdtrack.clock import Clock, as_clock
from phdtrack.detect.base import Describer, Detector, described, detect_all, pose_of
from phdtrack.pipeline import TrackingState
from phdtrack.run.camera_motion import Mover
from phdtrack.tracker import Tracker, uninterrupted
from phdtrack.types import F8, STILL, Detections, DetectionTable, Frame, Image, Step, Tracks

NO_PICTURE: Image = np.zeros((0, 0, 3), np.uint8)


class DetectedFrame(NamedTuple):
    """A frame and its detections.

    Attributes
    ----------
    frame, detections : the frame, and everything that was detected in it.
    warp : (3, 3) from the pixels of the last frame to those of this one, or `types.STILL`.
    seconds : time that detecting and describing took.
    pose : (3, 3) from the pixels of the scene to those of this frame, or `types.STILL`.
    """

    frame: Frame
    detections: Detections
    warp: F8 = STILL
    seconds: float = 0.0
    pose: F8 = STILL


class TrackedFrame(NamedTuple):
    """A frame behind the tracker.

    Attributes
    ----------
    detected : the frame and its detections.
    step : what the tracker made of it.
    rows : online rows that are final now; their ``detection`` counts in ``detected``.
    state : of the tracker, after this frame.
    """

    detected: DetectedFrame
    step: Step
    rows: Tracks
    state: TrackingState


class FrameObserver(Protocol):
    """Takes in every frame behind the tracker."""

    def take(self, tracked: TrackedFrame) -> None:
        """Take in a frame."""
        ...


def detect_frames(
    detector: Detector,
    frames: Iterable[Frame],
    mover: Mover | None = None,
    describer: Describer | None = None,
) -> Iterator[DetectedFrame]:
    """Detect objects in each frame, describe them, and measure the camera's motion.

    Parameters
    ----------
    detector, frames : the detector, and the frames.
    mover : the camera's motion; None for a camera that stands still.
    describer : describes the appearance of the boxes; None if it is not used.
    """
    for frame, found, seconds in detect_all(detector, frames):
        clock = time.perf_counter()
        detections = described(found, frame, describer)
        seconds += time.perf_counter() - clock
        pose = pose_of(detector, frame)
        warp = STILL
        if mover is not None:
            warp = mover(frame, detections, pose)
        yield DetectedFrame(frame, detections, warp, seconds, pose)


def table_frames(
    table: DetectionTable, numbers: Iterable[int], fps: float | Clock
) -> Iterator[DetectedFrame]:
    """The frames of a table of detections, without pictures.

    Parameters
    ----------
    table : the detections.
    numbers, fps : numbers of the frames, and frames per second or their times.
    """
    clock = as_clock(fps)
    for number in numbers:
        yield DetectedFrame(Frame(number, clock.time(number), NO_PICTURE), table.at(number))


def track_frame(tracker: Tracker, detected: DetectedFrame) -> TrackedFrame:
    """Give a frame to the tracker, which limits its detections and separates their classes.

    Parameters
    ----------
    tracker : what is carried from frame to frame.
    detected : a frame and its detections.

    Returns
    -------
    What the frame brought.
    """
    frame = detected.frame
    warp = detected.warp if len(detected.warp) else None
    rows = tracker.update(detected.detections, frame.number, frame.time, warp)
    step = tracker.step
    assert step is not None
    return TrackedFrame(detected, step, rows, tracker.state)


def track_frames(
    tracker: Tracker, frames: Iterable[DetectedFrame], observers: Sequence[FrameObserver]
) -> None:
    """Give all frames to the tracker, and the tracked frames to the observers.

    Ctrl-C is raised between two frames: every observer has taken in the same frames. (And Numba
    does not survive Ctrl-C while it makes Python objects.)

    Parameters
    ----------
    tracker, frames : the tracker, and frames with their detections.
    observers : take in every frame, in this order.
    """
    for detected in frames:
        with uninterrupted():
            tracked = track_frame(tracker, detected)
            for observer in observers:
                observer.take(tracked)
