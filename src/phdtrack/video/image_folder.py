"""A sequence of image files as a source of frames.

The files are put in natural order (``img2`` before ``img10``). The last number in each name is the
number of the frame, counted from the first file as frame 1 in steps of the names' common divisor: a
file missing from ``000001.jpg 000002.jpg 000004.jpg`` is a dropped frame, and the time between
frames 2 and 4 is two intervals. Files are simply counted if their names have no numbers, if the
numbers do not increase, or if more than nine in ten frames would be missing (time stamps).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import readable_name
from phdtrack.types import Frame, Image, SequenceInfo
from phdtrack.video.video_source import Read, VideoSource

SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"})
# Frames per file above which the numbers in the names are not those of frames.
_MAX_SPACING = 10
_DEFAULT_FPS = 25.0
_DIGITS = re.compile(r"\d+")


def image_source(files: Sequence[Path], fps: float, folder: Path) -> VideoSource:
    """Image files as frames.

    Parameters
    ----------
    files : at least one image. Raises `InputError` otherwise.
    fps : frames per second; 0: 25.
    folder : names the sequence. MOTChallenge puts images into ``NAME/img1``, which is called NAME.
    """
    folder = folder.resolve()
    name = readable_name(folder.parent.name if folder.name == "img1" else folder.name)
    if not files:
        raise InputError(
            "there is no image",
            where=name,
            cure=f"Files that end in {', '.join(sorted(SUFFIXES))} are read.",
        )
    # Padded with zeros, runs of digits compare as numbers.
    paths = sorted(
        files, key=lambda path: _DIGITS.sub(lambda digits: digits[0].zfill(30), path.name)
    )
    numbers = frame_numbers([path.stem for path in paths])
    rate, note = known_rate(fps, "images do")
    height, width = _image(paths[0]).shape[:2]

    def read(source: VideoSource) -> Iterator[Read]:
        for path, number in zip(paths, numbers, strict=True):
            if number >= source.first:
                yield number, (number - 1) / rate, _image(path), f"{path}, frame {number}"

    def sample(count: int) -> Iterator[Frame]:
        for k in np.unique(np.linspace(0, len(paths) - 1, count).round().astype(int)).tolist():
            yield Frame(numbers[k], (numbers[k] - 1) / rate, _image(paths[k]))

    info = SequenceInfo(width, height, rate, len(paths), name)
    return VideoSource(info, read, note, sample=sample, zero=0.0)


def known_rate(rate: float, subject: str) -> tuple[float, str]:
    """The rate in frames per second, and a note if it is unknown (0)."""
    if rate > 0:
        return rate, ""
    return _DEFAULT_FPS, f"{subject} not state its rate; {_DEFAULT_FPS:g} frames/s assumed"


def frame_numbers(stems: Sequence[str]) -> list[int]:
    """The frame number, from 1, of each name: by the last number in it if these are plausible, else
    by counting.
    """
    counted = list(range(1, len(stems) + 1))
    digits = [_DIGITS.findall(stem) for stem in stems]
    if len(stems) < 2 or not all(digits):
        return counted
    numbers = [int(found[-1]) for found in digits]
    steps = [after - before for before, after in pairwise(numbers)]
    if min(steps) <= 0:
        return counted
    stride = math.gcd(*steps)
    relative = [(number - numbers[0]) // stride + 1 for number in numbers]
    if relative[-1] > _MAX_SPACING * len(stems):
        return counted
    return relative


def _image(path: Path) -> Image:
    """(H, W, 3) BGR uint8. Raises `InputError` with the file's name if it is not an image."""
    import cv2

    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"this file cannot be read ({error.strerror})", where=path) from None
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if image is None:
        raise InputError(
            "this is not a readable image", where=path, cure="Repair the file or remove it."
        )
    return np.asarray(image, np.uint8)
