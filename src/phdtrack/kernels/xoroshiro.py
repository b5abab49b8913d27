"""xoroshiro64*, a small generator made for numbers in single precision [Blackman and Vigna 2021].

Where a whole block's random numbers are wanted, in their order, a stream costs half of what a counter-based generator does.
Each stream's state is a counter's words (`philox`), so that a block's numbers still depend on its own number alone.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from phdtrack.kernels.fast32 import INNER

W = np.uint32
D = np.uint64
STAR, LOW = D(0x9E3779BB), D(0xFFFFFFFF)
TURN_A, BACK_A, SHIFT, TURN_B, BACK_B = W(26), W(6), W(9), W(13), W(19)


@njit(**INNER)
def xoroshiro(a: np.uint32, b: np.uint32) -> tuple[np.uint32, np.uint32, np.uint32]:
    """A word of 32 bits, of which the upper are the better ones, and the state after it; (0, 0) is no state."""
    word = W((D(a) * STAR) & LOW)
    b = W(b ^ a)
    a = W(W(W(a << TURN_A) | W(a >> BACK_A)) ^ b ^ W(b << SHIFT))
    return word, a, W(W(b << TURN_B) | W(b >> BACK_B))
