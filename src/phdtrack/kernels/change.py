"""Background subtraction: one pass that finds changes against the reference, and one that updates
reference and noise.

The method stands in `detect.change`. Pictures are as decoders make them, YUV 4:2:0 in one row (n,):
brightness (H·W), and below it the blue and the red colour difference, each a plane of half width
and height, rounded up. Each row goes through short loops over a few arrays, which vectorise;
between them it stays in the cache.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels import F4, F8, I8, U1
from phdtrack.kernels.blobs import Cleaning, cleaned, mirrored
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, INT, ONE, VECTOR, D, F, log32
from phdtrack.kernels.planes import (
    BLACK,
    GREYS,
    LIFT,
    LOG,
    LOG_SCALE,
    lighting,
    noise,
    quartile,
    relit,
    smooth,
)
from phdtrack.kernels.small_arrays import copy_rows

Pixel = tuple[np.int32, np.int32, np.int32]
Weights = tuple[np.float32, np.float32, np.float32, np.float32]
Reaches = tuple[np.int32, np.int32, np.int32, np.int32]
# A pixel has not changed if it resembles samples in at least `OFTEN` runs, and at least the share
# `SHARE` of the samples that differ from the reference there: passers-by hardly resemble each
# other, leaves do.
OFTEN = 4
SHARE = 0.35
# If at least the share `BUSY` of the samples differs, samples that it resembles `REACH` pixels away
# count too: leaves sway. Then it takes the share `NEAR` of all samples, and as many as differ
# there: no more samples resemble a passer-by than there are passers-by.
BUSY = 0.1
NEAR = 0.33
REACH = 3
# What comes and goes does so in other samples each time: there are at least this share of the runs
# that as many samples in random order would have. A person who stands is in one run.
COMES = 0.6
CHANNELS = 3
# Pixels so near to the foreground count as foreground.
MARGIN = 2
# Columns whose medians are computed together: their samples stay in the cache. Pixels that are
# skipped together.
_BLOCK = 512
_PIXELS = 64
_NONE = F(0)
_BLACK = F(BLACK)
_WHITE = F(235)
_MIDDLE = F(128)
_THIRD = F(1 / CHANNELS)
# `_ORIGIN`: the brightness at which grey level + `_LIFT` would be 0.
_LOG_SCALE = F(LOG_SCALE)
_ORIGIN = F(BLACK - LIFT / GREYS)
# The third quartile of |difference of two numbers| of deviation 1; how much of the camera's noise
# is kept in each frame.
_QUARTILE_OF_DIFFERENCES = 1.1503 * 2**0.5
_MEMORY = 0.9
_1 = D(1)


class Statistic(NamedTuple):
    """The test of change in a pixel.

    ``local`` (4,): variances by local light of differences of brightness towards dark and bright,
    and of blue and red; ``window`` its side, odd; ``threshold`` of the window's mean; ``alike``:
    energy below which a sample resembles a pixel.
    """

    local: F8
    window: int
    threshold: float
    alike: float


class Past(NamedTuple):
    """Earlier pictures: ``samples`` (n, K) of other times in order, with the logarithm of
    brightness; ``differing`` (H, W), how many of them differ from the reference; ``extremes`` (n,
    2), the `OFTEN`-th smallest and largest of each number; ``near``, the `often_near`-th of the
    smallest and largest within `REACH`."""

    samples: U1
    differing: U1
    extremes: U1
    near: U1


class Alike(NamedTuple):
    """The test of similarity of a sample and a pixel: ``weights`` 1/σ², see `Statistic.local`,
    ``limit`` of the energy, and ``reaches``, the least difference in each component that is too
    large on its own."""

    weights: Weights
    limit: np.float32
    reaches: Reaches


def often_near(count: int) -> int:
    """The least number of samples, of so many, that a pixel must resemble some pixels away."""
    return max(1, math.ceil(NEAR * count))


@njit(**ENTRY)
def changed(
    image: U1,
    before: U1,
    camera: F8,
    background: tuple[F4, F4, U1],
    rule: Statistic,
    past: Past,
    steps: tuple[int, int],
    cleaning: Cleaning,
    beyond: tuple[int, int],
) -> tuple[U1, F4, F4, U1]:
    """The cleaned mask of the next frame, its energy as in `compare`, its light (3, 4) as in
    `lighting`, and the picture in the light of the reference, if there is a past.

    All of it in one call: a thread that runs Python beside this one delays the begin and the end of
    each call.

    Parameters
    ----------
    image : (n,); its colours are smoothed in place.
    before : (3, h, w) sparse pixels of the frame before; become those of this one.
    camera : (3,) deviations of brightness and colours by the camera's noise; updated.
    background : reference (n,), usual energy (H, W), and the foreground (H, W) of the frame before;
        becomes that of this one.
    rule, past : as for `compare`.
    steps : distance both ways of the pixels from which the camera's noise is measured, even, and
        of those for the light.
    cleaning : as for `cleaned`.
    beyond : so many columns on the left and on the right, and rows above and below, show nothing of
        the scene.
    """
    reference, scene, foreground = background
    smooth(image, scene.shape)
    counts = noise(image, before, scene.shape, steps[0])
    for c in range(3):
        camera[c] += (1 - _MEMORY) * (quartile(counts[c]) / _QUARTILE_OF_DIFFERENCES - camera[c])
    light = lighting(reference, image, foreground, steps[1])
    raw, energy, level = compare(image, reference, light, scene, rule, camera, past)
    _border(raw, beyond, 0)
    mask, near = cleaned(raw, cleaning, MARGIN)
    copy_rows(near, foreground)
    _border(foreground, beyond, 255)
    return mask, energy, light, level


@njit(**ENTRY)
def compare(
    image: U1, reference: F4, light: F4, scene: F4, rule: Statistic, camera: F8, past: Past
) -> tuple[U1, F4, U1]:
    """(H, W) 255 for pixels of ``image`` that changed against the ``reference`` in another
    ``light``, (H, W) the energy, and (n,) the image in the light of the reference, if there is a
    past.

    ``image``, ``reference`` (n,); ``light`` (3, 4) from `lighting`; ``scene`` (H, W): the usual
    energy, three times s; ``rule``, ``past``: see above; ``camera`` (3,): deviations of brightness
    and of colours by the camera's noise.
    """
    height, width = scene.shape
    mask = np.empty((height, width), np.uint8)
    energy = np.empty((height, width), np.float32)
    reach = rule.window // 2
    window = rule.window
    across = (width + 1) // 2
    limit = F(rule.threshold * window * window)
    least = F(rule.threshold / 2)
    weights = _weights(rule.local, camera)
    count = past.samples.shape[1]
    level = image
    if count:
        level = relit(image, light, scene.shape)
    alike = Alike(weights, F(rule.alike), _reaches(weights, F(rule.alike)))
    # Arrays of a row: brightness, the colours' part of the energy and the colours' part of the
    # light of every other pixel; the last two of all pixels; and the sums over columns of the
    # window, with a margin.
    half = np.zeros((3, across), np.float32)
    whole = np.zeros((2, 2 * across), np.float32)
    column = np.empty(width + 2 * reach, np.float32)
    normal = np.empty((window, width), np.float32)
    total = np.empty(width, np.float32)
    work = np.empty(count, np.uint8), np.empty((2, 9), np.int64)
    for y in range(height + reach):
        if y < height:
            if y % 2 == 0:
                _colour_energy(y, image, reference, light, weights, scene, half, whole)
            _energy(y, image, reference, light, weights, scene, whole, energy, normal)
        at = y - reach
        if at >= 0:
            _columns(at, height, normal, column)
            _copy(column, reach, total)
            for k in range(reach):
                _add(column, k, 2 * reach - k, total)
            _passed(at, normal, total, limit, least, mask)
            if count:
                _recall(level, alike, past, at, work, mask)
    return mask, energy, level


@njit(**ENTRY)
def follow(image: U1, energy: F4, reference: F4, scene: F4, foreground: U1, rates: F4) -> None:
    """Update ``reference`` (n,) with ``image``, and ``scene`` (H, W) outside of the ``foreground``
    with ``energy``.

    ``rates``: of the reference outside of the foreground and in it, and of the scene; the largest
    value of the scene.
    """
    height, width = scene.shape
    low = (height + 1) // 2
    across = (width + 1) // 2
    _approach(image, foreground.reshape(-1), rates, reference, 0)
    _settle(energy.reshape(-1), foreground.reshape(-1), rates[2], rates[3], scene.reshape(-1))
    colours = np.empty((low, across), np.uint8)
    for y in range(low):
        _halved(foreground, y, colours)
    for k in range(2):
        _approach(image, colours.reshape(-1), rates, reference, height * width + k * low * across)


@njit(**INNER)
def _border(mask: U1, beyond: tuple[int, int], value: int) -> None:
    """Write a value into so many columns on both sides, and rows above and below."""
    height, width = mask.shape
    across, down = beyond
    for y in range(height):
        if y < down or y >= height - down:
            for x in range(width):
                mask[y, x] = value
        for x in range(min(across, width)):
            mask[y, x] = value
            mask[y, width - 1 - x] = value


@njit(**INNER)
def _weights(local: F8, camera: F8) -> Weights:
    """1/σ² of differences with these variances by local light, and the camera's noise."""
    grey = camera[0] ** 2
    blue = F(1 / (local[2] + camera[1] ** 2))
    red = F(1 / (local[3] + camera[2] ** 2))
    return F(1 / (local[0] + grey)), F(1 / (local[1] + grey)), blue, red


