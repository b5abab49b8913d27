"""Upright boxes around rotated boxes and polygons."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

# Degrees below which a rotation is none.
_STRAIGHT = 1e-6


def rotated_hull(
    left: float, top: float, right: float, bottom: float, degrees: float
) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of the upright box around a box that is rotated about its centre.

    Parameters
    ----------
    left, top, right, bottom : the box before it is rotated, pixels.
    degrees : the angle.
    """
    if abs(math.remainder(degrees, 180.0)) < _STRAIGHT:
        return left, top, right, bottom
    cosine = abs(math.cos(math.radians(degrees)))
    sine = abs(math.sin(math.radians(degrees)))
    half_width = (cosine * (right - left) + sine * (bottom - top)) / 2
    half_height = (sine * (right - left) + cosine * (bottom - top)) / 2
    x = (left + right) / 2
    y = (top + bottom) / 2
    return x - half_width, y - half_height, x + half_width, y + half_height


def hull(xs: Sequence[float], ys: Sequence[float]) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of the upright box around points."""
    return min(xs), min(ys), max(xs), max(ys)


@dataclass(frozen=True, slots=True)
class Shapes:
    """Counts of shapes that are not upright boxes, by their name: those ``read`` as their hull, and
    those ``left_out``."""

    read: Counter[str] = field(default_factory=Counter[str])
    left_out: Counter[str] = field(default_factory=Counter[str])

    def sentences(self) -> Iterator[str]:
        """Yield a sentence for those read, and one for those left out."""
        if self.read:
            yield f"read as the upright boxes around them: {_listed(self.read)}"
        if self.left_out:
            yield f"left out, because they are no boxes or areas: {_listed(self.left_out)}"


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{count} × {name}" for name, count in sorted(counts.items()))
