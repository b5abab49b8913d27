"""OSPA, GOSPA, SFDA and the number of boxes, frame by frame: scores that know no identities and no threshold.

On boxes the base distance is 1 − IoU, with c = 1, p = 1, α = 2; OSPA and GOSPA are means over all frames of the sequence, in
which a frame that is empty on both sides counts 0, and SFDA is one over the frames that are not.

OSPA: one distance between two sets of points, for where they are and how many (Schuhmacher, Vo, Vo 2008).

    OSPA(x, y) = [ 1/max(n, m) ( min_π Σ min(d(x_i, y_π(i)), c)^p + c^p |n − m| ) ]^(1/p)

where π maps the smaller set into the larger. In the unit of d; c is the price of a point too many, p ≥ 1 how much outliers
weigh. Two empty sets are at distance 0. The mapping minimises Σ min(d, c)^p; Stone Soup minimises Σ min(d, c) whatever p is,
and so gives more than the least for p > 1 at times.

GOSPA: OSPA without the division, with a price per missed and per false point (Rahmathullah et al. 2017).

    GOSPA(x, y) = [ min_π Σ min(d(x_i, y_π(i)), c)^p + c^p/α |n − m| ]^(1/p)

where π maps the smaller set into the larger. With α = 2 this is the least, over all partial mappings, of

    Σ_mapped d^p + c^p/2 (number of missed + number of false points)

and splits into these three. It grows with the number of errors, where OSPA stays below c.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.errors import InputError
from phdtrack.metrics.clear import fda_from
from phdtrack.metrics.matching import Scene, assign, cheapest, ratio
from phdtrack.types import F8

CUTOFF, ORDER, ALPHA = 1.0, 1.0, 2.0


@dataclass(frozen=True, slots=True)
class SetCounts:
    """Sums over ``frames`` frames, ``occupied`` of which hold a box on either side: OSPA, GOSPA, FDA, the error of the
    count (output − truth), and its square."""

    frames: int
    occupied: int
    ospa_sum: float
    gospa_sum: float
    fda_sum: float
    count_error: int
    count_error_squared: int

    def ospa(self) -> float:
        """Mean OSPA; NaN without frames."""
        return ratio(self.ospa_sum, self.frames)

    def gospa(self) -> float:
        """Mean GOSPA; NaN without frames."""
        return ratio(self.gospa_sum, self.frames)

    def sfda(self) -> float:
        """Mean FDA over the occupied frames; NaN without any."""
        return ratio(self.fda_sum, self.occupied)

    def count_error_mean(self) -> float:
        """Mean of (output − truth) boxes per frame: positive where too many are reported."""
        return ratio(self.count_error, self.frames)

    def count_error_rms(self) -> float:
        """Root of the mean squared error of the number of boxes."""
        return math.sqrt(ratio(self.count_error_squared, self.frames))


def count_sets(scene: Scene) -> SetCounts:
    """The sums of ``scene``."""
    ospa_sum = gospa_sum = fda_sum = 0.0
    for pair in scene.pairs:
        n, m = pair.iou.shape
        # With distance 1 − IoU the cheapest mapping is the one with most overlap, and serves all scores.
        overlap = float(pair.iou[assign(pair.iou)].sum())
        least = min(n, m) - overlap
        ospa_sum += _ospa_from(least, n, m, c=CUTOFF, p=ORDER)
        gospa_sum += _gospa_from(least, n, m, c=CUTOFF, p=ORDER, alpha=ALPHA)
        fda_sum += fda_from(overlap, n, m)
    error = scene.output_boxes - scene.truth_boxes
    sums = ospa_sum, gospa_sum, fda_sum
    return SetCounts(scene.frames, len(scene.pairs), *sums, int(error.sum()), int(np.square(error).sum()))


def ospa(x: F8, y: F8, c: float, p: float = 1.0) -> float:
    """OSPA between the points ``x`` (d, n) and ``y`` (d, m), columns, under the Euclidean distance.

    Parameters
    ----------
    x, y : (d, n), (d, m) points, columns.
    c : cut-off distance, in the unit of the points.
    p : order, from 1.

    Raises
    ------
    InputError : for points of different dimension or not finite, c ≤ 0, or p outside [1, ∞).
    """
    return ospa_of(euclidean(x, y), c, p)


def ospa_of(distance: F8, c: float, p: float = 1.0) -> float:
    """OSPA between two sets with the given ``distance`` (n, m) of each point of the one from each of the other.

    Parameters
    ----------
    distance : (n, m) between each point of the one set and each of the other.
    c : cut-off distance, in the unit of the points.
    p : order, from 1.
    """
    check_order(c, p)
    cost = _cut(distance, c, p)
    return _ospa_from(float(cost[cheapest(cost)].sum()), *distance.shape, c=c, p=p)


def _ospa_from(least: float, n: int, m: int, *, c: float, p: float) -> float:
    """OSPA of sets of ``n`` and ``m`` points, when the best mapping of one into the other costs ``least``."""
    if not max(n, m):
        return 0.0
    return float(((least + c**p * abs(n - m)) / max(n, m)) ** (1 / p))


def _cut(distance: F8, c: float, p: float) -> F8:
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

    Parameters
    ----------
    x, y : (d, n), (d, m) points, columns.
    c : cut-off distance, in the unit of the points.
    p : order, from 1.
    alpha : α; the price of a point too many is c^p/α.

    Raises
    ------
    InputError : for points of different dimension or not finite, c ≤ 0, p outside [1, ∞), or alpha outside (0, 2].
    """
    return gospa_of(euclidean(x, y), c, p, alpha)


