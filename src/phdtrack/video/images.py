"""Folders and glob patterns of images as a source of frames.

Files are put in natural order (``img2`` before ``img10``). The last number in each name says which frame it is, counted
from the first file as frame 1 in steps of the names' common divisor: a file missing from ``000001.jpg 000002.jpg
000004.jpg`` is a dropped frame, and the time between frames 2 and 4 is two intervals. Names without numbers, names whose
numbers do not increase, and names in which more than nine frames in ten would be missing (time stamps) are only counted.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import Frame, Image, SequenceInfo
from phdtrack.video.source import check_size

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
