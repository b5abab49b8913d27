"""What the boxes of a frame hide: behind a nearer box a target is seen less often; E13's filter does not know it [E13 §6].

A detector finds a person by what is to be seen of him. Of two boxes the nearer one hides the other: the one whose lower edge
is lower in the image, or whose foot point is nearer to the camera. The covered part of a target is here the largest that
one single box covers. The union of several would be more exact by what two nearer people hide of a third beside each
other, would cost a sweep over their edges for every particle, and differs only where three stand in line.

What a target might itself have given, a z within the 99 % region of the sensor's noise, says that it is seen: nothing hides
it then. That is a choice: were p_D low all the same, the part (1 − p_D) of its weight that no detection explains would stay
beside the part that its own detection explains, and be counted twice wherever a detector sees more than half of a covered
person. On six cases of given detections, GM-PHD, that cost 0.07 of MOTA, and 0.02 as it is. What it brings is the count: on
PETS 2009 S1.L1 the number of states is half as wrong as with a constant p_D.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.kernels.gating import gated_pairs
from phdtrack.kernels.hidden import hiding
from phdtrack.kernels.overlaps import rectangle_grid
from phdtrack.protocols import Sensor
from phdtrack.types import F8, I8, Bool


@dataclass(frozen=True, slots=True, eq=False)
class Hiders:
    """The N boxes of a frame that may hide targets.

    Attributes
    ----------
    xyxy : (N, 4) boxes, pixels.
    depth : (N,) how far away each stands, in any unit that grows with distance.
    z : (m, K) the measurement vectors that they gave; of some there may be none.
    """

    xyxy: F8
    depth: F8
    z: F8

    def __len__(self) -> int:
        return len(self.xyxy)

    def over(self, xyxy: F8, depth: F8) -> tuple[I8, I8, F8]:
        """Pairs (i, j) and shares (P,): of the box i (L, 4) at ``depth`` (L,) the nearer box j covers this part; by i."""
        low, high = np.ascontiguousarray(xyxy[:, :2].T), np.ascontiguousarray(xyxy[:, 2:].T)
        lower, upper = np.ascontiguousarray(self.xyxy[:, :2].T), np.ascontiguousarray(self.xyxy[:, 2:].T)
        grid, found, room = rectangle_grid(lower, upper), np.empty(len(self), np.int64), 2 * len(depth) + 64
        while True:
            pairs, part = np.empty((2, room), np.int64), np.empty(room)
            count = hiding(low, high, depth, lower, upper, self.depth, *grid, found, pairs, part)
            if count <= room:
                return pairs[0, :count], pairs[1, :count], part[:count]
            room = count


NOBODY = Hiders(np.zeros((0, 4)), np.zeros(0), np.zeros((0, 0)))
"""Nothing that could hide."""


def covered(hiders: Hiders, sensor: Sensor, x: F8, xyxy: F8, depth: F8, region: float) -> F8:
    """(L,) the largest part of each target's box that one of the ``hiders`` covers; 0 for a target that is seen.

    Targets at ``x`` (d, L) have the boxes ``xyxy`` (L, 4) and stand at ``depth`` (L,). Seen is who lies within the squared
    Mahalanobis distance ``region`` of one of the frame's measurements.
    """
    out = np.zeros(x.shape[1])
    unseen = np.flatnonzero(~_seen(hiders.z, sensor, x, region))
    which, _, part = hiders.over(xyxy[unseen], depth[unseen])
    np.maximum.at(out, unseen[which], part)
    return out


def _seen(z: F8, sensor: Sensor, x: F8, region: float) -> Bool:
    """(L,) whether one of the measurements may be of the target."""
    point, which = gated_pairs(np.ascontiguousarray(x[0]), np.ascontiguousarray(x[1]), *sensor.gate(z))
    near = sensor.distance2(z[:, which], x[:, point]) <= region
    seen = np.zeros(x.shape[1], np.bool_)
    seen[point[near]] = True
    return seen
