"""The passes over a frame that find and follow change, against the same array by array."""

import cv2
import numpy as np
import pytest

from phdtrack.kernels.blobs import Cleaning, cleaned, edges, measured, valley
from phdtrack.kernels.change import MARGIN, Past, Statistic, changed, compare, follow, middle
from phdtrack.kernels.planes import colours, inverse_light, lighting, noise, relit, smooth
from reference import change_twin as twin

WEIGHTS = tuple(np.array([1 / 100, 1 / 40, 1 / 12, 1 / 9], np.float32))
SAME = np.eye(3, 4, dtype=np.float32)
# Of a picture: with windows that reach beyond it, wide enough for whole registers, and odd.
SIZES = [(24, 40, 5), (9, 37, 3), (3, 2, 5), (1, 1, 1)]


# Deviations by the camera's noise, which explain a part of the weights.
CAMERA = np.array([3.0, 1.5, 0.0])


def rule(window: int) -> Statistic:
    return Statistic(
        1 / np.array(WEIGHTS, np.float64) - np.square(CAMERA)[[0, 0, 1, 2]], window, 6.0, 3.0
    )


def nothing(n: int, height: int, width: int) -> Past:
    """Without samples."""
    return Past(*(np.zeros(size, np.uint8) for size in ((n, 0), (height, width), (n, 2), (n, 2))))


