"""Folders and glob patterns of images as a source of frames.

Files are put in natural order (``img2`` before ``img10``). The last number in each name says which frame it is, counted
from the first file as frame 1 in steps of the names' common divisor: a file missing from ``000001.jpg 000002.jpg
000004.jpg`` is a dropped frame, and the time between frames 2 and 4 is two intervals. Names without numbers, names whose
numbers do not increase, and names in which more than nine frames in ten would be missing (time stamps) are only counted.

A camera on this machine, through OpenCV, with times by the machine's monotonic clock.

From what a user writes ("street.mp4", "frames/", "img/*.png", "0", "rtsp://…") to a source of frames.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import Frame, Image, SequenceInfo
from phdtrack.video.stream import Clock, VideoFile, VideoSource, check_size

SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"})
DEFAULT_FPS = 25.0
_MOST_MISSING = 10


class ImageSequence:
    """Images as frames.

    Parameters
    ----------
    paths : the files, in any order; at least one.
    fps : frames per second; 0 assumes 25 and says so in `note`.
    name : of the sequence; by default that of the folder.

    Raises InputError where there is no file or the first is not an image; during iteration for a file that cannot be
    read and for one of another size.
    """

    def __init__(self, paths: Sequence[Path], *, fps: float = 0.0, name: str = "") -> None:
        if not paths:
            raise InputError(
                "there is no image", where=name, cure=f"Files that end in {', '.join(sorted(SUFFIXES))} are read."
            )
        self._paths = sorted(paths, key=lambda path: natural_key(path.name))
        self._numbers = frame_numbers([path.stem for path in self._paths])
        self._fps = fps or DEFAULT_FPS
        self._note = "" if fps else f"images do not state their rate; {DEFAULT_FPS:g} frames a second assumed"
        first = read_image(self._paths[0])
        folder = self._paths[0].resolve().parent
        self._info = SequenceInfo(first.shape[1], first.shape[0], self._fps, len(paths), name or folder.name)

    @property
    def info(self) -> SequenceInfo:
        """Size in pixels, rate, name; ``frames`` is the number of files."""
        return self._info

    @property
    def note(self) -> str:
        """The assumed rate; empty where it was given."""
        return self._note

    @property
    def problem(self) -> str:
        """Always empty: an image that cannot be read is an error that names it."""
        return ""

    def __iter__(self) -> Iterator[Frame]:
        for path, number in zip(self._paths, self._numbers, strict=True):
            image = read_image(path)
            check_size(image, self._info.width, self._info.height, f"{path}, frame {number}")
            yield Frame(number, (number - 1) / self._fps, image)


def natural_key(text: str) -> list[tuple[int, int, str]]:
    """A sort key by which runs of digits compare as numbers."""
    return [(0, int(part), part) if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", text) if part]


def frame_numbers(stems: Sequence[str]) -> list[int]:
    """The frame number from 1 of each name, by the last number in it where these make sense, else by counting."""
    counted = list(range(1, len(stems) + 1))
    found = [re.findall(r"\d+", stem) for stem in stems]
    if len(stems) < 2 or not all(found):
        return counted
    numbers = [int(digits[-1]) for digits in found]
    steps = [after - before for before, after in pairwise(numbers)]
    if min(steps) <= 0:
        return counted
    stride = int(np.gcd.reduce(np.array(steps, dtype=object)))
    relative = [(number - numbers[0]) // stride + 1 for number in numbers]
    return relative if relative[-1] <= _MOST_MISSING * len(stems) else counted


def read_image(path: Path) -> Image:
    """(H, W, 3) BGR uint8; InputError naming the file where it is not an image."""
    import cv2

    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"this file cannot be read ({error.strerror})", where=path) from None
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if image is None:
        raise InputError("this is not an image that can be read", where=path, cure="Repair the file or take it away.")
    return np.asarray(image, np.uint8)


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


_PATTERN = frozenset("*?[")


def open_source(spec: str | Path | int, *, fps: float = 0.0) -> VideoSource:
    """The frames that ``spec`` names.

    Parameters
    ----------
    spec : a video file; a folder of images; a glob pattern of images; an address with ``://``; the index of a camera.
    fps : frames per second. Above 0 it replaces the time stamps of a video and is the rate of a folder of images; 0 takes
        the stream's own times, and 25 for images.

    Raises
    ------
    InputError : nothing there, nothing that can be decoded, or a rate that is not a positive number.
    """
    if not math.isfinite(fps) or fps < 0:
        raise InputError(f"the rate must be a number of frames per second above 0, not {fps}", where="fps")
    text = str(spec)
    path = Path(text)
    if "://" in text:
        return VideoFile(text, fps=fps)
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix.lower() in SUFFIXES]
        return ImageSequence(files, fps=fps, name=_folder_name(path))
    if path.exists():
        return VideoFile(path, fps=fps)
    if text.isdecimal():
        return Camera(int(text), fps=fps)
    if _PATTERN & set(text):
        files = [file for file in _glob(path) if file.is_file()]
        if not files:
            raise InputError("no file matches this pattern", where=text, cure="Check the folder and the pattern.")
        return ImageSequence(files, fps=fps, name=_folder_name(files[0].parent))
    raise InputError("there is no such file or folder", where=text, cure=_nearby(path))


def _folder_name(folder: Path) -> str:
    """The name that tells a folder from its sisters: MOTChallenge puts every sequence's images into ``NAME/img1``."""
    folder = folder.resolve()
    return folder.parent.name if folder.name == "img1" else folder.name


def _glob(path: Path) -> list[Path]:
    import glob

    return [Path(name) for name in glob.glob(str(path), recursive=True)]


def _nearby(path: Path) -> str:
    """Which existing file the user may have meant, or where the path breaks off."""
    import difflib

    folder = path.parent
    if not folder.is_dir():
        return f"The folder {folder} does not exist either."
    close = difflib.get_close_matches(path.name, [file.name for file in folder.iterdir()], n=1)
    return f"Did you mean {folder / close[0]}?" if close else "Check the spelling."
