"""From what a user writes ("street.mp4", "frames/", "img/*.png", "0", "rtsp://…") to a source of frames.

The files of a folder or a glob pattern of images are put in natural order (``img2`` before ``img10``). The last number in
each name says which frame it is, counted from the first file as frame 1 in steps of the names' common divisor: a file
missing from ``000001.jpg 000002.jpg 000004.jpg`` is a dropped frame, and the time between frames 2 and 4 is two intervals.
Names without numbers, names whose numbers do not increase, and names in which more than nine frames in ten would be missing
(time stamps) are only counted.

A video is opened once for its first frame, which settles size, orientation and rate (headers are often wrong), and once for
each iteration. Packets that cannot be decoded are skipped; a file cut short gives the frames that it has.

Videos are written as mp4 that plays in a browser: H.264, 4:2:0, even sizes, the index in front of the pictures.
"""

from __future__ import annotations

import difflib
import glob
import math
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import cannot_write, part_of, publish, refuse_part
from phdtrack.types import Frame, Image, SequenceInfo

SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"})
_MOST_MISSING, _DEFAULT_FPS = 10, 25.0
# Seconds to wait for an address: until it is open, and for more of what it sends.
CONNECT, READ = 10.0, 10.0
Read = tuple[int, float | None, Image, str]
"""A frame's number, its time stamp in seconds (None where the stream has none), its picture, and where it is in words."""


@dataclass(slots=True, eq=False)
class VideoSource:
    """Frames in order; their times are seconds since the first one, strictly increasing.

    A stamp that is missing, or not later than the one before, counts as one interval after it. A stream that jumps back (two
    recordings joined) goes on from there, with the intervals that its later stamps have.

    Attributes
    ----------
    info : size in pixels as shown, rate, name; ``frames`` is 0 where only decoding gives it.
    read : given this record, the frames; it sets ``problem``.
    note : what was assumed because it was not given (the rate of a folder of images); empty where nothing was.
    problem : after the iteration: why the frames ended early, or which were lost; empty where all were read.
    """

    info: SequenceInfo
    read: Callable[[VideoSource], Iterator[Read]]
    note: str = ""
    problem: str = ""

    def __iter__(self) -> Iterator[Frame]:
        """The frames. Raises `InputError` for a picture of another size than the first; empty ones pass."""
        self.problem, interval = "", 1 / self.info.fps
        last, zero = -interval, math.nan
        for number, stamp, image, where in self.read(self):
            high, wide = image.shape[:2]
            if image.size and (wide, high) != (self.info.width, self.info.height):
                raise InputError(
                    f"this frame is {wide}x{high} pixels, the first one {self.info.width}x{self.info.height}",
                    where=where,
                    cure="All frames of a sequence need one size: split the input where the size changes.",
                )
            moment = math.nan if stamp is None else stamp - zero
            last = moment if moment > last else last + interval
            if stamp is not None:
                zero = stamp - last
            yield Frame(number, last, image)


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
    refuse_part(path)
    if path.is_dir():
        return _images([file for file in path.iterdir() if file.suffix.lower() in SUFFIXES], fps, path)
    if "://" in text or path.exists():
        # `phdtrack.live` reads what never ends.
        return _video(text, fps)
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


def _rate(rate: float, what: str) -> tuple[float, str]:
    """The rate in frames per second, and a note where it is not known (0)."""
    return (rate, "") if rate > 0 else (_DEFAULT_FPS, f"{what} not state its rate; {_DEFAULT_FPS:g} frames a second assumed")


def _images(files: Sequence[Path], fps: float, folder: Path) -> VideoSource:
    """Images as frames. MOTChallenge puts those of every sequence into ``NAME/img1``, which is called NAME."""
    folder = folder.resolve()
    name = folder.parent.name if folder.name == "img1" else folder.name
    if not files:
        raise InputError("there is no image", where=name, cure=f"Files that end in {', '.join(sorted(SUFFIXES))} are read.")
    # Runs of digits compare as numbers.
    paths = sorted(files, key=lambda path: re.sub(r"\d+", lambda digits: digits[0].zfill(30), path.name))
    numbers = frame_numbers([path.stem for path in paths])
    rate, note = _rate(fps, "images do")
    height, width = _image(paths[0]).shape[:2]

    def read(_: VideoSource) -> Iterator[Read]:
        for path, number in zip(paths, numbers, strict=True):
            yield number, (number - 1) / rate, _image(path), f"{path}, frame {number}"

    return VideoSource(SequenceInfo(width, height, rate, len(paths), name), read, note)


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


