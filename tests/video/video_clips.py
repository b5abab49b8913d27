"""Pictures and files that the tests of video make for themselves."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from phdtrack.types import Image


def picture(index: int, width: int = 64, height: int = 48) -> Image:
    """Grey, with a bright square that moves two pixels to the right per frame."""
    image = np.full((height, width, 3), 60, np.uint8)
    image[16:32, 2 * index % width : 2 * index % width + 12] = (40, 120, 220)
    return image


def encode(
    path: Path, images: Sequence[Image], stamps: Sequence[int], *, per_second: int = 1000
) -> None:
    """A Matroska file with one picture per time stamp, in units of 1/``per_second`` s."""
    with av.open(str(path), "w", format="matroska") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, per_second)
        for image, stamp in zip(images, stamps, strict=True):
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts = stamp
            frame.time_base = Fraction(1, per_second)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
