"""The passes over a frame that find and follow change, against the same array by array."""

import numpy as np
import pytest

from phdtrack.kernels.change import Past, Statistic, compare, edge, follow, lighting, middle, noise
from reference import change_twin as twin

WEIGHTS = tuple(np.array([1 / 100, 1 / 40, 1 / 9, 1 / 12], np.float32))
# Of a picture: with windows that reach beyond it, and wide enough for whole registers.
SIZES = [(24, 40, 5), (9, 37, 3), (3, 2, 5), (1, 1, 1)]


def rule(window: int) -> Statistic:
    return Statistic(WEIGHTS, window, 6.0, 3.0)


def past(samples: np.ndarray, differing: np.ndarray) -> Past:
    """With what `twin.extremes` says of the samples (H, W, 3, K), if there are any."""
    if samples.shape[3]:
        return Past(samples, differing, *twin.extremes(samples))
    return Past(samples, differing, *np.zeros((2, *samples.shape[:3], 2), np.uint8))


def flat(image: np.ndarray) -> np.ndarray:
    return image.reshape(len(image), -1)


def case(rng: np.random.Generator, height: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A reference, a picture of it with noise in which a part changed, and what energy is usual."""
    reference = rng.uniform(20, 230, (height, width, 3)).astype(np.float32)
    image = reference + rng.normal(0, 4, reference.shape)
    image[height // 3 : 2 * height // 3, width // 4 : width // 2] = 60
    return reference, image.clip(0, 255).astype(np.uint8), rng.uniform(1, 9, (height, width)).astype(np.float32)


@pytest.mark.parametrize(("height", "width", "window"), SIZES)
def test_what_changed(rng: np.random.Generator, height: int, width: int, window: int) -> None:
    reference, image, scene = case(rng, height, width)
    light = np.array([[1.0213, 0.9071, 1.0], [-3.07, 8.03, 0.0]], np.float32)
    none = past(np.zeros((height, width, 3, 0), np.uint8), np.zeros((height, width), np.uint8))
    mask, energy, expected = compare(flat(image), flat(reference), light, scene, rule(window), none)
    lit = twin.relit(reference, light[0].astype(float), light[1].astype(float))
    np.testing.assert_array_equal(expected.reshape(lit.shape), lit)
    usual = twin.energy(twin.planes(image), twin.planes(expected.reshape(lit.shape)), WEIGHTS)
    np.testing.assert_allclose(energy, usual, rtol=1e-5)
    np.testing.assert_array_equal(mask > 0, twin.mask(usual, scene, window, 6.0))
    assert height < 9 or 0 < mask.mean() < 255


def test_what_was_seen_before_has_not_changed(rng: np.random.Generator) -> None:
    reference, image, scene = case(rng, 8, 30)
    samples = (twin.planes(image)[..., None] + rng.integers(-9, 10, (8, 30, 3, 20))).clip(0, 255).astype(np.uint8)
    differing = rng.integers(0, 21, (8, 30), dtype=np.uint8)
    same, none = np.array([[1, 1, 1], [0, 0, 0]], np.float32), np.zeros((8, 30, 3, 0), np.uint8)
    before = compare(flat(image), flat(reference), same, scene, rule(3), past(none, differing))[0] > 0
    after = compare(flat(image), flat(reference), same, scene, rule(3), past(samples, differing))[0] > 0
    known = twin.recalled(twin.planes(image), samples, differing, WEIGHTS, 3.0)
    np.testing.assert_array_equal(after, before & ~known)
    # Some of it is known from nearby alone.
    alone = twin.recalled(twin.planes(image), samples, np.minimum(differing, 1), WEIGHTS, 3.0)
    assert (known & ~alone).any()
    assert (before & known).any()
    assert after.any()


def test_the_light_is_a_line_through_what_did_not_change(rng: np.random.Generator) -> None:
    reference, image, _ = case(rng, 60, 80)
    image[..., 1] = (1.1 * reference[..., 1] - 5).clip(0, 255)
    foreground = np.where(rng.random((60, 80)) < 0.2, 255, 0).astype(np.uint8)
    found = lighting(flat(reference), flat(image), foreground, 3)
    grid = slice(1, None, 3)
    for channel in range(3):
        x, y = np.floor(reference[grid, grid, channel] + 0.5), image[grid, grid, channel].astype(float)
        exposed = (foreground[grid, grid] == 0) & (np.minimum(x, y) > 8) & (np.maximum(x, y) < 245)
        gain, offset = twin.line(x[exposed], y[exposed])
        assert abs(found[0, channel] - gain) < 0.002
        assert abs(found[1, channel] - offset) < 0.15
    assert found[0, 1] * 100 + found[1, 1] == pytest.approx(1.1 * 100 - 5, abs=1)


@pytest.mark.parametrize("covered", [True, False])
def test_where_little_tells_of_the_light_it_is_the_same(rng: np.random.Generator, covered: bool) -> None:
    reference = np.full((40, 40, 3), 100.0, np.float32)
    image, foreground = np.full((40, 40, 3), 110, np.uint8), np.full((40, 40), 255 if covered else 0, np.uint8)
    # One brightness tells no gain from an offset; one of them explains it.
    gain, offset = lighting(flat(reference), flat(image), foreground, 2)
    np.testing.assert_allclose(100 * gain + offset, 100 if covered else 110, atol=0.01)


def test_reference_and_noise_follow(rng: np.random.Generator) -> None:
    reference, image, scene = case(rng, 7, 21)
    energy, foreground = rng.uniform(0, 80, (7, 21)).astype(np.float32), np.zeros((7, 21), np.uint8)
    foreground[2:5, 3:9] = 255
    before, usual = reference.astype(float), scene.astype(float)
    follow(flat(image), energy, flat(reference), scene, foreground, np.array([0.1, 0.01, 0.2, 9.5], np.float32))
    rate = np.where(foreground, 0.01, 0.1)[..., None]
    np.testing.assert_allclose(reference, before + rate * (image - before), rtol=1e-5)
    np.testing.assert_allclose(
        scene, np.minimum(np.where(foreground, usual, usual + 0.2 * (energy - usual)), 9.5), rtol=1e-5
    )


def test_the_noise_between_two_pictures(rng: np.random.Generator) -> None:
    first, second = rng.integers(0, 256, (2, 13, 22, 3), dtype=np.uint8)
    planes, now = (np.moveaxis(twin.planes(each[::4, ::4]), 2, 0).copy() for each in (first, second))
    differences = np.abs(planes.astype(int) - now).reshape(3, -1)
    counts = noise(flat(second), planes, 4)
    np.testing.assert_array_equal(counts, [np.bincount(each, minlength=256) for each in differences])
    np.testing.assert_array_equal(planes, now)


def test_how_much_of_an_edge_there_is(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    where = rng.integers(0, 2, (9, 12), dtype=np.uint8) * 255
    for left, top in ((0, 0), (18, 11), (5, 7)):
        window = image[top : top + 9, left : left + 12].copy()
        assert edge(flat(image), left, top, where) == pytest.approx(twin.edge(window, where))
    assert edge(flat(image), 3, 3, np.zeros((2, 2), np.uint8)) == 0


@pytest.mark.parametrize(("count", "n", "kind"), [(51, 30, np.uint8), (7, 700, np.int16), (1, 3, np.uint8)])
def test_medians(rng: np.random.Generator, count: int, n: int, kind: type) -> None:
    samples = rng.integers(0, 200, (count, n)).astype(kind)
    np.testing.assert_array_equal(middle(samples), np.median(samples, axis=0))
