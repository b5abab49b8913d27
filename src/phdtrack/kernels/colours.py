"""Histograms of brightness and of colour differences in the stripes of boxes."""

from __future__ import annotations

import numpy as np

from phdtrack.kernels import F4, F8, I8, U1
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER

# Parts of a bin in which the place of a value is counted, as a power of two.
SHIFT = 8
ONE = 1 << SHIFT
# Added to a value, which may be a difference, for its row in a table.
OFFSET = 255
# Pixels that a box must show.
LEAST_PIXELS = 16.0


@njit(**INNER)
def add_row(
    image: U1, y: int, left: float, width: float, across: F8, weights: I8, places: I8, counts: I8
) -> None:
    """Add the pixels in row ``y`` of a box that begins at ``left`` to the ``counts`` (m + 1,)."""
    for j in range(len(across)):
        x = np.floor(left + across[j] * width)
        if not 0.0 <= x < image.shape[1]:
            continue
        blue = np.int64(image[y, int(x), 0])
        green = np.int64(image[y, int(x), 1])
        red = np.int64(image[y, int(x), 2])
        bright = (29 * blue + 150 * green + 77 * red) >> 8
        for part, value in enumerate((bright, blue - bright, red - bright)):
            place = places[part, value + OFFSET]
            share = weights[j] * (place & (ONE - 1))
            counts[place >> SHIFT] += ONE * weights[j] - share
            counts[(place >> SHIFT) + 1] += share


@njit(**ENTRY)
def colour_histograms(
    image: U1, boxes: F8, across: F8, weights: I8, rows: tuple[int, int], places: I8, ends: I8
) -> F4:
    """(n, stripes · m) square roots of the shares of the pixels of boxes (n, 4) in m bins, of each
    stripe from the top; 0 for a box that shows fewer than `LEAST_PIXELS`.

    ``image``: (h, w, 3) BGR. ``across`` (c,): the columns of pixels that are taken, in shares of a
    box's width, with their ``weights`` (c,). ``rows``: the number of stripes, and of rows of pixels
    in each. Pixels outside the image do not count. ``places`` (3, 511): the bin, times `ONE`, of
    each value of the brightness, and of blue and red less that; the remainder is the share of the
    next bin. ``ends`` (3,): one more than the last bin of each. Each stripe has the squared norm
    1/stripes: half for the brightness, a quarter for each difference.
    """
    stripes, levels = rows
    length = ends[-1]
    counts = np.empty(length + 1, np.int64)
    out = np.zeros((len(boxes), stripes * length), np.float32)
    for k in range(len(boxes)):
        left, top, right, bottom = boxes[k]
        seen_width = min(right, image.shape[1]) - max(left, 0.0)
        seen_height = min(bottom, image.shape[0]) - max(top, 0.0)
        if not (seen_width > 0.0 and seen_width * seen_height >= LEAST_PIXELS):
            continue
        for s in range(stripes):
            counts[:] = 0
            for i in range(s * levels, (s + 1) * levels):
                y = np.floor(top + (i + 0.5) / (stripes * levels) * (bottom - top))
                if 0.0 <= y < image.shape[0]:
                    add_row(image, int(y), left, right - left, across, weights, places, counts)
            first = 0
            for part in range(3):
                total = counts[first : ends[part]].sum()
                share = 0.5 if part == 0 else 0.25
                for b in range(first, ends[part]):
                    if counts[b]:
                        out[k, s * length + b] = np.sqrt(share / stripes * counts[b] / total)
                first = ends[part]
    return out
