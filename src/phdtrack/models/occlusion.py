"""What the boxes of a frame hide: behind a nearer box a target is seen less often; E13's filter does not know it [E13 §6].

A detector finds a person by what is to be seen of him. Of two boxes the nearer one hides the other: the one whose lower edge
is lower in the image, or whose foot point is nearer to the camera. The covered part of a target is here the largest that
one single box covers. The union of several would be more exact by what two nearer people hide of a third beside each
other, would cost a sweep over their edges for every particle, and differs only where three stand in line.

The box that a target might itself have given, z within the 99 % region of the sensor's noise, hides nothing of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.kernels.hidden import hiding
from phdtrack.kernels.overlaps import rectangle_grid
from phdtrack.types import F8, I8, Bool


@dataclass(frozen=True, slots=True, eq=False)
class Hiders:
    """The N boxes of a frame that may hide targets.

    Attributes
    ----------
    xyxy : (N, 4) boxes, pixels.
    depth : (N,) how far away each stands, in any unit that grows with distance.
    z : (m, N) the measurement vectors that they gave.
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


def greatest(which: I8, part: F8, own: Bool, count: int) -> F8:
    """(count,) the largest of the shares ``part`` (P,) of each box ``which`` (P,); those of its ``own`` (P,) left out."""
    covered = np.zeros(count)
    np.maximum.at(covered, which[~own], part[~own])
    return covered
