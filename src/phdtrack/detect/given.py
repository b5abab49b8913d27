"""Detections that come from elsewhere: a table read from a file, or any function of the picture."""

from __future__ import annotations

from collections.abc import Callable

from phdtrack.detect.convert import as_detections, check_inside
from phdtrack.types import Detections, DetectionTable, Frame, Image


class TableDetector:
    """The rows of ``table`` by frame number; frames without rows are empty. The picture is not looked at."""

    def __init__(self, table: DetectionTable) -> None:
        self._table = table

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """The detections of frame ``frame.number``."""
        return self._table.at(frame.number)


class CallableDetector:
    """Any function of a BGR picture (H, W, 3) uint8 that gives boxes in one of the forms that `as_detections` takes.

    Boxes wholly outside the frame are an error that names it, or are left out with ``drop_outside``. A function that
    remembers earlier pictures is not reset: give a new detector for a new video.
    """

    def __init__(self, function: Callable[[Image], object], *, drop_outside: bool = False) -> None:
        self._function = function
        self._drop = drop_outside

    def reset(self) -> None:
        """Nothing to forget here."""

    def __call__(self, frame: Frame) -> Detections:
        """What the function finds in ``frame``, checked."""
        where = f"frame {frame.number}"
        found = as_detections(self._function(frame.image), where=where)
        height, width = frame.image.shape[:2]
        return check_inside(found, width, height, where=where, drop=self._drop)
