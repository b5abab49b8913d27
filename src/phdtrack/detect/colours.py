"""Descriptors of boxes by the colours of the picture: no network."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import InputError
from phdtrack.kernels.colours import OFFSET, ONE, colour_histograms
from phdtrack.types import F4, F8, I8, Image

# Stripes of a box from top to bottom, the rows of pixels that are read in each, and the columns.
STRIPES = 6
ROWS = 8
_COLUMNS = 12
# The columns lie in this share of the width, and count as a normal distribution of this deviation,
# in shares of the width: at the sides a box shows the background.
_WIDTH = 0.75
_DEVIATION = 0.175
# Bins of brightness, on a logarithmic scale with this level added, and of each colour difference,
# which only counts up to so many grey levels: most colours are pale.
_BRIGHT_BINS = 16
_DARK = 16.0
_COLOUR_BINS = 8
_MAX_DIFFERENCE = 40
_HALF_WEIGHT = 64


def _places() -> tuple[I8, I8]:
    """(3, 511) where each value is among the bins, and (3,) where the bins of each part end, as the
    kernel takes them.
    """
    value = np.arange(-OFFSET, OFFSET + 1)
    level = np.log1p(np.maximum(value, 0) / _DARK) / np.log1p(255 / _DARK)
    bright = np.rint(level * (_BRIGHT_BINS - 1) * ONE).astype(np.int64)
    clipped = np.clip(value, -_MAX_DIFFERENCE, _MAX_DIFFERENCE) + _MAX_DIFFERENCE
    colour = clipped * (_COLOUR_BINS - 1) * ONE // (2 * _MAX_DIFFERENCE)
    ends = np.cumsum([_BRIGHT_BINS, _COLOUR_BINS, _COLOUR_BINS])
    return np.stack([bright, colour + ends[0] * ONE, colour + ends[1] * ONE]), ends


ACROSS: F8 = 0.5 + _WIDTH * ((np.arange(_COLUMNS) + 0.5) / _COLUMNS - 0.5)
WEIGHTS: I8 = np.rint(_HALF_WEIGHT * np.exp(-0.5 * ((ACROSS - 0.5) / _DEVIATION) ** 2)).astype(
    np.int64
)
PLACES, ENDS = _places()


@dataclass(frozen=True, slots=True)
class Colours:
    """Histograms of brightness and of two colour differences in six horizontal stripes of a box.

    Where a picture has no colours, the histograms of their differences are all the same, and the
    brightness alone distinguishes the boxes: one descriptor for colour, greyscale and infrared.
    """

    @property
    def length(self) -> int:
        """Numbers of a descriptor: 192."""
        return STRIPES * int(ENDS[-1])

    def describe(self, image: Image, boxes: F8) -> F4:
        """(N, 192) descriptors of boxes, in steps of a 16-bit float: square roots of shares, whose
        squares add up to 1; zeros for a box that shows fewer than 16 pixels.

        Parameters
        ----------
        image : (H, W, 3) BGR uint8.
        boxes : (N, 4) left, top, right, bottom in pixels of the image.

        Raises
        ------
        InputError : an image of another shape or type.
        """
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise InputError(
                f"expected an image (H, W, 3) of uint8, got {image.shape} of {image.dtype}"
            )
        read: F4 = colour_histograms(
            image,
            np.ascontiguousarray(boxes, np.float64),
            ACROSS,
            WEIGHTS,
            (STRIPES, ROWS),
            PLACES,
            ENDS,
        )
        # What a file keeps for the next run is the same to the bit.
        return np.asarray(read.astype(np.float16), np.float32)
