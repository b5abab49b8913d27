"""A level camera over a flat ground, and walks on it.

Lengths on the ground are in body heights (of a figure of stature 1), so that a walking speed reads as body heights per
second. With focal length f (pixels), camera height c (body heights), horizon row y₀ and image centre x₀, a foot point at
lateral X and depth Z is seen at

    x = x₀ + f X / Z        y = y₀ + f c / Z        and a figure there is   f / Z = (y − y₀) / c   pixels tall:

lower in the picture is larger, and straight walks on the ground are straight in the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.types import F8, I8

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Camera:
    """``horizon`` and ``centre`` in pixels, ``focal`` in pixels, ``height`` above the ground in body heights."""

    centre: float
    horizon: float
    focal: float
    height: float

    def to_ground(self, xy: F8) -> F8:
        """(n, 2) lateral and depth of the foot points ``xy`` (n, 2) in pixels, which must lie below the horizon."""
        depth = self.focal * self.height / (xy[:, 1] - self.horizon)
        return np.stack([(xy[:, 0] - self.centre) * depth / self.focal, depth], axis=1)

    def to_picture(self, ground: F8) -> F8:
        """(n, 2) pixels of the ground points (n, 2)."""
        x = self.centre + self.focal * ground[:, 0] / ground[:, 1]
        return np.stack([x, self.horizon + self.focal * self.height / ground[:, 1]], axis=1)

    def scale(self, foot_row: F8) -> F8:
        """Pixels that a figure of stature 1 measures with its foot at these rows."""
        return (foot_row - self.horizon) / self.height

    def boxes(self, foot: F8, stature: float, aspect: float) -> F8:
        """(n, 4) xyxy of figures standing at the pixels ``foot`` (n, 2); ``aspect`` is width over height."""
        tall = stature * self.scale(foot[:, 1])
        half = aspect * tall / 2
        return np.stack([foot[:, 0] - half, foot[:, 1] - tall, foot[:, 0] + half, foot[:, 1]], axis=1)

    def row_below(self, bottom: float, stature: float) -> float:
        """The foot row, in pixels, of a figure whose head just touches the lower edge ``bottom`` of the picture."""
        return (bottom - stature * self.horizon / self.height) / (1 - stature / self.height)


@dataclass(frozen=True, slots=True)
class Walk:
    """One figure's way.

    Attributes
    ----------
    points : two or more foot points (x, y) as fractions of the frame's width and height; corners are rounded.
    at : second at which the walk begins; may be before the first frame.
    speed : body heights per second on the ground.
    stature : height relative to the scene's usual.
    pauses : pairs (seconds walked until the pause, its length in seconds), ascending.
    """

    points: tuple[Point, ...]
    at: float = 0.0
    speed: float = 0.75
    stature: float = 1.0
    pauses: tuple[Point, ...] = ()


def follow(walk: Walk, camera: Camera, size: Point, times: F8) -> tuple[F8, I8]:
    """Foot points (n, 2) in pixels of ``walk`` at those of ``times`` at which it is under way, and their indices (n,).

    ``size`` is the frame's width and height in pixels.
    """
    corners = camera.to_ground(np.array(walk.points) * np.array(size))
    path = rounded(corners) if len(corners) > 2 else corners
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    gone = walk.speed * walked_seconds(times - walk.at, walk.pauses)
    under_way = np.flatnonzero((times >= walk.at) & (gone <= length[-1]))
    at = gone[under_way]
    ground = np.stack([np.interp(at, length, path[:, 0]), np.interp(at, length, path[:, 1])], axis=1)
    return camera.to_picture(ground), under_way


def walked_seconds(since: F8, pauses: tuple[Point, ...]) -> F8:
    """How many of the seconds ``since`` the start of a walk were spent walking and not in its pauses."""
    spent = np.zeros_like(since)
    paused = 0.0
    for walked, pause in pauses:
        spent += np.clip(since - (walked + paused), 0, pause)
        paused += pause
    return since - spent


def rounded(corners: F8, times: int = 4) -> F8:
    """The polyline ``corners`` (n, 2) with its corners cut ``times`` times (Chaikin); its ends stay."""
    line = corners
    for _ in range(times):
        a, b = line[:-1], line[1:]
        cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, 2)
        line = np.concatenate([line[:1], cut, line[-1:]])
    return line
