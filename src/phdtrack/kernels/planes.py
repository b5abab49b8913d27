"""Pictures as planes, as decoders make them: smoothing, noise, light, and drawing.

They are YUV 4:2:0 in one row (n,): brightness (H·W), and below it the blue and the red colour
difference, each a plane of half width and height, rounded up.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels import F4, F8, I4, I8, U1
from phdtrack.kernels.blobs import mirrored
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER, INT, VECTOR, D, F

# Brightness is 16 (black) to 235 (white), colour differences 16 to 240 (BT.601): grey levels and
# levels of colour in each.
BLACK = 16
GREYS = 255 / 219
COLOURS = 255 / 224
# Brightness is compared as the logarithm of grey level + `LIFT`: noise in the dark counts less.
# `LOG` has it in whole numbers, 0 for black; by its scale they fit into a byte.
LIFT = 15
LOG_SCALE = 88.0
LOG: U1 = np.rint(
    LOG_SCALE * np.log1p(GREYS * np.clip(np.arange(256) - BLACK, 0, 219) / LIFT)
).astype(np.uint8)
# Blue, green and red, 0 to 255, of brightness less BLACK, and the colour differences of blue and
# red less 128.
TO_BGR: F8 = np.array([[1, 1.772, 0], [1, -0.344136, -0.714136], [1, 0, 1.402]]) * np.array(
    [GREYS, COLOURS, COLOURS]
)
FROM_BGR: F8 = np.asarray(np.linalg.inv(TO_BGR), np.float64)
# The light is fitted to pixels between these grey levels, if there are enough, within so many
# deviations.
_DARKEST = 8
_BRIGHTEST = 245
_FEWEST = 50
_NEAR = 2.5
_ROUNDS = 3
_BINS = 8192
# Two lights are the same if no gain differs by more, and no offset in grey levels.
_SAME_GAIN = 0.01
_SAME_OFFSET = 1.0
# Pixels of a row that are skipped together if nothing was drawn on them, and the bits of two of
# them.
_STRETCH = 8
_TWO = D(0xFFFF)
_BITS = D(16)


def luma(picture: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """(H, W) a view of the brightness of a picture (n, ...) of this shape."""
    return picture[: shape[0] * shape[1]].reshape(*shape, *picture.shape[1:])


def colours(picture: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """(2, h, w) a view of its colour differences of blue and red."""
    height, width = shape
    return picture[height * width :].reshape(
        2, (height + 1) // 2, (width + 1) // 2, *picture.shape[1:]
    )


@njit(**ENTRY)
def smooth(picture: U1, shape: tuple[int, int]) -> None:
    """Replace the colours of a picture (n,) of this shape by the means of squares of nine,
    rounded.
    """
    height = (shape[0] + 1) // 2
    width = (shape[1] + 1) // 2
    sums = np.empty((3, width), np.int32)
    for first in (shape[0] * shape[1], shape[0] * shape[1] + height * width):
        _three(picture, first, sums, 0)
        for y in range(height):
            if y + 1 < height:
                _three(picture, first + (y + 1) * width, sums, (y + 1) % 3)
            above = mirrored(y - 1, height) % 3
            below = mirrored(y + 1, height) % 3
            _ninth(sums, (above, y % 3, below), picture, first + y * width)


@njit(**VECTOR)
def _three(picture: U1, start: int, sums: I4, slot: int) -> None:
    """The sum of each number of a row and its two neighbours."""
    width = sums.shape[1]
    left = D(start - 1)
    here = D(start)
    right = D(start + 1)
    for i in range(D(1), D(max(width - 1, 1))):
        sums[slot, i] = INT(picture[left + i]) + INT(picture[here + i]) + INT(picture[right + i])
    for k in (0, width - 1):
        a = mirrored(k - 1, width)
        b = mirrored(k + 1, width)
        sums[slot, k] = INT(picture[start + k]) + INT(picture[start + a]) + INT(picture[start + b])


@njit(**VECTOR)
def _ninth(sums: I4, rows: tuple[int, int, int], picture: U1, start: int) -> None:
    """Write the means of squares of nine numbers from the sums of threes in these rows."""
    above, here, below = rows
    for i in range(D(sums.shape[1])):
        # The ninth, rounded, of up to 2295.
        total = sums[above, i] + sums[here, i] + sums[below, i] + INT(4)
        picture[D(start) + i] = np.uint8((total * INT(7282)) >> INT(16))


@njit(**ENTRY)
def noise(image: U1, before: U1, shape: tuple[int, int], step: int) -> I8:
    """(3, 256) histograms of the differences of every ``step``-th pixel both ways of ``image``
    (n,), of this shape, from the frame before.

    ``before`` (3, h, w): logarithm of brightness, and the colours; become those of this image.
    ``step`` is even.
    """
    tall, wide = shape
    _, height, width = before.shape
    across = (wide + 1) // 2
    counts = np.zeros((3, 256), np.int64)
    now = np.empty(3, np.uint8)
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
def quartile(counts: I8) -> float:
    """The third quartile of whole numbers with this histogram, as by NumPy's percentile."""
    place = 0.75 * (counts.sum() - 1)
    below = 0
    low = -1
    for value in range(counts.size):
        below += counts[value]
        if low < 0 and below > math.floor(place):
            low = value
        if below > math.ceil(place):
            return float(low + (value - low) * (place % 1))
    return 0.0


