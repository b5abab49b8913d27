"""From what a user writes ("street.mp4", "frames/", "img/*.png", "0", "rtsp://…") to a source of frames."""

from __future__ import annotations

import math
from pathlib import Path

from phdtrack.errors import InputError
from phdtrack.video.camera import Camera
from phdtrack.video.images import SUFFIXES, ImageSequence
from phdtrack.video.source import VideoSource
from phdtrack.video.stream import VideoFile

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
