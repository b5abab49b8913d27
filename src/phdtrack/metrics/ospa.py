"""OSPA: one distance between two sets of points, for where they are and how many (Schuhmacher, Vo, Vo 2008).

    OSPA(x, y) = [ 1/max(n, m) ( min_π Σ min(d(x_i, y_π(i)), c)^p + c^p |n − m| ) ]^(1/p)

where π maps the smaller set into the larger. In the unit of d; c is the price of a point too many, p ≥ 1 how much outliers
weigh. Two empty sets are at distance 0. The mapping minimises Σ min(d, c)^p; Stone Soup minimises Σ min(d, c) whatever p is,
and so gives more than the least for p > 1 at times.
"""

from __future__ import annotations

import math

import numpy as np

from phdtrack.errors import InputError
from phdtrack.metrics.assignment import cheapest
from phdtrack.types import F8


def ospa(x: F8, y: F8, c: float, p: float = 1.0) -> float:
    """OSPA between the points ``x`` (d, n) and ``y`` (d, m), columns, under the Euclidean distance.

    Raises
    ------
    InputError : for points of different dimension or not finite, c ≤ 0, or p outside [1, ∞).
    """
    return ospa_of(euclidean(x, y), c, p)


def ospa_of(distance: F8, c: float, p: float = 1.0) -> float:
    """OSPA between two sets with the given ``distance`` (n, m) of each point of the one from each of the other."""
    check_order(c, p)
    cost = cut(distance, c, p)
    return ospa_from(float(cost[cheapest(cost)].sum()), *distance.shape, c=c, p=p)


def ospa_from(least: float, n: int, m: int, *, c: float, p: float) -> float:
    """OSPA of sets of ``n`` and ``m`` points, when the best mapping of one into the other costs ``least``."""
    if not max(n, m):
        return 0.0
    return float(((least + c**p * abs(n - m)) / max(n, m)) ** (1 / p))


def cut(distance: F8, c: float, p: float) -> F8:
    """(n, m) min(d, c)^p."""
    cost: F8 = np.minimum(distance, c) ** p
    return cost


def euclidean(x: F8, y: F8) -> F8:
    """(n, m) distances between the columns of ``x`` (d, n) and of ``y`` (d, m)."""
    if x.ndim != 2 or y.ndim != 2 or len(x) != len(y):
        raise InputError(
            f"expected two sets of points as columns, (d, n) and (d, m), got {x.shape} and {y.shape}",
            cure="An array with a point in each row needs .T.",
        )
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("expected finite coordinates, got NaN or infinity")
    distance: F8 = np.sqrt(((x[:, :, None] - y[:, None, :]) ** 2).sum(axis=0))
    return distance


def check_order(c: float, p: float) -> None:
    """Raise `InputError` unless 0 < c < ∞ and 1 ≤ p < ∞."""
    if not (0 < c < math.inf):
        raise InputError(f"expected a cut-off distance c > 0, got {c}", where="c")
    if not (1 <= p < math.inf):
        raise InputError(f"expected an order 1 ≤ p < ∞, got {p}", where="p")
