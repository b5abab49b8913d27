"""Video files and streams, decoded by FFmpeg.

A video is opened once for its first frame, which determines size, orientation and rate (headers are
often wrong), and once for each iteration. Packets that cannot be decoded are skipped; a truncated
file yields the frames that it has. A decoded picture is converted to BGR or planes when needed, at
the size that is needed.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import chain, dropwhile, islice
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.addresses import filled, named, shown
from phdtrack.clock import Clock, settled
from phdtrack.errors import InputError, needed
from phdtrack.files import ffmpeg_name, readable_name
from phdtrack.types import Frame, Image, SequenceInfo
from phdtrack.video.image_folder import head_of, is_animated_webp, known_rate
from phdtrack.video.video_source import Read, VideoSource

# Seconds to wait for an address to be opened, and for more data from it.
CONNECT = 10.0
READ = 10.0
# FFmpeg's number for pictures whose black is 0.
_FULL_RANGE = 2
# Pixels of 1080p as they are encoded.
_LARGE = 1920 * 1088
# Pictures by which the order of packets may differ from the order of presentation, at most.
_MAX_REORDERED = 32
# Pictures whose stamps measure the rate of a file.
_MEASURED = 100
_MIN_STEPS = 8
# A stated rate is believed if it is at most this many times the measured one: if the file has an
# index, and otherwise. Of a rate that varies it is the mean, which may be lower.
_FASTER = 10.0
_GUESSED_FASTER = 1.5
_SLOWER = 20.0
# FFmpeg's dispositions of attached pictures, timed thumbnails and still images.
_PICTURES = 0x400 | 0x800 | 0x100000
_CONVERT = "convert it (ffmpeg -i IN -c:v libx264 OUT.mp4)"


def file_source(path: str, fps: float, first: int) -> VideoSource:
    """The frames of a video file or address that FFmpeg can open, in order of presentation.

    Parameters
    ----------
    path : a file, or an address with ``://``. Raises `InputError` if no frame can be decoded.
    fps : frames per second; above 0 it replaces the stream's time stamps.
    first : the first frame that is needed, from 1.
    """
    losses: list[tuple[int, str]] = []
    measured = 0.0
    with _open(path) as (container, stream):
        stated = float(stream.average_rate or 0)
        guessed = float(stream.guessed_rate or stream.base_rate or 0)
        length = container.duration or 0
        picture = next(_pictures(container, stream, losses), None)
        announced = stream.frames
        shuffled = container.format.name == "avi" and stream.codec_context.has_b_frames
        pixel_aspect = float(stream.sample_aspect_ratio or 1)
        choice = _choice(path, container)
        if picture is not None and not fps:
            with suppress(*_damage()):
                measured = _measured_rate(container, stream)
    if picture is None:
        reason = f" ({losses[0][1]})" if losses else ""
        if "://" not in path and is_animated_webp(head_of(Path(path))):
            raise InputError(
                "this is an animated WebP, which FFmpeg cannot decode",
                where=path,
                cure="Convert it with another program: magick IN.webp OUT.mp4",
            )
        raise InputError(
            f"no frame could be decoded{reason}",
            where=path,
            cure=f"The file is empty or damaged: copy it again, or {_CONVERT}.",
        )
    if not measured:
        stated = stated or guessed
    rate, doubt = _rate(path, fps, stated, measured, indexed=bool(announced))
    note = ". ".join(filter(None, (choice, doubt)))
    decoded = Decoded(picture)
    if decoded.size != (picture.width, picture.height):
        pixel_aspect = 1 / pixel_aspect
    info = SequenceInfo(*decoded.size, rate, 0, _name(path), pixel_aspect)
    video = _VideoFile(path, fps, rate, note, picture.pts, picture.time or 0.0, shuffled)
    return VideoSource(
        info,
        video.read,
        note,
        announced=announced or round(length / 1e6 * rate),
        sample=video.sample,
        first=first,
        zero=0.0,
        times=video.clock,
    )


def _measured_rate(container: Any, stream: Any) -> float:
    """Frames per second by the stamps of the next packets; 0 if they say nothing."""
    stamps = _packet_stamps(container, stream, _MEASURED)
    known = np.array([stamp for stamp in stamps if stamp is not None], np.float64)
    steps = np.diff(np.unique(known))
    if len(steps) < _MIN_STEPS:
        return 0.0
    usual = float(np.median(steps))
    even = steps[steps < 2 * usual]
    # Stamps are rounded, mostly to milliseconds.
    return float(f"{1 / (even.mean() * float(stream.time_base)):.4g}")


def _rate(
    path: str, fps: float, stated: float, measured: float, *, indexed: bool
) -> tuple[float, str]:
    """Frames per second, and a sentence if the file does not state its rate, or a wrong one.

    Parameters
    ----------
    path : of the file, for the sentence.
    fps, stated, measured : as the user, the file and its stamps have it; 0 if unknown.
    indexed : whether the file knows the number of its frames.
    """
    if fps or not measured:
        return known_rate(float(fps or stated), f"{path} does")
    most = (_FASTER if indexed else _GUESSED_FASTER) * measured
    if not stated:
        return measured, ""
    if measured / _SLOWER <= stated <= most:
        return stated, ""
    return measured, (
        f"{path} states {stated:g} frames/s, and by its time stamps it has {measured:g}: the time"
        " stamps are used"
    )


@dataclass(frozen=True, slots=True)
class _VideoFile:
    """A file that can be decoded.

    Attributes
    ----------
    path : of the file.
    fps : frames per second that replace its stamps; 0 for the stamps.
    rate, note : frames per second that are usual, and a sentence about them.
    begin, zero : the first picture's stamp, in the stream's unit and in seconds.
    shuffled : whether the stamps are those of the order of decoding. AVI has no others, and
        pictures that are predicted from later ones get those of their neighbours.
    """

    path: str
    fps: float
    rate: float
    note: str
    begin: int | None
    zero: float
    shuffled: bool = False

    def read(self, source: VideoSource) -> Iterator[Read]:
        """Yield the frames, and report what was lost in ``source.problem``, and which stamps were
        not believed in ``source.note``.
        """
        losses: list[tuple[int, str]] = []
        doubted: list[tuple[int, float]] = []
        stamps: list[int] = []
        if source.first > 1:
            stamps = self._stamps_to(source.first)
        number = before = max(0, len(stamps) - 1)
        with _open(self.path) as (container, stream):
            unit = stream.time_base
            pictures = _pictures_from(container, stream, stamps, losses, source)
            skipped = ((k, float(stamps[k - 1] * unit), None) for k in range(1, before + 1))
            shown = (
                (k, self._stamp(one, unit), one) for k, one in enumerate(pictures, start=before + 1)
            )
            for number, time, picture in self._timed(chain(skipped, shown), doubted):
                if picture is not None:
                    yield number, time, Decoded(picture), f"{self.path}, frame {number}"
        if losses:
            after, reason = losses[0]
            source.problem = (
                f"{self.path}: damaged after frame {after} ({reason}); {number} frames could be"
                " decoded"
            )
        elif number < stream.frames:
            source.problem = (
                f"{self.path}: ends after frame {number}, but its header announces"
                f" {stream.frames}; it may be truncated"
            )
        if doubted:
            doubts = f"{self.path}: {_doubts(doubted)}"
            source.note = ". ".join(filter(None, (self.note, doubts)))

    def clock(self) -> Clock:
        """The times of all frames. Nothing is decoded if the packets have the stamps."""
        if self.fps:
            return Clock.constant(self.fps)
        stamps = self._stamps(None)
        with _open(self.path) as (container, stream):
            unit = stream.time_base
            pairs: Iterator[tuple[int, float | None]] = (
                (k, float(stamp * unit)) for k, stamp in enumerate(stamps, start=1)
            )
            if not stamps:
                every = _pictures(container, stream, [])
                pairs = ((k, self._stamp(one, unit)) for k, one in enumerate(every, start=1))
            reads = ((number, stamp, None) for number, stamp in pairs)
            found = [(number, time) for number, time, _ in self._timed(reads, [])]
        return Clock.of([number for number, _ in found], [time for _, time in found], self.rate)

    def _timed(
        self, reads: Iterable[tuple[int, float | None, Any]], doubted: list[tuple[int, float]]
    ) -> Iterator[tuple[int, float, Any]]:
        """The frames with their times in seconds."""
        if self.fps:
            return ((number, (number - 1) / self.fps, item) for number, _, item in reads)
        return settled(reads, 1 / self.rate, doubted)

    def _stamp(self, picture: Any, unit: Fraction) -> float | None:
        """The time stamp of a picture in seconds; None without one."""
        if not self.shuffled:
            time: float | None = picture.time
            return time
        if picture.dts is None:
            return None
        return float(picture.dts * unit)

    def _stamps_to(self, number: int) -> list[int]:
        """The time stamps of the frames up to ``number``; empty if the file cannot seek there, and
        must be decoded from its beginning.
        """
        stamps = self._stamps(number)
        if not stamps:
            return []
        with _open(self.path) as (container, stream):
            picture = next(_pictures_from(container, stream, stamps, []), None)
            if picture is None or picture.pts != stamps[-1]:
                return []
        return stamps

    def _stamps(self, count: int | None) -> list[int]:
        """The time stamps of the first ``count`` frames, or of all, without decoding; empty if they
        do not identify frames.
        """
        stamps: list[int] = []
        if self.shuffled:
            return stamps
        with _open(self.path) as (container, stream), suppress(*_damage()):
            stamps = _stamps(container, stream, count)
        if stamps[:1] != [self.begin]:
            # Pictures before the first one cannot be decoded.
            return []
        return stamps

    def sample(self, count: int) -> Iterator[Frame]:
        """Yield ``count`` frames spread over the file, which are numbered from 1, at their times;
        fewer if it cannot seek to so many.
        """
        with _open(self.path) as (container, stream):
            last = -1.0
            for k in range(count if container.duration else 0):
                # This seeks to the key frame before.
                offset = round((k + 0.5) / count * container.duration)
                container.seek(offset + (container.start_time or 0))
                picture = next(_pictures(container, stream, []), None)
                if picture is None or picture.time is None or picture.time <= last:
                    return
                last = picture.time
                yield Frame(k + 1, last - self.zero, Decoded(picture))


def endless(path: str) -> bool:
    """Return True if an address has no end, as a camera's: neither length nor duration is known.

    Raises `InputError` if it cannot be opened.
    """
    with _open(path) as (container, stream):
        return not stream.frames and container.duration is None


def _stamps(container: Any, stream: Any, count: int | None) -> list[int]:
    """The time stamps of the first ``count`` pictures, or of all, in order of presentation, without
    decoding.

    Empty if some packets have none, or if stamps jump back, as in joined recordings: then they do
    not identify frames.
    """
    more = None
    if count is not None:
        more = count + _MAX_REORDERED
    stamps = _packet_stamps(container, stream, more)
    found = [stamp for stamp in stamps if stamp is not None]
    if len(found) < len(stamps) or len(set(found)) < len(found):
        return []
    order = sorted(range(len(found)), key=found.__getitem__)
    if any(abs(place - number) > _MAX_REORDERED for place, number in enumerate(order)):
        return []
    return [found[number] for number in order[:count]]


def _packet_stamps(container: Any, stream: Any, count: int | None) -> list[int | None]:
    """The time stamps of the next ``count`` packets with pictures, or of all; None without one."""
    packets = (
        packet.pts for packet in container.demux(stream) if packet.size and not packet.is_discard
    )
    return list(islice(packets, count))


def _damage() -> tuple[type[Exception], ...]:
    """The errors of packets that cannot be read, and of streams that begin later."""
    return needed("av").FFmpegError, IndexError


def _doubts(doubted: list[tuple[int, float]]) -> str:
    """A sentence about stamps that cannot be right."""
    number, stamp = doubted[0]
    if len(doubted) == 1:
        frames = "1 frame has a time stamp"
    else:
        frames = f"{len(doubted)} frames have time stamps"
    return (
        f"{frames} that cannot be right, repeated or out of order (frame {number}: {stamp:.3f} s);"
        " their times are taken from the frames around them"
    )


def _pictures_from(
    container: Any,
    stream: Any,
    stamps: list[int],
    losses: list[tuple[int, str]],
    source: VideoSource | None = None,
) -> Iterator[Any]:
    """The pictures of `_pictures`, from the last of the stamps on; all if there are none."""
    if not stamps:
        return _pictures(container, stream, losses, source)
    # Start some pictures earlier, so that those before the next key frame are complete.
    container.seek(stamps[max(0, len(stamps) - 1 - _MAX_REORDERED)], stream=stream)
    return dropwhile(
        lambda picture: picture.pts is not None and picture.pts < stamps[-1],
        _pictures(container, stream, losses, source),
    )


def _pictures(
    container: Any, stream: Any, losses: list[tuple[int, str]], source: VideoSource | None = None
) -> Iterator[Any]:
    """Yield the decoded pictures. Failures are skipped and added to ``losses``, each with the
    number of the frame before it.

    ``source.share`` is set to the share of the file that has been read.
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
    except av.FFmpegError as error:
        losses.append((number, _reason(error)))
    except IndexError:
        # PyAV only knows the streams that existed at the beginning.
        losses.append((number, "it continues with other streams"))