@njit(**ENTRY)
def lighting(reference: F4, image: U1, foreground: U1, step: int) -> F4:
    """(3, 4) the map of the ``reference`` into the light of ``image``: a matrix, and in its last
    column the offsets.

    It maps brightness − 16, and the colour differences of blue and red − 128. Blue, green and red
    each have a gain and an offset, fitted to every ``step``-th pixel both ways outside of the
    ``foreground``; 1 and 0 if there are too few pixels.
    """
    height, width = foreground.shape
    first = step // 2
    n = np.zeros(3, np.int64)
    across = (width + 1) // 2
    room = len(range(first, height, step)) * len(range(first, width, step))
    x = np.empty((3, room))
    y = np.empty((3, room))
    size = np.empty(room)
    counts = np.empty(_BINS, np.int32)
    for i in range(first, height, step):
        for j in range(first, width, step):
            if foreground[i, j] == 0:
                blue = height * width + i // 2 * across + j // 2
                red = blue + (height + 1) // 2 * across
                p = i * width + j
                for c in range(3):
                    a = TO_BGR[c, 0]
                    b = TO_BGR[c, 1]
                    d = TO_BGR[c, 2]
                    was = (
                        a * (reference[p] - 16)
                        + b * (reference[blue] - 128)
                        + d * (reference[red] - 128)
                    )
                    now = (
                        a * (F(image[p]) - 16)
                        + b * (F(image[blue]) - 128)
                        + d * (F(image[red]) - 128)
                    )
                    if was > _DARKEST and was < _BRIGHTEST and now > _DARKEST and now < _BRIGHTEST:
                        x[c, n[c]] = was
                        y[c, n[c]] = now
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
def relit(image: U1, light: F4, shape: tuple[int, int]) -> U1:
    """(n,) the picture in the light of the reference, from whose light ``light`` (3, 4), as from
    `lighting`, leads to that of ``image``; the image itself if the two are the same.
    """
    if _same_light(light):
        return image
    inverse = inverse_light(light)
    height, width = shape
    across = (width + 1) // 2
    out = np.empty_like(image)
    whole = np.zeros((2, 2 * across), np.float32)
    for y in range(height):
        if y % 2 == 0:
            _relit_colours(y, image, inverse, (height, width), out, whole)
        _relit_row(y * width, width, image, inverse, whole, out)
    return out


@njit(**INNER)
def _same_light(light: F4) -> bool:
    """True if a light changes no grey level by more than about one."""
    for i in range(3):
        for j in range(3):
            if abs(light[i, j] - (1 if i == j else 0)) > _SAME_GAIN:
                return False
        if abs(light[i, 3]) > _SAME_OFFSET:
            return False
    return True


@njit(**ENTRY)
def inverse_light(light: F4) -> F4:
    """(3, 4) the map from a light back to that from which ``light`` (3, 4) leads."""
    out = np.empty((3, 4), np.float32)
    for i in range(3):
        for j in range(3):
            a = light[(j + 1) % 3, (i + 1) % 3] * light[(j + 2) % 3, (i + 2) % 3]
            b = light[(j + 1) % 3, (i + 2) % 3] * light[(j + 2) % 3, (i + 1) % 3]
            out[i, j] = a - b
    determinant = F(0)
    for j in range(3):
        determinant += light[0, j] * out[j, 0]
    for i in range(3):
        out[i, 3] = F(0)
        for j in range(3):
            out[i, j] = out[i, j] / determinant
            out[i, 3] -= out[i, j] * light[j, 3]
    return out


