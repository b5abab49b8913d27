"""Colours of boxes: the kernel against its definition, and what the descriptor tells apart."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.detect import colours
from phdtrack.detect.colours import Colours
from phdtrack.errors import InputError
from phdtrack.kernels.colours import OFFSET, ONE, SHIFT
from phdtrack.types import F4, F8, Image

BOXES = np.array(
    [
        [10, 5, 34, 65],
        [-8.5, -20, 12.25, 33.75],
        [50.3, 40.8, 57.9, 49.1],
        [70, 60, 95, 140],
        [2, 2, 5, 5],
        [200, 10, 220, 50],
        [-500, -500, 900, 900],
    ],
    np.float64,
)


def defined(image: Image, boxes: F8) -> F4:
    """The descriptor by its definition: one histogram after the other."""
    height, width = image.shape[:2]
    every = colours.STRIPES * colours.ROWS
    out = np.zeros((len(boxes), colours.STRIPES, 32))
    for k, (left, top, right, bottom) in enumerate(boxes):
        seen = np.minimum([right, bottom], [width, height]) - np.maximum([left, top], 0)
        if seen.min() <= 0 or seen.prod() < 16:
            continue
        for i in range(every):
            y = int(np.floor(top + (i + 0.5) / every * (bottom - top)))
            for across, weight in zip(colours.ACROSS, colours.WEIGHTS, strict=True):
                x = int(np.floor(left + across * (right - left)))
                if 0 <= y < height and 0 <= x < width:
                    blue, green, red = image[y, x].astype(int)
                    bright = (29 * blue + 150 * green + 77 * red) // 256
                    values = np.array([bright, blue - bright, red - bright])
                    place = colours.PLACES[range(3), values + OFFSET]
                    share = place % ONE / ONE
                    stripe = out[k, i // colours.ROWS]
                    np.add.at(stripe, place >> SHIFT, weight * (1 - share))
                    np.add.at(stripe, np.minimum((place >> SHIFT) + 1, 31), weight * share)
    parts = np.split(out, colours.ENDS[:-1], axis=2)
    totals = [part.sum(axis=2, keepdims=True) for part in parts]
    weights = (0.5, 0.25, 0.25)
    shares = [
        weight / colours.STRIPES * np.divide(part, total, out=part * 0, where=total > 0)
        for weight, part, total in zip(weights, parts, totals, strict=True)
    ]
    return np.sqrt(np.concatenate(shares, axis=2)).reshape(len(boxes), -1).astype(np.float32)


def person(rng: np.random.Generator, shirt: list[int], trousers: list[int]) -> Image:
    """A noisy picture (60, 24, 3) of somebody in these colours (BGR), before grey."""
    picture = np.full((60, 24, 3), 120.0)
    picture[10:35, 5:19] = shirt
    picture[35:58, 6:18] = trousers
    return np.asarray((picture + rng.normal(0, 8, picture.shape)).clip(0, 255), np.uint8)


def centred(looks: F4) -> F8:
    """Unit vectors of the differences from the mean."""
    away = looks.astype(np.float64) - looks.mean(axis=0)
    return np.asarray(away / np.linalg.norm(away, axis=1, keepdims=True))


def test_kernel_matches_definition(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (100, 90, 3)).astype(np.uint8)
    image[50:] //= 7
    found = Colours().describe(image, BOXES)
    assert (found.shape, found.dtype) == ((len(BOXES), Colours().length), np.float32)
    np.testing.assert_allclose(found, defined(image, BOXES), atol=3e-4)
    np.testing.assert_array_equal(found, found.astype(np.float16))


def test_norm_is_one_for_boxes_inside(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (100, 90, 3)).astype(np.uint8)
    norms = np.linalg.norm(Colours().describe(image, BOXES), axis=1)
    np.testing.assert_allclose(norms[[0, 2]], 1, atol=1e-3)
    # Half of this one is below the picture.
    assert 0.6 < norms[3] < 0.8


def test_boxes_that_show_few_pixels_are_zeros() -> None:
    image = np.full((100, 90, 3), 77, np.uint8)
    found = Colours().describe(image, BOXES)
    np.testing.assert_array_equal(found.any(axis=1), [1, 1, 1, 1, 0, 0, 1])
    assert Colours().describe(image, np.zeros((0, 4))).shape == (0, Colours().length)
    nowhere = np.array([[np.inf, 0, np.inf, 9], [5, 5, 5, 50], [9, 9, 3, 3]])
    assert not Colours().describe(image, nowhere).any()


@pytest.mark.parametrize("infrared", [False, True])
def test_clothes_tell_people_apart(rng: np.random.Generator, infrared: bool) -> None:
    clothes = [
        ([30, 30, 200], [60, 50, 40]),
        ([200, 90, 20], [60, 50, 40]),
        ([90, 160, 60], [30, 30, 35]),
    ]
    pictures = [person(rng, *clothes[k % 3]) for k in range(12)]
    if infrared:
        pictures = [np.repeat(one[..., 1:2], 3, axis=2) for one in pictures]
    box = np.array([[0.0, 0.0, 24.0, 60.0]])
    looks = np.concatenate([Colours().describe(one, box) for one in pictures])
    likeness = centred(looks) @ centred(looks).T
    same = np.arange(12)[:, None] % 3 == np.arange(12) % 3
    assert likeness[same].min() > likeness[~same].max() + 0.5


def test_grey_pictures_have_equal_differences(rng: np.random.Generator) -> None:
    grey = np.repeat(rng.integers(0, 256, (100, 90, 1)), 3, axis=2).astype(np.uint8)
    found = Colours().describe(grey, BOXES[[0, 2]]).reshape(2, -1, 32)
    np.testing.assert_array_equal(found[0, :, 16:], found[1, :, 16:])
    assert not np.array_equal(found[0, :, :16], found[1, :, :16])


def test_brightness_of_light_changes_little(rng: np.random.Generator) -> None:
    image = rng.integers(40, 200, (100, 90, 3)).astype(np.uint8)
    first = Colours().describe(image, BOXES[:1])
    other = Colours().describe(image + 3, BOXES[:1])
    assert float((first * other).sum()) > 0.97


@pytest.mark.parametrize("image", [np.zeros((9, 9)), np.zeros((9, 9, 3)), np.zeros((9, 9, 4))])
def test_other_images_are_refused(image: Image) -> None:
    with pytest.raises(InputError, match=r"expected an image \(H, W, 3\) of uint8, got"):
        Colours().describe(image, BOXES)
