"""Scenes with people: who comes when, from where, and walks where how fast, over a flat ground seen by a level camera.

Arrivals are a Poisson process in time. Each person walks from an entrance to another one over a point between, pauses now
and then, and has a speed and a stature. `Scenario.walks` adds given walks. The truth is what lies in the frame, clipped
to it; occluded people stay in it, as annotators of benchmarks keep them.

Lengths on the ground are in body heights. With focal length f (pixels), camera height c (body heights), horizon row y₀ and
image centre x₀, a foot point at lateral X and depth Z is seen at

    x = x₀ + f X / Z        y = y₀ + f c / Z        and a figure there is   f / Z = (y − y₀) / c   pixels tall.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from phdtrack.arrays import share_inside
from phdtrack.errors import InputError, NonNegative, Positive, PositiveCount, check
from phdtrack.types import F8, I8, SequenceInfo, Truth

Point = tuple[float, float]
# Part of a figure that must be in the frame for it to be in the truth.
_MIN_VISIBLE = 0.3


class Camera(NamedTuple):
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


def _standing(camera: Camera, foot: F8, stature: float, aspect: float) -> F8:
    """(n, 4) xyxy of figures that stand at the pixels ``foot`` (n, 2); their relative height, width over height."""
    tall = stature * ((foot[:, 1] - camera.horizon) / camera.height)
    half = aspect * tall / 2
    return np.stack([foot[:, 0] - half, foot[:, 1] - tall, foot[:, 0] + half, foot[:, 1]], axis=1)


class Walk(NamedTuple):
    """One person's way.

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


def _followed(walk: Walk, camera: Camera, size: Point, times: F8) -> tuple[F8, I8]:
    """Foot points (n, 2) in pixels at those ``times`` (T,) at which the walk is under way, and which (n,) these are."""
    line = camera.to_ground(np.array(walk.points) * np.array(size))
    for _ in range(4 if len(line) > 2 else 0):  # the corners are cut (Chaikin), the ends stay
        a, b = line[:-1], line[1:]
        cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, 2)
        line = np.concatenate([line[:1], cut, line[-1:]])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    since, paused = times - walk.at, 0.0
    spent = np.zeros_like(since)
    for walked, pause in walk.pauses:
        spent += np.clip(since - (walked + paused), 0, pause)
        paused += pause
    gone = walk.speed * (since - spent)
    index = np.flatnonzero((times >= walk.at) & (gone <= length[-1]))
    ground = np.stack([np.interp(gone[index], length, line[:, axis]) for axis in (0, 1)], axis=1)
    return camera.to_picture(ground), index


class Entrance(NamedTuple):
    """Where people come and go: a border of the frame, or a door at ``foot`` (x, y in fractions of the frame)."""

    side: Literal["left", "right", "bottom", "door"]
    foot: Point = (0.5, 0.5)
    weight: float = 1.0


