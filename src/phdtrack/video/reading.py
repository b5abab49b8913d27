"""From what a user writes ("street.mp4", "frames/", "img/*.png", "http://…") to a source of frames.

The files of a folder or a glob pattern of images are put in natural order (``img2`` before
``img10``). The last number in each name says which frame it is, counted from the first file as
frame 1 in steps of the names' common divisor: a file missing from ``000001.jpg 000002.jpg
000004.jpg`` is a dropped frame, and the time between frames 2 and 4 is two intervals. Names without
numbers, names whose numbers do not increase, and names in which more than nine frames in ten would
be missing (time stamps) are only counted.

Of a decoded picture BGR or planes are made when somebody asks for them, and in the size that he
needs.

A video is opened once for its first frame, which settles size, orientation and rate (headers are
often wrong), and once for each iteration. Packets that cannot be decoded are skipped; a file cut
short gives the frames that it has.
"""

from __future__ import annotations

import difflib
import glob
import math
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from itertools import dropwhile, islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.devices import Picture, size_of
from phdtrack.errors import InputError, needed
from phdtrack.files import refuse_part
from phdtrack.types import Frame, Image, SequenceInfo

SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"})
_MOST_MISSING = 10
_DEFAULT_FPS = 25.0
# Seconds to wait for an address: until it is open, and for more of what it sends.
CONNECT = 10.0
READ = 10.0
# What FFmpeg calls pictures whose black is 0; the pixels of 1080p, as they are encoded.
_FULL_RANGE = 2
_LARGE = 1920 * 1088
# Pictures by which the order of packets may differ from that of presentation, at most.
_REORDERED = 32
Read = tuple[int, float | None, Image | Picture, str]
"""A frame's number, its time stamp in seconds (None where the stream has none), its picture, and
where it is in words.
"""


@dataclass(slots=True, eq=False)
class VideoSource:
    """Frames in order; their times are seconds since the first one, strictly increasing.

    A stamp that is missing, or not later than the one before, counts as one interval after it. A
    stream that jumps back (two recordings joined) goes on from there, with the intervals that its
    later stamps have.

    Attributes
    ----------
    info : size in pixels as shown, rate, name; ``frames`` is 0 where only decoding gives it.
    read : given this record, the frames; it sets ``problem``.
    note : what was assumed because it was not given (the rate of a folder of images); empty where
        nothing was.
    problem : after the iteration: why the frames ended early, or which were lost; empty where all
        were read.
    share : how much of the file was read so far, from 0 to 1; 0 where that is not known.
    announced : how many frames the header of the file announces, which may be wrong; 0 where it
        does not.
    sample : so many frames in order, spread over all of the file; fewer where it cannot jump to
        that many places.
    first, last : the frames that are given; 0: up to the end. Their numbers and times are those of
        the whole.
    zero : the stamp whose time is 0; NaN: that of the first frame.
    """

    info: SequenceInfo
    read: Callable[[VideoSource], Iterator[Read]]
    note: str = ""
    problem: str = ""
    share: float = 0.0
    announced: int = 0
    sample: Callable[[int], Iterator[Frame]] = lambda count: iter(())
    first: int = 1
    last: int = 0
    zero: float = math.nan

    def __iter__(self) -> Iterator[Frame]:
        """The frames. Raises `InputError` for a picture of another size than the first; empty ones
        pass.
        """
        self.problem = ""
        interval = 1 / self.info.fps
        number = 0
        last = -interval
        zero = self.zero
        for number, stamp, image, where in self.read(self):
            if self.last and number > self.last:
                return
            frame = Frame(number, math.nan, image)
            wide, high = size_of(frame)
            if wide and (wide, high) != (self.info.width, self.info.height):
                problem = (
                    f"this frame is {wide}x{high} pixels, the first one"
                    f" {self.info.width}x{self.info.height}"
                )
                cure = (
                    "All frames of a sequence need one size: split the input where the size"
                    " changes."
                )
                raise InputError(problem, where=where, cure=cure)
            if stamp is None:
                moment = math.nan
            else:
                moment = stamp - zero
            if moment > last:
                last = moment
            else:
                last = last + interval
            if stamp is not None:
                zero = stamp - last
            if number >= self.first:
                yield replace(frame, time=last)
        if number < self.first > 1:
            self.problem = (
                f"there is no frame {self.first}: the last one is {max(number, self.info.frames)}"
            )


