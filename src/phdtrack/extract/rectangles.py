"""Rectangles in a grid, so that those which overlap given ones are found without looking at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.kernels.joining import meeting
from phdtrack.kernels.overlaps import rectangle_grid
from phdtrack.types import F8, I8


@dataclass(frozen=True, slots=True, eq=False)
class Rectangles:
    """N closed rectangles in the position plane.

    Attributes
    ----------
    lower, upper : (2, N) finite corners, C-contiguous.
    grid : over them, as `kernels.overlaps.rectangle_grid` makes it.
    """

    lower: F8
    upper: F8
    grid: tuple[F8, I8, I8, I8]

    @classmethod
    def of(cls, lower: F8, upper: F8) -> Rectangles:
        """The rectangles with these corners."""
        return cls(lower, upper, rectangle_grid(lower, upper))

    def meeting(self, low: F8, high: F8) -> tuple[I8, I8]:
        """Pairs (i, j): rectangle i of those with corners ``low`` and ``high`` (2, M) overlaps j of these; ordered by i."""
        n = self.lower.shape[1]
        found, room = np.empty(n, np.int64), 4 * (n + low.shape[1]) + 64
        while True:
            pairs = np.empty((2, room), np.int64)
            count = meeting(low, high, self.lower, self.upper, *self.grid, found, pairs)
            if count <= room:
                return pairs[0, :count], pairs[1, :count]
            room = count
