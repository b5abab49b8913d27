"""The statistic of `detect.change`, array by array, with OpenCV's functions and sorted medians."""

from __future__ import annotations

import math

import cv2
import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

LOG = np.rint(90.0 * np.log1p(np.arange(256) / 16.0)).astype(np.uint8)


def planes(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) logarithm of luma, and the two chroma differences."""
    out = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)
    out[..., 0] = LOG[out[..., 0]]
    return out


def relit(reference: np.ndarray, gain: np.ndarray, offset: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(gain * cv2.convertScaleAbs(reference) + offset, 0, 255)).astype(np.uint8)


def energy(now: np.ndarray, expected: np.ndarray, weights: tuple[float, ...]) -> np.ndarray:
    """Weighted squares of the difference of planes; weights of luma are those towards dark and towards bright."""
    d = now.astype(np.float64) - expected
    luma = np.where(d[..., 0] < 0, weights[0], weights[1])
    return luma * d[..., 0] ** 2 + weights[2] * d[..., 1] ** 2 + weights[3] * d[..., 2] ** 2


def mask(energies: np.ndarray, scene: np.ndarray, window: int, threshold: float) -> np.ndarray:
    normal = energies / np.maximum(scene / 3, 1)
    return (cv2.blur(normal, (window, window)) > threshold) & (normal > threshold / 2)


def recalled(
    now: np.ndarray, samples: np.ndarray, differing: np.ndarray, weights: tuple[float, ...], limit: float
) -> np.ndarray:
    """Where pixels look as in at least 4 runs of samples (H, W, 3, K), and in 0.35 of those that differ.

    Where a tenth of them differs, also where as many samples as differ, and 0.33 of all, look so within three pixels.
    """
    height, width, _, count = samples.shape
    alike = np.zeros((2, count, height, width), bool)
    for i in (-3, 0, 3):
        for j in (-3, 0, 3):
            there = slice(max(0, i), height + min(0, i)), slice(max(0, j), width + min(0, j))
            here = slice(max(0, -i), height + min(0, -i)), slice(max(0, -j), width + min(0, -j))
            for k in range(count):
                same = energy(now[here], samples[..., k][there], weights) < limit
                alike[1, k][here] |= same
                if i == j == 0:
                    alike[0, k] = same
    runs = alike[:, 0] + (alike[:, 1:] & ~alike[:, :-1]).sum(axis=1)
    often = alike.sum(axis=1)
    sways = (differing >= 0.1 * count) & (often[1] >= np.maximum(0.33 * count, differing)) & (runs[1] >= 4)
    return ((runs[0] >= 4) & (often[0] >= 0.35 * differing)) | sways


def extremes(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3, 2) the fourth smallest and largest of samples (H, W, 3, K); and of the smallest and the largest of each
    within three pixels, so many from either end that 0.33 of all are not less."""
    ordered, near = np.sort(samples, axis=3), math.ceil(0.33 * samples.shape[3])
    where = np.zeros((7, 7, 1, 1))
    where[::3, ::3] = 1
    filters = (minimum_filter, 255), (maximum_filter, 0)
    low, high = (np.sort(each(samples, footprint=where, mode="constant", cval=beyond), axis=3) for each, beyond in filters)
    return ordered[..., [3, -4]].copy(), np.stack([low[..., near - 1], high[..., -near]], axis=3)


def line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Gain and offset of y ≈ gain·x + offset by three rounds of least squares without what misses it by far."""
    if len(x) < 50:
        return 1.0, 0.0
    gain, offset = np.median(y / x), 0.0
    for _ in range(3):
        residual = y - gain * x - offset
        near = np.abs(residual) < 2.5 * (1.4826 * np.median(np.abs(residual)) + 0.5)
        if x[near].var() > 100.0:
            gain = np.cov(x[near], y[near], bias=True)[0, 1] / x[near].var()
        offset = np.median(y[near] - gain * x[near])
    return float(gain), float(offset)


def edge(image: np.ndarray, where: np.ndarray) -> float:
    """Mean gradient of the luma of a window over the pixels ``where`` is not 0."""
    luma = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)[..., 0]
    return float(np.hypot(cv2.Sobel(luma, cv2.CV_64F, 1, 0), cv2.Sobel(luma, cv2.CV_64F, 0, 1))[where > 0].mean())
