"""Scenes with people: who comes when, from where, and walks where how fast, over a flat ground seen by a level camera.

Arrivals are a Poisson process in time. Each person takes an entrance and another one as exit, walks from one to the other
over a point between, pauses now and then, and has a speed and a stature of their own. Walks can also be written down
(`Scenario.walks`), for crossings that must happen. The truth is what lies in the frame, clipped to it, from the moment that
a given part of the figure is inside; occluded people stay in it, as annotators of benchmarks keep them.

Lengths on the ground are in body heights. With focal length f (pixels), camera height c (body heights), horizon row y₀ and
image centre x₀, a foot point at lateral X and depth Z is seen at

    x = x₀ + f X / Z        y = y₀ + f c / Z        and a figure there is   f / Z = (y − y₀) / c   pixels tall:

lower in the picture is larger, and straight walks on the ground are straight in the picture.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8, I8, SequenceInfo, Truth

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

    def boxes(self, foot: F8, stature: float, aspect: float) -> F8:
        """(n, 4) xyxy of figures standing at the pixels ``foot`` (n, 2); ``aspect`` is width over height."""
        tall = stature * ((foot[:, 1] - self.horizon) / self.height)
        half = aspect * tall / 2
        return np.stack([foot[:, 0] - half, foot[:, 1] - tall, foot[:, 0] + half, foot[:, 1]], axis=1)

    def row_below(self, bottom: float, stature: float) -> float:
        """The foot row, in pixels, of a figure whose head just touches the lower edge ``bottom`` of the picture."""
        return (bottom - stature * self.horizon / self.height) / (1 - stature / self.height)


@dataclass(frozen=True, slots=True)
class Walk:
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

    def follow(self, camera: Camera, size: Point, times: F8) -> tuple[F8, I8]:
        """The foot points at those of the given times at which the walk is under way.

        Parameters
        ----------
        camera : the camera that sees the ground.
        size : width and height of the frame, pixels.
        times : (T,) seconds.

        Returns
        -------
        foot : (n, 2) foot points, pixels.
        index : (n,) int64 which of the times they belong to.
        """
        corners = camera.to_ground(np.array(self.points) * np.array(size))
        path = rounded(corners) if len(corners) > 2 else corners
        length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
        gone = self.speed * walked_seconds(times - self.at, self.pauses)
        index = np.flatnonzero((times >= self.at) & (gone <= length[-1]))
        ground = np.stack([np.interp(gone[index], length, path[:, axis]) for axis in (0, 1)], axis=1)
        return camera.to_picture(ground), index


def walked_seconds(since: F8, pauses: tuple[Point, ...]) -> F8:
    """How many of the seconds ``since`` the start of a walk were spent walking and not in its pauses."""
    spent = np.zeros_like(since)
    paused = 0.0
    for walked, pause in pauses:
        spent += np.clip(since - (walked + paused), 0, pause)
        paused += pause
    return since - spent


def rounded(corners: F8) -> F8:
    """The polyline ``corners`` (n, 2) with its corners cut four times (Chaikin); its ends stay."""
    line = corners
    for _ in range(4):
        a, b = line[:-1], line[1:]
        cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, 2)
        line = np.concatenate([line[:1], cut, line[-1:]])
    return line


@dataclass(frozen=True, slots=True)
class Entrance:
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
    min_visible : part of a figure that must be in the frame for it to be in the truth.
    """

    name: str = "street"
    frames: int = 500
    fps: float = 25.0
    width: int = 640
    height: int = 360
    horizon: float = 0.12
    focal: float = 0.9
    camera_height: float = 2.7
    rows: Point = (0.52, 0.97)
    arrivals: float = 0.45
    lead_in: float = 1.0
    entrances: tuple[Entrance, ...] = (Entrance("left"), Entrance("right"))
    speed: float = 0.75
    speed_spread: float = 0.15
    aspect: float = 0.38
    stature_spread: float = 0.06
    pause_rate: float = 0.05
    pause_seconds: float = 2.0
    walks: tuple[Walk, ...] = ()
    obstacles: tuple[tuple[float, float, float, float], ...] = ()
    min_visible: float = 0.3

    def __post_init__(self) -> None:
        check_sequence(self.info)
        low = min((y for walk in self.walks for _, y in walk.points), default=1.0)
        expected = {
            f"0 or more arrivals per second, got {self.arrivals:g}": 0 <= self.arrivals < np.inf,
            f"a positive speed, got {self.speed:g} ± {self.speed_spread:g}": self.speed > 0 and self.speed_spread >= 0,
            f"rows below the horizon {self.horizon:g}, got {self.rows}": self.horizon < self.rows[0] <= self.rows[1],
            f"camera_height above the tallest head, 1.3, got {self.camera_height:g}": self.camera_height > 1.3,
            f"aspect and focal above 0, got {self.aspect:g} and {self.focal:g}": min(self.aspect, self.focal) > 0,
            f"min_visible in (0, 1], got {self.min_visible:g}": 0 < self.min_visible <= 1,
            "pause_rate and pause_seconds of 0 or more": min(self.pause_rate, self.pause_seconds) >= 0,
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
        fractions = np.array(self.obstacles, dtype=np.float64).reshape(-1, 4)
        pixels: F8 = fractions * np.array([self.width, self.height, self.width, self.height])
        return pixels

    @property
    def doors_px(self) -> F8:
        """(D, 4) xyxy of the doors, pixels: a quarter taller than the people, and half as wide as high."""
        feet = np.array([e.foot for e in self.entrances if e.side == "door"], dtype=np.float64).reshape(-1, 2)
        return self.camera.boxes(feet * np.array([self.width, self.height]), stature=1.25, aspect=0.5)

    def figures(self, rng: np.random.Generator) -> Truth:
        """All figures with any part in the frame, numbered in the order of their arrival; boxes not clipped."""
        walks = sorted((*self.walks, *self._arriving(rng)), key=lambda walk: walk.at)
        times = np.arange(self.frames) / self.fps
        parts = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 4)))]
        for walk in walks:
            foot, index = walk.follow(self.camera, (self.width, self.height), times)
            box = self.camera.boxes(foot, walk.stature, self.aspect)
            seen = visible(box, self.info) > 0
            if seen.any():
                parts.append((index[seen] + 1, np.full(int(seen.sum()), len(parts), np.int64), box[seen]))
        frame, identity, boxes = (np.concatenate(column) for column in zip(*parts, strict=True))
        return truth_rows(frame, identity, boxes)

    def truth(self, figures: Truth) -> Truth:
        """The figures of which ``min_visible`` is in the frame, boxes clipped to it."""
        kept = np.flatnonzero(visible(figures.xyxy, self.info) >= self.min_visible)
        return truth_rows(figures.frame[kept], figures.identity[kept], clip(figures.xyxy[kept], self.info))

    def _arriving(self, rng: np.random.Generator) -> list[Walk]:
        """The walks of the people who arrive by chance."""
        seconds = max(self.frames / self.fps - self.lead_in, 0)
        if not self.entrances or not self.arrivals:
            return []
        begins = self.lead_in + np.sort(rng.random(rng.poisson(self.arrivals * seconds))) * seconds
        return [self._draw_walk(float(at), person) for at, person in zip(begins, rng.spawn(len(begins)), strict=True)]

    def _draw_walk(self, at: float, rng: np.random.Generator) -> Walk:
        """One person's way, speed, stature and pauses; a stream each, so that one more arrival changes no other."""
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
        pauses = tuple((float(a), float(b)) for a, b in zip(np.cumsum(gaps), lengths, strict=True))
        return Walk((start, between, end), at, speed, stature, pauses)

    def _foot(self, entrance: Entrance, stature: float, rng: np.random.Generator) -> Point:
        """A foot point at an entrance at which the figure is just outside the frame, or in the door."""
        row, column = float(rng.uniform(*self.rows)), float(rng.uniform(0.2, 0.8))
        box = self.camera.boxes(np.array([[0.0, row * self.height]]), stature, self.aspect)
        half = float(box[0, 2]) / self.width
        match entrance.side:
            case "left":
                return -half, row
            case "right":
                return 1 + half, row
            case "bottom":
                return column, self.camera.row_below(self.height, stature) / self.height
            case "door":
                return entrance.foot


