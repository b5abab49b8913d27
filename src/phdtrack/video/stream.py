"""What every source of frames has, the clock that turns time stamps into times, and video files decoded by PyAV.

A video is opened twice: once for its first frame, which settles size, orientation and rate (headers are often wrong), and
once for each iteration. Packets that cannot be decoded are skipped and reported in `VideoSource.problem`; a file cut short
gives the frames that it has. Portrait recordings of telephones are turned upright, as players do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from phdtrack.errors import InputError
from phdtrack.protocols import Source
from phdtrack.types import Frame, Image, SequenceInfo

DEFAULT_FPS = 25.0


class VideoSource(Source, Protocol):
    """A source that also says what it assumed and what went wrong, for the caller to print and to store."""

    @property
    def note(self) -> str:
        """What was assumed because it was not given (the rate of a folder of images); empty where nothing was."""

    @property
    def problem(self) -> str:
        """After the iteration: why the frames ended early, or which were lost; empty where all were read."""


@dataclass(slots=True, eq=False)
class Recording:
    """A `VideoSource`; iterating raises `InputError` for a frame of another size than the first.

    Attributes
    ----------
    info : size in pixels as shown, rate, name; ``frames`` is 0 where only decoding gives it.
    read : given this record, the frames and the place of each in words; it sets ``problem``.
    note, problem : as `VideoSource` has them.
    """

    info: SequenceInfo
    read: Callable[[Recording], Iterator[tuple[Frame, str]]]
    note: str = ""
    problem: str = ""

    def __iter__(self) -> Iterator[Frame]:
        self.problem = ""
        first = (self.info.width, self.info.height)
        for frame, where in self.read(self):
            size = (frame.image.shape[1], frame.image.shape[0])
            if size != first:
                raise InputError(
                    f"this frame is {size[0]}x{size[1]} pixels, the first one {first[0]}x{first[1]}",
                    where=where,
                    cure="All frames of a sequence need one size: split the input where the size changes.",
                )
            yield frame


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


def assumed_rate(rate: float, what: str) -> tuple[float, str]:
    """The rate in frames per second, and a note where it is not known (0)."""
    return (rate, "") if rate > 0 else (DEFAULT_FPS, f"{what} not state its rate; {DEFAULT_FPS:g} frames a second assumed")


def video_file(path: str | Path, fps: float) -> Recording:
    """The frames of a video file or of an address that FFmpeg can open, in order of presentation.

    ``fps`` above 0 replaces the stream's time stamps. Raises `InputError` where no frame can be decoded.
    """
    losses: list[tuple[int, str]] = []
    with _open(str(path)) as container:
        stream = _video_stream(container, str(path))
        stated = stream.average_rate or stream.guessed_rate or stream.base_rate
        picture = next(_pictures(container, stream, losses), None)
    if picture is None:
        raise InputError(
            f"no frame could be decoded{f' ({losses[0][1]})' if losses else ''}",
            where=path,
            cure="The file is empty or damaged: copy it again, or convert it (ffmpeg -i IN -c:v libx264 OUT.mp4).",
        )
    rate, note = assumed_rate(float(fps or stated or 0), f"{path} does")
    height, width = _upright(picture).shape[:2]

    def read(made: Recording) -> Iterator[tuple[Frame, str]]:
        losses: list[tuple[int, str]] = []
        number, clock = 0, Clock(1.0 / rate)
        with _open(str(path)) as container:
            stream = _video_stream(container, str(path))
            for number, picture in enumerate(_pictures(container, stream, losses), start=1):
                yield Frame(number, clock(None if fps else picture.time), _upright(picture)), f"{path}, frame {number}"
        if losses:
            after, reason = losses[0]
            made.problem = f"{path}: damaged after frame {after} ({reason}); {number} frames could be decoded"
        elif number < stream.frames:
            made.problem = f"{path}: ends after frame {number}, its header announces {stream.frames}; it may be cut short"

    return Recording(SequenceInfo(width, height, rate, name=Path(path).stem), read, note)


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


def _pictures(container: Any, stream: Any, losses: list[tuple[int, str]]) -> Iterator[Any]:
    """The decoded pictures; what fails is added to ``losses``, with the number of the frame before it, and passed over."""
    import av

    packets = container.demux(stream)
    number = 0
    while True:
        try:
            packet = next(packets, None)
        except av.FFmpegError as error:
            losses.append((number, _reason(error)))
            return
        if packet is None:
            return
        try:
            pictures = packet.decode()
        except av.FFmpegError as error:
            losses.append((number, _reason(error)))
            continue
        for picture in pictures:
            if picture.is_corrupt:
                losses.append((number, "parts of a picture are missing"))
            number += 1
            yield picture


def _upright(picture: Any) -> Image:
    """(H, W, 3) BGR uint8, turned by the orientation that the recording carries."""
    image: Image = picture.to_ndarray(format="bgr24")
    turns = round(picture.rotation / 90) % 4
    return np.ascontiguousarray(np.rot90(image, turns)) if turns else image
