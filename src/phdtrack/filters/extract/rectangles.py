"""Rectangles in a grid, so that kernels find those which overlap given ones without looking at all."""

from __future__ import annotations

from dataclasses import dataclass

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
