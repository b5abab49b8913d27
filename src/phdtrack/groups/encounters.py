"""Warnings before two groups meet, which E13's conclusion asks for.

Two people at relative position Δ and velocity δ, who keep their velocities, are closest after
τ = −Δ·δ / |δ|², at the distance |Δ + δτ|. Two groups meet if any member of one comes close enough
to any member of the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import Checked, Positive, Share
from phdtrack.types import F8, I8, GaussianMixture


@dataclass(frozen=True, slots=True)
class Encounter:
    """Groups ``first`` < ``second`` are expected to meet.

    For the most probable pair of members: ``seconds`` until they are closest, their ``distance``
    then and its ``deviation``, metres, the ``place`` half-way between them, and the ``probability``
    that they come close.
    """

    first: int
    second: int
    seconds: float
    distance: float
    deviation: float
    place: tuple[float, float]
    probability: float


@dataclass(frozen=True, slots=True)
class EncounterWarning(Checked):
    """The conditions of a warning.

    Parameters
    ----------
    horizon : seconds to look ahead; people turn, so straight lines predict little beyond it.
    max_distance : metres; groups that come closer have met.
    probability : of coming so close, from which on a warning is given.
    """

    horizon: Positive = 4.0
    max_distance: Positive = 2.0
    probability: Share = 0.5

    def expected(self, group: I8, members: GaussianMixture) -> tuple[Encounter, ...]:
        """Warnings in order, at most one for each pair of groups; none for groups that are close
        already.

        ``group`` (J,) is that of each of the ``members`` over (px, py, vx, vy), 0 for none. The
        deviation is that of the distance along the line of closest approach, from P_a + P_b
        predicted to that time.
        """
        from scipy.special import ndtr

        grouped = np.flatnonzero(group)
        i, j = grouped[np.stack(np.triu_indices(len(grouped), 1))]
        different = group[i] != group[j]
        i = i[different]
        j = j[different]
        mean = members.mean
        offset = mean[:2, i] - mean[:2, j]
        velocity = mean[2:4, i] - mean[2:4, j]
        with np.errstate(divide="ignore", invalid="ignore"):
            closest = -(offset * velocity).sum(0) / (velocity**2).sum(0)
            after = np.clip(np.nan_to_num(closest), 0, self.horizon)
            then = offset + velocity * after
            distance = np.hypot(then[0], then[1])
            line = np.where(distance > 0, then / distance, [[1.0], [0.0]])
            along = np.concatenate([line, line * after])
            both = members.covariance[i, :4, :4] + members.covariance[j, :4, :4]
            deviation = np.sqrt(np.einsum("rp,prs,sp->p", along, both, along))
            probability = np.nan_to_num(ndtr((self.max_distance - distance) / deviation))
        pair = np.sort(np.stack([group[i], group[j]]), axis=0)
        met = {(a, b) for a, b in pair[:, np.hypot(*offset) < self.max_distance].T.tolist()}
        best: dict[tuple[int, int], Encounter] = {}
        for k in np.flatnonzero((after > 0) & (probability >= self.probability)):
            key = (int(pair[0, k]), int(pair[1, k]))
            if key in met or (key in best and best[key].probability >= probability[k]):
                continue
            best[key] = Encounter(
                *key,
                float(after[k]),
                float(distance[k]),
                float(deviation[k]),
                _halfway(mean[:, i[k]], mean[:, j[k]], after[k]),
                float(probability[k]),
            )
        return tuple(best[key] for key in sorted(best))


def _halfway(a: F8, b: F8, seconds: float) -> tuple[float, float]:
    """The point between two states (px, py, vx, vy) after some seconds, metres."""
    x, y = (0.5 * (a[:2] + b[:2] + (a[2:4] + b[2:4]) * seconds)).tolist()
    return x, y
