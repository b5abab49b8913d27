"""Elementary functions and random numbers in float32, which vectorise (libm's do not), and options
of compilation.

The coefficients are near-minimax fits (Lawson's iteration on Chebyshev nodes); tests/kernels states
and shows the errors. Random numbers depend on a counter and a key, so that threads cannot change a
result. `philox` is Philox 4x32 [Salmon et al. 2011] with seven rounds, the fewest that pass
BigCrush; `xoroshiro` is xoroshiro64* [Blackman and Vigna 2021], which costs half as much: its first
state is a counter's words.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from phdtrack.kernels import Real
from phdtrack.kernels.cache import njit

# Lets sums be reordered and so vectorise, but keeps NaN and infinity (unlike ``fastmath=True``).
FAST = {"contract", "nsz", "arcp", "reassoc", "afn"}
# Options of all kernels. No wrapper for callers in C: there are none, and each would take a tenth
# of the time of compilation.
LEAN = {"no_cfunc_wrapper": True, "error_model": "numpy"}
ENTRY = LEAN | {"cache": True, "nogil": True}
# For kernels that Python calls, and larger kernels too, which they become a part of before anything
# is compiled: this takes less time than compiling them and linking them.
MERGED = ENTRY | {"inline": "always"}
# For kernels that only kernels call: no wrapper for callers in Python either. A call from Python
# ends the process.
INNER = LEAN | {"no_cpython_wrapper": True}
VECTOR = INNER | {"fastmath": FAST}
# Always a part of its caller: for the few lines of an inner loop, which LLVM calls as a function if
# they are long.
INLINED = INNER | {"forceinline": True}
# If a kernel calls a function that vectorises, the process that compiles both runs the function's
# own copy, and one that loads the kernel runs the kernel's; the two may round differently.
INLINED_VECTOR = INLINED | {"fastmath": FAST}

# Numbers in the widest vector register; narrower ones divide it. Loops over whole registers have no
# remainder, which would be done one by one.
LANES = 16
F = np.float32
INT = np.int32
W = np.uint32
D = np.uint64
ONE = F(1.0)
HALF = F(0.5)
LOWEST = F(-87.0)  # below, exp is no normal float32 any more
LOG2E = F(1.44269504)
LN2_HIGH = F(0.693359375)
LN2_LOW = F(-2.12194440e-4)
LN2 = F(0.693147181)
BIAS = INT(127)
MANTISSA = INT(23)
ROOT_HALF = INT(0x3F3504F3)  # the bits of √½
SIGN = INT(31)
REST = INT(0x7FFFFFFF)
E0 = F(1.00000007)
E1 = F(0.999999692)
E2 = F(0.499988945)
E3 = F(0.166675751)
E4 = F(0.0419154212)
E5 = F(0.00829764667)
L0 = F(0.999999975)
L1 = F(-0.499999777)
L2 = F(0.333341605)
L3 = F(-0.250029458)
L4 = F(0.199584158)
L5 = F(-0.165437443)
L6 = F(0.149173977)
L7 = F(-0.144821502)
L8 = F(0.0895981238)
S0 = F(6.28318527)
S1 = F(-16.2089556)
S2 = F(16.7691897)
S3 = F(-9.62460471)
S4 = F(3.51637608)
S5 = F(-0.798343085)
C0 = F(0.999999988)
C1 = F(-3.73920462)
C2 = F(5.11185246)
C3 = F(-3.66074089)
C4 = F(1.59794309)
C5 = F(-0.40875047)
FOUR = F(4.0)
SIXTEEN = F(16.0)
ROUNDS = 7
MULTIPLY_0 = D(0xD2511F53)
MULTIPLY_1 = D(0xCD9E8D57)
WEYL_0 = D(0x9E3779B9)
WEYL_1 = D(0xBB67AE85)
HIGH = D(32)
LOW = D(0xFFFFFFFF)
TO_23_BITS = W(9)
STEP = F(2.0**-23)
HALF_STEP = F(2.0**-24)
STAR = D(0x9E3779BB)
TURN_A = W(26)
BACK_A = W(6)
SHIFT = W(9)
TURN_B = W(13)
BACK_B = W(19)


@njit(**INNER)
def whole(n: int) -> int:
    """The least multiple of `LANES` that is not below n."""
    return (n + LANES - 1) // LANES * LANES


@njit(**VECTOR)
def exp32(x: np.float32) -> np.float32:
    """eˣ for x ≤ 0, relative error below 5e-7; e⁻⁸⁷ for smaller x."""
    x = max(LOWEST, x)
    whole = np.floor(x * LOG2E + HALF)
    r = x - whole * LN2_HIGH - whole * LN2_LOW
    power = F(INT((INT(whole) + BIAS) << MANTISSA).view(np.float32))
    out: np.float32 = (E0 + r * (E1 + r * (E2 + r * (E3 + r * (E4 + r * E5))))) * power
    return out


@njit(**VECTOR)
def log32(x: np.float32) -> np.float32:
    """log x for positive normal x, absolute error below 2e-7·(1 + |log x|)."""
    bits = F(x).view(np.int32)
    # Each step is cast back to 32 bits: Numba's sums of integers have 64, and half as many fit into
    # a register.
    e = INT(INT(bits - ROOT_HALF) >> MANTISSA)
    f = INT(bits - INT(e << MANTISSA)).view(np.float32) - ONE
    series = L0 + f * (
        L1 + f * (L2 + f * (L3 + f * (L4 + f * (L5 + f * (L6 + f * (L7 + f * L8))))))
    )
    return f * series + F(e) * LN2


@njit(**VECTOR)
def cos_sin_turn(u: np.float32) -> tuple[np.float32, np.float32]:
    """cos and sin of 2π·u for 0 ≤ u < 1, absolute error below 3e-7; with their zeros as factors, no
    folding is needed.
    """
    w = u - HALF
    q = w * w
    sine = w * (ONE - FOUR * q) * (S0 + q * (S1 + q * (S2 + q * (S3 + q * (S4 + q * S5)))))
    cosine = (ONE - SIXTEEN * q) * (C0 + q * (C1 + q * (C2 + q * (C3 + q * (C4 + q * C5)))))
    return -cosine, -sine


@njit(**INNER)
def philox(
    c0: np.uint32,
    c1: np.uint32,
    c2: np.uint32,
    c3: np.uint32,
    k0: np.uint32,
    k1: np.uint32,
    rounds: int,
) -> tuple[np.uint32, np.uint32, np.uint32, np.uint32]:
    """Four words of 32 random bits for the counter (c0, c1, c2, c3) under the key (k0, k1)."""
    for _ in range(rounds):
        a = MULTIPLY_0 * D(c0)
        b = MULTIPLY_1 * D(c2)
        c0 = W(b >> HIGH) ^ c1 ^ k0
        c1 = W(b & LOW)
        c2 = W(a >> HIGH) ^ c3 ^ k1
        c3 = W(a & LOW)
        k0 = W((D(k0) + WEYL_0) & LOW)
        k1 = W((D(k1) + WEYL_1) & LOW)
    return c0, c1, c2, c3


@njit(**VECTOR)
def unit(word: np.uint32) -> np.float32:
    """A uniform number in (0, 1): the middle of one of 2²³ equal cells (of 2²⁴ the last would round
    to 1).
    """
    return np.float32(np.int32(word >> TO_23_BITS)) * STEP + HALF_STEP


@njit(**INNER)
def xoroshiro(a: np.uint32, b: np.uint32) -> tuple[np.uint32, np.uint32, np.uint32]:
    """A word of 32 bits, of which the upper ones are better, and the state after it; (0, 0) is not
    a state.
    """
    word = W((D(a) * STAR) & LOW)
    b = W(b ^ a)
    a = W(W(W(a << TURN_A) | W(a >> BACK_A)) ^ b ^ W(b << SHIFT))
    return word, a, W(W(b << TURN_B) | W(b >> BACK_B))


def by_type(single: Callable[..., Any], double: Callable[..., Any]) -> Callable[..., Any]:
    """A function that calls ``single`` if its last argument has 32 bits, else ``double``, compiled
    or not.
    """

    @wraps(single)
    def chosen(*args: Any) -> Any:
        form = single if isinstance(args[-1], np.float32 | np.int32) else double
        return form(*args)

    @wraps(single)
    def typed(*args: Any) -> Callable[..., Any]:
        if args[-1] in (types.float32, types.int32):
            return single
        return double

    overload(chosen, jit_options=VECTOR)(typed)
    return chosen


def _exp_single(x: Any) -> Any:
    """eˣ for x ≤ 0 in the type of x: in single precision a polynomial, which vectorises."""
    return exp32(x)


def _exp_double(x: Any) -> Any:
    return math.exp(x)


def _log_single(x: Any) -> Any:
    """log x for normal x > 0 in the type of x."""
    return log32(x)


def _log_double(x: Any) -> Any:
    return math.log(x)


def _key_single(x: Any) -> Any:
    """An integer that sorts like x: minima of integers vectorise, those of numbers that may be NaN
    do not.
    """
    bits = F(x).view(np.int32)
    return INT(bits ^ INT(INT(bits >> SIGN) & REST))


def _key_double(x: Any) -> Any:
    bits = np.float64(x).view(np.int64)
    return bits ^ ((bits >> np.int64(63)) & np.int64(0x7FFFFFFFFFFFFFFF))


def _number_single(key: Any) -> Any:
    """The number that `sortable` made ``key`` of."""
    return INT(key ^ INT(INT(key >> SIGN) & REST)).view(np.float32)


def _number_double(key: Any) -> Any:
    return np.int64(key ^ ((key >> np.int64(63)) & np.int64(0x7FFFFFFFFFFFFFFF))).view(np.float64)


exp_of = by_type(_exp_single, _exp_double)
log_of = by_type(_log_single, _log_double)
sortable = by_type(_key_single, _key_double)
sorted_number = by_type(_number_single, _number_double)


@njit(**VECTOR)
def extent(state: Real, r: int, begin: int, n: int) -> tuple[float, float]:
    """The smallest and the largest of n > 0 numbers of a row, from column ``begin`` on."""
    at = D(begin)
    low = high = sortable(state[r, begin])
    for i in range(D(n)):
        key = sortable(state[r, at + i])
        low = min(low, key)
        high = max(high, key)
    return sorted_number(low), sorted_number(high)
