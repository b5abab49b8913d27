"""Detections from a table in place of a detector, and the frames that such a run visits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from phdtrack.types import Detections, DetectionTable, Frame, Real

# Seconds without detections after which further empty frames are skipped, and the bounds of this
# time in frames.
_MAX_EMPTY_TIME = 60.0
_MIN_EMPTY_FRAMES = 250
_MAX_EMPTY_FRAMES = 100_000


@dataclass(frozen=True)
class TableDetector:
    """Looks up the rows of ``table`` by frame number; frames without rows are empty. The picture is
    ignored.

    ``embeddings`` (M, D) have a row for each row of the table's file; None without any. They may
    be on disk.
    """

    table: DetectionTable
    embeddings: Real | None = None

    def reset(self) -> None:
        """Do nothing: the table stays."""

    def __call__(self, frame: Frame) -> Detections:
        """The detections of frame ``frame.number``."""
        found = self.table.at(frame.number)
        if self.embeddings is None:
            return found
        rows = self.table.file_row[self.table.places(frame.number)]
        return replace(found, embeddings=np.asarray(self.embeddings[rows], np.float32))


def frames_walked(table: DetectionTable, last: int, fps: float) -> Iterator[int]:
    """The numbers of the frames 1 … ``last`` that a tracker visits if there are detections but no
    video.

    After a minute (at least 250 frames) without a detection no target is left that another empty
    frame could change. The remaining frames up to the next detection are skipped as one interval,
    so that a gap of any length takes no time. The last frame counts as one with detections.

    Parameters
    ----------
    table : the detections.
    last : the last frame.
    fps : frames per second.

    Yields
    ------
    The numbers, ascending.
    """
    before = 0
    for number in chain(np.unique(table.frame[table.frame <= last]).tolist(), [last]):
        yield from frames_up_to(number, before, fps)
        before = number


def frames_up_to(number: int, before: int, fps: float) -> Iterator[int]:
    """The frames after ``before`` up to ``number`` that `frames_walked` yields if those between are
    empty.

    Parameters
    ----------
    number, before : two frames with detections, or 0 before the first.
    fps : frames per second.

    Yields
    ------
    The numbers, ascending.
    """
    longest = max(_MIN_EMPTY_FRAMES, int(min(_MAX_EMPTY_TIME * fps, _MAX_EMPTY_FRAMES)))
    yield from range(before + 1, min(before + longest, number - 1) + 1)
    if number > before:
        yield number
