"""Patches of a picture that recur in samples of a video: what does not move comes back the same."""

from __future__ import annotations

import math

import numpy as np

from phdtrack.kernels import I2, I8, U1
from phdtrack.kernels.blobs import mirrored
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, VECTOR


@njit(**ENTRY)
def recurrences(samples: U1, tolerance: int, reach: int, share: float) -> I8:
    """(K, h, w) the number of other samples in which the patch around each pixel of each sample is
    the same.

    Two patches are the same if their middles are, and at least ``share`` of their pixels; two
    pixels are if no channel differs by more than the ``tolerance``.

    Parameters
    ----------
    samples : (K, h, w, 3).
    tolerance : grey levels.
    reach : a patch has 2 · ``reach`` + 1 pixels each way, mirrored at the border.
    share : between 0 and 1.
    """
    count, height, width, _ = samples.shape
    counts = np.zeros((count, height, width), np.int16)
    planes = _planes(samples, reach)
    same = np.empty((height + 2 * reach, width + 2 * reach), np.int16)
    rows = np.empty((height + 2 * reach, width), np.int16)
    least = math.ceil(share * (2 * reach + 1) ** 2)
    agreed = np.empty((height, width), np.int16)
    for k in range(count):
        for j in range(k + 1, count):
            _same(planes, k, j, np.int16(tolerance), same)
            _box_sums(same, reach, rows, agreed)
            _add_where(agreed, same, reach, least, counts, k)
            _add_where(agreed, same, reach, least, counts, j)
    return counts.astype(np.int64)


@njit(**ENTRY)
def same_patches(
    samples: U1, tolerance: int, reach: int, share: float, chosen: I8, few: int
) -> tuple[I8, I8]:
    """(few, h, w) the first samples in which the patch around each pixel is the same as in sample
    ``chosen`` (h, w); that sample again where there are fewer. And (h, w) in how many runs of
    samples it is the same.

    The other parameters are those of `recurrences`.
    """
    count, height, width, channels = samples.shape
    size = 2 * reach + 1
    out = np.empty((few, height, width), np.int64)
    runs = np.zeros((height, width), np.int64)
    planes = _planes(samples, reach)
    least = math.ceil(share * size**2)
    # The patches of the chosen samples along a row, and how many of their pixels are the same.
    patch = np.empty((size, size, channels, width), np.int16)
    agreed = np.empty(width, np.int16)
    middle = np.empty(width, np.int16)
    found = np.empty(width, np.int64)
    before = np.empty(width, np.bool_)
    for y in range(height):
        for d in range(size):
            for e in range(size):
                for c in range(channels):
                    for x in range(width):
                        patch[d, e, c, x] = planes[chosen[y, x], c, y + d, x + e]
        found[:] = 0
        before[:] = False
        for j in range(count):
            agreed[:] = 0
            for d in range(size):
                for e in range(size):
                    _count(planes, (j, y + d, e), patch, (d, e), np.int16(tolerance), agreed)
            middle[:] = 0
            place = j, y + reach, reach
            _count(planes, place, patch, (reach, reach), np.int16(tolerance), middle)
            for x in range(width):
                now = agreed[x] >= least and middle[x] > 0
                if now and found[x] < few:
                    out[found[x], y, x] = j
                    found[x] += 1
                if now and not before[x]:
                    runs[y, x] += 1
                before[x] = now
        for x in range(width):
            out[found[x] :, y, x] = chosen[y, x]
    return out, runs


@njit(**INNER)
def _planes(samples: U1, reach: int) -> I2:
    """(K, 3, h + 2r, w + 2r) the channels of samples (K, h, w, 3), one after the other, with
    ``reach`` more pixels on each side, which mirror those inside.
    """
    count, height, width, channels = samples.shape
    out = np.empty((count, channels, height + 2 * reach, width + 2 * reach), np.int16)
    for k in range(count):
        for y in range(out.shape[2]):
            row = mirrored(y - reach, height)
            for x in range(out.shape[3]):
                column = mirrored(x - reach, width)
                for c in range(channels):
                    out[k, c, y, x] = samples[k, row, column, c]
    return out


# These functions take whole arrays and places in them: the compiler does not know that a part of an
# array is contiguous.
@njit(**VECTOR)
def _same(planes: I2, k: int, j: int, tolerance: np.int16, out: I2) -> None:
    """Write 1 for each pixel in which two samples differ by the tolerance at most, 0 elsewhere."""
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            a = abs(planes[k, 0, y, x] - planes[j, 0, y, x]) <= tolerance
            b = abs(planes[k, 1, y, x] - planes[j, 1, y, x]) <= tolerance
            c = abs(planes[k, 2, y, x] - planes[j, 2, y, x]) <= tolerance
            out[y, x] = a & b & c


@njit(**VECTOR)
def _count(
    planes: I2,
    place: tuple[int, int, int],
    patch: I2,
    pixel: tuple[int, int],
    tolerance: np.int16,
    out: I2,
) -> None:
    """Add 1 for each pixel of a row of patches (w,) that is the same at a place of the planes:
    sample, row, and the first column.
    """
    j, row, first = place
    d, e = pixel
    for x in range(out.size):
        a = abs(planes[j, 0, row, first + x] - patch[d, e, 0, x]) <= tolerance
        b = abs(planes[j, 1, row, first + x] - patch[d, e, 1, x]) <= tolerance
        c = abs(planes[j, 2, row, first + x] - patch[d, e, 2, x]) <= tolerance
        out[x] += a & b & c


@njit(**VECTOR)
def _box_sums(same: I2, reach: int, rows: I2, out: I2) -> None:
    """Write the sums of ``same`` (h + 2r, w + 2r) over the patch around each pixel (h, w)."""
    height, width = out.shape
    for y in range(rows.shape[0]):
        for x in range(width):
            rows[y, x] = same[y, x]
        for e in range(1, 2 * reach + 1):
            for x in range(width):
                rows[y, x] += same[y, x + e]
    for y in range(height):
        for x in range(width):
            out[y, x] = rows[y, x]
        for d in range(1, 2 * reach + 1):
            for x in range(width):
                out[y, x] += rows[y + d, x]


@njit(**VECTOR)
def _add_where(agreed: I2, same: I2, reach: int, least: int, out: I2, k: int) -> None:
    """Count the pixels of sample k whose patch agrees, and whose middle does."""
    for y in range(agreed.shape[0]):
        for x in range(agreed.shape[1]):
            out[k, y, x] += (agreed[y, x] >= least) & same[y + reach, x + reach]
