"""Early warning: groups that are about to meet (E13's conclusion asks for it).

Two people at relative position Δ and velocity δ, who both go on as they go, are closest after τ = −Δ·δ / |δ|², at the
distance |Δ + δτ|. Two groups meet when any member of one comes that close to any of the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.checks import Positive, Share, check
from phdtrack.types import F8, I8


@dataclass(frozen=True, slots=True)
class Warned:
    """Groups ``first`` < ``second`` are expected to meet.

    Of the two members that are likeliest to: ``seconds`` from now until they are closest, ``distance`` then and its
    ``deviation``, metres, the ``place`` half-way between them, and the ``probability`` that they come near.
    """

    first: int
    second: int
    seconds: float
    distance: float
    deviation: float
    place: tuple[float, float]
    probability: float


@dataclass(frozen=True, slots=True)
class Meetings:
    """When to warn.

    Parameters
    ----------
    horizon : seconds looked ahead; people turn, and straight lines say little about more.
    near : metres; who comes closer has met.
    probability : of coming so close, from which on it is worth a warning.
    """

    horizon: Positive = 4.0
    near: Positive = 2.0
    probability: Share = 0.5

    def __post_init__(self) -> None:
        check(self)

    def expected(self, group: I8, mean: F8, covariance: F8) -> tuple[Warned, ...]:
        """Warnings for members with states (4, n), covariances (n, 4, 4) and groups (n,); groups that are near do not count.

        The deviation is that of the distance along the line of closest approach, P_a + P_b carried on to that time.
        """
        i, j = np.triu_indices(len(group), 1)
        other = group[i] != group[j]
        i, j = i[other], j[other]
        apart, drift = mean[:2, i] - mean[:2, j], mean[2:4, i] - mean[2:4, j]
        drift2 = (drift**2).sum(0)
        towards = -(apart * drift).sum(0)
        after = np.clip(np.divide(towards, drift2, out=np.zeros_like(drift2), where=drift2 > 0), 0, self.horizon)
        then = apart + drift * after
        distance = np.hypot(then[0], then[1])
        deviation = _deviation(covariance[i] + covariance[j], then, distance, after)
        pair = np.stack([np.minimum(group[i], group[j]), np.maximum(group[i], group[j])])
        met = {(int(a), int(b)) for a, b in pair[:, np.hypot(*apart) < self.near].T}
        best: dict[tuple[int, int], Warned] = {}
        for k in np.flatnonzero(after > 0):
            key = (int(pair[0, k]), int(pair[1, k]))
            chance = _below(self.near, float(distance[k]), float(deviation[k]))
            if key in met or chance < self.probability or (key in best and best[key].probability >= chance):
                continue
            middle = 0.5 * (mean[:2, i[k]] + mean[:2, j[k]] + (mean[2:4, i[k]] + mean[2:4, j[k]]) * after[k])
            place = (float(middle[0]), float(middle[1]))
            best[key] = Warned(*key, float(after[k]), float(distance[k]), float(deviation[k]), place, chance)
        return tuple(best[key] for key in sorted(best))


def _deviation(covariance: F8, then: F8, distance: F8, after: F8) -> F8:
    """(P,) deviations of the distance, from covariances (P, 4, 4) of relative position and velocity."""
    line = np.divide(then, distance, out=np.tile([[1.0], [0.0]], (1, len(distance))), where=distance > 0)
    along = np.concatenate([line, line * after])
    out: F8 = np.sqrt(np.einsum("rp,prs,sp->p", along, covariance[:, :4, :4], along))
    return out


def _below(near: float, distance: float, deviation: float) -> float:
    """Probability that a Gaussian distance lies below ``near``."""
    if deviation == 0:
        return float(distance < near)
    return 0.5 * math.erfc((distance - near) / (deviation * math.sqrt(2)))
