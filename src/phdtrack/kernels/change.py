"""A frame against the reference: one pass that says where it changed, and one by which reference and noise follow it.

What each computes is said in `detect.change`. Pictures are (H, 3W): the values of a pixel, BGR, lie side by side. Each row
goes through short loops over a few arrays, which vectorise; between them it stays in the cache.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, HALF, INNER, INT, ONE, VECTOR, D, F

U1 = NDArray[np.uint8]
F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
I4 = NDArray[np.int32]
I8 = NDArray[np.int64]
Pixel = tuple[np.int32, np.int32, np.int32]
Weights = tuple[np.float32, np.float32, np.float32, np.float32]
# A pixel is not changed where it resembles samples in at least `OFTEN` runs, and at least the share `SHARE` of the samples
# that differ from the reference there: passers-by hardly resemble each other, leaves do.
OFTEN, SHARE = 4, 0.35
# Where at least the share `BUSY` of the samples differs, samples count too that it resembles `REACH` pixels away: leaves
# sway. Then it takes the share `NEAR` of all samples, and as many as differ there: no more resemble a passer-by than pass.
BUSY, NEAR, REACH = 0.1, 0.33, 3
CHANNELS = 3
LOG_SCALE = 90.0
LOG: U1 = np.rint(LOG_SCALE * np.log1p(np.arange(256) / 16.0)).astype(np.uint8)
# Grey levels between which a pixel tells of the light, the fewest pixels, and the deviations within which they fit.
_DARKEST, _BRIGHTEST, _FEWEST, _NEAR, _ROUNDS = 8, 245, 50, 2.5, 3
_BINS = 8192
# Columns whose medians are made together: their samples stay in the cache. Pixels that are passed over at once.
_BLOCK, _PIXELS = 512, 64
# Luma of blue, green and red, and chroma of red and blue, in 2⁻¹⁴; what rounds, and the middle of chroma.
_BLUE, _GREEN, _RED, _TO_RED, _TO_BLUE, _BITS = INT(1868), INT(9617), INT(4899), INT(11682), INT(9241), INT(14)
_ROUND, _MIDDLE = INT(1 << 13), INT((128 << 14) + (1 << 13))
_NONE, _WHITE, _THIRD = F(0), F(255), F(1 / CHANNELS)
_FULL = INT(255)
_1, _2, _3 = D(1), D(2), D(3)


class Statistic(NamedTuple):
    """What decides that a pixel changed.

    ``weights``: 1/σ² of differences of luma towards dark and bright, and of the two of chroma; ``window`` its side, odd;
    ``threshold`` of the window's mean; ``alike``: energy below which a sample resembles a pixel.
    """

    weights: Weights
    window: int
    threshold: float
    alike: float


class Past(NamedTuple):
    """``samples`` (H, W, 3, K) planes of other times in order, how many of them differ from the reference (H, W), and the
    ``OFTEN``-th smallest and largest of each plane (H, W, 3, 2); ``near``: the same of the smallest and largest within
    `REACH`, the `often_near`-th."""

    samples: U1
    differing: U1
    extremes: U1
    near: U1


def often_near(count: int) -> int:
    """How many of so many samples a pixel has to resemble some pixels away at the least."""
    return max(1, math.ceil(NEAR * count))


@njit(**ENTRY)
def compare(image: U1, reference: F4, light: F4, scene: F4, rule: Statistic, past: Past) -> tuple[U1, F4, U1]:
    """(H, W) 255 where ``image`` changed, (H, W) its energy, and (H, 3W) the ``reference`` in its ``light``.

    Parameters
    ----------
    image, reference : (H, 3W).
    light : (2, 3) gain and offset of blue, green and red.
    scene : (H, W) energy that is usual there, three times s.
    rule, past : as above.
    """
    height, width = scene.shape
    mask, energy, expected = np.empty((height, width), np.uint8), np.empty((height, width), np.float32), np.empty_like(image)
    gain, offset = np.empty(3 * width, np.float32), np.empty(3 * width, np.float32)
    for i in range(3 * width):
        gain[i], offset[i] = light[0, i % 3], light[1, i % 3]
    window, reach = rule.window, rule.window // 2
    limit, least = F(rule.threshold * window * window), F(rule.threshold / 2)
    # The planes and the statistic of the rows of a window; their sum, with a margin, and the sum over windows.
    planes, usual = np.empty((window, 3, width), np.uint8), np.empty((3, width), np.uint8)
    normal, column = np.empty((window, width), np.float32), np.empty(width + 2 * reach, np.float32)
    total, seen = np.empty(width, np.float32), np.empty(past.samples.shape[3], np.uint8)
    for y in range(height + reach):
        if y < height:
            now = planes[y % window]
            _relight(reference[y], gain, offset, expected[y])
            _planes(image[y], now)
            _planes(expected[y], usual)
            _energy(now, usual, rule.weights, scene[y], energy[y], normal[y % window])
        row = y - reach
        if row >= 0:
            column[:] = 0
            total[:] = 0
            for k in range(row - reach, row + reach + 1):
                _add(normal[_mirrored(k, height) % window], column[reach : reach + width])
            for k in range(reach):
                column[k] = column[reach + _mirrored(k - reach, width)]
                column[reach + width + k] = column[reach + _mirrored(width + k, width)]
            for k in range(window):
                _add(column[k : k + width], total)
            _passed(total, normal[row % window], limit, least, mask[row])
            if seen.size:
                _recall(planes[row % window], rule, past, row, seen, mask[row])
    return mask, energy, expected


@njit(**ENTRY)
def follow(image: U1, energy: F4, reference: F4, scene: F4, foreground: U1, rates: F4) -> None:
    """Move ``reference`` (H, 3W) towards ``image``, and outside of the ``foreground`` ``scene`` (H, W) towards ``energy``.

    ``rates``: of the reference outside of the foreground and in it, and of the scene; the largest value of that.
    """
    height, width = scene.shape
    rate = np.empty(3 * width, np.float32)
    for y in range(height):
        _rates(foreground[y], rates[0], rates[1], rate)
        _approach(image[y], rate, reference[y])
        _settle(energy[y], foreground[y], rates[2], rates[3], scene[y])


@njit(**ENTRY)
def lighting(reference: F4, image: U1, foreground: U1, step: int) -> F4:
    """(2, 3) gain and offset of each channel by which ``reference`` becomes ``image`` outside of the ``foreground``.

    Every ``step``-th pixel both ways is looked at; gain 1 and offset 0 where too few of them tell.
    """
    height, width = foreground.shape
    out, first, n = np.zeros((2, 3), np.float32), step // 2, np.zeros(3, np.int64)
    room = len(range(first, height, step)) * len(range(first, width, step))
    x, y, size, counts = np.empty((3, room)), np.empty((3, room)), np.empty(room), np.empty(_BINS, np.int32)
    for i in range(first, height, step):
        for j in range(first, width, step):
            if foreground[i, j] == 0:
                for c in range(3):
                    was, now = np.floor(reference[i, 3 * j + c] + HALF), image[i, 3 * j + c]
                    if was > _DARKEST and was < _BRIGHTEST and now > _DARKEST and now < _BRIGHTEST:
                        x[c, n[c]], y[c, n[c]] = was, now
                        n[c] += 1
    for c in range(3):
        out[0, c], out[1, c] = _line(x[c, : n[c]], y[c, : n[c]], size[: n[c]], counts)
    return out


@njit(**ENTRY)
def noise(image: U1, before: U1, step: int) -> I8:
    """(3, 256) how often each plane of every ``step``-th pixel both ways of ``image`` (H, 3W) differs by so much.

    From ``before`` (3, h, w): logarithm of luma, and the two of chroma, which become those of this image.
    """
    _, height, width = before.shape
    counts, row, now = np.zeros((3, 256), np.int64), np.empty(3 * width, np.uint8), np.empty((3, width), np.uint8)
    for y in range(height):
        for x in range(width):
            for c in range(3):
                row[3 * x + c] = image[step * y, 3 * step * x + c]
        _planes(row, now)
        for c in range(3):
            for x in range(width):
                counts[c, abs(np.int64(now[c, x]) - np.int64(before[c, y, x]))] += 1
                before[c, y, x] = now[c, x]
    return counts


@njit(**ENTRY)
def edge(image: U1, left: int, top: int, where: U1) -> float:
    """Mean gradient (Sobel) of the luma of ``image`` (H, 3W) where the window ``where`` (h, w) at (left, top) is not 0."""
    height, width = where.shape
    luma, total, count = np.empty((height, width), np.int32), 0.0, 0
    for i in range(height):
        for j in range(width):
            luma[i, j] = _luma(image[top + i], D(3 * (left + j)))
    for i in range(height):
        above, row, below = luma[_mirrored(i - 1, height)], luma[i], luma[_mirrored(i + 1, height)]
        for j in range(width):
            if where[i, j]:
                k, m = _mirrored(j - 1, width), _mirrored(j + 1, width)
                x = above[m] - above[k] + 2 * (row[m] - row[k]) + below[m] - below[k]
                y = below[k] - above[k] + 2 * (below[j] - above[j]) + below[m] - above[m]
                total, count = total + math.sqrt(x * x + y * y), count + 1
    return total / count if count else 0.0


@njit(**INNER)
def _line(x: F8, y: F8, size: F8, counts: I4) -> tuple[float, float]:
    """Gain and offset of y ≈ gain·x + offset, robust; ``size`` and ``counts`` are overwritten."""
    if x.size < _FEWEST:
        return 1.0, 0.0
    for i in range(x.size):
        size[i] = y[i] / x[i]
    gain, offset = _median(size, counts), 0.0
    for _ in range(_ROUNDS):
        for i in range(x.size):
            size[i] = abs(y[i] - gain * x[i] - offset)
        limit = _NEAR * (1.4826 * _median(size, counts) + 0.5)
        n, a, b, aa, ab = 0, 0.0, 0.0, 0.0, 0.0
        for i in range(x.size):
            if size[i] < limit:
                n += 1
                a += x[i]
                b += y[i]
                aa += x[i] * x[i]
                ab += x[i] * y[i]
        a, b, aa, ab = a / n, b / n, aa / n, ab / n
        # A scene of one brightness does not tell gain from offset: keep the gain and move the offset alone.
        if aa - a * a > 100.0:
            gain = (ab - a * b) / (aa - a * a)
        n = 0
        for i in range(x.size):
            if size[i] < limit:
                size[n] = y[i] - gain * x[i]
                n += 1
        offset = _median(size[:n], counts)
    return gain, offset


@njit(**INNER)
def _median(values: F8, counts: I4) -> float:
    """The median of n > 0 numbers, within a few thousandths of their range: the mean of those that share its bin."""
    low, high = values[0], values[0]
    for value in values:
        low, high = min(low, value), max(high, value)
    scale, reached, bin, total = (counts.size - 1) / max(high - low, 1e-9), 0, 0, 0.0
    counts[:] = 0
    for value in values:
        counts[int((value - low) * scale)] += 1
    while reached + counts[bin] <= values.size // 2:
        reached += counts[bin]
        bin += 1
    for value in values:
        if int((value - low) * scale) == bin:
            total += value
    return float(total / counts[bin])


@njit(**ENTRY)
def middle(samples: NDArray[np.integer[Any]]) -> NDArray[np.integer[Any]]:
    """(n,) the median of each column of an odd number of ``samples`` (K, n), by exchanges of neighbours."""
    count, n = samples.shape
    out, part = np.empty(n, samples.dtype), np.empty((count, _BLOCK), samples.dtype)
    for start in range(0, n, _BLOCK):
        width = min(_BLOCK, n - start)
        for k in range(count):
            for i in range(width):
                part[k, i] = samples[k, start + i]
        for last in range(count - 1, count // 2 - 1, -1):
            for k in range(last):
                _exchange(part[k], part[k + 1])
        for i in range(width):
            out[start + i] = part[count // 2, i]
    return out


@njit(**INNER)
def _mirrored(k: int, size: int) -> int:
    """The index within 0 … size − 1 that k is when the picture is mirrored at its outermost pixels."""
    while k < 0 or k >= size:
        k = 0 if size == 1 else (-k if k < 0 else 2 * size - 2 - k)
    return k


@njit(**VECTOR)
def _relight(reference: F4, gain: F4, offset: F4, out: U1) -> None:
    for i in range(D(out.size)):
        value = np.floor(reference[i] + HALF) * gain[i] + offset[i]
        out[i] = np.uint8(INT(min(max(value, _NONE), _WHITE) + HALF))


@njit(**VECTOR)
def _luma(row: U1, k: int) -> np.int32:
    """Of the pixel whose blue is at ``k``, as that of OpenCV's YCrCb."""
    return INT(INT(INT(row[k]) * _BLUE + INT(row[k + _1]) * _GREEN + INT(row[k + _2]) * _RED + _ROUND) >> _BITS)


