"""The statistic of `detect.change`, array by array, with OpenCV's functions and sorted medians.

Pictures are (H, W, 3): brightness, and the colour differences of blue and red of the square of four
pixels that share them.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

LOG = np.rint(88.0 * np.log1p(255 / 219 * np.clip(np.arange(256) - 16.0, 0, 219) / 15)).astype(
    np.uint8
)
TO_BGR = np.array(
    [[1.164384, 2.017232, 0.0], [1.164384, -0.391762, -0.812968], [1.164384, 0.0, 1.596027]]
)
ZERO = np.array([16.0, 128.0, 128.0])


def joined(picture: np.ndarray, height: int, width: int) -> np.ndarray:
    """(H, W, 3, ...) of the planes (n, ...) of a picture."""
    half = picture[height * width :].reshape(
        2, (height + 1) // 2, (width + 1) // 2, *picture.shape[1:]
    )
    colours = half.repeat(2, axis=1).repeat(2, axis=2)[:, :height, :width]
    return np.stack(
        [picture[: height * width].reshape(height, width, *picture.shape[1:]), *colours], axis=2
    )


def parted(image: np.ndarray) -> np.ndarray:
    """(n, ...) the planes of (H, W, 3, ...): colours are those of every other pixel both ways."""
    rest = image.shape[3:]
    return np.concatenate(
        [
            image[:, :, 0].reshape(-1, *rest),
            *(image[::2, ::2, c].reshape(-1, *rest) for c in (1, 2)),
        ]
    )


def logarithmic(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) with the logarithm of brightness."""
    out = image.copy()
    out[:, :, 0] = LOG[out[:, :, 0]]
    return out