def case(
    rng: np.random.Generator, height: int, width: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A reference, a picture of it with noise in which a part changed, and what energy is usual;
    both (H, W, 3).
    """
    reference = rng.uniform([40, 100, 100], [200, 156, 156], (height, width, 3))
    reference = twin.joined(twin.parted(reference), height, width).astype(np.float32)
    image = reference + rng.normal(0, 4, reference.shape)
    image[height // 3 : 2 * height // 3, width // 4 : width // 2] = 60
    image = twin.joined(twin.parted(image.clip(0, 255).astype(np.uint8)), height, width)
    return reference, image, rng.uniform(1, 9, (height, width)).astype(np.float32)


@pytest.mark.parametrize(("height", "width", "window"), SIZES)
def test_changed_pixels_are_those_of_the_definition(
    rng: np.random.Generator, height: int, width: int, window: int
) -> None:
    reference, image, scene = case(rng, height, width)
    gain = np.array([1.0213, 0.9071, 1.0])
    offset = np.array([-3.07, 8.03, 0.0])
    inverse = np.linalg.inv(twin.TO_BGR)
    light = np.column_stack([inverse @ np.diag(gain) @ twin.TO_BGR, inverse @ offset]).astype(
        np.float32
    )
    flat = twin.parted(image)
    then = twin.parted(reference)
    mask, energy, _ = compare(
        flat, then, light, scene, rule(window), CAMERA, nothing(len(flat), height, width)
    )
    usual = twin.energy(image, twin.relit(reference.astype(float), gain, offset), WEIGHTS)
    np.testing.assert_allclose(energy, usual, rtol=1e-3, atol=2e-3)
    expected = twin.mask(energy.astype(float), scene, window, 6.0)
    np.testing.assert_array_equal(mask > 0, expected)
    assert height < 9 or 0 < expected.mean() < 1


def test_pixels_like_earlier_samples_have_not_changed(rng: np.random.Generator) -> None:
    height = 9
    width = 31
    reference, image, scene = case(rng, height, width)
    now = twin.logarithmic(image)
    samples = (
        (now[..., None] + rng.integers(-9, 10, (height, width, 3, 20)))
        .clip(0, 255)
        .astype(np.uint8)
    )
    flat = twin.parted(image)
    seen = twin.parted(samples)
    samples = twin.joined(seen, height, width)
    differing = rng.integers(0, 21, (height, width), dtype=np.uint8)
    past = Past(seen, differing, *twin.extremes(seen, height, width))
    then = twin.parted(reference)
    before = (
        compare(flat, then, SAME, scene, rule(3), CAMERA, nothing(len(flat), height, width))[0] > 0
    )
    after = compare(flat, then, SAME, scene, rule(3), CAMERA, past)[0] > 0
    known = twin.recalled(now, samples, differing, WEIGHTS, 3.0)
    np.testing.assert_array_equal(after, before & ~known)
    # Some of it is known from nearby alone.
    alone = twin.recalled(now, samples, np.minimum(differing, 1), WEIGHTS, 3.0)
    assert (known & ~alone).any()
    assert (before & known).any()
    assert after.any()


def test_light_is_a_line_through_unchanged_pixels(rng: np.random.Generator) -> None:
    reference, image, _ = case(rng, 60, 81)
    lit = twin.relit(reference.astype(float), np.array([1.0, 1.1, 1.0]), np.array([0.0, -5.0, 0.0]))
    image[20:40] = lit[20:40].clip(0, 255)
    foreground = np.where(rng.random((60, 81)) < 0.2, 255, 0).astype(np.uint8)
    found = lighting(twin.parted(reference), twin.parted(image), foreground, 3)
    grid = slice(1, None, 3)
    was, now = (
        (each[grid, grid] - twin.ZERO) @ twin.TO_BGR.T for each in (reference, image.astype(float))
    )
    gain = np.ones(3)
    offset = np.zeros(3)
    for c in range(3):
        x = was[..., c]
        y = now[..., c]
        exposed = (foreground[grid, grid] == 0) & (np.minimum(x, y) > 8) & (np.maximum(x, y) < 245)
        gain[c], offset[c] = twin.line(x[exposed], y[exposed])
    inverse = np.linalg.inv(twin.TO_BGR)
    np.testing.assert_allclose(found[:, :3], inverse @ np.diag(gain) @ twin.TO_BGR, atol=0.003)
    np.testing.assert_allclose(found[:, 3], inverse @ offset, atol=0.2)


@pytest.mark.parametrize(("height", "width"), [(24, 40), (9, 37), (1, 1)])
def test_a_picture_is_led_back_to_the_light_of_the_reference(
    rng: np.random.Generator, height: int, width: int
) -> None:
    reference = twin.joined(
        twin.parted(rng.uniform([60, 118, 118], [140, 138, 138], (height, width, 3))), height, width
    ).round()
    gain = np.array([0.7, 0.8, 0.75])
    offset = np.array([6.0, -2.0, 3.0])
    inverse = np.linalg.inv(twin.TO_BGR)
    light = np.column_stack([inverse @ np.diag(gain) @ twin.TO_BGR, inverse @ offset]).astype(
        np.float32
    )
    dim = twin.relit(reference, gain, offset).round().clip(0, 255).astype(np.uint8)
    found = relit(twin.parted(dim), light, (height, width))
    # Rounding of the dim picture, divided by its gain.
    np.testing.assert_allclose(found, twin.parted(reference), atol=1.6)
    flat = twin.parted(dim)
    assert relit(flat, SAME, (height, width)) is flat


def test_inverse_light_leads_back(rng: np.random.Generator) -> None:
    light = np.column_stack([np.eye(3) + rng.normal(0, 0.1, (3, 3)), rng.normal(0, 5, 3)]).astype(
        np.float32
    )
    back = inverse_light(light)
    there = rng.normal(0, 50, (3, 20))
    lit = light[:, :3] @ there + light[:, 3:]
    np.testing.assert_allclose(back[:, :3] @ lit + back[:, 3:], there, atol=1e-3)


def test_pixels_are_compared_with_the_past_in_one_light(rng: np.random.Generator) -> None:
    """What samples often showed is the scene in any light."""
    height = 16
    width = 24
    reference = np.full((height, width, 3), 128, np.float32)
    reference[..., 0] = 140
    leaf = np.full((height, width, 3), 128, np.uint8)
    leaf[..., 0] = 60
    samples = np.stack([twin.parted(reference.astype(np.uint8)), twin.parted(leaf)] * 10, axis=1)
    samples[: height * width] = twin.LOG[samples[: height * width]]
    differing = np.full((height, width), 10, np.uint8)
    past = Past(samples, differing, *twin.extremes(samples, height, width))
    light = SAME.copy()
    light[0, 0] = 0.5
    dim = leaf.copy()
    dim[..., 0] = 16 + (60 - 16) // 2
    scene = np.full((height, width), 3, np.float32)
    then = twin.parted(reference)
    mask, _, level = compare(twin.parted(dim), then, light, scene, rule(3), CAMERA, past)
    assert not mask.any()
    np.testing.assert_allclose(level[: height * width], 60, atol=1)
    # What nobody has seen is still a change.
    other = dim.copy()
    other[..., 0] = 150
    mask = compare(twin.parted(other), then, light, scene, rule(3), CAMERA, past)[0]
    assert mask.all()


def test_saturated_pixels_have_not_changed() -> None:
    """The reference in a light that makes it brighter than white."""
    image = np.full((12, 12, 3), 128, np.uint8)
    reference = image.astype(np.float32)
    image[..., 0] = 235
    reference[..., 0] = 200
    light = SAME.copy()
    light[0, 0] = 2.0
    past = nothing(216, 12, 12)
    scene = np.ones((12, 12), np.float32)
    mask, energy, _ = compare(
        twin.parted(image), twin.parted(reference), light, scene, rule(3), CAMERA, past
    )
    assert not mask.any()
    np.testing.assert_allclose(energy, 0, atol=1e-6)


@pytest.mark.parametrize("covered", [True, False])
def test_light_is_unchanged_without_enough_pixels(covered: bool) -> None:
    reference = np.full((40, 40, 3), 128, np.float32)
    image = np.full((40, 40, 3), 128, np.uint8)
    reference[..., 0] = 100
    image[..., 0] = 110
    foreground = np.full((40, 40), 255 if covered else 0, np.uint8)
    # One brightness tells no gain from an offset; one of them explains it.
    found = lighting(twin.parted(reference), twin.parted(image), foreground, 2)
    np.testing.assert_allclose(found @ [84, 0, 0, 1], [84 if covered else 94, 0, 0], atol=0.02)


@pytest.mark.parametrize(("height", "width"), [(8, 22), (7, 21)])
def test_reference_and_noise_are_updated(rng: np.random.Generator, height: int, width: int) -> None:
    reference, image, scene = case(rng, height, width)
    energy = rng.uniform(0, 80, scene.shape).astype(np.float32)
    foreground = np.zeros(scene.shape, np.uint8)
    foreground[2:5, 3:9] = 255
    before = reference.astype(float)
    usual = scene.astype(float)
    then = twin.parted(reference)
    follow(
        twin.parted(image),
        energy,
        then,
        scene,
        foreground,
        np.array([0.1, 0.01, 0.2, 9.5], np.float32),
    )
    rate = np.where(foreground, 0.01, 0.1)[..., None]
    np.testing.assert_allclose(then, twin.parted(before + rate * (image - before)), rtol=1e-5)
    np.testing.assert_allclose(
        scene,
        np.minimum(np.where(foreground, usual, usual + 0.2 * (energy - usual)), 9.5),
        rtol=1e-5,
    )


def test_noise_is_the_histogram_of_differences(rng: np.random.Generator) -> None:
    first, second = (
        twin.joined(twin.parted(each), 13, 23)
        for each in rng.integers(0, 256, (2, 13, 23, 3), dtype=np.uint8)
    )
    planes, now = (
        np.moveaxis(twin.logarithmic(each)[::4, ::4], 2, 0).copy() for each in (first, second)
    )
    differences = np.abs(planes.astype(int) - now).reshape(3, -1)
    counts = noise(twin.parted(second), planes, (13, 23), 4)
    np.testing.assert_array_equal(
        counts, [np.bincount(each, minlength=256) for each in differences]
    )
    np.testing.assert_array_equal(planes, now)


@pytest.mark.parametrize(("width", "reach"), [(30, 2), (130, 3), (136, 3)])
def test_edges_are_mean_gradients_along_the_outline(
    rng: np.random.Generator, width: int, reach: int
) -> None:
    image = rng.integers(0, 256, (20, width), dtype=np.uint8)
    reference = rng.uniform(0, 255, (20, width)).astype(np.float32)
    mask = np.where(cv2.blur(rng.random((20, width)), (9, 9)) > 0.5, 255, 0).astype(np.uint8)
    square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    outline = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_GRADIENT, square), np.uint8)
    assert 0.2 < (outline > 0).mean() < 0.95
    boxes = np.array(
        [
            [0, 0, 12, 9],
            [width - 12, 11, width, 20],
            [width // 2 - 10, 7, width // 2 - 6, 20],
            [3, 0, width, 20],
        ]
    )
    found = edges(image, reference, mask, reach, boxes)
    expected = [[twin.edge(each, outline, box) for each in (image, reference)] for box in boxes]
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    np.testing.assert_array_equal(edges(image, reference, np.zeros_like(mask), reach, boxes), 0)


def test_boxes_and_areas_of_contours_are_those_of_opencv(rng: np.random.Generator) -> None:
    mask = cv2.dilate((rng.random((60, 90)) < 0.01).astype(np.uint8), np.ones((5, 3), np.uint8))
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    boxes, areas = measured(np.concatenate(found)[:, 0], np.cumsum([len(one) for one in found]))
    sizes = np.array([cv2.boundingRect(one) for one in found])
    np.testing.assert_array_equal(boxes, np.hstack([sizes[:, :2], sizes[:, :2] + sizes[:, 2:]]))
    np.testing.assert_array_equal(areas, [cv2.contourArea(one) for one in found])
    assert len(found) > 10


def test_valley_is_that_of_the_definition(rng: np.random.Generator) -> None:
    cuts = set()
    for _ in range(60):
        filled = np.zeros((40, int(rng.integers(16, 60))), np.uint8)
        for left in rng.integers(0, filled.shape[1] - 8, 2):
            filled[rng.integers(0, 20) :, left : left + rng.integers(5, 20)] = 255
        filled[38:] = 255
        asked = 0.7, 3, int(rng.integers(2, 6)), 0.3
        cut = valley(filled, *asked)
        assert cut == twin.valley(filled, *asked)
        cuts.add(cut)
    assert len(cuts) > 5
    assert -1 in cuts


@pytest.mark.parametrize(("height", "width"), [(24, 40), (9, 37), (30, 136)])
@pytest.mark.parametrize("beyond", [(0, 0), (3, 1)])
def test_one_call_does_all_steps_of_a_frame(
    rng: np.random.Generator, height: int, width: int, beyond: tuple[int, int]
) -> None:
    reference, image, scene = case(rng, height, width)
    flat = twin.parted(image)
    then = twin.parted(reference)
    past = nothing(len(twin.parted(image)), height, width)
    foreground = np.where(rng.random((height, width)) < 0.1, 255, 0).astype(np.uint8)
    own = flat.copy()
    before = twin.logarithmic(image)[::4, ::4].transpose(2, 0, 1) // 2 + 40
    camera = CAMERA.copy()
    sparse = before.copy()
    near = foreground.copy()
    cleaning = Cleaning(0, np.array([0, 1, 0]), np.zeros(1, np.int64))
    mask, *found = changed(
        own, sparse, camera, (then, scene, near), rule(3), past, (4, 2), cleaning, beyond
    )
    smooth(flat, (height, width))
    np.testing.assert_array_equal(own, flat)
    counts = noise(flat, before, (height, width), 4)
    np.testing.assert_array_equal(sparse, before)
    quartiles = [np.percentile(np.repeat(np.arange(256), each), 75) for each in counts]
    np.testing.assert_allclose(
        camera, 0.9 * CAMERA + 0.1 * np.array(quartiles) / (1.1503 * np.sqrt(2))
    )
    light = lighting(then, flat, foreground, 2)
    across, down = beyond
    raw, energy, level = compare(flat, then, light, scene, rule(3), camera, past)
    for one, other in zip(found, (energy, light, level), strict=True):
        np.testing.assert_array_equal(one, other)
    inside = np.zeros((height, width), np.bool_)
    inside[down : height - down, across : width - across] = True
    expected, seen = cleaned(np.where(inside, raw, 0).astype(np.uint8), cleaning, MARGIN)
    assert 0 < (expected > 0).mean() < 0.9
    np.testing.assert_array_equal(mask, expected)
    np.testing.assert_array_equal(near, np.where(inside, seen, 255))


@pytest.mark.parametrize(("height", "width"), [(24, 40), (9, 37), (2, 1), (5, 3)])
def test_colours_are_smoothed_as_by_opencv(
    rng: np.random.Generator, height: int, width: int
) -> None:
    picture = twin.parted(rng.integers(0, 256, (height, width, 3), dtype=np.uint8))
    before = picture.copy()
    smooth(picture, (height, width))
    np.testing.assert_array_equal(picture[: height * width], before[: height * width])
    for now, was in zip(
        colours(picture, (height, width)), colours(before, (height, width)), strict=True
    ):
        np.testing.assert_array_equal(now, cv2.blur(was, (3, 3)))


@pytest.mark.parametrize(("height", "width"), [(60, 190), (35, 128), (4, 66), (3, 7)])
@pytest.mark.parametrize("peel", [0, 1, 2])
def test_masks_are_cleaned_as_by_opencv(
    rng: np.random.Generator, height: int, width: int, peel: int
) -> None:
    mask = (
        cv2.dilate((rng.random((height, width)) < 0.03).astype(np.uint8), np.ones((9, 6), np.uint8))
        * 255
    )
    mask[rng.random((height, width)) < 0.02] = 0
    opening, closing = (
        cv2.getStructuringElement(cv2.MORPH_ELLIPSE, size) for size in ((3, 3), (5, 15))
    )
    # Whatever is not 0 is foreground.
    mask[mask > 0] = rng.choice([255, 254, 1, 64], (mask > 0).sum())
    before = mask.copy()
    whole = np.where(mask > 0, 255, 0).astype(np.uint8)
    rows = [element.sum(axis=1, dtype=np.int64) // 2 for element in (opening, closing)]
    expected = cv2.erode(whole, np.ones((2 * peel + 1, 2 * peel + 1), np.uint8))
    expected = cv2.morphologyEx(
        cv2.morphologyEx(expected, cv2.MORPH_OPEN, opening), cv2.MORPH_CLOSE, closing
    )
    found, near = cleaned(mask, Cleaning(peel, *rows), 2)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(near, cv2.dilate(expected, np.ones((5, 5), np.uint8)))
    np.testing.assert_array_equal(mask, before)


@pytest.mark.parametrize(
    ("count", "n", "kind"), [(51, 30, np.uint8), (7, 700, np.int16), (1, 3, np.uint8)]
)
def test_middle_is_the_median(rng: np.random.Generator, count: int, n: int, kind: type) -> None:
    samples = rng.integers(0, 200, (count, n)).astype(kind)
    np.testing.assert_array_equal(middle(samples), np.median(samples, axis=0))