@njit(**VECTOR)
def _chroma(colour: np.uint8, luma: np.int32, scale: np.int32) -> np.uint8:
    """Their difference, as that of OpenCV's YCrCb."""
    return np.uint8(min(INT(INT(INT(INT(colour) - luma) * scale + _MIDDLE) >> _BITS), _FULL))


@njit(**VECTOR)
def _planes(row: U1, out: U1) -> None:
    """Logarithm of luma, and the two of chroma, of a row."""
    luma, red, blue = out[0], out[1], out[2]
    for i in range(D(luma.size)):
        k = _3 * i
        y = _luma(row, k)
        luma[i], red[i], blue[i] = np.uint8(y), _chroma(row[k + _2], y, _TO_RED), _chroma(row[k], y, _TO_BLUE)
    for i in range(D(luma.size)):
        luma[i] = LOG[luma[i]]


@njit(**VECTOR)
def _energy(now: U1, usual: U1, weights: Weights, scene: F4, out: F4, normal: F4) -> None:
    """The energy of a row, and what it is over what is usual there."""
    dark, bright, red, blue = weights
    for i in range(D(out.size)):
        d, e = F(INT(INT(now[0, i]) - INT(usual[0, i]))), F(INT(INT(now[1, i]) - INT(usual[1, i])))
        f = F(INT(INT(now[2, i]) - INT(usual[2, i])))
        out[i] = value = d * d * (dark if d < _NONE else bright) + e * e * red + f * f * blue
        normal[i] = value / max(scene[i] * _THIRD, ONE)