def open_source(
    spec: str | Path, *, fps: float = 0.0, first: int = 1, last: int = 0
) -> VideoSource:
    """The frames that ``spec`` names. Raises `InputError` where there are none that can be decoded,
    or the rate is wrong.

    Parameters
    ----------
    spec : a video file; a folder of images; a glob pattern of images; an address with ``://``.
    fps : frames per second. Above 0 it replaces the time stamps of a video and is the rate of a
        folder of images; 0 takes the stream's own times, and 25 for images.
    first, last : only these frames, from 1; 0: up to the end. In a video file they are jumped to,
        if it has time stamps.
    """
    if not math.isfinite(fps) or fps < 0:
        raise InputError(
            f"the rate must be a number of frames per second above 0, not {fps}", where="fps"
        )
    text = str(spec)
    path = Path(str(spec))
    refuse_part(path)
    if path.is_dir():
        source = _images(
            [file for file in path.iterdir() if file.suffix.lower() in SUFFIXES], fps, path
        )
        return replace(source, first=first, last=last)
    if "://" in text or path.exists():
        # `phdtrack.live` reads what never ends.
        return replace(_video(text, fps, first), last=last)
    if set(text) & set("*?["):
        files = [Path(name) for name in glob.glob(text, recursive=True) if Path(name).is_file()]
        if not files:
            raise InputError(
                "no file matches this pattern", where=text, cure="Check the folder and the pattern."
            )
        return replace(_images(files, fps, files[0].parent), first=first, last=last)
    cure = f"The folder {path.parent} does not exist either."
    if path.parent.is_dir():
        close = difflib.get_close_matches(
            path.name, [file.name for file in path.parent.iterdir()], n=1
        )
        if close:
            cure = f"Did you mean {path.parent / close[0]}?"
        else:
            cure = "Check the spelling."
        if "%" in path.name:
            cure = "Say * in place of the number: 'img/*.png'."
        else:
            cure = cure
    raise InputError("there is no such file or folder", where=text, cure=cure)


def _rate(rate: float, what: str) -> tuple[float, str]:
    """The rate in frames per second, and a note where it is not known (0)."""
    if rate > 0:
        return (rate, "")
    return (_DEFAULT_FPS, f"{what} not state its rate; {_DEFAULT_FPS:g} frames a second assumed")


def _images(files: Sequence[Path], fps: float, folder: Path) -> VideoSource:
    """Images as frames. MOTChallenge puts those of every sequence into ``NAME/img1``, which is
    called NAME.
    """
    folder = folder.resolve()
    if folder.name == "img1":
        name = folder.parent.name
    else:
        name = folder.name
    if not files:
        raise InputError(
            "there is no image",
            where=name,
            cure=f"Files that end in {', '.join(sorted(SUFFIXES))} are read.",
        )
    # Runs of digits compare as numbers.
    paths = sorted(
        files, key=lambda path: re.sub(r"\d+", lambda digits: digits[0].zfill(30), path.name)
    )
    numbers = frame_numbers([path.stem for path in paths])
    rate, note = _rate(fps, "images do")
    height, width = _image(paths[0]).shape[:2]

    def read(source: VideoSource) -> Iterator[Read]:
        for path, number in zip(paths, numbers, strict=True):
            if number >= source.first:
                yield number, (number - 1) / rate, _image(path), f"{path}, frame {number}"

    def sample(count: int) -> Iterator[Frame]:
        for k in np.unique(np.linspace(0, len(paths) - 1, count).round().astype(int)).tolist():
            yield Frame(numbers[k], (numbers[k] - 1) / rate, _image(paths[k]))

    return VideoSource(
        SequenceInfo(width, height, rate, len(paths), name), read, note, sample=sample, zero=0.0
    )


def frame_numbers(stems: Sequence[str]) -> list[int]:
    """The frame number from 1 of each name, by the last number in it where these make sense, else
    by counting.
    """
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
    if relative[-1] <= _MOST_MISSING * len(stems):
        return relative
    return counted


def _image(path: Path) -> Image:
    """(H, W, 3) BGR uint8; InputError naming the file where it is not an image."""
    import cv2

    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"this file cannot be read ({error.strerror})", where=path) from None
    if data.size:
        image = cv2.imdecode(data, cv2.IMREAD_COLOR)
    else:
        image = None
    if image is None:
        raise InputError(
            "this is not an image that can be read",
            where=path,
            cure="Repair the file or take it away.",
        )
    return np.asarray(image, np.uint8)


def _stamps(container: Any, stream: Any, count: int) -> list[int]:
    """The time stamps of the first ``count`` pictures in order of presentation, of packets that are
    not decoded; nothing where some have none, or they jump back, as in recordings that were joined:
    then they do not tell which frame it is."""
    packets = (
        packet.pts for packet in container.demux(stream) if packet.size and not packet.is_discard
    )
    found = list(islice(packets, count + _REORDERED))
    if None in found:
        order = []
    else:
        order = sorted(range(len(found)), key=found.__getitem__)
    ordered = all(abs(place - number) <= _REORDERED for place, number in enumerate(order))
    if ordered:
        return [found[number] for number in order[:count]]
    return []


