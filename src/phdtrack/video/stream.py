"""What every source of frames has, and the clock that turns time stamps into times that only go forward.

Video files and network streams, decoded by PyAV.

The file is opened twice: once for its first frame, which settles size, orientation and rate (headers are not believed),
and once for each iteration. Packets that cannot be decoded are skipped and told in `VideoFile.problem`; a file cut short
gives the frames that it has. Portrait recordings of telephones are turned upright, as players do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from phdtrack.errors import InputError
from phdtrack.protocols import Source
from phdtrack.types import Frame, Image, SequenceInfo


class VideoSource(Source, Protocol):
    """A source that also says what it assumed and what went wrong, for the caller to print and to store."""

    @property
    def note(self) -> str:
        """What was assumed because nobody said it (the rate of a folder of images); empty where nothing was."""

    @property
    def problem(self) -> str:
        """After the iteration: why the frames ended early, or which were lost; empty where all were read."""


@dataclass(slots=True)
class Clock:
    """Times in seconds since the first frame, strictly increasing.

    A stamp that is missing, or not later than the one before, counts as one ``interval`` (seconds) after it. A stream
    that jumps back (two recordings joined) goes on from there, with the intervals that its later stamps have.
    """

    interval: float
    _last: float = field(default=0.0, init=False)
    _zero: float | None = field(default=None, init=False)
    _started: bool = field(default=False, init=False)

    def __call__(self, stamp: float | None) -> float:
        """The time of the next frame, whose stamp in seconds is ``stamp``, None where the stream gives none."""
        expected = self._last + self.interval if self._started else 0.0
        time = expected if stamp is None or self._zero is None else stamp - self._zero
        if self._started and time <= self._last:
            time = expected
        if stamp is not None:
            self._zero = stamp - time
        self._last, self._started = time, True
        return time


def check_size(image: Image, width: int, height: int, where: str) -> None:
    """Raise InputError where ``image`` (H, W, 3) is not ``width`` x ``height`` pixels like the first frame.

    Parameters
    ----------
    image : (H, W, 3).
    width, height : of the first frame, pixels.
    where : what the message names.
    """
    got = (image.shape[1], image.shape[0])
    if got != (width, height):
        raise InputError(
            f"this frame is {got[0]}x{got[1]} pixels, the first one {width}x{height}",
            where=where,
            cure="All frames of a sequence need one size: split the input where the size changes.",
        )


FALLBACK_FPS = 25.0


@dataclass(slots=True)
class _Losses:
    """What the decoder complained about during one pass."""

    after: int = 0
    reason: str = ""
    announced: int = 0

    def add(self, number: int, reason: str) -> None:
        """Note the first damage, which came after frame ``number``."""
        if not self.reason:
            self.after, self.reason = number, reason

    def describe(self, path: str, decoded: int) -> str:
        """One sentence for the user; empty where nothing was lost."""
        if self.reason:
            return f"{path}: damaged after frame {self.after} ({self.reason}); {decoded} frames could be decoded"
        if decoded < self.announced:
            return f"{path}: ends after frame {decoded}, its header announces {self.announced}; it may be cut short"
        return ""


class VideoFile:
    """The frames of a video file or stream address, in order of presentation.

    Parameters
    ----------
    path : file or address that FFmpeg can open.
    fps : frames per second; above 0 it replaces the stream's time stamps, 0 believes them.

    Raises InputError where no frame can be decoded, and during iteration for a frame of another size.
    """

    def __init__(self, path: str | Path, *, fps: float = 0.0) -> None:
        self._path = str(path)
        self._fps = fps
        self._problem = ""
        with _open(self._path) as container:
            stream = _video_stream(container, self._path)
            rate = stream.average_rate or stream.guessed_rate or stream.base_rate
            image = self._first_image(container)
        self._info = SequenceInfo(
            width=image.shape[1],
            height=image.shape[0],
            fps=fps or float(rate or FALLBACK_FPS),
            name=Path(self._path).stem,
        )
        self._note = "" if fps or rate else f"{path} does not state its rate; {FALLBACK_FPS:g} frames a second assumed"

    @property
    def info(self) -> SequenceInfo:
        """Size in pixels as shown, mean rate, name; ``frames`` is 0, for only decoding tells."""
        return self._info

    @property
    def note(self) -> str:
        """What was assumed; empty where nothing was."""
        return self._note

    @property
    def problem(self) -> str:
        """What was lost in the last iteration; empty where nothing was."""
        return self._problem

    def __iter__(self) -> Iterator[Frame]:
        self._problem = ""
        losses, number, clock = _Losses(), 0, Clock(1.0 / self._info.fps)
        with _open(self._path) as container:
            stream = _video_stream(container, self._path)
            losses.announced = stream.frames
            for picture in _pictures(container, stream, losses):
                number += 1
                image = _upright(picture)
                check_size(image, self._info.width, self._info.height, f"{self._path}, frame {number}")
                yield Frame(number, clock(None if self._fps else picture.time), image)
        self._problem = losses.describe(self._path, number)

    def _first_image(self, container: Any) -> Image:
        losses = _Losses()
        for picture in _pictures(container, _video_stream(container, self._path), losses):
            return _upright(picture)
        reason = f" ({losses.reason})" if losses.reason else ""
        raise InputError(
            f"no frame could be decoded{reason}",
            where=self._path,
            cure="The file is empty or damaged: copy it again, or convert it (ffmpeg -i IN -c:v libx264 OUT.mp4).",
        )


def _reason(error: Exception) -> str:
    """What FFmpeg says, without its call and number."""
    return str(getattr(error, "strerror", "") or error)


def _open(path: str) -> Any:
    import av

    try:
        return av.open(path)
    except (av.FFmpegError, OSError) as error:
        raise InputError(
            f"this cannot be read as a video ({_reason(error)})",
            where=path,
            cure="Check that it is a whole video file: an mp4 cut off while it was recorded or copied has no index. "
            "`ffmpeg -i IN -c:v libx264 OUT.mp4` converts most other kinds.",
        ) from None


def _video_stream(container: Any, path: str) -> Any:
    if not container.streams.video:
        raise InputError("there is no video in this file", where=path, cure="Give one with pictures.")
    stream = container.streams.video[0]
    stream.thread_type = "AUTO"
    return stream


def _pictures(container: Any, stream: Any, losses: _Losses) -> Iterator[Any]:
    """The decoded pictures; whatever fails is counted in ``losses`` and passed over."""
    import av

    packets = container.demux(stream)
    number = 0
    while True:
        try:
            packet = next(packets, None)
        except av.FFmpegError as error:
            losses.add(number, _reason(error))
            return
        if packet is None:
            return
        try:
            pictures = packet.decode()
        except av.FFmpegError as error:
            losses.add(number, _reason(error))
            continue
        for picture in pictures:
            if picture.is_corrupt:
                losses.add(number, "parts of a picture are missing")
            number += 1
            yield picture


def _upright(picture: Any) -> Image:
    """(H, W, 3) BGR uint8, turned by the orientation that the recording carries."""
    image: Image = picture.to_ndarray(format="bgr24")
    turns = round(picture.rotation / 90) % 4
    return np.ascontiguousarray(np.rot90(image, turns)) if turns else image