@dataclass(frozen=True, slots=True)
class Scenario:
    """Settings of a scene with people; lengths in the picture are fractions of the frame's width or height.

    Attributes
    ----------
    name, frames, fps, width, height : of the sequence; width and height in pixels.
    horizon, focal, camera_height : row of the horizon, focal length in frame widths, height in body heights (`Camera`).
    rows : foot rows (top, bottom) between which people walk.
    arrivals : people per second; they begin at second ``lead_in``, which may be negative: then some are there at once.
    entrances : where the arriving come from and go to.
    speed, speed_spread : mean and standard deviation over people, in body heights per second.
    aspect, stature_spread : width over height of a figure; standard deviation of its relative height.
    pause_rate, pause_seconds : pauses per second of walking and their mean length.
    walks : walks in addition to the arrivals.
    obstacles : standing things (left, top, right, bottom) that hide what is behind them.
    """

    name: str = "street"
    frames: PositiveCount = 500
    fps: Positive = 25.0
    width: int = 640
    height: int = 360
    horizon: float = 0.12
    focal: Positive = 0.9
    camera_height: float = 2.7
    rows: Point = (0.52, 0.97)
    arrivals: NonNegative = 0.45
    lead_in: float = 1.0
    entrances: tuple[Entrance, ...] = (Entrance("left"), Entrance("right"))
    speed: Positive = 0.75
    speed_spread: NonNegative = 0.15
    aspect: Positive = 0.38
    stature_spread: float = 0.06
    pause_rate: NonNegative = 0.05
    pause_seconds: NonNegative = 2.0
    walks: tuple[Walk, ...] = ()
    obstacles: tuple[tuple[float, float, float, float], ...] = ()

    def __post_init__(self) -> None:
        check(self)
        low = min((y for walk in self.walks for _, y in walk.points), default=1.0)
        expected = {
            f"at least 16x16 pixels, got {self.width}x{self.height}": min(self.width, self.height) >= 16,
            f"rows below the horizon {self.horizon:g}, got {self.rows}": self.horizon < self.rows[0] <= self.rows[1],
            f"camera_height above the tallest head, 1.3, got {self.camera_height:g}": self.camera_height > 1.3,
            "walks with two points or more and a positive speed": all(len(w.points) > 1 and w.speed > 0 for w in self.walks),
            f"walks below the horizon {self.horizon:g}, got a foot at {low:g}": low > self.horizon,
        }
        for what, met in expected.items():
            if not met:
                raise InputError(f"expected {what}", where=f"scenario {self.name}", cure="Change this setting of the scene")

    @property
    def info(self) -> SequenceInfo:
        """Size, rate, number of frames and name of the sequence."""
        return SequenceInfo(self.width, self.height, self.fps, self.frames, self.name)

    @property
    def camera(self) -> Camera:
        """The camera, in pixels."""
        return Camera(self.width / 2, self.horizon * self.height, self.focal * self.width, self.camera_height)

    @property
    def obstacles_px(self) -> F8:
        """(K, 4) xyxy of the obstacles, pixels."""
        pixels: F8 = np.array(self.obstacles, np.float64).reshape(-1, 4) * np.tile([self.width, self.height], 2)
        return pixels

    @property
    def doors_px(self) -> F8:
        """(D, 4) xyxy of the doors, pixels: a quarter taller than the people, and half as wide as high."""
        feet = np.array([e.foot for e in self.entrances if e.side == "door"], dtype=np.float64).reshape(-1, 2)
        return _standing(self.camera, feet * np.array([self.width, self.height]), stature=1.25, aspect=0.5)

    def figures(self, rng: np.random.Generator) -> Truth:
        """All figures with any part in the frame, numbered in the order of their arrival; boxes not clipped."""
        walks = sorted((*self.walks, *self._arriving(rng)), key=lambda walk: walk.at)
        times = np.arange(self.frames) / self.fps
        parts = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 4)))]
        for walk in walks:
            foot, index = _followed(walk, self.camera, (self.width, self.height), times)
            box = _standing(self.camera, foot, walk.stature, self.aspect)
            seen = share_inside(box, self.width, self.height) > 0
            if seen.any():
                parts.append((index[seen] + 1, np.full(int(seen.sum()), len(parts), np.int64), box[seen]))
        frame, identity, boxes = (np.concatenate(column) for column in zip(*parts, strict=True))
        return truth_rows(frame, identity, boxes)

    def truth(self, figures: Truth) -> Truth:
        """The figures of which enough is in the frame, boxes clipped to it."""
        kept = np.flatnonzero(share_inside(figures.xyxy, self.width, self.height) >= _MIN_VISIBLE)
        inside = np.clip(figures.xyxy[kept], 0.0, np.tile([self.width, self.height], 2))
        return truth_rows(figures.frame[kept], figures.identity[kept], inside)

    def _arriving(self, rng: np.random.Generator) -> list[Walk]:
        """The walks of the people who arrive by chance; a random stream each, so that one more arrival changes no other."""
        seconds = max(self.frames / self.fps - self.lead_in, 0)
        if not self.entrances or not self.arrivals:
            return []
        begins = self.lead_in + np.sort(rng.random(rng.poisson(self.arrivals * seconds))) * seconds
        return [self._draw_walk(float(at), person) for at, person in zip(begins, rng.spawn(len(begins)), strict=True)]

    def _draw_walk(self, at: float, rng: np.random.Generator) -> Walk:
        """The way, speed, stature and pauses of one person."""
        stature = float(np.clip(rng.normal(1, self.stature_spread), 0.7, 1.3))
        speed = float(max(rng.normal(self.speed, self.speed_spread), 0.3 * self.speed))
        weight = np.array([e.weight for e in self.entrances])
        first = int(rng.choice(len(weight), p=weight / weight.sum()))
        others = weight * (np.arange(len(weight)) != first)
        last = int(rng.choice(len(weight), p=others / others.sum())) if others.any() else first
        start, end = (self._foot(self.entrances[i], stature, rng) for i in (first, last))
        between = (float(rng.uniform(0.2, 0.8)), float(rng.uniform(*self.rows)))
        gaps = rng.exponential(1 / self.pause_rate, size=8) if self.pause_rate else np.zeros(0)
        lengths = rng.exponential(self.pause_seconds, size=len(gaps))
        pauses = tuple(zip(np.cumsum(gaps).tolist(), lengths.tolist(), strict=True))
        return Walk((start, between, end), at, speed, stature, pauses)

    def _foot(self, entrance: Entrance, stature: float, rng: np.random.Generator) -> Point:
        """A foot point at an entrance at which the figure is just outside the frame, or in the door."""
        row, column = float(rng.uniform(*self.rows)), float(rng.uniform(0.2, 0.8))
        box = _standing(self.camera, np.array([[0.0, row * self.height]]), stature, self.aspect)
        half = float(box[0, 2]) / self.width
        match entrance.side:
            case "left":
                return -half, row
            case "right":
                return 1 + half, row
            case "bottom":  # the head just touches the lower edge of the picture
                row = self.height - stature * self.camera.horizon / self.camera_height
                return column, row / (1 - stature / self.camera_height) / self.height
            case "door":
                return entrance.foot


def truth_rows(frame: I8, identity: I8, xyxy: F8) -> Truth:
    """A `Truth` of rows of which all count.

    Parameters
    ----------
    frame, identity : (M,).
    xyxy : (M, 4) pixels.

    Returns
    -------
    The rows, sorted by frame, then identity.
    """
    order = np.lexsort((identity, frame))
    return Truth(frame[order], identity[order], xyxy[order], np.zeros(len(frame), np.bool_))