def _video(path: str, fps: float, first: int) -> VideoSource:
    """The frames of a video file or of an address that FFmpeg can open, in order of presentation,
    from frame ``first`` on.

    ``fps`` above 0 replaces the stream's time stamps. Raises `InputError` where no frame can be
    decoded.
    """
    losses: list[tuple[int, str]] = []
    with _open(path) as (container, stream):
        stated = stream.average_rate or stream.guessed_rate or stream.base_rate
        length = container.duration or 0
        picture = next(_pictures(container, stream, losses), None)
    stamps = list[int]()
    if first > 1 and picture is not None:
        with _open(path) as (container, stream):
            stamps = _stamps(container, stream, first)
        with _open(path) as (container, stream):
            if stamps:
                found = next(_from(container, stream, stamps, losses), None)
            else:
                found = None
            # A file that cannot jump there is decoded from its beginning.
            if found is not None and found.pts == stamps[-1]:
                stamps = stamps
            else:
                stamps = []
    if picture is None:
        problem = f"no frame could be decoded{f' ({losses[0][1]})' if losses else ''}"
        cure = (
            "The file is empty or damaged: copy it again, or convert it (ffmpeg -i IN -c:v libx264"
            " OUT.mp4)."
        )
        raise InputError(problem, where=path, cure=cure)
    rate, note = _rate(float(fps or stated or 0), f"{path} does")
    info = SequenceInfo(*Decoded(picture).size, rate, name=Path(path).stem)

    def read(source: VideoSource) -> Iterator[Read]:
        losses: list[tuple[int, str]] = []
        jump = stamps if source.first > 1 else []
        number = before = max(0, len(jump) - 1)
        with _open(path) as (container, stream):
            for number, picture in enumerate(
                _from(container, stream, jump, losses, source), start=before + 1
            ):
                if fps:
                    stamp = (number - 1) / fps
                else:
                    stamp = picture.time
                yield number, stamp, Decoded(picture), f"{path}, frame {number}"
        if losses:
            after, reason = losses[0]
            source.problem = (
                f"{path}: damaged after frame {after} ({reason}); {number} frames could be decoded"
            )
        elif number < stream.frames:
            source.problem = (
                f"{path}: ends after frame {number}, its header announces {stream.frames}; it may"
                " be cut short"
            )

    def sample(count: int) -> Iterator[Frame]:
        with _open(path) as (container, stream):
            last = -1.0
            for k in range(count if container.duration else 0):
                # To the picture before that needs no other one to be decoded.
                container.seek(
                    round((k + 0.5) / count * container.duration) + (container.start_time or 0)
                )
                picture = next(_pictures(container, stream, []), None)
                if picture is None or picture.time is None or picture.time <= last:
                    return
                last = picture.time
                yield Frame(k + 1, last, Decoded(picture))

    if fps:
        zero = 0.0
    elif stamps:
        zero = float(stamps[0] * stream.time_base)
    else:
        zero = math.nan
    announced = stream.frames or round(length / 1e6 * rate)
    return VideoSource(info, read, note, announced=announced, sample=sample, first=first, zero=zero)


def _from(
    container: Any,
    stream: Any,
    stamps: list[int],
    losses: list[tuple[int, str]],
    source: VideoSource | None = None,
) -> Iterator[Any]:
    """As `_pictures`, from the last of the stamps on; all without any."""
    if not stamps:
        return _pictures(container, stream, losses, source)
    # Some pictures earlier, so that those before the next one that stands by itself are whole.
    container.seek(stamps[max(0, len(stamps) - 1 - _REORDERED)], stream=stream)
    return dropwhile(
        lambda one: one.pts is not None and one.pts < stamps[-1],
        _pictures(container, stream, losses, source),
    )


def _reason(error: Exception) -> str:
    """What FFmpeg says, without its call and number."""
    return str(getattr(error, "strerror", "") or error)


@contextmanager
def _open(path: str) -> Iterator[tuple[Any, Any]]:
    """The container and its first video stream."""
    av = needed("av")
    remote = "://" in path
    try:
        container: Any = av.open(
            path, timeout=(CONNECT, READ) if remote else None, metadata_errors="replace"
        )
    except (av.FFmpegError, OSError, ValueError) as error:
        cure = (
            "Check that it is a whole video file: an mp4 cut off while it was recorded or copied"
            " has no index. "
        )
        cure += "`ffmpeg -i IN -c:v libx264 OUT.mp4` converts most other kinds."
        if remote:
            cure = (
                "Check the address, and that what it names is switched on and can be reached from"
                " here."
            )
        if isinstance(error, av.ExitError):
            late = f"no answer in {CONNECT:g} s"
        else:
            late = _reason(error)
        raise InputError(
            f"this cannot be read as a video ({late})", where=path, cure=cure
        ) from None
    with container:
        stream = next(iter(container.streams.video), None)
        if stream is None or stream.codec_context is None:
            if stream is None:
                which = "there is no video"
            else:
                which = "FFmpeg has no decoder for the video"
            cure = "Give another one, or convert it (ffmpeg -i IN -c:v libx264 OUT.mp4)."
            raise InputError(f"{which} in this file", where=path, cure=cure)
        # A second thread takes the memory of a dozen pictures, and helps where they are larger than
        # 1080p.
        if stream.width * stream.height > _LARGE:
            threads = 2
        else:
            threads = 1
        stream.thread_type = "AUTO"
        stream.codec_context.thread_count = threads
        yield container, stream


