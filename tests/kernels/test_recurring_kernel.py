"""Patches that recur in samples, against comparing each pair of patches."""

import numpy as np
import pytest

from phdtrack.kernels.recurring import recurrences, same_patches

TOLERANCE = 12
REACH = 2
SHARE = 0.8


def same(samples: np.ndarray) -> np.ndarray:
    """(K, K, h, w) True where two samples show the same patch."""
    alike = np.abs(samples[:, None].astype(int) - samples).max(axis=-1) <= TOLERANCE
    width = (REACH, REACH)
    beyond = np.pad(alike, ((0, 0), (0, 0), width, width), mode="reflect")
    size = 2 * REACH + 1
    patches = np.lib.stride_tricks.sliding_window_view(beyond, (size, size), axis=(2, 3))
    return alike & (patches.sum(axis=(-2, -1)) >= SHARE * size**2)


def pictures(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """A noisy scene with a square of another colour at another place in each sample."""
    out = 100 + rng.normal(0, 3, (9, height, width, 3))
    for k, picture in enumerate(out):
        top = int(rng.integers(0, height - 2))
        left = int(rng.integers(0, width - 2))
        picture[top : top + 4, left : left + 4] = 20 * k
    return out.clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize(("height", "width"), [(12, 17), (7, 8)])
def test_recurrences_are_counted_for_each_patch(
    rng: np.random.Generator, height: int, width: int
) -> None:
    samples = pictures(rng, height, width)
    counts = recurrences(samples, TOLERANCE, REACH, SHARE)
    expected = same(samples)
    np.testing.assert_array_equal(counts, expected.sum(axis=1) - expected[range(9), range(9)])
    assert counts.min() < counts.max()


def test_the_first_samples_with_the_same_patch_are_found(rng: np.random.Generator) -> None:
    samples = pictures(rng, 12, 17)
    chosen = rng.integers(0, 9, (12, 17))
    found, runs = same_patches(samples, TOLERANCE, REACH, SHARE, chosen, 3)
    alike = same(samples)
    fewer = 0
    for y in range(12):
        for x in range(17):
            there = alike[chosen[y, x], :, y, x]
            assert runs[y, x] == there[0] + (there[1:] & ~there[:-1]).sum()
            which = np.flatnonzero(there)[:3]
            fewer += len(which) < 3
            rest = [chosen[y, x]] * (3 - len(which))
            assert found[:, y, x].tolist() == [*which, *rest]
    assert 0 < fewer < 12 * 17
