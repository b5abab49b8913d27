"""Patches of a picture that recur in samples of a video: what does not move comes back the same."""

from __future__ import annotations

import numpy as np

from phdtrack.kernels import I4, I8, U1
from phdtrack.kernels.blobs import mirrored
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, INT


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
    out = np.zeros((count, height, width), np.int64)
    same = np.empty((height, width), np.int32)
    rows = np.empty((height, width), np.int32)
    least = share * (2 * reach + 1) ** 2
    for k in range(count):
        for j in range(k + 1, count):
            _same(samples, k, j, tolerance, same)
            _sums(same, reach, rows)
            for y in range(height):
                for x in range(width):
                    if same[y, x]:
                        total = 0
                        for d in range(-reach, reach + 1):
                            total += rows[mirrored(y + d, height), x]
                        if total >= least:
                            out[k, y, x] += 1
                            out[j, y, x] += 1
    return out


@njit(**ENTRY)
def same_patches(
    samples: U1, tolerance: int, reach: int, share: float, chosen: I8, few: int
) -> tuple[I8, I8]:
    """(few, h, w) the first samples in which the patch around each pixel is the same as in sample
    ``chosen`` (h, w); that sample again where there are fewer. And (h, w) in how many runs of
    samples it is the same.

    The other parameters are those of `recurrences`.
    """
    count, height, width, _ = samples.shape
    out = np.empty((few, height, width), np.int64)
    runs = np.zeros((height, width), np.int64)
    least = share * (2 * reach + 1) ** 2
    for y in range(height):
        for x in range(width):
            k = chosen[y, x]
            found = 0
            before = False
            for j in range(count):
                total = 0
                if _alike(samples, k, j, y, x, tolerance):
                    for d in range(-reach, reach + 1):
                        row = mirrored(y + d, height)
                        for e in range(-reach, reach + 1):
                            total += _alike(samples, k, j, row, mirrored(x + e, width), tolerance)
                now = total >= least
                if now and found < few:
                    out[found, y, x] = j
                    found += 1
                if now and not before:
                    runs[y, x] += 1
                before = now
            out[found:, y, x] = k
    return out, runs


@njit(**INNER)
def _alike(samples: U1, k: int, j: int, y: int, x: int, tolerance: int) -> bool:
    """True if a pixel of two samples differs by the tolerance at most."""
    for c in range(3):
        if abs(INT(samples[k, y, x, c]) - INT(samples[j, y, x, c])) > tolerance:
            return False
    return True


@njit(**INNER)
def _same(samples: U1, k: int, j: int, tolerance: int, out: I4) -> None:
    """Write 1 for each pixel in which two samples differ by the tolerance at most."""
    height, width = out.shape
    for y in range(height):
        for x in range(width):
            out[y, x] = _alike(samples, k, j, y, x, tolerance)


@njit(**INNER)
def _sums(same: I4, reach: int, out: I4) -> None:
    """Write the sums along rows of the pixels within ``reach``."""
    height, width = same.shape
    for y in range(height):
        total = INT(0)
        for e in range(-reach, reach + 1):
            total += same[y, mirrored(e, width)]
        for x in range(width):
            out[y, x] = total
            total += same[y, mirrored(x + reach + 1, width)] - same[y, mirrored(x - reach, width)]