def _pictures(
    container: Any, stream: Any, losses: list[tuple[int, str]], source: VideoSource | None = None
) -> Iterator[Any]:
    """The decoded pictures; what fails is added to ``losses``, with the number of the frame before
    it, and passed over.

    ``source`` is told how much of the file was read.
    """
    av = needed("av")
    number = 0
    size = container.size
    try:
        for packet in container.demux(stream):
            if source is not None and size > 0 and packet.pos is not None:
                source.share = min(1.0, packet.pos / size)
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
    except (av.FFmpegError, IndexError) as error:
        # PyAV knows no streams but those that there were at the beginning.
        if isinstance(error, IndexError):
            reason = "it goes on with other streams"
        else:
            reason = _reason(error)
        losses.append((number, reason))


class _Converter(threading.local):
    """What FFmpeg prepares to convert pictures, of each thread: to prepare it anew takes longer
    than to convert one.
    """

    def __init__(self) -> None:
        self.reformat = needed("av.video.reformatter").VideoReformatter().reformat


@cache
def _converter() -> _Converter:
    return _Converter()


def bgr(picture: Any, width: int, height: int) -> Image:
    """(H, W, 3) BGR uint8: a picture as FFmpeg decodes it in other pixels.

    Parameters
    ----------
    picture : an `av.VideoFrame`.
    width, height : of the image in pixels.
    """
    return np.asarray(
        _converter().reformat(picture, width, height, "bgr24", interpolation="AREA").to_ndarray(),
        np.uint8,
    )


class Decoded:
    """A picture as FFmpeg decodes it, turned by the orientation that the recording carries."""

    __slots__ = ("_image", "_picture", "_ready", "_turns", "size")

    def __init__(self, picture: Any) -> None:
        self._picture = picture
        self._turns = round(picture.rotation / 90) % 4
        wide = picture.width
        high = picture.height
        if self._turns % 2:
            self.size = (high, wide)
        else:
            self.size = (wide, high)
        self._image: Image | None = None
        self._ready: tuple[tuple[int, int], Image] | None = None

    def prepare(self, size: tuple[int, int]) -> None:
        """As `Picture.prepare`."""
        self._ready = size, self.planes(size)

    def bgr(self, size: tuple[int, int] | None = None) -> Image:
        """(H, W, 3) BGR uint8 of this width and height, or of its own: that is made once."""
        if size is None and self._image is not None:
            return self._image
        image = np.ascontiguousarray(
            np.rot90(bgr(self._picture, *self._before_turns(size)), self._turns)
        )
        if size is None:
            self._image = image
        else:
            self._image = self._image
        return image

    def planes(self, size: tuple[int, int] | None = None) -> Image:
        """As `Picture.planes`."""
        ready = self._ready
        self._ready = None
        if ready is not None and ready[0] == (size or self.size):
            return ready[1]
        picture = self._picture
        wide, high = self._before_turns(size)
        if picture.color_range == _FULL_RANGE:
            full = "JPEG"
        else:
            full = None
        if (
            (wide, high) != (picture.width, picture.height)
            or picture.format.name != "yuv420p"
            or full
        ):
            # Versions of PyAV before 18 do not ask the picture for its range.
            picture = _converter().reformat(
                picture,
                wide,
                high,
                "yuv420p",
                interpolation="AREA",
                src_color_range=full,
                dst_color_range="MPEG",
            )
        half = ((wide + 1) // 2, (high + 1) // 2)
        start = 0
        out: Image = np.empty(wide * high + 2 * half[0] * half[1], np.uint8)
        for plane, (across, low) in zip(picture.planes, ((wide, high), half, half), strict=True):
            part = np.rot90(
                np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[:low, :across],
                self._turns,
            )
            out[start : start + part.size].reshape(part.shape)[:] = part
            start += part.size
        return out

    def _before_turns(self, size: tuple[int, int] | None) -> tuple[int, int]:
        """Width and height of what is turned to have this size."""
        wide, high = size or self.size
        if self._turns % 2:
            return (high, wide)
        return (wide, high)


def endless(path: str) -> bool:
    """Whether an address names something without an end, as a camera does: neither its length nor
    its duration is known.

    Raises `InputError` where it cannot be opened.
    """
    with _open(path) as (container, stream):
        return not stream.frames and container.duration is None