def check_sequence(info: SequenceInfo) -> None:
    """Raise `InputError` where a simulated sequence would have no frames, no rate or hardly any pixels."""
    expected = {
        f"1 frame or more, got {info.frames}": info.frames >= 1,
        f"a positive fps, got {info.fps:g}": info.fps > 0,
        f"at least 16x16 pixels, got {info.width}x{info.height}": min(info.width, info.height) >= 16,
    }
    for what, met in expected.items():
        if not met:
            raise InputError(f"expected {what}", where=f"scenario {info.name}", cure="Change this setting of the scene")


def truth_rows(frame: I8, identity: I8, xyxy: F8) -> Truth:
    """A `Truth` of the rows (M,), (M,), (M, 4), sorted by frame, then identity, in which every row counts."""
    order = np.lexsort((identity, frame))
    return Truth(frame[order], identity[order], xyxy[order], np.zeros(len(frame), np.bool_))


def visible(xyxy: F8, info: SequenceInfo) -> F8:
    """(n,) part of each box's area that lies in the frame."""
    inside = clip(xyxy, info)
    width, height = xyxy[:, 2] - xyxy[:, 0], xyxy[:, 3] - xyxy[:, 1]
    return (inside[:, 2] - inside[:, 0]) * (inside[:, 3] - inside[:, 1]) / (width * height)


def clip(xyxy: F8, info: SequenceInfo) -> F8:
    """(n, 4) the boxes cut at the frame's borders."""
    return np.clip(xyxy, 0, np.array([info.width, info.height, info.width, info.height], dtype=np.float64))
