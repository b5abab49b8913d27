"""Writing mp4 that plays in a browser: H.264, 4:2:0, even sizes, the index before the pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phdtrack.errors import InputError, needed
from phdtrack.files import cannot_write, ffmpeg_name, part_of, publish
from phdtrack.types import Image

ENCODERS = [
    "libx264",
    "libopenh264",
    "h264_videotoolbox",
    "h264_mf",
    "h264_nvenc",
    "h264_qsv",
    "h264_amf",
    "h264_v4l2m2m",
]
_LARGEST_DENOMINATOR = 1001
_LARGEST_ASPECT = 255
# Seconds between two pictures at a constant rate, at most.
_SLOWEST = Fraction(1_000_000)
# The least number of ticks in a second by which times are rounded.
_TICKS_PER_SECOND = 50_000
# Ticks between two pictures at most: mp4 has 31 bits for a few of them.
_MOST_TICKS = 2**29
# x264's output depends on the number of threads, so it is the same on every machine, with one frame
# per thread. Macroblock-tree rate control (mbtree) is off because it makes output unrepeatable.
_THREADS = 4
# No picture waits for later ones, and each has one reference picture: stored pictures take 12 MB
# each at 1080p. So does a second thread; up to 1080p one thread is fast enough.
_FAST = ":bframes=0:rc-lookahead=0:ref=1:weightp=0:subme=0:me=dia"
_LARGE = 1920 * 1088


class Coding(NamedTuple):
    """How a video is compressed.

    Attributes
    ----------
    quality : constant rate factor from 0 (lossless) to 51, if the encoder has one; 23 is usual.
    fast : x264 takes less than half the time and a quarter of the memory, but files are two to
        three times as large.
    """

    quality: int = 23
    fast: bool = False


USUAL = Coding()
FAST = Coding(fast=True)


class VideoWriter:
    """Writes BGR images, at a constant rate or at their own times; close it, or use it in a
    ``with`` statement.

    The file gets its name when it is closed. Before, and if an error leaves the ``with`` block, its
    name ends in ``.part``.

    Parameters
    ----------
    path : the file, which is overwritten; its folder must exist.
    width, height : of the images in pixels. An odd size is padded by one row or column, because
        H.264 needs even sizes.
    fps : frames per second, possibly a fraction (29.97).
    coding : quality and speed.
    pixel_aspect : width of a pixel as it is displayed, divided by its height.
    fragmented : the file has its name at once, and can be played even if it is never closed, except
        for the last seconds.

    Raises
    ------
    InputError : the file cannot be written, or no H.264 encoder works here.
    """

    def __init__(
        self,
        path: str | Path,
        width: int,
        height: int,
        fps: float,
        *,
        coding: Coding = USUAL,
        fragmented: bool = False,
        pixel_aspect: float = 1.0,
    ) -> None:
        if width < 1 or height < 1 or not fps > 0 or not np.isfinite(fps):
            raise InputError(
                f"a video needs a size and a rate above 0, got {width}x{height} at {fps} frames/s",
                where=path,
            )
        av = needed("av")
        self._path = Path(path)
        self._width = width
        self._height = height
        self._file = self._path if fragmented else part_of(self._path)
        rate = _as_fraction(fps)
        padded = (width + width % 2, height + height % 2)
        # A picture takes so many ticks of the clock at a constant rate. Times are rounded to ticks.
        self._ticks = min(math.ceil(_TICKS_PER_SECOND / rate), _MOST_TICKS)
        self._per_second = float(rate * self._ticks)
        name = _working_encoder(*padded, rate)
        options = dict[str, str]()
        if name == "libx264":
            options = _x264_options(width, height, coding)
        muxing = {"movflags": "+faststart"}
        if fragmented:
            # One fragment per second, written to the file at once.
            muxing = {
                "movflags": "+frag_keyframe+empty_moov",
                "frag_duration": "1000000",
                "flush_packets": "1",
            }
        try:
            self._container: Any = av.open(
                ffmpeg_name(self._file), "w", format="mp4", options=muxing
            )
            self._stream: Any = self._container.add_stream(name, rate=rate, options=options)
            self._stream.width, self._stream.height = padded
            self._stream.pix_fmt = "yuv420p"
            self._stream.codec_context.time_base = 1 / (rate * self._ticks)
            aspect = Fraction(pixel_aspect).limit_denominator(_LARGEST_ASPECT)
            if aspect != 1:
                self._stream.codec_context.sample_aspect_ratio = aspect
            self._container.start_encoding()
        except (av.FFmpegError, OSError) as error:
            raise cannot_write(path, error) from None
        # Frames written so far.
        self.frames = 0
        # Ticks since the first picture, and the time of that one.
        self._stamp = -self._ticks
        self._begin = math.nan
        self._open = True

    def write(self, image: Image, at: float = math.nan) -> None:
        """Append a picture.

        Parameters
        ----------
        image : (height, width, 3) BGR uint8, or `Decoded.planes` as (3H/2, W). Raises `InputError`
            for anything else.
        at : its time in seconds, for a video with the times of its pictures instead of a constant
            rate. The first picture is shown at the beginning, whatever its time.
        """
        av = needed("av")
        planes = image.shape == (self._height * 3 // 2, self._width)
        if (
            not planes and image.shape != (self._height, self._width, 3)
        ) or image.dtype != np.uint8:
            raise InputError(
                f"expected an image of shape {(self._height, self._width, 3)} and type uint8, got"
                f" {image.shape} and {image.dtype}",
                where=f"{self._path}, frame {self.frames + 1}",
            )
        if not self._open:
            raise InputError("this video is already closed", where=self._path)
        odd = (self._height % 2, self._width % 2)
        padded = np.ascontiguousarray(image)
        if any(odd) and not planes:
            padded = np.pad(image, ((0, odd[0]), (0, odd[1]), (0, 0)), mode="edge")
        picture = av.VideoFrame.from_numpy_buffer(padded, format="yuv420p" if planes else "bgr24")
        self._stamp = self._next_stamp(at)
        picture.pts = self._stamp
        picture.time_base = self._stream.codec_context.time_base
        with self._checked():
            self._container.mux(self._stream.encode(picture))
        self.frames += 1

    def _next_stamp(self, at: float) -> int:
        """The ticks of a picture at a time, or at the next one of a constant rate if it is NaN."""
        if math.isnan(at):
            return self._stamp + self._ticks
        if math.isnan(self._begin):
            self._begin = at - (self._stamp + self._ticks) / self._per_second
        due = max(self._stamp + 1, round((at - self._begin) * self._per_second))
        if due > self._stamp + _MOST_TICKS:
            # A pause of many hours is shortened to what the format can express.
            due = self._stamp + _MOST_TICKS
            self._begin = at - due / self._per_second
        return due

    def close(self, *, complete: bool = True) -> None:
        """Finish the file; a second call does nothing. Unless ``complete``, it keeps its temporary
        name.
        """
        if not self._open:
            return
        self._open = False
        with self._checked():
            if self.frames:
                self._container.mux(self._stream.encode(None))
            self._container.close()
            if complete and self._file != self._path:
                publish(self._path)

    @contextmanager
    def _checked(self) -> Iterator[None]:
        """Turn errors of the disk into an `InputError`."""
        av = needed("av")
        try:
            yield
        except (av.FFmpegError, OSError) as error:
            raise cannot_write(self._path, error) from error

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(complete=kind is None)


def _as_fraction(fps: float) -> Fraction:
    """A rate above 0 as a fraction with small numbers, such as 30000/1001, or 1/3600."""
    if fps >= 1:
        return Fraction(fps).limit_denominator(_LARGEST_DENOMINATOR)
    return 1 / min(Fraction(1 / fps).limit_denominator(_LARGEST_DENOMINATOR), _SLOWEST)


def _x264_options(width: int, height: int, coding: Coding) -> dict[str, str]:
    """The options of x264."""
    if coding.fast:
        threads = 1 + (width * height > _LARGE)
        return {
            "crf": str(coding.quality),
            "preset": "ultrafast",
            "x264-params": f"threads={threads}:sliced-threads=0:mbtree=0{_FAST}",
        }
    return {
        "crf": str(coding.quality),
        "preset": "veryfast",
        "x264-params": f"threads={_THREADS}:sliced-threads=0:mbtree=0",
    }


def _working_encoder(width: int, height: int, rate: Fraction) -> str:
    """The first of `ENCODERS` that opens: FFmpeg also lists some whose device is missing."""
    av = needed("av")
    for name in ENCODERS:
        try:
            context: Any = av.CodecContext.create(name, "w")
            context.width = width
            context.height = height
            context.pix_fmt = "yuv420p"
            context.time_base = 1 / rate
            context.framerate = rate
            context.open()
        except (av.FFmpegError, ValueError, OSError):
            continue
        return name
    cure = "Install a build of PyAV that has one: python -m pip install --force-reinstall av"
    raise InputError(f"no H.264 encoder works here; tried {', '.join(ENCODERS)}", cure=cure)
