"""GOSPA: OSPA without the division, with a price per missed and per false point (Rahmathullah et al. 2017).

    GOSPA(x, y) = [ min_π Σ min(d(x_i, y_π(i)), c)^p + c^p/α |n − m| ]^(1/p)

where π maps the smaller set into the larger. With α = 2 this is the least, over all partial mappings, of

    Σ_mapped d^p + c^p/2 (number of missed + number of false points)

and splits into these three. It grows with the number of errors, where OSPA stays below c.
"""

from __future__ import annotations

from dataclasses import dataclass

from phdtrack.errors import InputError
from phdtrack.metrics.assignment import cheapest
from phdtrack.metrics.ospa import check_order, cut, euclidean
from phdtrack.types import F8


@dataclass(frozen=True, slots=True)
class GospaParts:
    """GOSPA for α = 2: ``distance``^p = ``localisation`` + ``missed`` + ``false``; numbers of missed and false points."""

    distance: float
    localisation: float
    missed: float
    false: float
    missed_count: int
    false_count: int


def gospa(x: F8, y: F8, c: float, p: float = 1.0, alpha: float = 2.0) -> float:
    """GOSPA between the points ``x`` (d, n) and ``y`` (d, m), columns, under the Euclidean distance.

    Raises
    ------
    InputError : for points of different dimension or not finite, c ≤ 0, p outside [1, ∞), or alpha outside (0, 2].
    """
    return gospa_of(euclidean(x, y), c, p, alpha)


def gospa_of(distance: F8, c: float, p: float = 1.0, alpha: float = 2.0) -> float:
    """GOSPA between two sets with the given ``distance`` (n, m) of each point of the one from each of the other."""
    check_order(c, p)
    if not 0 < alpha <= 2:
        raise InputError(f"expected 0 < alpha ≤ 2, got {alpha}", where="alpha")
    cost = cut(distance, c, p)
    return gospa_from(float(cost[cheapest(cost)].sum()), *distance.shape, c=c, p=p, alpha=alpha)


def gospa_from(least: float, n: int, m: int, *, c: float, p: float, alpha: float) -> float:
    """GOSPA of sets of ``n`` and ``m`` points, when the best mapping of one into the other costs ``least``."""
    return float((least + c**p / alpha * abs(n - m)) ** (1 / p))


def gospa_parts(truth: F8, output: F8, c: float, p: float = 1.0) -> GospaParts:
    """GOSPA (α = 2) of ``output`` (d, m) against ``truth`` (d, n) by kind of error; a pair at distance ≥ c is apart."""
    return gospa_parts_of(euclidean(truth, output), c, p)


def gospa_parts_of(distance: F8, c: float, p: float = 1.0) -> GospaParts:
    """As `gospa_parts`, from the ``distance`` (n, m) of each true point from each output point."""
    check_order(c, p)
    rows, columns = cheapest(cut(distance, c, p))
    near = distance[rows, columns][distance[rows, columns] < c]
    localisation = float((near**p).sum())
    missed, false = distance.shape[0] - len(near), distance.shape[1] - len(near)
    price = c**p / 2
    whole = (localisation + price * (missed + false)) ** (1 / p)
    return GospaParts(whole, localisation, price * missed, price * false, missed, false)
