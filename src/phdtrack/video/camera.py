"""A camera on this machine, through OpenCV, with times by the machine's monotonic clock."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import Frame, SequenceInfo
from phdtrack.video.source import Clock, check_size

FALLBACK_FPS = 25.0


class Camera:
    """Frames of camera ``index`` (from 0), until it stops or the caller does.

    A frame's time is when it arrived: a camera delivers no time stamps that mean the same on every system.
    """

    def __init__(self, index: int, *, fps: float = 0.0) -> None:
        import cv2

        self._index = index
        self._problem = ""
        self._capture = cv2.VideoCapture(index)
        if not self._capture.isOpened():
            raise InputError(
                f"camera {index} cannot be opened",
                cure="Check that it is connected, that no other program uses it, and that this user may read it.",
            )
        if fps:
            self._capture.set(cv2.CAP_PROP_FPS, fps)
        width, height = (round(self._capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        rate = fps or self._capture.get(cv2.CAP_PROP_FPS)
        self._note = "" if rate > 0 else f"camera {index} does not state its rate; {FALLBACK_FPS:g} frames a second assumed"
        self._info = SequenceInfo(width, height, rate if rate > 0 else FALLBACK_FPS, 0, f"camera{index}")

    @property
    def info(self) -> SequenceInfo:
        """Size and rate that the camera states."""
        return self._info

    @property
    def note(self) -> str:
        """The assumed rate; empty where the camera states one."""
        return self._note

    @property
    def problem(self) -> str:
        """Why the camera stopped; empty while it runs."""
        return self._problem

    def __iter__(self) -> Iterator[Frame]:
        clock, number = Clock(1.0 / self._info.fps), 0
        try:
            while True:
                ok, image = self._capture.read()
                arrived = time.monotonic()
                if not ok:
                    self._problem = f"camera {self._index}: no more pictures after frame {number}"
                    return
                number += 1
                check_size(image, self._info.width, self._info.height, f"camera {self._index}, frame {number}")
                yield Frame(number, clock(arrived), np.asarray(image, np.uint8))
        finally:
            self._capture.release()