@njit(**INNER)
def _reaches(weights: Weights, limit: np.float32) -> Reaches:
    """The least differences of each component with an energy not below the limit."""
    return (
        _reach(weights[0], limit),
        _reach(weights[1], limit),
        _reach(weights[2], limit),
        _reach(weights[3], limit),
    )


@njit(**INNER)
def _reach(weight: np.float32, limit: np.float32) -> np.int32:
    """The least difference with an energy not below the limit."""
    for difference in range(256):
        if F(difference) * F(difference) * weight >= limit:
            return INT(difference)
    return INT(256)


@njit(**ENTRY)
def middle(samples: NDArray[np.integer[Any]]) -> NDArray[np.integer[Any]]:
    """(n,) the median of each column of an odd number of ``samples`` (K, n), by exchanges of
    neighbours.
    """
    count, n = samples.shape
    out = np.empty(n, samples.dtype)
    part = np.empty((count, _BLOCK), samples.dtype)
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
def _halved(foreground: U1, row: int, out: U1) -> None:
    """Copy every other pixel of every other row, one row."""
    for i in range(D(out.shape[1])):
        out[row, i] = foreground[2 * row, i + i]


# The functions of a row take whole arrays and its position in them: taking a row out costs as much
# as working on it.
@njit(**VECTOR)
def _colour_energy(
    y: int, image: U1, reference: F4, light: F4, weights: Weights, scene: F4, half: F4, whole: F4
) -> None:
    """The colours' part of the energy of a row, and their contribution to the brightness of the
    reference in another light.
    """
    height, width = scene.shape
    across = (width + 1) // 2
    row = D(y * width)
    blue = D(height * width + y // 2 * across)
    red = blue + D((height + 1) // 2 * across)
    n = D(across)
    a = light[1, 0]
    b = light[1, 1]
    c = light[1, 2]
    d = light[1, 3]
    e = light[2, 0]
    f = light[2, 1]
    g = light[2, 2]
    h = light[2, 3]
    v = weights[2]
    w = weights[3]
    by_blue = light[0, 1]
    by_red = light[0, 2]
    for i in range(n):
        half[0, i] = reference[row + i + i]
    for i in range(n):
        x = half[0, i] - _BLACK
        t = reference[blue + i] - _MIDDLE
        u = reference[red + i] - _MIDDLE
        q = F(image[blue + i]) - _MIDDLE - (a * x + b * t + c * u + d)
        r = F(image[red + i]) - _MIDDLE - (e * x + f * t + g * u + h)
        half[1, i] = q * q * v + r * r * w
        half[2, i] = t * by_blue + u * by_red
    for i in range(n):
        whole[0, i + i] = half[1, i]
        whole[0, i + i + _1] = half[1, i]
    for i in range(n):
        whole[1, i + i] = half[2, i]
        whole[1, i + i + _1] = half[2, i]


@njit(**VECTOR)
def _energy(
    y: int,
    image: U1,
    reference: F4,
    light: F4,
    weights: Weights,
    scene: F4,
    whole: F4,
    energy: F4,
    normal: F4,
) -> None:
    """The energy of a row, and its ratio to the usual energy."""
    dark = weights[0]
    bright = weights[1]
    slot = y % normal.shape[0]
    start = D(y * scene.shape[1])
    gain = light[0, 0]
    offset = light[0, 3] + _BLACK - light[0, 0] * _BLACK
    for i in range(D(scene.shape[1])):
        usual = (
            min(max(reference[start + i] * gain + whole[1, i] + offset, _BLACK), _WHITE) - _ORIGIN
        )
        d = _LOG_SCALE * log32((min(max(F(image[start + i]), _BLACK), _WHITE) - _ORIGIN) / usual)
        value = d * d * (dark if d < _NONE else bright) + whole[0, i]
        energy[y, i] = value
        normal[slot, i] = value / max(scene[y, i] * _THIRD, ONE)


@njit(**VECTOR)
def _columns(at: int, height: int, normal: F4, column: F4) -> None:
    """The sums of the rows of the window around a row, mirrored beyond its ends."""
    window, width = normal.shape
    reach = window // 2
    n = D(width)
    start = D(reach)
    here = at % window
    for i in range(n):
        column[start + i] = normal[here, i]
    for k in range(1, reach + 1):
        above = mirrored(at - k, height) % window
        below = mirrored(at + k, height) % window
        for i in range(n):
            column[start + i] += normal[above, i] + normal[below, i]
    for k in range(reach):
        column[k] = column[reach + mirrored(k - reach, width)]
        column[reach + width + k] = column[reach + mirrored(width + k, width)]


@njit(**VECTOR)
def _copy(column: F4, start: int, total: F4) -> None:
    """Copy the sums over columns from ``start`` on."""
    for i in range(D(total.size)):
        total[i] = column[D(start) + i]


@njit(**VECTOR)
def _add(column: F4, a: int, b: int, total: F4) -> None:
    """Add the sums over columns from a and from b on."""
    x = D(a)
    y = D(b)
    for i in range(D(total.size)):
        total[i] += column[x + i] + column[y + i]


@njit(**VECTOR)
def _passed(at: int, normal: F4, total: F4, limit: np.float32, least: np.float32, mask: U1) -> None:
    """Write 255 for the pixels of a row that changed: the window's mean must pass the limit, and
    the pixel itself half of it, which keeps outlines sharp.
    """
    slot = at % normal.shape[0]
    for i in range(D(total.size)):
        passed = (total[i] > limit) & (normal[slot, i] > least)
        mask[at, i] = np.uint8(255) if passed else np.uint8(0)


@njit(**INNER)
def _recall(image: U1, alike: Alike, past: Past, y: int, work: tuple[U1, I8], mask: U1) -> None:
    """Remove pixels that resemble the past from row ``y`` of the mask; ``work`` is scratch."""
    similar, near = work
    samples = past.samples
    reaches = alike.reaches
    height, width = past.differing.shape
    across = (width + 1) // 2
    plane = (height + 1) // 2 * ((width + 1) // 2)
    for start in range(0, width, _PIXELS):
        stop = min(start + _PIXELS, width)
        # Most of a picture has not changed.
        if not _any(mask, y, start, stop):
            continue
        for x in range(start, stop):
            if mask[y, x] == 0:
                continue
            p = y * width + x
            q = height * width + y // 2 * across + x // 2
            differing = past.differing[y, x]
            pixel = INT(LOG[image[p]]), INT(image[q]), INT(image[q + plane])
            if not _beyond(pixel, past.extremes, (p, q, q + plane), reaches):
                near[0, 0] = p
                near[1, 0] = q
                count = _resembling(pixel, samples, near, 1, plane, alike, similar)
                if _often(count, similar, SHARE * differing):
                    mask[y, x] = 0
            busy = mask[y, x] and differing >= BUSY * similar.size
            if busy and not _beyond(pixel, past.near, (p, q, q + plane), reaches):
                n = _neighbours(y, x, height, width, near)
                count = _resembling(pixel, samples, near, n, plane, alike, similar)
                if _often(count, similar, max(NEAR * similar.size, differing)):
                    mask[y, x] = 0


@njit(**INNER)
def _neighbours(y: int, x: int, height: int, width: int, near: I8) -> int:
    """Write the positions of brightness and blue of a pixel and the eight `REACH` pixels away;
    returns how many are inside of the picture.
    """
    across = (width + 1) // 2
    n = 0
    for i in (y - REACH, y, y + REACH):
        for j in (x - REACH, x, x + REACH):
            if 0 <= i < height and 0 <= j < width:
                near[0, n] = i * width + j
                near[1, n] = height * width + i // 2 * across + j // 2
                n += 1
    return n


@njit(**VECTOR)
def _any(mask: U1, y: int, start: int, stop: int) -> bool:
    """True if a part of a row is not all 0."""
    bits = np.uint8(0)
    for i in range(D(start), D(stop)):
        bits |= mask[y, i]
    return bool(bits)


@njit(**INNER)
def _beyond(pixel: Pixel, extremes: U1, at: tuple[int, int, int], reaches: Reaches) -> bool:
    """True if a pixel is too far below the first or above the second extreme to resemble a sample
    between them.
    """
    for c in range(3):
        low = INT(extremes[at[c], 0])
        high = INT(extremes[at[c], 1])
        if low - pixel[c] >= reaches[0 if c == 0 else c + 1] or pixel[c] - high >= reaches[c + 1]:
            return True
    return False


@njit(**INNER)
def _often(count: int, similar: U1, least: float) -> bool:
    """True if there are enough ones, ``count``, in at least `OFTEN` runs, and nearly as many runs
    as in random order: n ones among N have n (N − n + 1) / N.
    """
    if count < least or count < OFTEN:
        return False
    runs = 0
    before = np.uint8(0)
    for now in similar:
        runs = runs + (now > before)
        before = now
    size = similar.size
    return runs >= max(OFTEN, COMES * count * (size - count + 1) / size)


@njit(**VECTOR)
def _resembling(
    pixel: Pixel, samples: U1, near: I8, positions: int, plane: int, alike: Alike, out: U1
) -> Any:
    """Write 1 for each sample that a pixel resembles at one of the positions ``near`` (of
    brightness and of blue; red is a ``plane`` behind blue); returns their number.
    """
    a, b, c = pixel
    dark, bright, v, w = alike.weights
    limit = alike.limit
    count = INT(0)
    for k in range(D(out.size)):
        out[k] = 0
    for m in range(positions):
        # No rows are taken out of the array, which would take longer than comparing them.
        i = D(near[0, m])
        j = D(near[1, m])
        red = j + D(plane)
        for k in range(D(out.size)):
            d = F(INT(a - INT(samples[i, k])))
            e = F(INT(b - INT(samples[j, k])))
            f = F(INT(c - INT(samples[red, k])))
            same = d * d * (dark if d < _NONE else bright) + e * e * v + f * f * w < limit
            out[k] |= np.uint8(1) if same else np.uint8(0)
    for k in range(D(out.size)):
        count += INT(out[k])
    return count


@njit(**VECTOR)
def _approach(image: U1, foreground: U1, rates: F4, reference: F4, start: int) -> None:
    """Update a plane of the reference, from number ``start`` on, as large as the foreground."""
    outside = rates[0]
    inside = rates[1]
    first = D(start)
    for i in range(D(foreground.size)):
        k = first + i
        reference[k] += (F(image[k]) - reference[k]) * (outside if foreground[i] == 0 else inside)


@njit(**VECTOR)
def _settle(energy: F4, foreground: U1, rate: np.float32, most: np.float32, scene: F4) -> None:
    """Update the usual energy outside of the foreground."""
    for i in range(D(scene.size)):
        value = scene[i] + (energy[i] - scene[i]) * rate
        scene[i] = min(value if foreground[i] == 0 else scene[i], most)


@njit(**VECTOR)
def _exchange(low: NDArray[np.integer[Any]], high: NDArray[np.integer[Any]]) -> None:
    """Put the smaller of two numbers of each column first."""
    for i in range(D(low.size)):
        a = low[i]
        b = high[i]
        low[i] = min(a, b)
        high[i] = max(a, b)
