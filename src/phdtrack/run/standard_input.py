"""Detections from standard input, which may have no end, as frames and a detector."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import share_inside
from phdtrack.detect.base import Detector
from phdtrack.detect.table_detector import frames_up_to
from phdtrack.formats.stream import stream_detections
from phdtrack.report.pages import counted
from phdtrack.run.loop import NO_PICTURE
from phdtrack.types import Detections, Frame, Image, SequenceInfo
from phdtrack.video import VideoSource


@dataclass(frozen=True, slots=True)
class _WaitingDetections:
    """A detector that gives each frame's detections once."""

    by_frame: dict[int, Detections]

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """The detections of frame ``frame.number``."""
        return self.by_frame.pop(frame.number, Detections.empty())


def open_standard_input(size: tuple[int, int], fps: float) -> tuple[VideoSource, Detector]:
    """Frames without pictures up to the last row that was read, and a detector that knows the rows.

    Parameters
    ----------
    size : width and height of the frames in pixels.
    fps : frames per second.
    """
    width, height = size
    waiting = dict[int, Detections]()

    def read(source: VideoSource) -> Iterator[tuple[int, float, Image, str]]:
        last = 0
        dropped = 0
        for table in stream_detections(sys.stdin.buffer, "standard input"):
            inside = share_inside(table.detections.xyxy, width, height) > 0
            dropped += int((~inside).sum()) + table.empty
            if dropped:
                boxes = counted(dropped, "box", "boxes")
                source.problem = f"{boxes} without area or outside the frame dropped"
            for number in np.unique(table.frame).tolist():
                rows = np.flatnonzero(inside & (table.frame == number))
                waiting[number] = table.detections.select(rows)
                for frame in frames_up_to(number, last, fps):
                    yield frame, (frame - 1) / fps, NO_PICTURE, ""
                last = number

    info = SequenceInfo(width, height, fps, 0, "stdin")
    return VideoSource(info, read), _WaitingDetections(waiting)