def gospa_of(distance: F8, c: float, p: float = 1.0, alpha: float = 2.0) -> float:
    """GOSPA between two sets with the given ``distance`` (n, m) of each point of the one from each of the other.

    Parameters
    ----------
    distance : (n, m) between each point of the one set and each of the other.
    c : cut-off distance, in the unit of the points.
    p : order, from 1.
    alpha : α; the price of a point too many is c^p/α.
    """
    check_order(c, p)
    if not 0 < alpha <= 2:
        raise InputError(f"expected 0 < alpha ≤ 2, got {alpha}", where="alpha")
    cost = _cut(distance, c, p)
    return _gospa_from(float(cost[cheapest(cost)].sum()), *distance.shape, c=c, p=p, alpha=alpha)


def _gospa_from(least: float, n: int, m: int, *, c: float, p: float, alpha: float) -> float:
    """GOSPA of sets of ``n`` and ``m`` points, when the best mapping of one into the other costs ``least``."""
    return float((least + c**p / alpha * abs(n - m)) ** (1 / p))


def gospa_parts(truth: F8, output: F8, c: float, p: float = 1.0) -> GospaParts:
    """GOSPA (α = 2) of ``output`` (d, m) against ``truth`` (d, n) by kind of error; a pair at distance ≥ c is apart.

    Parameters
    ----------
    truth, output : (d, n), (d, m) points, columns.
    c : cut-off distance, in the unit of the points.
    p : order, from 1.
    """
    return gospa_parts_of(euclidean(truth, output), c, p)


def gospa_parts_of(distance: F8, c: float, p: float = 1.0) -> GospaParts:
    """As `gospa_parts`, from the ``distance`` (n, m) of each true point from each output point.

    Parameters
    ----------
    distance : (n, m) between each point of the one set and each of the other.
    c : cut-off distance, in the unit of the points.
    p : order, from 1.
    """
    check_order(c, p)
    rows, columns = cheapest(_cut(distance, c, p))
    near = distance[rows, columns][distance[rows, columns] < c]
    localisation = float((near**p).sum())
    missed, false = distance.shape[0] - len(near), distance.shape[1] - len(near)
    price = c**p / 2
    whole = (localisation + price * (missed + false)) ** (1 / p)
    return GospaParts(whole, localisation, price * missed, price * false, missed, false)
