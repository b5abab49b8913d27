"""Elementary functions in float32, as polynomials that vectorise (libm's do not), and the settings to compile with.

The coefficients are near-minimax fits (Lawson's iteration on Chebyshev nodes); tests/kernels states and shows the errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from phdtrack.kernels.cache import njit

# What lets sums be reordered and so vectorise, but keeps NaN and infinity (unlike ``fastmath=True``).
FAST = {"contract", "nsz", "arcp", "reassoc", "afn"}
# How kernels are compiled. No wrapper for callers in C: there are none, and each would take a tenth of a kernel's time.
LEAN = {"no_cfunc_wrapper": True, "error_model": "numpy"}
ENTRY = LEAN | {"cache": True, "nogil": True}
# For kernels that only kernels call: no wrapper for callers in Python either. A call from Python ends the process.
INNER = LEAN | {"no_cpython_wrapper": True}
VECTOR = INNER | {"fastmath": FAST}

F = np.float32
INT = np.int32
ONE, HALF = F(1.0), F(0.5)
LOWEST = F(-87.0)  # below, exp is no normal float32 any more
LOG2E, LN2_HIGH, LN2_LOW = F(1.44269504), F(0.693359375), F(-2.12194440e-4)
LN2 = F(0.693147181)
BIAS, MANTISSA = INT(127), INT(23)
ROOT_HALF = INT(0x3F3504F3)  # the bits of √½
SIGN, REST = INT(31), INT(0x7FFFFFFF)
E0, E1, E2 = F(1.00000007), F(0.999999692), F(0.499988945)
E3, E4, E5 = F(0.166675751), F(0.0419154212), F(0.00829764667)
L0, L1, L2 = F(0.999999975), F(-0.499999777), F(0.333341605)
L3, L4, L5 = F(-0.250029458), F(0.199584158), F(-0.165437443)
L6, L7, L8 = F(0.149173977), F(-0.144821502), F(0.0895981238)
S0, S1, S2 = F(6.28318527), F(-16.2089556), F(16.7691897)
S3, S4, S5 = F(-9.62460471), F(3.51637608), F(-0.798343085)
C0, C1, C2 = F(0.999999988), F(-3.73920462), F(5.11185246)
C3, C4, C5 = F(-3.66074089), F(1.59794309), F(-0.40875047)
FOUR, SIXTEEN = F(4.0), F(16.0)


@njit(**VECTOR)
def exp32(x: np.float32) -> np.float32:
    """eˣ for x ≤ 0, relative error below 5e-7; e⁻⁸⁷ for everything smaller."""
    x = x if x > LOWEST else LOWEST
    whole = np.floor(x * LOG2E + HALF)
    r = x - whole * LN2_HIGH - whole * LN2_LOW
    power = F(INT((INT(whole) + BIAS) << MANTISSA).view(np.float32))
    out: np.float32 = (E0 + r * (E1 + r * (E2 + r * (E3 + r * (E4 + r * E5))))) * power
    return out


@njit(**VECTOR)
def log32(x: np.float32) -> np.float32:
    """log x for positive normal x, absolute error below 2e-7·(1 + |log x|)."""
    bits = F(x).view(np.int32)
    # Every step back to 32 bits: Numba's sums of integers have 64, and half as many fit into a register.
    e = INT(INT(bits - ROOT_HALF) >> MANTISSA)
    f = INT(bits - INT(e << MANTISSA)).view(np.float32) - ONE
    series = L0 + f * (L1 + f * (L2 + f * (L3 + f * (L4 + f * (L5 + f * (L6 + f * (L7 + f * L8)))))))
    return f * series + F(e) * LN2


@njit(**VECTOR)
def cos_sin_turn(u: np.float32) -> tuple[np.float32, np.float32]:
    """cos and sin of 2π·u for 0 ≤ u < 1, absolute error below 3e-7; with their zeros as factors, no folding is needed."""
    w = u - HALF
    q = w * w
    sine = w * (ONE - FOUR * q) * (S0 + q * (S1 + q * (S2 + q * (S3 + q * (S4 + q * S5)))))
    cosine = (ONE - SIXTEEN * q) * (C0 + q * (C1 + q * (C2 + q * (C3 + q * (C4 + q * C5)))))
    return -cosine, -sine


def _exp_single(x: Any) -> Any:
    return exp32(x)


def _exp_double(x: Any) -> Any:
    return math.exp(x)


def _log_single(x: Any) -> Any:
    return log32(x)


def _log_double(x: Any) -> Any:
    return math.log(x)


def _key_single(x: Any) -> Any:
    bits = F(x).view(np.int32)
    return INT(bits ^ INT(INT(bits >> SIGN) & REST))


def _key_double(x: Any) -> Any:
    bits = np.float64(x).view(np.int64)
    return bits ^ ((bits >> np.int64(63)) & np.int64(0x7FFFFFFFFFFFFFFF))


def _of_key_single(key: Any) -> Any:
    return INT(key ^ INT(INT(key >> SIGN) & REST)).view(np.float32)


def _of_key_double(key: Any) -> Any:
    return np.int64(key ^ ((key >> np.int64(63)) & np.int64(0x7FFFFFFFFFFFFFFF))).view(np.float64)


def exp_of(x: Any) -> Any:
    """eˣ for x ≤ 0 in the type of x: in single precision a polynomial, which vectorises."""
    return _exp_single(x) if isinstance(x, np.float32) else _exp_double(x)


def log_of(x: Any) -> Any:
    """log x for normal x > 0 in the type of x."""
    return _log_single(x) if isinstance(x, np.float32) else _log_double(x)


def sortable(x: Any) -> Any:
    """An integer that is greater where x is: minima of integers vectorise, those of numbers that may be NaN do not."""
    return _key_single(x) if isinstance(x, np.float32) else _key_double(x)


def sorted_number(key: Any) -> Any:
    """The number that `sortable` made ``key`` of."""
    return _of_key_single(key) if isinstance(key, np.int32) else _of_key_double(key)


@overload(exp_of, jit_options=VECTOR)
def _exp_of(x: Any) -> Callable[..., Any]:
    return _exp_single if x == types.float32 else _exp_double


@overload(log_of, jit_options=VECTOR)
def _log_of(x: Any) -> Callable[..., Any]:
    return _log_single if x == types.float32 else _log_double


@overload(sortable, jit_options=VECTOR)
def _sortable(x: Any) -> Callable[..., Any]:
    return _key_single if x == types.float32 else _key_double


@overload(sorted_number, jit_options=VECTOR)
def _sorted_number(key: Any) -> Callable[..., Any]:
    return _of_key_single if key == types.int32 else _of_key_double
