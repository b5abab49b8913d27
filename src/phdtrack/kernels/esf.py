"""Elementary symmetric functions in logarithms, and sums over all but one of their arguments.

The cardinalised PHD filter needs the coefficients of Π_i (a_i + b_i t) of a scan, with a = κ(z) and
b = C(z). They span hundreds of orders of magnitude, so everything is a logarithm (−∞ for zero), and
nothing is ever subtracted.

For each detection z it needs the same without z, through one sum Σ_j w_j [t^j]. That is the
derivative of the whole sum by a_z: one sweep backwards through the products gives it for all z in
O(m²), by additions only. Dividing (a_z + b_z t) out would lose every digit where b_z/a_z is large,
and multiplying anew for each z would cost O(m³).
"""

from __future__ import annotations

import numpy as np

from phdtrack.kernels import F8
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.small_arrays import copy_into


@njit(**INNER)
def _log_add(a: float, b: float) -> float:
    """log(eᵃ + eᵇ); −∞ stands for zero."""
    if a < b:
        a, b = b, a
    # exp(-40) is below the last digit of 1.
    if b == -np.inf or b - a < -40.0:
        return a
    total: float = a + np.log1p(np.exp(b - a))
    return total


@njit(**ENTRY)
def log_products(log_a: F8, log_b: F8, most: int) -> F8:
    """(m + 1, J + 1) row k: the logarithms of the coefficients of Π_{i<k} (a_i + b_i t), up to t^J,
    J = min(m, most).
    """
    m = log_a.size
    top = min(m, most)
    out = np.full((m + 1, top + 1), -np.inf)
    out[0, 0] = 0.0
    for k in range(m):
        out[k + 1, 0] = out[k, 0] + log_a[k]
        for j in range(1, min(k + 1, top) + 1):
            out[k + 1, j] = _log_add(out[k, j] + log_a[k], out[k, j - 1] + log_b[k])
    return out


@njit(**ENTRY)
def log_sums_without(log_a: F8, log_b: F8, products: F8, log_w: F8) -> F8:
    """(m,) for each k the logarithm of Σ_j w_j [t^j] Π_{i≠k} (a_i + b_i t).

    ``products`` from `log_products` with ``most`` at least J; ``log_w`` (J + 1,) the weights, zero
    beyond.
    """
    m = log_a.size
    top = min(log_w.size, products.shape[1])
    after = np.full(top + 1, -np.inf)
    copy_into(log_w[:top], after)
    out = np.empty(m)
    for k in range(m - 1, -1, -1):
        largest = -np.inf
        for j in range(min(k + 1, top)):
            largest = max(largest, products[k, j] + after[j])
        out[k] = largest
        if largest > -np.inf:
            total = 0.0
            for j in range(min(k + 1, top)):
                total += np.exp(products[k, j] + after[j] - largest)
            out[k] += np.log(total)
        # w after the factors behind k: coefficient j before k contributes to j and, by b_k t, to j
        # + 1.
        for j in range(top):
            after[j] = _log_add(log_a[k] + after[j], log_b[k] + after[j + 1])
    return out


@njit(**ENTRY)
def thinned(probability: F8, keep: float) -> F8:
    """(n,) distribution of the number that is left of one with distribution ``probability`` (n,),
    each kept with probability ``keep``.

    Horner's rule on Σ_l p_l (1 − keep + keep t)^l.
    """
    n = probability.size
    out = np.zeros(n)
    lost = 1.0 - keep
    for top in range(n):
        for j in range(top, 0, -1):
            out[j] = lost * out[j] + keep * out[j - 1]
        out[0] = lost * out[0] + probability[n - 1 - top]
    return out