def _video_streams(container: Any) -> list[Any]:
    """The video streams of a container that are no cover, thumbnail or other single picture beside
    a video. The first of them is read.
    """
    streams = [
        stream for stream in container.streams.video if not stream.disposition.value & _PICTURES
    ]
    moving = [stream for stream in streams if stream.frames != 1]
    return moving or streams


def video_stream(container: Any) -> Any | None:
    """The video stream of a container that is read; None if there is none."""
    return next(iter(_video_streams(container)), None)


def _choice(path: str, container: Any) -> str:
    """A sentence if a file has several videos; else empty."""
    streams = _video_streams(container)
    if len(streams) < 2:
        return ""
    sizes = ", ".join(f"{stream.width}x{stream.height}" for stream in streams)
    return (
        f"{shown(path)} has {len(streams)} video streams ({sizes}), and the first of them is read"
    )


def _name(path: str) -> str:
    """The name of a video; without the secrets of an address."""
    if "://" in path:
        return named(path)
    return readable_name(Path(path).stem)


def _reason(error: Exception) -> str:
    """FFmpeg's description of an error, without its call and number."""
    return str(getattr(error, "strerror", "") or error)


@contextmanager
def _open(path: str) -> Iterator[tuple[Any, Any]]:
    """The container and its `video_stream`. Raises `InputError` if there is none."""
    av = needed("av")
    remote = "://" in path
    try:
        container: Any = av.open(
            filled(path) if remote else ffmpeg_name(path),
            timeout=(CONNECT, READ) if remote else None,
            metadata_errors="replace",
        )
    except (av.FFmpegError, OSError, ValueError, LookupError) as error:
        reason = _reason(error)
        if isinstance(error, av.ExitError):
            reason = f"no answer in {CONNECT:g} s"
        cure = (
            "Check that it is a complete video file: an mp4 cut off during recording or copying has"
            " no index. `ffmpeg -i IN -c:v libx264 OUT.mp4` converts most other formats."
        )
        if remote:
            cure = "Check the address, and that the device is on and reachable from here."
        raise InputError(
            f"this cannot be read as a video ({reason})", where=path, cure=cure
        ) from None
    with container:
        stream = video_stream(container)
        if stream is None:
            found = ", only a picture such as a cover" if container.streams.video else ""
            raise InputError(
                f"there is no video in this file{found}",
                where=path,
                cure=f"Give another one, or {_CONVERT}.",
            )
        if stream.codec_context is None:
            raise InputError(
                "FFmpeg has no decoder for the video in this file",
                where=path,
                cure=f"Give another one, or {_CONVERT}.",
            )
        # A second thread takes the memory of a dozen pictures, and helps only above 1080p.
        large = stream.width * stream.height > _LARGE
        stream.thread_type = "AUTO"
        stream.codec_context.thread_count = 2 if large else 1
        yield container, stream