def _camera(index: int, fps: float) -> VideoSource:
    """Frames of camera ``index`` (from 0), until it stops or the caller does.

    A frame's stamp is when it arrived: a camera delivers no time stamps that mean the same on every system.
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
    rate, note = _rate(fps or capture.get(cv2.CAP_PROP_FPS), f"camera {index} does")

    def read(source: VideoSource) -> Iterator[Read]:
        number = 0
        try:
            while (shot := capture.read())[0]:
                number += 1
                yield number, time.monotonic(), np.asarray(shot[1], np.uint8), f"camera {index}, frame {number}"
            source.problem = f"camera {index}: no more pictures after frame {number}"
        finally:
            capture.release()

    return VideoSource(SequenceInfo(width, height, rate, 0, f"camera{index}"), read, note)


def _video(path: str, fps: float) -> VideoSource:
    """The frames of a video file or of an address that FFmpeg can open, in order of presentation.

    ``fps`` above 0 replaces the stream's time stamps. Raises `InputError` where no frame can be decoded.
    """
    losses: list[tuple[int, str]] = []
    container, stream = _open(path)
    with container:
        stated = stream.average_rate or stream.guessed_rate or stream.base_rate
        picture = next(_pictures(container, stream, losses), None)
    if picture is None:
        raise InputError(
            f"no frame could be decoded{f' ({losses[0][1]})' if losses else ''}",
            where=path,
            cure="The file is empty or damaged: copy it again, or convert it (ffmpeg -i IN -c:v libx264 OUT.mp4).",
        )
    rate, note = _rate(float(fps or stated or 0), f"{path} does")
    height, width = _upright(picture).shape[:2]

    def read(source: VideoSource) -> Iterator[Read]:
        losses: list[tuple[int, str]] = []
        number = 0
        container, stream = _open(path)
        with container:
            for number, picture in enumerate(_pictures(container, stream, losses), start=1):
                yield number, None if fps else picture.time, _upright(picture), f"{path}, frame {number}"
        if losses:
            after, reason = losses[0]
            source.problem = f"{path}: damaged after frame {after} ({reason}); {number} frames could be decoded"
        elif number < stream.frames:
            source.problem = f"{path}: ends after frame {number}, its header announces {stream.frames}; it may be cut short"

    return VideoSource(SequenceInfo(width, height, rate, name=Path(path).stem), read, note)


def _reason(error: Exception) -> str:
    """What FFmpeg says, without its call and number."""
    return str(getattr(error, "strerror", "") or error)


def _open(path: str) -> tuple[Any, Any]:
    """The container and its first video stream."""
    import av

    remote = "://" in path
    try:
        container: Any = av.open(path, timeout=(CONNECT, READ) if remote else None, metadata_errors="replace")
    except (av.FFmpegError, OSError, ValueError) as error:
        cure = "Check that it is a whole video file: an mp4 cut off while it was recorded or copied has no index. "
        cure += "`ffmpeg -i IN -c:v libx264 OUT.mp4` converts most other kinds."
        if remote:
            cure = "Check the address, and that what it names is switched on and can be reached from here."
        late = f"no answer in {CONNECT:g} s" if isinstance(error, av.ExitError) else _reason(error)
        raise InputError(f"this cannot be read as a video ({late})", where=path, cure=cure) from None
    if not container.streams.video:
        container.close()
        raise InputError("there is no video in this file", where=path, cure="Give one with pictures.")
    stream = container.streams.video[0]
    stream.thread_type = "AUTO"
    return container, stream


def _pictures(container: Any, stream: Any, losses: list[tuple[int, str]]) -> Iterator[Any]:
    """The decoded pictures; what fails is added to ``losses``, with the number of the frame before it, and passed over."""
    import av

    number = 0
    try:
        for packet in container.demux(stream):
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
        reason = "it goes on with other streams" if isinstance(error, IndexError) else _reason(error)
        losses.append((number, reason))


def _upright(picture: Any) -> Image:
    """(H, W, 3) BGR uint8, turned by the orientation that the recording carries."""
    image: Image = picture.to_ndarray(format="bgr24")
    turns = round(picture.rotation / 90) % 4
    return np.ascontiguousarray(np.rot90(image, turns)) if turns else image


def endless(path: str) -> bool:
    """Whether an address names something without an end, as a camera does: neither its length nor its duration is known.

    Raises `InputError` where it cannot be opened.
    """
    container, stream = _open(path)
    with container:
        return not stream.frames and container.duration is None


ENCODERS = ["libx264", "libopenh264", "h264_videotoolbox", "h264_mf", "h264_nvenc", "h264_qsv", "h264_amf", "h264_v4l2m2m"]
_LARGEST_DENOMINATOR = 1001
# The same on every machine, each thread with a frame of its own: x264's pictures depend on the number of threads. Its tree
# of macroblocks (mbtree) is off, as with it the same pictures are now and then encoded in another way.
_THREADS = 4


class VideoWriter:
    """Writes BGR images at a constant rate; close it, or use it in a ``with`` statement.

    The file has its name when it is closed; until then, or where a ``with`` block is left by an error, it ends in ``.part``.

    Parameters
    ----------
    path : the file, which is overwritten; its folder must exist.
    width, height : of the images in pixels. An odd size is padded by one row or column, for H.264 needs even ones.
    fps : frames per second, fractions too (29.97).
    quality : constant rate factor from 0 (lossless) to 51 where the encoder has one; 23 is usual.
    fragmented : it has its name at once, and what is written can be played also when the file is never closed, but for the
        last seconds.

    Raises InputError where the file cannot be written or no H.264 encoder works here.
    """

    def __init__(
        self, path: str | Path, width: int, height: int, fps: float, *, quality: int = 23, fragmented: bool = False
    ) -> None:
        if width < 1 or height < 1 or not fps > 0 or not np.isfinite(fps):
            raise InputError(
                f"a video needs a size and a rate above 0, not {width}x{height} at {fps} per second", where=path
            )
        import av

        self._path, self._width, self._height = Path(path), width, height
        self._grown = self._path if fragmented else part_of(self._path)
        rate = Fraction(fps).limit_denominator(_LARGEST_DENOMINATOR)
        padded = (width + width % 2, height + height % 2)
        name, options = _working_encoder(*padded, rate), dict[str, str]()
        if name == "libx264":
            parameters = f"threads={_THREADS}:sliced-threads=0:mbtree=0"
            options = {"crf": str(quality), "preset": "veryfast", "x264-params": parameters}
        try:
            muxing = {"movflags": "+faststart"}
            if fragmented:
                # A fragment a second, which goes to the file at once.
                muxing = {"movflags": "+frag_keyframe+empty_moov", "frag_duration": "1000000", "flush_packets": "1"}
            self._container: Any = av.open(str(self._grown), "w", format="mp4", options=muxing)
            self._stream: Any = self._container.add_stream(name, rate=rate, options=options)
            self._stream.width, self._stream.height = padded
            self._stream.pix_fmt = "yuv420p"
            self._container.start_encoding()
        except (av.FFmpegError, OSError) as error:
            raise cannot_write(path, error) from None
        self.frames, self._stamp, self._fps = 0, -1, float(rate)  # frames written so far
        self._open = True

    def write(self, image: Image, at: float = math.nan) -> None:
        """Append ``image``, (height, width, 3) BGR uint8; InputError where it is of another shape or type.

        ``at``: its time in seconds, where the video is to have the times of its pictures and not a constant rate.
        """
        import av

        if image.shape != (self._height, self._width, 3) or image.dtype != np.uint8:
            raise InputError(
                f"expected an image of shape {(self._height, self._width, 3)} and type uint8, "
                f"got {image.shape} and {image.dtype}",
                where=f"{self._path}, frame {self.frames + 1}",
            )
        if not self._open:
            raise InputError("this video is closed already", where=self._path)
        odd = (self._height % 2, self._width % 2)
        padded = np.pad(image, ((0, odd[0]), (0, odd[1]), (0, 0)), mode="edge") if any(odd) else np.ascontiguousarray(image)
        picture = av.VideoFrame.from_ndarray(padded, format="bgr24")
        self._stamp = self._stamp + 1 if math.isnan(at) else max(self._stamp + 1, round(at * self._fps))
        picture.pts = self._stamp
        picture.time_base = 1 / self._stream.codec_context.framerate
        with self._checked():
            self._container.mux(self._stream.encode(picture))
        self.frames += 1

    def close(self, *, complete: bool = True) -> None:
        """Finish the file; a second call does nothing. Where it is not ``complete`` it keeps the name that it grew under."""
        if not self._open:
            return
        self._open = False
        with self._checked():
            if self.frames:
                self._container.mux(self._stream.encode(None))
            self._container.close()
            if complete and self._grown != self._path:
                publish(self._path)

    @contextmanager
    def _checked(self) -> Iterator[None]:
        """What goes wrong with the disk, in a sentence."""
        import av

        try:
            yield
        except (av.FFmpegError, OSError) as error:
            raise cannot_write(self._path, error) from error

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(complete=kind is None)


def _working_encoder(width: int, height: int, rate: Fraction) -> str:
    """The first of `ENCODERS` that opens: some are listed by FFmpeg and then lack their device."""
    import av

    for name in ENCODERS:
        try:
            context: Any = av.CodecContext.create(name, "w")
            context.width, context.height, context.pix_fmt = width, height, "yuv420p"
            context.time_base, context.framerate = 1 / rate, rate
            context.open()
        except (av.FFmpegError, ValueError, OSError):
            continue
        return name
    raise InputError(
        f"no H.264 encoder works here; tried {', '.join(ENCODERS)}",
        cure="Install a build of PyAV that has one: python -m pip install --force-reinstall av",
    )