def relit(reference: np.ndarray, gain: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """(H, W, 3) a picture whose blue, green and red have each a gain and an offset; colours of the
    first of four pixels.
    """
    out = ((reference - ZERO) @ TO_BGR.T * gain + offset) @ np.linalg.inv(TO_BGR).T + ZERO
    return joined(parted(out), *out.shape[:2])


def energy(now: np.ndarray, expected: np.ndarray, weights: tuple[float, ...]) -> np.ndarray:
    """Weighted squares of differences; weights of brightness are those towards dark and towards
    bright.
    """
    grey = [
        88.0 * np.log(255 / 219 * (np.clip(each[..., 0].astype(float), 16, 235) - 16) + 15)
        for each in (now, expected)
    ]
    return _weighted(grey[0] - grey[1], now[..., 1:].astype(float) - expected[..., 1:], weights)


def _weighted(grey: np.ndarray, colours: np.ndarray, weights: tuple[float, ...]) -> np.ndarray:
    bright = np.where(grey < 0, weights[0], weights[1])
    return bright * grey**2 + weights[2] * colours[..., 0] ** 2 + weights[3] * colours[..., 1] ** 2


def mask(energies: np.ndarray, scene: np.ndarray, window: int, threshold: float) -> np.ndarray:
    normal = energies / np.maximum(scene / 3, 1)
    return (cv2.blur(normal, (window, window)) > threshold) & (normal > threshold / 2)


def recalled(
    now: np.ndarray,
    samples: np.ndarray,
    differing: np.ndarray,
    weights: tuple[float, ...],
    limit: float,
) -> np.ndarray:
    """Where pixels look as in at least 4 runs of samples (H, W, 3, K), 0.6 of the runs that are
    expected of as many in random order, and in 0.35 of those that differ.

    Where a tenth of them differs, also where as many samples as differ, and 0.33 of all, look so
    within three pixels. Both have the logarithm of brightness.
    """
    height, width, _, count = samples.shape
    alike = np.zeros((2, count, height, width), bool)
    for i in (-3, 0, 3):
        for j in (-3, 0, 3):
            there = slice(max(0, i), height + min(0, i)), slice(max(0, j), width + min(0, j))
            here = slice(max(0, -i), height + min(0, -i)), slice(max(0, -j), width + min(0, -j))
            for k in range(count):
                apart = now[here].astype(float) - samples[..., k][there]
                same = _weighted(apart[..., 0], apart[..., 1:], weights) < limit
                alike[1, k][here] |= same
                if i == j == 0:
                    alike[0, k] = same
    runs = alike[:, 0] + (alike[:, 1:] & ~alike[:, :-1]).sum(axis=1)
    often = alike.sum(axis=1)
    enough = runs >= np.maximum(4, 0.6 * often * (count - often + 1) / count)
    sways = (
        (differing >= 0.1 * count) & (often[1] >= np.maximum(0.33 * count, differing)) & enough[1]
    )
    return (enough[0] & (often[0] >= 0.35 * differing)) | sways


def extremes(samples: np.ndarray, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, 2) the fourth smallest and largest of samples (n, K); and of the smallest and the largest
    of each within three pixels, of colours within two of theirs, so many from either end that 0.33
    of all are not less."""
    ordered = np.sort(samples, axis=1)
    rank = math.ceil(0.33 * samples.shape[1])
    where = np.zeros((7, 7, 1))
    where[::3, ::3] = 1
    half = ((height + 1) // 2, (width + 1) // 2)
    near = []
    for each, beyond in ((minimum_filter, 255), (maximum_filter, 0)):
        parts = [(samples[: height * width], (height, width), where)]
        parts += [
            (part, half, np.ones((5, 5, 1))) for part in np.split(samples[height * width :], 2)
        ]
        found = [
            each(part.reshape(*size, -1), footprint=of, mode="constant", cval=beyond)
            for part, size, of in parts
        ]
        near.append(
            np.sort(np.concatenate([part.reshape(-1, samples.shape[1]) for part in found]), axis=1)
        )
    return ordered[:, [3, -4]].copy(), np.stack([near[0][:, rank - 1], near[1][:, -rank]], axis=1)


def line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Gain and offset of y ≈ gain·x + offset by three rounds of least squares without what misses
    it by far.
    """
    if len(x) < 50:
        return 1.0, 0.0
    gain = np.median(y / x)
    offset = 0.0
    for _ in range(3):
        residual = y - gain * x - offset
        near = np.abs(residual) < 2.5 * (1.4826 * np.median(np.abs(residual)) + 0.5)
        if x[near].var() > 100.0:
            gain = np.cov(x[near], y[near], bias=True)[0, 1] / x[near].var()
        offset = np.median(y[near] - gain * x[near])
    return float(gain), float(offset)


def edge(picture: np.ndarray, outline: np.ndarray, box: np.ndarray) -> float:
    """Mean gradient of a picture (H, W) over every other row of a box where the outline is not
    0.
    """
    gradient = np.hypot(cv2.Sobel(picture, cv2.CV_64F, 1, 0), cv2.Sobel(picture, cv2.CV_64F, 0, 1))
    left, top, right, bottom = box
    rows = slice(top, bottom, 2)
    columns = slice(left, right)
    return float(gradient[rows, columns][outline[rows, columns] > 0].mean())


def valley(filled: np.ndarray, depth: float, smooth: int, margin: int, least: float) -> int:
    """The lowest column of a profile, smoothed by OpenCV, with as much on either side; −1 where it
    is not deep enough.
    """
    width = filled.shape[1]
    profile = cv2.blur((filled > 0).sum(axis=0, dtype=float)[None], (smooth, 1))[0]
    left = np.maximum.accumulate(profile)
    right = np.maximum.accumulate(profile[::-1])[::-1]
    before = np.cumsum(profile)
    allowed = (before > least * before[-1]) & (before < (1 - least) * before[-1])
    allowed &= (np.arange(width) >= margin) & (np.arange(width) < width - margin)
    ratio = np.where(allowed, profile / np.maximum(np.minimum(left, right), 1.0), np.inf)
    return int(ratio.argmin()) if ratio.min() <= depth else -1