class _Converter(threading.local):
    """FFmpeg's converter of pictures, one per thread: setting it up takes longer than converting a
    picture.
    """

    def __init__(self) -> None:
        self.reformat = needed("av.video.reformatter").VideoReformatter().reformat


@cache
def _converter() -> _Converter:
    return _Converter()


def bgr(picture: Any, width: int, height: int) -> Image:
    """(H, W, 3) BGR uint8 from a picture that FFmpeg has decoded.

    Parameters
    ----------
    picture : an `av.VideoFrame`.
    width, height : of the image in pixels.
    """
    converted = _converter().reformat(picture, width, height, "bgr24", interpolation="AREA")
    return np.asarray(converted.to_ndarray(), np.uint8)


class Decoded:
    """A picture that FFmpeg has decoded, rotated as the recording's orientation requires."""

    __slots__ = ("_image", "_picture", "_prepared", "_turns", "size")

    def __init__(self, picture: Any) -> None:
        self._picture = picture
        self._turns = round(picture.rotation / 90) % 4
        self.size: tuple[int, int] = (picture.width, picture.height)
        if self._turns % 2:
            self.size = (picture.height, picture.width)
        self._image: Image | None = None
        self._prepared: tuple[tuple[int, int], Image] | None = None

    def prepare(self, size: tuple[int, int]) -> None:
        """Convert to planes of this width and height now, for the next call of `planes`."""
        self._prepared = size, self.planes(size)

    def bgr(self, size: tuple[int, int] | None = None) -> Image:
        """(H, W, 3) BGR uint8 of this width and height, or of its own size, which is converted only
        once.
        """
        if size is None and self._image is not None:
            return self._image
        unrotated = bgr(self._picture, *self._unrotated(size or self.size))
        image = np.ascontiguousarray(np.rot90(unrotated, self._turns))
        if size is None:
            self._image = image
        return image

    def planes(self, size: tuple[int, int] | None = None) -> Image:
        """The planes of `Picture.planes`."""
        prepared = self._prepared
        self._prepared = None
        if prepared is not None and prepared[0] == (size or self.size):
            return prepared[1]
        picture = self._picture
        width, height = self._unrotated(size or self.size)
        full_range = picture.color_range == _FULL_RANGE
        same_size = (width, height) == (picture.width, picture.height)
        if full_range or not same_size or picture.format.name != "yuv420p":
            # Versions of PyAV before 18 do not take the range from the picture.
            picture = _converter().reformat(
                picture,
                width,
                height,
                "yuv420p",
                interpolation="AREA",
                src_color_range="JPEG" if full_range else None,
                dst_color_range="MPEG",
            )
        half = ((width + 1) // 2, (height + 1) // 2)
        out: Image = np.empty(width * height + 2 * half[0] * half[1], np.uint8)
        start = 0
        sizes = ((width, height), half, half)
        for plane, (columns, rows) in zip(picture.planes, sizes, strict=True):
            lines = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
            part = np.rot90(lines[:rows, :columns], self._turns)
            out[start : start + part.size].reshape(part.shape)[:] = part
            start += part.size
        return out

    def _unrotated(self, size: tuple[int, int]) -> tuple[int, int]:
        """Width and height before rotation of a picture that has this size after it."""
        width, height = size
        if self._turns % 2:
            return height, width
        return width, height
