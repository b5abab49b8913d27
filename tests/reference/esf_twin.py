"""Products of linear factors by enumeration and one by one; thinning by the binomial."""

from __future__ import annotations

import math
from fractions import Fraction


def coefficients(a, b) -> list[Fraction]:
    """Exactly: the coefficients of Π (a_i + b_i t), multiplied out one factor after the other."""
    out = [Fraction(1)]
    for low, high in zip(map(Fraction, a), map(Fraction, b), strict=True):
        out = [
            low * x + high * y
            for x, y in zip([*out, Fraction(0)], [Fraction(0), *out], strict=True)
        ]
    return out


def sums_without(a, b, w) -> list[Fraction]:
    """Σ_j w_j [t^j] Π_{i≠k}, multiplied out anew for each k: O(m³)."""
    rest = [coefficients([*a[:k], *a[k + 1 :]], [*b[:k], *b[k + 1 :]]) for k in range(len(a))]
    return [sum((Fraction(x) * y for x, y in zip(w, c, strict=False)), Fraction(0)) for c in rest]


def log_of(value: Fraction) -> float:
    """log of an exact number of any size; −∞ of zero."""
    if value == 0:
        return -math.inf
    shift = value.numerator.bit_length() - value.denominator.bit_length()
    return math.log(value / Fraction(2) ** shift) + shift * math.log(2)


def thinned(probability, keep):
    n = len(probability)
    return [
        math.fsum(
            p * math.comb(total, j) * keep**j * (1 - keep) ** (total - j)
            for total, p in enumerate(probability)
            if total >= j
        )
        for j in range(n)
    ]