@njit(**VECTOR)
def _relit_colours(
    y: int, image: U1, inverse: F4, shape: tuple[int, int], out: U1, whole: F4
) -> None:
    """Write the colours of two rows in another light, without the part of their brightness, and
    both colours of each pixel of a row.
    """
    height, width = shape
    across = (width + 1) // 2
    blue = D(height * width + y // 2 * across)
    red = blue + D((height + 1) // 2 * across)
    row = D(y * width)
    one = D(1)
    middle = F(128)
    black = F(BLACK)
    for i in range(D(across)):
        t = F(image[row + i + i]) - black
        u = F(image[blue + i]) - middle
        v = F(image[red + i]) - middle
        a = inverse[1, 0] * t + inverse[1, 1] * u + inverse[1, 2] * v + inverse[1, 3] + middle
        b = inverse[2, 0] * t + inverse[2, 1] * u + inverse[2, 2] * v + inverse[2, 3] + middle
        out[blue + i] = np.uint8(min(max(a + F(0.5), F(0)), F(255)))
        out[red + i] = np.uint8(min(max(b + F(0.5), F(0)), F(255)))
        part = inverse[0, 1] * u + inverse[0, 2] * v
        whole[0, i + i] = part
        whole[0, i + i + one] = part


@njit(**VECTOR)
def _relit_row(start: int, width: int, image: U1, inverse: F4, whole: F4, out: U1) -> None:
    """Write the brightness of a row in another light."""
    first = D(start)
    gain = inverse[0, 0]
    offset = inverse[0, 3] + F(BLACK) - gain * F(BLACK) + F(0.5)
    for i in range(D(width)):
        value = gain * F(image[first + i]) + whole[0, i] + offset
        out[first + i] = np.uint8(min(max(value, F(0)), F(255)))


@njit(**INNER)
def _line(x: F8, y: F8, size: F8, counts: I4) -> tuple[float, float]:
    """Gain and offset of a robust fit y ≈ gain·x + offset; ``size`` and ``counts`` are scratch."""
    if x.size < _FEWEST:
        return 1.0, 0.0
    for i in range(x.size):
        size[i] = y[i] / x[i]
    gain = _median(size, counts)
    offset = 0.0
    for _ in range(_ROUNDS):
        for i in range(x.size):
            size[i] = abs(y[i] - gain * x[i] - offset)
        limit = _NEAR * (1.4826 * _median(size, counts) + 0.5)
        n = 0
        a = 0.0
        b = 0.0
        aa = 0.0
        ab = 0.0
        for i in range(x.size):
            if size[i] < limit:
                n += 1
                a += x[i]
                b += y[i]
                aa += x[i] * x[i]
                ab += x[i] * y[i]
        a = a / n
        b = b / n
        aa = aa / n
        ab = ab / n
        # A scene of one brightness does not separate gain and offset: keep the gain and move only
        # the offset.
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
    """The median of n > 0 numbers, within a few thousandths of their range: the mean of those that
    share its bin.
    """
    low = values[0]
    high = values[0]
    for value in values:
        low = min(low, value)
        high = max(high, value)
    scale = (counts.size - 1) / max(high - low, 1e-9)
    reached = 0
    bin = 0
    total = 0.0
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
def blend(y: U1, u: U1, v: U1, sheet: U1, opacity: U1) -> None:
    """Mix ``sheet`` (H, W, 3), BGR, into ``y`` (H, W), ``u`` and ``v`` (H/2, W/2) by ``opacity``
    (H, W), which is then 0.

    H and W are even. Colours are those of BT.601 with the range 16 … 235.
    """
    height, width = opacity.shape
    whole = width // _STRETCH
    for i in range(0, height, 2):
        upper = opacity[i, : whole * _STRETCH].view(np.uint64)
        lower = opacity[i + 1, : whole * _STRETCH].view(np.uint64)
        for k in range(whole):
            drawn = upper[k] | lower[k]
            j = k * _STRETCH
            while drawn:
                if drawn & _TWO:
                    _mix(y, u, v, sheet, opacity, i, j)
                drawn = drawn >> _BITS
                j = j + 2
        for j in range(whole * _STRETCH, width, 2):
            _mix(y, u, v, sheet, opacity, i, j)


@njit(**INNER)
def _mix(y: U1, u: U1, v: U1, sheet: U1, opacity: U1, i: int, j: int) -> None:
    """Mix the four pixels from (i, j) on, which share their colours."""
    whole = np.int64(0)
    blue = np.int64(0)
    red = np.int64(0)
    for row in range(i, i + 2):
        for column in range(j, j + 2):
            a = np.int64(opacity[row, column])
            if a:
                b = np.int64(sheet[row, column, 0])
                g = np.int64(sheet[row, column, 1])
                r = np.int64(sheet[row, column, 2])
                light = 16 + ((66 * r + 129 * g + 25 * b + 128) >> 8)
                mixed = np.int64(y[row, column]) * (255 - a) + light * a + 128
                # Over 255, rounded, without a division.
                y[row, column] = (mixed + (mixed >> 8)) >> 8
                whole += a
                blue += a * (128 + ((112 * b - 74 * g - 38 * r + 128) >> 8))
                red += a * (128 + ((112 * r - 94 * g - 18 * b + 128) >> 8))
                opacity[row, column] = 0
    if whole:
        # 1028 / 2²⁰ is 1/1020.
        rest = 1020 - whole
        u[i // 2, j // 2] = (np.int64(u[i // 2, j // 2]) * rest + blue + 510) * 1028 >> 20
        v[i // 2, j // 2] = (np.int64(v[i // 2, j // 2]) * rest + red + 510) * 1028 >> 20
