"""The random generators: published answers, twins in integers, and the normals made of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config, njit
from scipy import stats

from inner_kernels import from_python
from phdtrack.kernels.fast32 import philox, unit, xoroshiro
from phdtrack.kernels.particle_models import BLOCK, N0
from phdtrack.kernels.particles import LANES, ROWS, fill_normals
from reference import random_twin as twins

fill_normals, philox, unit, xoroshiro = from_python(fill_normals, philox, unit, xoroshiro)

# The known answers that come with Random123: rounds, counter, key, words.
PI = (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344)
PUBLISHED = [
    (7, (0,) * 4, (0,) * 2, (0x5F6FB709, 0x0D893F64, 0x4F121F81, 0x4F730A48)),
    (7, (twins.WORD,) * 4, (twins.WORD,) * 2, (0x5207DDC2, 0x45165E59, 0x4D8EE751, 0x8C52F662)),
    (7, PI, (0xA4093822, 0x299F31D0), (0x4DFCCABA, 0x190A87F0, 0xC47362BA, 0xB6B5242A)),
    (10, (0,) * 4, (0,) * 2, (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    (10, (twins.WORD,) * 4, (twins.WORD,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (10, PI, (0xA4093822, 0x299F31D0), (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1)),
]
BLOCKS = 6 if config.DISABLE_JIT else 400
words = st.integers(0, twins.WORD)


def words_of(counter, key, rounds: int) -> tuple[int, ...]:
    return tuple(
        int(w)
        for w in philox(*(np.uint32(c) for c in counter), *(np.uint32(k) for k in key), rounds)
    )


@pytest.mark.parametrize(("rounds", "counter", "key", "answer"), PUBLISHED)
def test_published_answers(rounds: int, counter, key, answer):
    assert words_of(counter, key, rounds) == answer
    assert twins.philox(counter, key, rounds) == answer


def test_published_words_of_a_stream():
    """Those that the Rust crate rand_xoshiro tests with, made with the authors' program from the
    state (1, 2).
    """
    state = (np.uint32(1), np.uint32(2))
    found = []
    for _ in range(10):
        word, *state = xoroshiro(*state)
        found.append(int(word))
    assert found[:5] == [2654435771, 327208753, 4063491769, 4259754937, 261922412]
    assert found[5:] == [168123673, 552743735, 1672597395, 1031040050, 2755315674]


@given(words)
@settings(max_examples=200, deadline=None)
def test_a_unit_number_is_never_0_or_1(word: int):
    found = unit(np.uint32(word))
    assert 0 < found < 1
    assert found == twins.unit(word), "exact in single precision"


@njit
def many_normals(blocks, stage, k0, k1, out):
    s = np.zeros(ROWS * BLOCK, np.float32)
    for b in range(blocks):
        fill_normals(s, BLOCK, np.uint32(b), stage, k0, k1)
        for row in range(4):
            out[row, b, :] = s[N0 + row * BLOCK : N0 + (row + 1) * BLOCK]


def normals(key=(3, 4), stage: int = 0, blocks: int = BLOCKS) -> np.ndarray:
    """(4, blocks, BLOCK)."""
    out = np.empty((4, blocks, BLOCK), np.float32)
    many_normals(blocks, np.uint32(stage), np.uint32(key[0]), np.uint32(key[1]), out)
    return out.astype(np.float64)


def test_normals_are_those_of_the_definition():
    found = normals((12345, 0xDEADBEEF), 1, 2)
    for b, i in ((0, 0), (0, 1), (0, 255), (1, 0), (1, 77)):
        np.testing.assert_allclose(
            found[:, b, i], twins.normals(i, b, 1, (12345, 0xDEADBEEF)), rtol=1e-5, atol=2e-6
        )


def test_moments_and_law_of_the_normals():
    """Each within four of its own standard errors; Kolmogorov and Smirnov's test at one in a
    thousand.
    """
    for row in normals():
        x = row.ravel()
        n = row.size
        for power, mean, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
            assert abs((x**power).mean() - mean) < 4 * np.sqrt(variance / n), power
        assert stats.kstest(x, "norm").pvalue > 1e-3
        assert np.abs(x).max() < np.sqrt(2 * 24 * np.log(2)) + 1e-3
        # The tails, each count within 4.5 deviations of its Poisson law's.
        for far in (2.0, 3.0, 4.0):
            wanted = n * 2 * stats.norm.sf(far)
            assert abs(np.count_nonzero(np.abs(x) > far) - wanted) < 4.5 * np.sqrt(wanted) + 3, far


def test_normals_of_different_streams_do_not_correlate():
    a = normals()
    x = a.ravel()
    others = {
        "rows": (a[:-1].ravel(), a[1:].ravel()),
        "blocks": (a[:, :-1].ravel(), a[:, 1:].ravel()),
        "particles": (a[:, :, :-1].ravel(), a[:, :, 1:].ravel()),
        "words of a stream": (a[:, :, :-LANES].ravel(), a[:, :, LANES:].ravel()),
        "stages": (x, normals(stage=1).ravel()),
        "next key": (x, normals((4, 4)).ravel()),
        "next second key": (x, normals((3, 5)).ravel()),
        "key turned round": (x, normals((4, 3)).ravel()),
        "frames": (x, normals((0x9E3779BC, 0xBB67AE89)).ravel()),
    }
    for name, (left, right) in others.items():
        limit = 4.5 / np.sqrt(left.size)
        assert abs(np.corrcoef(left, right)[0, 1]) < limit, name
        # Also not through their sizes, as numbers of one radius would.
        assert abs(np.corrcoef(left**2, right**2)[0, 1]) < limit, name
