"""A window of the desktop that shows annotated frames while they are tracked."""

from __future__ import annotations

import os
import re
import sys
from collections import deque
from collections.abc import Mapping

from phdtrack.errors import InputError
from phdtrack.opencv_package import cv2
from phdtrack.report import Annotator
from phdtrack.run.loop import TrackedFrame
from phdtrack.types import Image, SequenceInfo

_WHERE = "--display"
# Larger pictures are shown smaller at first; the user may drag the window.
_WIDTH = 1280
_END = (ord("q"), ord("Q"), 27)


def check_windows() -> None:
    """Raise `InputError` unless this OpenCV, on this machine, can show a window."""
    found = re.search(r"^\s*GUI:\s*(\S+)", cv2.getBuildInformation(), re.MULTILINE)
    if found is not None and found[1] == "NONE":
        raise InputError(
            "this OpenCV has no windows: it is a headless package",
            where=_WHERE,
            cure="python -m pip install --force-reinstall opencv-python",
        )
    # OpenCV would end the whole process.
    seen = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    if sys.platform.startswith("linux") and not seen:
        raise InputError(
            "there is no desktop: neither DISPLAY nor WAYLAND_DISPLAY is set",
            where=_WHERE,
            cure="Use ssh -X, or phdtrack live, whose page shows the picture in a browser.",
        )


class Window:
    """A window with a title. It opens with the first picture; if the user closes it, it stays
    closed.
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._open = False
        self._closed = False

    def show(self, image: Image) -> None:
        """Show a picture, (H, W, 3) BGR.

        Raises
        ------
        KeyboardInterrupt : the user has pressed Q or Esc in the window: as Ctrl-C.
        """
        if self._closed:
            return
        if not self._open:
            height, width = image.shape[:2]
            share = min(1.0, _WIDTH / width)
            cv2.namedWindow(self._title, cv2.WINDOW_NORMAL | cv2.WINDOW_KEEPRATIO)
            cv2.resizeWindow(self._title, round(share * width), round(share * height))
            self._open = True
        cv2.imshow(self._title, image)
        key = cv2.waitKey(1)
        if key >= 0 and key & 0xFF in _END:
            self.close()
            raise KeyboardInterrupt
        if cv2.getWindowProperty(self._title, cv2.WND_PROP_VISIBLE) < 1:
            self._closed = True

    def close(self) -> None:
        """Close it."""
        if self._open and not self._closed:
            cv2.destroyWindow(self._title)
        self._closed = True


class Viewer:
    """Shows the frames of a run, with the online rows, as soon as these are final.

    Parameters
    ----------
    window : shows them.
    info : size and rate of the frames.
    names : of the classes; None without classes.
    blur : ``boxes`` or ``faces`` to pixelate them; empty for nothing.
    delay : frames by which online rows lag.
    """

    def __init__(
        self,
        window: Window,
        info: SequenceInfo,
        names: Mapping[int, str] | None = None,
        blur: str = "",
        delay: int = 0,
    ) -> None:
        self._window = window
        self._annotate = Annotator(info, names=names, blur=blur, legend=True)
        self._delay = delay
        self._held = deque[TrackedFrame]()

    def take(self, tracked: TrackedFrame) -> None:
        """Show a frame. Raises `KeyboardInterrupt` as `Window.show` does."""
        self._held.append(tracked)
        if len(self._held) <= self._delay:
            return
        held = self._held.popleft()
        step = held.step
        image = held.detected.frame.image
        if not image.size:
            return
        picture = self._annotate(
            image,
            step.number,
            tracked.rows,
            step.detections,
            mass=step.info.mass,
            clutter_probability=step.info.clutter_probability,
            time=step.time,
        )
        self._window.show(picture)
