"""A frame against the reference: one pass that says where it changed, and one by which reference and noise follow it.

What each computes is said in `detect.change`. Pictures are as decoders have them, YUV 4:2:0 in one row (n,): brightness
(H·W), and below it the blue and the red colour difference, each a plane of half width and height, rounded up. Each row goes
through short loops over a few arrays, which vectorise; between them it stays in the cache.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.blobs import mirrored
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, INT, ONE, VECTOR, D, F, log32

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
# Brightness is 16 (black) to 235 (white), colour differences 16 to 240 (BT.601): grey levels and levels of colour in each.
BLACK, GREYS, COLOURS = 16, 255 / 219, 255 / 224
# Brightness is compared as the logarithm of grey level + `_LIFT`: noise in the dark counts less. `LOG` has it in whole
# numbers, 0 for black; by its scale they fit into a byte.
_LIFT, LOG_SCALE = 15, 88.0
LOG: U1 = np.rint(LOG_SCALE * np.log1p(GREYS * np.clip(np.arange(256) - BLACK, 0, 219) / _LIFT)).astype(np.uint8)
# Blue, green and red, 0 to 255, of brightness less BLACK, and the colour differences of blue and red less 128.
TO_BGR: F8 = np.array([[1, 1.772, 0], [1, -0.344136, -0.714136], [1, 0, 1.402]]) * np.array([GREYS, COLOURS, COLOURS])
FROM_BGR: F8 = np.asarray(np.linalg.inv(TO_BGR), np.float64)
# Grey levels between which a pixel tells of the light, the fewest pixels, and the deviations within which they fit.
_DARKEST, _BRIGHTEST, _FEWEST, _NEAR, _ROUNDS = 8, 245, 50, 2.5, 3
_BINS = 8192
# Columns whose medians are made together: their samples stay in the cache. Pixels that are passed over at once.
_BLOCK, _PIXELS = 512, 64
_NONE, _BLACK, _WHITE, _MIDDLE, _THIRD = F(0), F(BLACK), F(235), F(128), F(1 / CHANNELS)
# `_ORIGIN`: the brightness at which grey level + `_LIFT` would be 0.
_LOG_SCALE, _ORIGIN = F(LOG_SCALE), F(BLACK - _LIFT / GREYS)
_1 = D(1)


class Statistic(NamedTuple):
    """What decides that a pixel changed.

    ``weights``: 1/σ² of differences of brightness towards dark and bright, and of blue and red; ``window`` its side, odd;
    ``threshold`` of the window's mean; ``alike``: energy below which a sample resembles a pixel.
    """

    weights: Weights
    window: int
    threshold: float
    alike: float


class Past(NamedTuple):
    """``samples`` (n, K) of other times in order, their brightness as its logarithm, how many of them differ from the
    reference (H, W), and the ``OFTEN``-th smallest and largest of each number (n, 2); ``near``: the same of the smallest and
    largest within `REACH`, the `often_near`-th."""

    samples: U1
    differing: U1
    extremes: U1
    near: U1


def often_near(count: int) -> int:
    """How many of so many samples a pixel has to resemble some pixels away at the least."""
    return max(1, math.ceil(NEAR * count))


def luma(picture: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """(H, W) the brightness of a picture (n, ...) of this shape, the same memory."""
    return picture[: shape[0] * shape[1]].reshape(*shape, *picture.shape[1:])


def colours(picture: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """(2, h, w) its colour differences of blue and red, the same memory."""
    height, width = shape
    return picture[height * width :].reshape(2, (height + 1) // 2, (width + 1) // 2, *picture.shape[1:])


@njit(**ENTRY)
def compare(image: U1, reference: F4, light: F4, scene: F4, rule: Statistic, past: Past) -> tuple[U1, F4]:
    """(H, W) 255 where ``image`` changed against the ``reference`` in another ``light``, and (H, W) its energy.

    Parameters
    ----------
    image, reference : (n,).
    light : (3, 4) as `lighting` has it.
    scene : (H, W) energy that is usual there, three times s.
    rule, past : as above.
    """
    height, width = scene.shape
    mask, energy = np.empty((height, width), np.uint8), np.empty((height, width), np.float32)
    low, across = (height + 1) // 2, (width + 1) // 2
    first, second = height * width, height * width + low * across
    window, reach = rule.window, rule.window // 2
    limit, least = F(rule.threshold * window * window), F(rule.threshold / 2)
    # The statistic of the rows of a window; the sum of that, with a margin, and the sum over windows.
    normal, column = np.empty((window, width), np.float32), np.empty(width + 2 * reach, np.float32)
    total, count = np.empty(width, np.float32), past.samples.shape[1]
    work = np.empty(count, np.uint8), np.empty((2, 9), np.int64)
    colour, half = np.empty(2 * across, np.float32), np.empty((2, across), np.float32)
    tint, tinted = np.zeros(2 * across, np.float32), light[0, 1] != 0 or light[0, 2] != 0
    for y in range(height + reach):
        if y < height:
            row, place = reference[y * width : (y + 1) * width], y // 2 * across
            if y % 2 == 0:
                blue, red = reference[first + place :][:across], reference[second + place :][:across]
                now_blue, now_red = image[first + place :][:across], image[second + place :][:across]
                _halved(row, half[0])
                if tinted:
                    _tint(blue, red, light, half[1])
                    _spread(half[1], tint)
                _colour_energy(half[0], blue, red, now_blue, now_red, light, rule.weights, half[1])
                _spread(half[1], colour)
            now = image[y * width : (y + 1) * width]
            _energy(now, row, light, tint, rule.weights, scene[y], colour, energy[y], normal[y % window])
        at = y - reach
        if at >= 0:
            column[:] = 0
            total[:] = 0
            for k in range(at - reach, at + reach + 1):
                _add(normal[mirrored(k, height) % window], column[reach : reach + width])
            for k in range(reach):
                column[k] = column[reach + mirrored(k - reach, width)]
                column[reach + width + k] = column[reach + mirrored(width + k, width)]
            for k in range(window):
                _add(column[k : k + width], total)
            _passed(total, normal[at % window], limit, least, mask[at])
            if count:
                _recall(image, rule, past, at, work, mask[at])
    return mask, energy


@njit(**ENTRY)
def follow(image: U1, energy: F4, reference: F4, scene: F4, foreground: U1, rates: F4) -> None:
    """Move ``reference`` (n,) towards ``image``, and outside of the ``foreground`` ``scene`` (H, W) towards ``energy``.

    ``rates``: of the reference outside of the foreground and in it, and of the scene; the largest value of that.
    """
    height, width = scene.shape
    low, across = (height + 1) // 2, (width + 1) // 2
    half = np.empty(across, np.uint8)
    for y in range(height):
        row = slice(y * width, (y + 1) * width)
        _approach(image[row], foreground[y], rates, reference[row])
        _settle(energy[y], foreground[y], rates[2], rates[3], scene[y])
        if y % 2 == 0:
            _halved(foreground[y], half)
            for k in range(2):
                start = height * width + (k * low + y // 2) * across
                place = slice(start, start + across)
                _approach(image[place], half, rates, reference[place])


@njit(**ENTRY)
def lighting(reference: F4, image: U1, foreground: U1, step: int) -> F4:
    """(3, 4) what brings the ``reference`` into the light of ``image``: a matrix, and in its last column what is added.

    It maps brightness less 16, and the colour differences of blue and red less 128. Blue, green and red each have a gain and
    an offset, fitted to every ``step``-th pixel both ways outside of the ``foreground``; 1 and 0 where too few tell.
    """
    height, width = foreground.shape
    first, n, across = step // 2, np.zeros(3, np.int64), (width + 1) // 2
    room = len(range(first, height, step)) * len(range(first, width, step))
    x, y, size, counts = np.empty((3, room)), np.empty((3, room)), np.empty(room), np.empty(_BINS, np.int32)
    for i in range(first, height, step):
        for j in range(first, width, step):
            if foreground[i, j] == 0:
                blue = height * width + i // 2 * across + j // 2
                red = blue + (height + 1) // 2 * across
                p = i * width + j
                for c in range(3):
                    a, b, d = TO_BGR[c, 0], TO_BGR[c, 1], TO_BGR[c, 2]
                    was = a * (reference[p] - 16) + b * (reference[blue] - 128) + d * (reference[red] - 128)
                    now = a * (F(image[p]) - 16) + b * (F(image[blue]) - 128) + d * (F(image[red]) - 128)
                    if was > _DARKEST and was < _BRIGHTEST and now > _DARKEST and now < _BRIGHTEST:
                        x[c, n[c]], y[c, n[c]] = was, now
                        n[c] += 1
    out = np.zeros((3, 4), np.float32)
    for c in range(3):
        gain, offset = _line(x[c, : n[c]], y[c, : n[c]], size[: n[c]], counts)
        for i in range(3):
            for j in range(3):
                out[i, j] += F(FROM_BGR[i, c] * gain * TO_BGR[c, j])
            out[i, 3] += F(FROM_BGR[i, c] * offset)
    return out


@njit(**ENTRY)
def noise(image: U1, before: U1, shape: tuple[int, int], step: int) -> I8:
    """(3, 256) how often every ``step``-th pixel both ways of ``image`` (n,), of this shape, differs by so much.

    From ``before`` (3, h, w): logarithm of brightness, and the colours, which become those of this image; ``step`` is even.
    """
    (tall, wide), (_, height, width) = shape, before.shape
    across = (wide + 1) // 2
    counts, now = np.zeros((3, 256), np.int64), np.empty(3, np.uint8)
    for y in range(height):
        for x in range(width):
            now[0] = LOG[image[step * (y * wide + x)]]
            now[1] = image[tall * wide + step // 2 * (y * across + x)]
            now[2] = image[tall * wide + (tall + 1) // 2 * across + step // 2 * (y * across + x)]
            for c in range(3):
                counts[c, abs(np.int64(now[c]) - np.int64(before[c, y, x]))] += 1
                before[c, y, x] = now[c]
    return counts


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


@njit(**VECTOR)
def _halved(row: NDArray[Any], out: NDArray[Any]) -> None:
    """The first of each two numbers."""
    for i in range(D(out.size)):
        out[i] = row[i + i]


@njit(**VECTOR)
def _spread(half: F4, out: F4) -> None:
    """Each number twice."""
    for i in range(D(half.size)):
        out[i + i], out[i + i + _1] = half[i], half[i]


@njit(**VECTOR)
def _tint(blue: F4, red: F4, light: F4, out: F4) -> None:
    """What the colours of the reference add to its brightness in another light."""
    a, b = light[0, 1], light[0, 2]
    for i in range(D(out.size)):
        out[i] = (blue[i] - _MIDDLE) * a + (red[i] - _MIDDLE) * b


@njit(**VECTOR)
def _colour_energy(grey: F4, blue: F4, red: F4, now_blue: U1, now_red: U1, light: F4, weights: Weights, out: F4) -> None:
    """The part of the energy that colours have."""
    v, w = weights[2], weights[3]
    a, b, c, d = light[1, 0], light[1, 1], light[1, 2], light[1, 3]
    e, f, g, h = light[2, 0], light[2, 1], light[2, 2], light[2, 3]
    for i in range(D(out.size)):
        x, y, z = grey[i] - _BLACK, blue[i] - _MIDDLE, red[i] - _MIDDLE
        s = F(now_blue[i]) - _MIDDLE - (a * x + b * y + c * z + d)
        t = F(now_red[i]) - _MIDDLE - (e * x + f * y + g * z + h)
        out[i] = s * s * v + t * t * w


@njit(**VECTOR)
def _energy(
    now: U1, reference: F4, light: F4, tint: F4, weights: Weights, scene: F4, colour: F4, out: F4, normal: F4
) -> None:
    """The energy of a row, and what it is over what is usual there."""
    dark, bright = weights[0], weights[1]
    gain, offset = light[0, 0], light[0, 3] + _BLACK - light[0, 0] * _BLACK
    for i in range(D(out.size)):
        usual = min(max(reference[i] * gain + tint[i] + offset, _BLACK), _WHITE) - _ORIGIN
        d = _LOG_SCALE * log32((min(max(F(now[i]), _BLACK), _WHITE) - _ORIGIN) / usual)
        out[i] = value = d * d * (dark if d < _NONE else bright) + colour[i]
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
def _recall(image: U1, rule: Statistic, past: Past, y: int, work: tuple[U1, I8], mask: U1) -> None:
    """Take what was seen before out of row ``y`` of the mask; ``work`` is overwritten."""
    (seen, near), samples, limit = work, past.samples, F(rule.alike)
    height, width = past.differing.shape
    across, plane = (width + 1) // 2, (height + 1) // 2 * ((width + 1) // 2)
    for start in range(0, width, _PIXELS):
        # Most of a picture has not changed.
        for x in range(start, min(start + _PIXELS, width)) if _any(mask[start : start + _PIXELS]) else range(0):
            if mask[x] == 0:
                continue
            p, q, differing = y * width + x, height * width + y // 2 * across + x // 2, past.differing[y, x]
            pixel = INT(LOG[image[p]]), INT(image[q]), INT(image[q + plane])
            if not _beyond(pixel, past.extremes, (p, q, q + plane), rule.weights, limit):
                near[0, 0], near[1, 0] = p, q
                count = _resembling(pixel, samples, near[:, :1], plane, rule.weights, limit, seen)
                if _often(count, seen, SHARE * differing):
                    mask[x] = 0
            busy = mask[x] and differing >= BUSY * seen.size
            if busy and not _beyond(pixel, past.near, (p, q, q + plane), rule.weights, limit):
                n = 0
                for i in (y - REACH, y, y + REACH):
                    for j in (x - REACH, x, x + REACH):
                        if 0 <= i < height and 0 <= j < width:
                            near[0, n], near[1, n] = i * width + j, height * width + i // 2 * across + j // 2
                            n += 1
                count = _resembling(pixel, samples, near[:, :n], plane, rule.weights, limit, seen)
                if _often(count, seen, max(NEAR * seen.size, differing)):
                    mask[x] = 0


@njit(**VECTOR)
def _any(row: U1) -> bool:
    """Whether not all are 0."""
    found = np.uint8(0)
    for i in range(D(row.size)):
        found |= row[i]
    return bool(found)


@njit(**INNER)
def _beyond(pixel: Pixel, extremes: U1, at: tuple[int, int, int], weights: Weights, limit: np.float32) -> bool:
    """Whether a pixel is too far below the first or above the second of two values of a plane to resemble those between."""
    for c in range(3):
        below, above = F(pixel[c] - INT(extremes[at[c], 0])), F(pixel[c] - INT(extremes[at[c], 1]))
        dark, bright = weights[0 if c == 0 else c + 1], weights[c + 1]
        if (below < _NONE and below * below * dark >= limit) or (above > _NONE and above * above * bright >= limit):
            return True
    return False


@njit(**INNER)
def _often(count: int, seen: U1, least: float) -> bool:
    """Whether the ``count`` of ones is at least so large, and they are in at least `OFTEN` runs."""
    if count < least or count < OFTEN:
        return False
    runs, before = 0, np.uint8(0)
    for one in seen:
        runs, before = runs + (one > before), one
    return runs >= OFTEN


@njit(**VECTOR)
def _resembling(pixel: Pixel, samples: U1, near: I8, plane: int, weights: Weights, limit: np.float32, out: U1) -> Any:
    """1 for each of the samples that a pixel resembles at one of the places ``near``, of brightness and of blue, and their
    number; red is a ``plane`` behind blue."""
    (a, b, c), (dark, bright, v, w), count = pixel, weights, INT(0)
    out[:] = 0
    for m in range(near.shape[1]):
        grey, blue, red = samples[near[0, m]], samples[near[1, m]], samples[near[1, m] + plane]
        for k in range(D(out.size)):
            d, e, f = F(INT(a - INT(grey[k]))), F(INT(b - INT(blue[k]))), F(INT(c - INT(red[k])))
            alike = d * d * (dark if d < _NONE else bright) + e * e * v + f * f * w < limit
            out[k] |= np.uint8(1) if alike else np.uint8(0)
    for k in range(D(out.size)):
        count += INT(out[k])
    return count


@njit(**VECTOR)
def _approach(image: U1, foreground: U1, rates: F4, reference: F4) -> None:
    outside, inside = rates[0], rates[1]
    for i in range(D(reference.size)):
        reference[i] += (F(image[i]) - reference[i]) * (outside if foreground[i] == 0 else inside)


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