@njit(**VECTOR)
def _add(row: F4, out: F4) -> None:
    for i in range(D(out.size)):
        out[i] += row[i]


@njit(**VECTOR)
def _passed(total: F4, normal: F4, limit: np.float32, least: np.float32, out: U1) -> None:
    """The window's mean must pass, and half of it the pixel itself, which keeps outlines sharp."""
    for i in range(D(out.size)):
        out[i] = np.uint8(255) if (total[i] > limit) & (normal[i] > least) else np.uint8(0)


@njit(**INNER)
def _recall(planes: U1, rule: Statistic, past: Past, y: int, seen: U1, mask: U1) -> None:
    """Take what was seen before out of row ``y`` of the mask; ``seen`` (K,) is overwritten."""
    samples, extremes, near, limit = past.samples, past.extremes, past.near, F(rule.alike)
    height, width = past.differing.shape
    for start in range(0, width, _PIXELS):
        # Most of a picture has not changed.
        for x in range(start, min(start + _PIXELS, width)) if _any(mask[start : start + _PIXELS]) else range(0):
            if mask[x] == 0:
                continue
            pixel, differing = (INT(planes[0, x]), INT(planes[1, x]), INT(planes[2, x])), past.differing[y, x]
            if not _beyond(pixel, extremes, y, x, rule.weights, limit):
                seen[:] = 0
                _resembling(pixel, samples[y, x], rule.weights, limit, seen)
                if _often(seen, SHARE * differing):
                    mask[x] = 0
            busy = mask[x] and differing >= BUSY * seen.size
            if busy and not _beyond(pixel, near, y, x, rule.weights, limit):
                seen[:] = 0
                for i in (-REACH, 0, REACH):
                    for j in (-REACH, 0, REACH):
                        if 0 <= y + i < height and 0 <= x + j < width:
                            _resembling(pixel, samples[y + i, x + j], rule.weights, limit, seen)
                if _often(seen, max(NEAR * seen.size, differing)):
                    mask[x] = 0


