"""What targets hide of each other: behind a nearer one a target is detected less often, which E13's filter does not know.

A detector finds a person by the part that it sees. Of two targets the one that is nearer to the camera hides the other. With
c the largest part of a target's box that the box of one single other covers [E13 §6],

    p_D(x) = p_D · max(1 − c^1.5, least)

The exponent was measured: of boxes that are covered to 5, 22, 45, 65 and 87 %, detectors find .98, .86, .72, .50 and .18 of
what they find of free ones.

The targets that hide are those that the last frame showed, where the motion expects them now, and not the boxes of this
frame: a box does not say which target is seen. And if p_D fell for people whom this frame shows, the weight that remains of
the undetected part would count them twice. A target does not hide itself: a state is that of the hider
nearest to it, where that is within the 99 % region of the sensor's noise, and all others may hide it. In a crowd many
hiders lie within that region: were all of them taken for the state's own, hardly anybody would count as hidden.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.kernels.grid import make_grid, overlapping_pairs
from phdtrack.types import F8

# From the covered part to the part of p_D that is lost.
SHAPE = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Hiders:
    """The K targets of a frame that may hide others.

    Attributes
    ----------
    xyxy : (K, 4) boxes, pixels.
    depth : (K,) how far away each stands, in any unit that grows with distance.
    place : (r, K) what a measurement would show of each.
    noise : (r, K) deviations by which that is resolved there.
    region : squared distance in deviations within which a state is that of the nearest hider.
    least : share of p_D that is left of a target that is covered altogether.
    """

    xyxy: F8
    depth: F8
    place: F8
    noise: F8
    region: float
    least: float

    def seen_part(self, place: F8, xyxy: F8, depth: F8) -> F8:
        """(L,) share of p_D that is left, max(1 − c^1.5, least).

        Parameters
        ----------
        place : array (r, L), what a measurement would show of the targets.
        xyxy : array (L, 4), their boxes.
        depth : array (L,), how far away they stand.
        """
        low, high = np.ascontiguousarray(xyxy[:, :2].T), np.ascontiguousarray(xyxy[:, 2:].T)
        lower, upper = np.ascontiguousarray(self.xyxy[:, :2].T), np.ascontiguousarray(self.xyxy[:, 2:].T)
        i, j = overlapping_pairs(low, high, make_grid(lower, upper))
        apart = (((place[:, i] - self.place[:, j]) / self.noise[:, j]) ** 2).sum(axis=0)
        own = np.full(len(depth), self.region)
        np.minimum.at(own, i, apart)
        others = (self.depth[j] < depth[i]) & (apart > own[i])
        i, j = i[others], j[others]
        width, height = np.maximum(np.minimum(high[:, i], upper[:, j]) - np.maximum(low[:, i], lower[:, j]), 0.0)
        covered = np.zeros(len(depth))
        np.maximum.at(covered, i, width / (high[0, i] - low[0, i]) * (height / (high[1, i] - low[1, i])))
        out: F8 = np.maximum(1 - covered**SHAPE, self.least)
        return out
