"""A sequence of image files as a source of frames.

The files are put in natural order (``img2`` before ``img10``); `file_names` has what the names say.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import readable_name
from phdtrack.opencv_package import cv2
from phdtrack.types import Frame, Image, SequenceInfo
from phdtrack.video.file_names import numbering
from phdtrack.video.video_source import Read, VideoSource

SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"})
_DEFAULT_FPS = 25.0
_DIGITS = re.compile(r"\d+")


def image_source(files: Sequence[Path], fps: float, folder: Path) -> VideoSource:
    """Image files as frames.

    Parameters
    ----------
    files : at least one image. Raises `InputError` otherwise.
    fps : frames per second; 0: that of the times in the names, or 25.
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
    names = numbering([path.stem for path in paths])
    numbers = names.numbers
    if fps > 0:
        # The rate replaces the times.
        names = replace(names, times=[], note=names.note * (not names.times))
    rate, unknown = known_rate(fps or names.rate, "images do")
    times = names.times or [(number - 1) / rate for number in numbers]
    animated = _animated(paths)
    note = "; ".join(filter(None, (names.note, animated, unknown)))
    height, width = _image(paths[0]).shape[:2]

    def read(source: VideoSource) -> Iterator[Read]:
        for path, number, time in zip(paths, numbers, times, strict=True):
            if number >= source.first:
                yield number, time, _image(path), f"{path}, frame {number}"

    def sample(count: int) -> Iterator[Frame]:
        for k in np.unique(np.linspace(0, len(paths) - 1, count).round().astype(int)).tolist():
            yield Frame(numbers[k], times[k], _image(paths[k]))

    info = SequenceInfo(width, height, rate, len(paths), name)
    return VideoSource(info, read, note, sample=sample, zero=0.0)


def _animated(paths: Sequence[Path]) -> str:
    """A sentence if some of the images are animated; else empty."""
    webp = (path for path in paths if path.suffix.lower() == ".webp")
    found = [path for path in webp if is_animated_webp(head_of(path))]
    if not found:
        return ""
    which = found[0].name if len(found) == 1 else f"{found[0].name} and {len(found) - 1} more"
    verb = "is" if len(found) == 1 else "are"
    return f"{which} {verb} animated: of such files only the first picture is read"


def is_animated_webp(head: bytes) -> bool:
    """True for a file that begins with these bytes and is an animated WebP."""
    if len(head) < 21 or not head.startswith(b"RIFF"):
        return False
    return head[8:16] == b"WEBPVP8X" and bool(head[20] & 2)


def known_rate(rate: float, subject: str) -> tuple[float, str]:
    """The rate in frames per second, and a note if it is unknown (0)."""
    if rate > 0:
        return rate, ""
    return _DEFAULT_FPS, f"{subject} not state a frame rate; {_DEFAULT_FPS:g} frames/s assumed"


def head_of(path: Path) -> bytes:
    """The first bytes of a file; none if it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(32)
    except OSError:
        return b""


def _image(path: Path) -> Image:
    """(H, W, 3) BGR uint8. Raises `InputError` with the file's name if it is not an image."""
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
