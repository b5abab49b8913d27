"""Settings of the camera's motion: none, measured by sparse optical flow, or given in a file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from phdtrack.checks import Positive, PositiveCount, Share, check


@dataclass(frozen=True, slots=True)
class Standing:
    """The camera stands still."""


@dataclass(frozen=True, slots=True)
class GivenWarps:
    """Motion from a file.

    Parameters
    ----------
    file : a row for each frame, ``frame,g11,g12,g13,g21,g22,g23[,g31,g32,g33]``: see `formats.read_warps`.
    """

    file: str


@dataclass(frozen=True, slots=True)
class SparseFlow:
    """Motion measured by points that are followed from one picture to the next.

    Corners outside the detected boxes are followed by Lucas and Kanade's method, forth and back, and a map is fitted to them
    by RANSAC: most of what is seen belongs to the background, or it cannot be measured so.

    Parameters
    ----------
    width : pictures are scaled down to this many pixels before they are looked at.
    points : corners that are followed at most.
    form : ``similarity`` (shift, turn, zoom), which few points determine well; ``homography`` for a camera that pans with a
        wide lens, or a scene that is one plane.
    error : pixels of the scaled picture by which a point may miss the map, and its way back its beginning.
    least : points that must fit the map; with fewer the camera is taken to stand still in that frame.
    share : share of the points followed that must fit it.
    """

    width: PositiveCount = 640
    points: PositiveCount = 300
    form: Literal["similarity", "homography"] = "similarity"
    error: Positive = 1.0
    least: PositiveCount = 20
    share: Share = 0.4

    def __post_init__(self) -> None:
        check(self)
