"""OSPA and GOSPA of points: distances that know no identities.

OSPA: one distance between two sets of points, for where they are and how many (Schuhmacher, Vo, Vo 2008).

    OSPA(x, y) = [ 1/max(n, m) ( min_π Σ min(d(x_i, y_π(i)), c)^p + c^p |n − m| ) ]^(1/p)

where π maps the smaller set into the larger. In the unit of d; c is the price of a point too many, p ≥ 1 how much outliers
weigh. Two empty sets are at distance 0. (Stone Soup maps for the least Σ min(d, c) whatever p is, and so gives more than the
least for p > 1 at times.)

GOSPA: OSPA without the division, with a price per missed and per false point (Rahmathullah et al. 2017).

    GOSPA(x, y) = [ min_π Σ min(d(x_i, y_π(i)), c)^p + c^p/α |n − m| ]^(1/p)

With α = 2 this is the least, over all partial mappings, of Σ_mapped d^p + c^p/2 (number of missed + number of false points).
It grows with the number of errors, where OSPA stays below c.
"""

from __future__ import annotations

import math

import numpy as np

from phdtrack.errors import InputError
from phdtrack.metrics.matching import cheapest
from phdtrack.types import F8


def ospa(x: F8, y: F8, c: float, p: float = 1.0) -> float:
    """OSPA between points under the Euclidean distance.

    Parameters
    ----------
    x, y : (d, n), (d, m) points, columns.
    c : cut-off distance, in the unit of the points.
    p : order, from 1.

    Returns
    -------
    The distance, in the unit of the points.

    Raises
    ------
    InputError : for points that do not fit or are not finite, c ≤ 0, or p outside [1, ∞).
    """
    most = max(x.shape[-1], y.shape[-1], 1)
    return float((_total(x, y, c, p, 1.0) / most) ** (1 / p))


def gospa(x: F8, y: F8, c: float, p: float = 1.0, alpha: float = 2.0) -> float:
    """GOSPA between points under the Euclidean distance.

    Parameters
    ----------
    x, y, c, p : as `ospa` has them.
    alpha : α; the price of a point too many is c^p/α.

    Returns
    -------
    The distance, in the unit of the points.

    Raises
    ------
    InputError : as `ospa`, or for alpha outside (0, 2].
    """
    if not 0 < alpha <= 2:
        raise InputError(f"expected 0 < alpha ≤ 2, got {alpha}", where="alpha")
    return float(_total(x, y, c, p, alpha) ** (1 / p))


def _total(x: F8, y: F8, c: float, p: float, alpha: float) -> float:
    """The least Σ min(d, c)^p over mappings of one set into the other, with the price of the points too many."""
    check_order(c, p)
    cost = np.minimum(euclidean(x, y), c) ** p
    return float(cost[cheapest(cost)].sum() + c**p / alpha * abs(cost.shape[0] - cost.shape[1]))


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
