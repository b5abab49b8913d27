"""Frames to an mp4 file that plays in a browser: H.264, 4:2:0, even sizes, the index in front of the pictures."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import Image

ENCODERS = ["libx264", "libopenh264", "h264_videotoolbox", "h264_mf", "h264_nvenc", "h264_qsv", "h264_amf", "h264_v4l2m2m"]
_LARGEST_DENOMINATOR = 1001
# The same on every machine, each thread with a frame of its own: x264's pictures depend on the number of threads.
_THREADS = 4


class VideoWriter:
    """Writes BGR images at a constant rate; close it, or use it in a ``with`` statement.

    Parameters
    ----------
    path : the file, which is overwritten; its folder must exist.
    width, height : of the images in pixels. An odd size is padded by one row or column, for H.264 needs even ones.
    fps : frames per second, fractions too (29.97).
    quality : constant rate factor from 0 (lossless) to 51 where the encoder has one; 23 is usual.

    Raises InputError where the file cannot be written or no H.264 encoder works here.
    """

    def __init__(self, path: str | Path, width: int, height: int, fps: float, *, quality: int = 23) -> None:
        if width < 1 or height < 1 or not fps > 0 or not np.isfinite(fps):
            raise InputError(
                f"a video needs a size and a rate above 0, not {width}x{height} at {fps} per second", where=path
            )
        import av

        self._path, self._width, self._height = str(path), width, height
        rate = Fraction(fps).limit_denominator(_LARGEST_DENOMINATOR)
        padded = (width + width % 2, height + height % 2)
        name, options = _working_encoder(*padded, rate), dict[str, str]()
        if name == "libx264":
            options = {"crf": str(quality), "preset": "veryfast", "x264-params": f"threads={_THREADS}:sliced-threads=0"}
        try:
            self._container: Any = av.open(self._path, "w", format="mp4", options={"movflags": "+faststart"})
            self._stream: Any = self._container.add_stream(name, rate=rate, options=options)
            self._stream.width, self._stream.height = padded
            self._stream.pix_fmt = "yuv420p"
            self._container.start_encoding()
        except (av.FFmpegError, OSError) as error:
            raise InputError(
                f"this file cannot be written ({error.strerror})", where=path, cure="Check the folder and its permissions."
            ) from None
        self.frames = 0  # written so far
        self._open = True

    def write(self, image: Image) -> None:
        """Append ``image``, (height, width, 3) BGR uint8; InputError where it is of another shape or type."""
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
        picture.pts = self.frames
        picture.time_base = 1 / self._stream.codec_context.framerate
        self._container.mux(self._stream.encode(picture))
        self.frames += 1

    def close(self) -> None:
        """Finish the file; a second call does nothing."""
        if not self._open:
            return
        self._open = False
        if self.frames:
            self._container.mux(self._stream.encode(None))
        self._container.close()

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


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
