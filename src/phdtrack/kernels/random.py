"""Random numbers that depend on a counter and a key alone, so that threads cannot change a result.

`philox` is Philox 4x32 [Salmon et al. 2011]: four random words for each counter and key, in any order. Seven rounds are the
fewest that pass BigCrush according to its authors. `xoroshiro` is xoroshiro64* [Blackman and Vigna 2021], a small generator
for single precision: a stream costs half as much as a counter, and its first state is a counter's words.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import INNER, VECTOR

U4 = NDArray[np.uint32]
W = np.uint32
D = np.uint64
ROUNDS = 7
MULTIPLY_0, MULTIPLY_1 = D(0xD2511F53), D(0xCD9E8D57)
WEYL_0, WEYL_1 = D(0x9E3779B9), D(0xBB67AE85)
HIGH, LOW = D(32), D(0xFFFFFFFF)
TO_23_BITS = W(9)
STEP = np.float32(2.0**-23)
HALF_STEP = np.float32(2.0**-24)
STAR = D(0x9E3779BB)
TURN_A, BACK_A, SHIFT, TURN_B, BACK_B = W(26), W(6), W(9), W(13), W(19)


@njit(**INNER)
def philox(
    c0: np.uint32, c1: np.uint32, c2: np.uint32, c3: np.uint32, k0: np.uint32, k1: np.uint32, rounds: int
) -> tuple[np.uint32, np.uint32, np.uint32, np.uint32]:
    """Four words of 32 random bits for the counter (c0, c1, c2, c3) under the key (k0, k1)."""
    for _ in range(rounds):
        a, b = MULTIPLY_0 * D(c0), MULTIPLY_1 * D(c2)
        c0, c1, c2, c3 = W(b >> HIGH) ^ c1 ^ k0, W(b & LOW), W(a >> HIGH) ^ c3 ^ k1, W(a & LOW)
        k0, k1 = W((D(k0) + WEYL_0) & LOW), W((D(k1) + WEYL_1) & LOW)
    return c0, c1, c2, c3


@njit(**VECTOR)
def unit(word: np.uint32) -> np.float32:
    """A uniform number in (0, 1): the middle of one of 2²³ equal cells (of 2²⁴ the last would round to 1)."""
    return np.float32(np.int32(word >> TO_23_BITS)) * STEP + HALF_STEP


@njit(**INNER)
def xoroshiro(a: np.uint32, b: np.uint32) -> tuple[np.uint32, np.uint32, np.uint32]:
    """A word of 32 bits, of which the upper are the better ones, and the state after it; (0, 0) is no state."""
    word = W((D(a) * STAR) & LOW)
    b = W(b ^ a)
    a = W(W(W(a << TURN_A) | W(a >> BACK_A)) ^ b ^ W(b << SHIFT))
    return word, a, W(W(b << TURN_B) | W(b >> BACK_B))