@njit(**VECTOR)
def _any(row: U1) -> bool:
    """Whether not all are 0."""
    found = np.uint8(0)
    for i in range(D(row.size)):
        found |= row[i]
    return bool(found)


@njit(**INNER)
def _beyond(pixel: Pixel, extremes: U1, y: int, x: int, weights: Weights, limit: np.float32) -> bool:
    """Whether a pixel is too far below the first or above the second of two values of a plane to resemble those between."""
    for c in range(3):
        below, above = F(pixel[c] - INT(extremes[y, x, c, 0])), F(pixel[c] - INT(extremes[y, x, c, 1]))
        dark, bright = weights[0 if c == 0 else c + 1], weights[c + 1]
        if (below < _NONE and below * below * dark >= limit) or (above > _NONE and above * above * bright >= limit):
            return True
    return False


@njit(**INNER)
def _often(seen: U1, least: float) -> bool:
    """Whether there are so many ones, in at least `OFTEN` runs."""
    count, runs, before = 0, 0, np.uint8(0)
    for one in seen:
        count, runs, before = count + one, runs + (one > before), one
    return count >= least and runs >= OFTEN


@njit(**VECTOR)
def _resembling(pixel: Pixel, samples: U1, weights: Weights, limit: np.float32, out: U1) -> None:
    """1 also in the place of each of the samples (3, K) that a pixel resembles."""
    (a, b, c), luma, red, blue = pixel, samples[0], samples[1], samples[2]
    dark, bright, w, v = weights
    for k in range(D(out.size)):
        d, e, f = F(INT(a - INT(luma[k]))), F(INT(b - INT(red[k]))), F(INT(c - INT(blue[k])))
        alike = d * d * (dark if d < _NONE else bright) + e * e * w + f * f * v < limit
        out[k] |= np.uint8(1) if alike else np.uint8(0)


@njit(**VECTOR)
def _rates(foreground: U1, outside: np.float32, inside: np.float32, out: F4) -> None:
    for i in range(D(foreground.size)):
        k, rate = _3 * i, outside if foreground[i] == 0 else inside
        out[k], out[k + _1], out[k + _2] = rate, rate, rate


@njit(**VECTOR)
def _approach(image: U1, rate: F4, reference: F4) -> None:
    for i in range(D(reference.size)):
        reference[i] += (F(image[i]) - reference[i]) * rate[i]


@njit(**VECTOR)
def _settle(energy: F4, foreground: U1, rate: np.float32, most: np.float32, scene: F4) -> None:
    for i in range(D(scene.size)):
        value = scene[i] + (energy[i] - scene[i]) * rate
        scene[i] = min(value if foreground[i] == 0 else scene[i], most)


@njit(**VECTOR)
def _exchange(low: NDArray[np.integer[Any]], high: NDArray[np.integer[Any]]) -> None:
    for i in range(D(low.size)):
        a, b = low[i], high[i]
        low[i], high[i] = min(a, b), max(a, b)
