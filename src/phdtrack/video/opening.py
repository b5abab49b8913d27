"""Frames from a path, a pattern or an address: "street/scene.mp4", "frames/", "img/*.png",
"http://…".
"""

from __future__ import annotations

import difflib
import glob
import math
from dataclasses import replace
from pathlib import Path

from phdtrack.errors import InputError
from phdtrack.files import refuse_part
from phdtrack.video.decoding import file_source
from phdtrack.video.image_folder import SUFFIXES, image_source
from phdtrack.video.video_source import VideoSource

# Suffixes of videos; track reads other files, too, if FFmpeg can.
VIDEOS = frozenset(
    f".{suffix}"
    for suffix in (
        *("264", "265", "3g2", "3gp", "amv", "asf", "av1", "avi", "divx", "dv", "f4v", "flv"),
        *("gif", "h264", "h265", "hevc", "ivf", "m1v", "m2p", "m2t", "m2ts", "m2v", "m4v", "mjpeg"),
        *("mjpg", "mk3d", "mkv", "mod", "mov", "mp4", "mpe", "mpeg", "mpg", "mpv", "mts", "mxf"),
        *("nut", "ogm", "ogv", "qt", "rm", "rmvb", "tod", "tp", "trp", "ts", "vob", "webm", "wmv"),
        *("wtv", "xvid", "y4m"),
    )
)
# Images for each video up to which they are no sequence.
_BESIDE = 5


def open_source(
    spec: str | Path, *, fps: float = 0.0, first: int = 1, last: int = 0
) -> VideoSource:
    """The frames that ``spec`` names.

    Parameters
    ----------
    spec : a video file; a folder of images; a glob pattern of images; an address with ``://``.
    fps : frames per second. Above 0 it replaces the time stamps of a video and is the rate of a
        folder of images; 0 takes the stream's own times, and 25 for images.
    first, last : only these frames, from 1; 0: up to the end. A video file with time stamps seeks
        to the first.

    Returns
    -------
    A source that yields frames in order, with their times in seconds.

    Raises
    ------
    InputError : there are no frames that can be decoded, or the rate is invalid.
    """
    if not math.isfinite(fps) or fps < 0:
        raise InputError(
            f"the rate must be a number of frames per second above 0, got {fps}", where="fps"
        )
    text = str(spec)
    path = Path(text)
    refuse_part(path)
    if path.is_dir():
        source = image_source(_sequence(path), fps, path)
    elif "://" in text or path.exists():
        source = file_source(text, fps, first)
    elif set(text) & set("*?["):
        files = [Path(name) for name in glob.glob(text, recursive=True) if Path(name).is_file()]
        if not files:
            raise InputError(
                "no file matches this pattern", where=text, cure="Check the folder and the pattern."
            )
        source = image_source(files, fps, files[0].parent)
    else:
        raise InputError("there is no such file or folder", where=text, cure=_likely_cause(path))
    return replace(source, first=first, last=last)


def is_video(path: Path) -> bool:
    """True for a file whose name is that of a video, and which is not hidden."""
    return path.suffix.lower() in VIDEOS and not path.name.startswith(".")


def is_image(path: Path) -> bool:
    """True for a file whose name is that of an image, and which is not hidden."""
    return path.suffix.lower() in SUFFIXES and not path.name.startswith(".")


def holds_sequence(images: int, videos: int) -> bool:
    """True if a folder with so many images and videos is an image sequence: a few images beside
    videos are thumbnails or covers.
    """
    return images > _BESIDE * videos


def _sequence(folder: Path) -> list[Path]:
    """The images of a folder. Raises `InputError` if it is a folder of videos."""
    files = [file for file in folder.iterdir() if file.is_file()]
    images = [file for file in files if is_image(file)]
    videos = [file for file in files if is_video(file)]
    if videos and not holds_sequence(len(images), len(videos)):
        found = f"{videos[0].name} and {len(videos) - 1} more" if videos[1:] else videos[0].name
        raise InputError(
            f"expected a folder of images, got one with videos ({found})",
            where=folder,
            cure="Name a video; for all there is `phdtrack batch`, for images a pattern:"
            f" '{folder / '*.png'}'.",
        )
    return images


def _likely_cause(path: Path) -> str:
    """A hint for a path that does not exist."""
    if not path.parent.is_dir():
        return f"The folder {path.parent} does not exist either."
    if "%" in path.name:
        return "Use * in place of the number: 'img/*.png'."
    names = [file.name for file in path.parent.iterdir()]
    close = difflib.get_close_matches(path.name, names, n=1)
    if close:
        return f"Did you mean {path.parent / close[0]}?"
    return "Check the spelling."
