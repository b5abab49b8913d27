"""From what a user writes ("street.mp4", "frames/", "img/*.png", "0", "rtsp://…") to a source of frames.

The files of a folder or a glob pattern of images are put in natural order (``img2`` before ``img10``). The last number in
each name says which frame it is, counted from the first file as frame 1 in steps of the names' common divisor: a file
missing from ``000001.jpg 000002.jpg 000004.jpg`` is a dropped frame, and the time between frames 2 and 4 is two intervals.
Names without numbers, names whose numbers do not increase, and names in which more than nine frames in ten would be missing
(time stamps) are only counted.
"""

from __future__ import annotations

import difflib
import glob
import math
import re
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import Frame, Image, SequenceInfo
from phdtrack.video.stream import Clock, Recording, VideoSource, assumed_rate, video_file

SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"})
_MOST_MISSING = 10


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
    if path.is_dir():
        return _images([file for file in path.iterdir() if file.suffix.lower() in SUFFIXES], fps, path)
    if "://" in text or path.exists():
        return video_file(text, fps)
    if text.isdecimal():
        return _camera(int(text), fps)
    if set(text) & set("*?["):
        files = [Path(name) for name in glob.glob(text, recursive=True) if Path(name).is_file()]
        if not files:
            raise InputError("no file matches this pattern", where=text, cure="Check the folder and the pattern.")
        return _images(files, fps, files[0].parent)
    cure = f"The folder {path.parent} does not exist either."
    if path.parent.is_dir():
        close = difflib.get_close_matches(path.name, [file.name for file in path.parent.iterdir()], n=1)
        cure = f"Did you mean {path.parent / close[0]}?" if close else "Check the spelling."
    raise InputError("there is no such file or folder", where=text, cure=cure)


def _images(files: Sequence[Path], fps: float, folder: Path) -> Recording:
    """Images as frames. MOTChallenge puts those of every sequence into ``NAME/img1``, which is called NAME."""
    folder = folder.resolve()
    name = folder.parent.name if folder.name == "img1" else folder.name
    if not files:
        raise InputError("there is no image", where=name, cure=f"Files that end in {', '.join(sorted(SUFFIXES))} are read.")
    paths = sorted(files, key=lambda path: natural_key(path.name))
    numbers = frame_numbers([path.stem for path in paths])
    rate, note = assumed_rate(fps, "images do")
    height, width = _image(paths[0]).shape[:2]

    def read(_: Recording) -> Iterator[tuple[Frame, str]]:
        for path, number in zip(paths, numbers, strict=True):
            yield Frame(number, (number - 1) / rate, _image(path)), f"{path}, frame {number}"

    return Recording(SequenceInfo(width, height, rate, len(paths), name), read, note)


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
    stride = math.gcd(*steps)
    relative = [(number - numbers[0]) // stride + 1 for number in numbers]
    return relative if relative[-1] <= _MOST_MISSING * len(stems) else counted


def _image(path: Path) -> Image:
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


def _camera(index: int, fps: float) -> Recording:
    """Frames of camera ``index`` (from 0), until it stops or the caller does.

    A frame's time is when it arrived: a camera delivers no time stamps that mean the same on every system.
    """
    import cv2

    capture = cv2.VideoCapture(index)
    if not capture.isOpened():
        raise InputError(
            f"camera {index} cannot be opened",
            cure="Check that it is connected, that no other program uses it, and that this user may read it.",
        )
    if fps:
        capture.set(cv2.CAP_PROP_FPS, fps)
    width, height = (round(capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    rate, note = assumed_rate(fps or capture.get(cv2.CAP_PROP_FPS), f"camera {index} does")

    def read(made: Recording) -> Iterator[tuple[Frame, str]]:
        clock, number = Clock(1.0 / rate), 0
        try:
            while True:
                ok, image = capture.read()
                arrived = time.monotonic()
                if not ok:
                    made.problem = f"camera {index}: no more pictures after frame {number}"
                    return
                number += 1
                frame = Frame(number, clock(arrived), np.asarray(image, np.uint8))
                yield frame, f"camera {index}, frame {number}"
        finally:
            capture.release()

    return Recording(SequenceInfo(width, height, rate, 0, f"camera{index}"), read, note)
