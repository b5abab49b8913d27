"""Where births and clutter are spread uniformly: the volumes that decide how fast a target is believed.

What counts is the ratio of the birth density to the clutter density at a measurement. Over the same volume one detection
alone brings a mass of about rate_birth/rate_clutter; how fast further ones raise it depends on the volume's size against
the noise's. ``image``: all positions and all sizes of the frame, W²H² pixel⁴: one more coherent detection suffices.
``local``: ±1 box in position and 0.5 to 1.5 in size around a detection, 4w²h²: about two more. M07's words, "around the
detections", suggest the latter.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8, Bool

Volume = Literal["image", "local"]
# Half the extent of a local volume in position, in boxes; its range of sizes, in boxes.
REACH = 1.0
SIZES = (0.5, 1.5)


def image_area(frame_size: tuple[float, float]) -> float:
    """All positions in the frame, WH pixel²; `InputError` where the frame has no size."""
    width, height = frame_size
    if width <= 0 or height <= 0:
        raise InputError(
            f"a uniform density over the image needs the frame's size, not {width:g}x{height:g}",
            cure="Give --frame-size WxH, or use the local volume",
        )
    return float(width * height)


def image_volume(frame_size: tuple[float, float]) -> float:
    """All positions and sizes of boxes in the frame, W²H² pixel⁴."""
    return image_area(frame_size) ** 2


def local_volume(z: F8) -> F8:
    """(N,) volume of the neighbourhood of each measurement z = (px, py, w, h), pixel⁴."""
    area: F8 = z[2] * z[3]
    return (2 * REACH) ** 2 * (SIZES[1] - SIZES[0]) ** 2 * area**2


def in_neighbourhood(x: F8, z: F8) -> Bool:
    """Whether the boxes x = (px, py, w, h) lie in the neighbourhood of z, elementwise over columns."""
    near: Bool = (np.abs(x[0] - z[0]) <= REACH * z[2]) & (np.abs(x[1] - z[1]) <= REACH * z[3])
    for k in (2, 3):
        near &= (x[k] >= SIZES[0] * z[k]) & (x[k] <= SIZES[1] * z[k])
    return near
