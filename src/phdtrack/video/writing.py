"""Videos are written as mp4 that plays in a browser: H.264, 4:2:0, even sizes, the index in front
of the pictures.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.errors import InputError, needed
from phdtrack.files import cannot_write, part_of, publish
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
# The same on every machine, each thread with a frame of its own: x264's pictures depend on the
# number of threads. Its tree of macroblocks (mbtree) is off, as with it the same pictures are now
# and then encoded in another way.
_THREADS = 4
# No picture waits for later ones, and each is compared with one other: these are what takes memory,
# 12 MB each at 1080p. A second thread takes as much; up to that size one keeps up with what reads
# and draws the pictures.
_FAST = ":bframes=0:rc-lookahead=0:ref=1:weightp=0:subme=0:me=dia"
_LARGE = 1920 * 1088


class VideoWriter:
    """Writes BGR images at a constant rate; close it, or use it in a ``with`` statement.

    The file has its name when it is closed; until then, or where a ``with`` block is left by an
    error, it ends in ``.part``.

    Parameters
    ----------
    path : the file, which is overwritten; its folder must exist.
    width, height : of the images in pixels. An odd size is padded by one row or column, for H.264
        needs even ones.
    fps : frames per second, fractions too (29.97).
    quality : constant rate factor from 0 (lossless) to 51 where the encoder has one; 23 is usual.
    fast : it takes x264 less than half of the time and a quarter of the memory, and files are two
        to three times as large.
    fragmented : it has its name at once, and what is written can be played also when the file is
        never closed, but for the last seconds.

    Raises InputError where the file cannot be written or no H.264 encoder works here.
    """

    def __init__(
        self,
        path: str | Path,
        width: int,
        height: int,
        fps: float,
        *,
        quality: int = 23,
        fast: bool = False,
        fragmented: bool = False,
    ) -> None:
        if width < 1 or height < 1 or not fps > 0 or not np.isfinite(fps):
            problem = (
                f"a video needs a size and a rate above 0, not {width}x{height} at {fps} per second"
            )
            raise InputError(problem, where=path)
        av = needed("av")
        self._path = Path(path)
        self._width = width
        self._height = height
        if fragmented:
            self._grown = self._path
        else:
            self._grown = part_of(self._path)
        rate = Fraction(fps).limit_denominator(_LARGEST_DENOMINATOR)
        padded = (width + width % 2, height + height % 2)
        name = _working_encoder(*padded, rate)
        options = dict[str, str]()
        if name == "libx264":
            if fast:
                threads = 1 + (width * height > _LARGE)
            else:
                threads = _THREADS
            options = {"crf": str(quality), "preset": "ultrafast" if fast else "veryfast"}
            options["x264-params"] = f"threads={threads}:sliced-threads=0:mbtree=0" + _FAST * fast
        try:
            muxing = {"movflags": "+faststart"}
            if fragmented:
                # A fragment a second, which goes to the file at once.
                muxing = {
                    "movflags": "+frag_keyframe+empty_moov",
                    "frag_duration": "1000000",
                    "flush_packets": "1",
                }
            self._container: Any = av.open(str(self._grown), "w", format="mp4", options=muxing)
            self._stream: Any = self._container.add_stream(name, rate=rate, options=options)
            self._stream.width, self._stream.height = padded
            self._stream.pix_fmt = "yuv420p"
            self._container.start_encoding()
        except (av.FFmpegError, OSError) as error:
            raise cannot_write(path, error) from None
        self.frames = 0
        self._stamp = -1
        self._fps = float(rate)  # frames written so far
        self._open = True

    def write(self, image: Image, at: float = math.nan) -> None:
        """Append ``image``, (height, width, 3) BGR uint8, or `Decoded.planes` as (3H/2, W);
        InputError otherwise.

        ``at``: its time in seconds, where the video is to have the times of its pictures and not a
        constant rate.
        """
        av = needed("av")
        planes = image.shape == (self._height * 3 // 2, self._width)
        if (
            not planes and image.shape != (self._height, self._width, 3)
        ) or image.dtype != np.uint8:
            expected = f"expected an image of shape {(self._height, self._width, 3)} and type uint8"
            problem = f"{expected}, got {image.shape} and {image.dtype}"
            raise InputError(problem, where=f"{self._path}, frame {self.frames + 1}")
        if not self._open:
            raise InputError("this video is closed already", where=self._path)
        if planes:
            odd = (0, 0)
        else:
            odd = (self._height % 2, self._width % 2)
        if any(odd):
            padded = np.pad(image, ((0, odd[0]), (0, odd[1]), (0, 0)), mode="edge")
        else:
            padded = np.ascontiguousarray(image)
        picture = av.VideoFrame.from_numpy_buffer(padded, format="yuv420p" if planes else "bgr24")
        if math.isnan(at):
            self._stamp = self._stamp + 1
        else:
            self._stamp = max(self._stamp + 1, round(at * self._fps))
        picture.pts = self._stamp
        picture.time_base = 1 / self._stream.codec_context.framerate
        with self._checked():
            self._container.mux(self._stream.encode(picture))
        self.frames += 1

    def close(self, *, complete: bool = True) -> None:
        """Finish the file; a second call does nothing. Where it is not ``complete`` it keeps the
        name that it grew under.
        """
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
        av = needed("av")
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
