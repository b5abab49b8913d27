"""The scene's noise and variety, learned from samples of a video."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from phdtrack.detect.reference import middle_of
from phdtrack.kernels.change import CHANNELS, OFTEN, REACH, Past, often_near
from phdtrack.kernels.planes import LOG, colours, luma
from phdtrack.opencv_package import cv2
from phdtrack.types import F4, Bool, Image

# The median of a third of χ²₃.
_MEDIAN_OF_CHI2 = 0.789
# Upper bound of the energy that the scene's noise explains.
MAX_NOISE = CHANNELS * 20.0
# The energies of all samples at once would be the largest piece of memory of a run.
_BAND_ROWS = 64
# Pixels `REACH` away, and the colours there, which have half the resolution.
_NEIGHBOURS = np.zeros((2 * REACH + 1, 2 * REACH + 1), np.uint8)
_NEIGHBOURS[::REACH, ::REACH] = 1
_NEAR_COLOURS = np.ones((2 * ((REACH + 1) // 2) + 1,) * 2, np.uint8)


def sample_history(pictures: Sequence[Image], shape: tuple[int, int]) -> Past:
    """The values that each pixel had in K samples (n,), and their extremes.

    Parameters
    ----------
    pictures : planes (n,) of independent samples, colours smoothed.
    shape : (H, W) of them.
    """
    n = pictures[0].size
    # The values of one pixel side by side: it is compared with all of them.
    samples: Image = np.empty((n, len(pictures)), np.uint8)
    extremes = _Extremes(OFTEN, n)
    near_extremes = _Extremes(often_near(len(pictures)), n)
    for k, picture in enumerate(pictures):
        planes = logarithmic(picture, shape)
        samples[:, k] = planes
        extremes.add(planes, planes)
        near_extremes.add(_nearby(cv2.erode, planes, shape), _nearby(cv2.dilate, planes, shape))
    differing: Image = np.zeros(shape, np.uint8)
    return Past(samples, differing, extremes.bounds(), near_extremes.bounds())


def scene_noise(
    energies: Callable[[slice], F4], shape: tuple[int, int], hidden: Bool | None = None
) -> F4:
    """(H, W) energy that the scene's noise explains, three times s(q).

    Parameters
    ----------
    energies : returns (K, h, W) energies of K samples against the reference in some rows.
    shape : (H, W) of the pictures.
    hidden : (H, W) pixels that objects hid in most samples: they take the usual noise.
    """
    typical = np.empty(shape, np.float32)
    for first in range(0, len(typical), _BAND_ROWS):
        rows = slice(first, first + _BAND_ROWS)
        # Floats that are not negative sort like their bits.
        bits = energies(rows).view(np.int32)
        typical[rows] = middle_of(bits).view(np.float32) / _MEDIAN_OF_CHI2
    if hidden is not None and hidden.any() and not hidden.all():
        typical[hidden] = np.minimum(typical[hidden], np.median(typical[~hidden]))
    spread = cv2.dilate(cv2.blur(typical, (5, 5)), np.ones((3, 3), np.uint8))
    return np.asarray(np.minimum(spread, np.float32(MAX_NOISE)), np.float32)


def logarithmic(picture: Image, shape: tuple[int, int]) -> Image:
    """The planes (n,) of a picture with the logarithm of brightness."""
    out = picture.copy()
    luma(out, shape)[:] = LOG[luma(picture, shape)]
    return out


def _nearby(extreme: Callable[..., Image], planes: Image, shape: tuple[int, int]) -> Image:
    """(n,) the ``extreme`` (`cv2.erode` or `cv2.dilate`) of each number within `REACH` pixels."""
    parts = [extreme(luma(planes, shape), _NEIGHBOURS)]
    parts += [extreme(plane, _NEAR_COLOURS) for plane in colours(planes, shape)]
    return np.concatenate([part.ravel() for part in parts])


class _Extremes:
    """The ``rank``-th smallest and largest value of each of n numbers."""

    def __init__(self, rank: int, n: int) -> None:
        self._low: Image = np.full((rank, n), 255, np.uint8)
        self._high: Image = np.zeros((rank, n), np.uint8)

    def add(self, low: Image, high: Image) -> None:
        """Add (n,) candidates for the smallest and for the largest values."""
        for j in range(len(self._low)):
            larger = np.maximum(self._low[j], low)
            self._low[j] = np.minimum(self._low[j], low)
            low = larger
            smaller = np.minimum(self._high[j], high)
            self._high[j] = np.maximum(self._high[j], high)
            high = smaller

    def bounds(self) -> Image:
        """(n, 2) the ``rank``-th smallest and largest value of each number."""
        return np.stack([self._low[-1], self._high[-1]], axis=1)
