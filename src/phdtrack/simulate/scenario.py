"""Scenes with people: who comes when, from where, and walks where how fast.

Arrivals are a Poisson process in time. Each takes an entrance and another one as exit, walks from one to the other over
a point between, stops now and then, and has a speed and a stature of its own. Walks can also be written down
(`Scenario.walks`), for crossings that must happen. The truth is what lies in the frame, clipped to it, from the moment
that a given part of the figure is inside; occluded figures stay in it, as annotators of benchmarks keep them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from phdtrack.errors import InputError
from phdtrack.simulate.ground import Camera, Point, Walk, follow
from phdtrack.simulate.records import rows
from phdtrack.types import F8, I8, SequenceInfo, Truth

Side = Literal["left", "right", "bottom", "door"]


@dataclass(frozen=True, slots=True)
class Entrance:
    """Where figures come and go: a border of the frame, or a door at ``foot`` (x, y in fractions of the frame)."""

    side: Side
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
    walks : walks beside the arrivals.
    obstacles : standing things (left, top, right, bottom) that hide who is behind them.
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
        for problem, cure in _problems(self):
            raise InputError(problem, where=f"scenario {self.name}", cure=cure)

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
        """(D, 4) xyxy of the doors, pixels: a quarter taller than those who come through them, and half as wide as high."""
        feet = np.array([e.foot for e in self.entrances if e.side == "door"], dtype=np.float64).reshape(-1, 2)
        return self.camera.boxes(feet * np.array([self.width, self.height]), stature=1.25, aspect=0.5)

    def figures(self, rng: np.random.Generator) -> Truth:
        """All figures with any part in the frame, numbered in the order of their arrival; boxes not clipped."""
        walks = sorted((*self.walks, *self._arriving(rng)), key=lambda walk: walk.at)
        times = np.arange(self.frames) / self.fps
        frame: list[I8] = [np.zeros(0, np.int64)]
        identity: list[I8] = [np.zeros(0, np.int64)]
        boxes: list[F8] = [np.zeros((0, 4))]
        known = 0
        for walk in walks:
            foot, index = follow(walk, self.camera, (self.width, self.height), times)
            box = self.camera.boxes(foot, walk.stature, self.aspect)
            seen = visible(box, self.info) > 0
            if seen.any():
                known += 1
                frame.append(index[seen] + 1)
                identity.append(np.full(int(seen.sum()), known, np.int64))
                boxes.append(box[seen])
        return rows(np.concatenate(frame), np.concatenate(identity), np.concatenate(boxes))

    def truth(self, figures: Truth) -> Truth:
        """The figures of which ``min_visible`` is in the frame, boxes clipped to it."""
        kept = np.flatnonzero(visible(figures.xyxy, self.info) >= self.min_visible)
        return rows(figures.frame[kept], figures.identity[kept], clip(figures.xyxy[kept], self.info))

    def _arriving(self, rng: np.random.Generator) -> list[Walk]:
        """The walks of those who arrive by chance."""
        seconds = max(self.frames / self.fps - self.lead_in, 0)
        if not self.entrances or not self.arrivals:
            return []
        begins = self.lead_in + np.sort(rng.random(rng.poisson(self.arrivals * seconds))) * seconds
        return [self._draw_walk(float(at), person) for at, person in zip(begins, rng.spawn(len(begins)), strict=True)]

    def _draw_walk(self, at: float, rng: np.random.Generator) -> Walk:
        """One person's way, speed, stature and pauses. A stream per person: one more arrival changes nobody else."""
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


def visible(xyxy: F8, info: SequenceInfo) -> F8:
    """(n,) part of each box's area that lies in the frame."""
    inside = clip(xyxy, info)
    width, height = xyxy[:, 2] - xyxy[:, 0], xyxy[:, 3] - xyxy[:, 1]
    return (inside[:, 2] - inside[:, 0]) * (inside[:, 3] - inside[:, 1]) / (width * height)


def clip(xyxy: F8, info: SequenceInfo) -> F8:
    """(n, 4) the boxes cut at the frame's borders."""
    edge = np.array([info.width, info.height, info.width, info.height], dtype=np.float64)
    return np.clip(xyxy, 0, edge)


def _problems(s: Scenario) -> list[tuple[str, str]]:
    """What is impossible about the settings: pairs of problem and cure."""
    below = [y > s.horizon for walk in s.walks for _, y in walk.points]
    checks = [
        (s.frames >= 1, f"frames must be at least 1, not {s.frames}", "Ask for one frame or more"),
        (
            min(s.width, s.height) >= 16,
            f"the frame must be 16 pixels wide and high, not {s.width}x{s.height}",
            "Make it larger",
        ),
        (s.fps > 0, f"fps must be positive, not {s.fps:g}", "25 is usual"),
        (0 <= s.arrivals < np.inf, f"arrivals must be 0 or more, not {s.arrivals:g}", "0 gives a scene without arrivals"),
        (
            s.speed > 0 and s.speed_spread >= 0,
            f"speed {s.speed:g} must be positive, its spread not negative",
            "People walk at 0.75",
        ),
        (s.horizon < s.rows[0] <= s.rows[1], f"rows {s.rows} must lie below the horizon {s.horizon:g}", "Lower the rows"),
        (
            s.camera_height > 1.3,
            f"camera_height must exceed the tallest head, 1.3, not {s.camera_height:g}",
            "Raise the camera",
        ),
        (
            s.aspect > 0 and s.focal > 0,
            f"aspect and focal must be positive, not {s.aspect:g} and {s.focal:g}",
            "0.4 and 0.9 are usual",
        ),
        (0 < s.min_visible <= 1, f"min_visible must be in (0, 1], not {s.min_visible:g}", "0.3 is usual"),
        (min(s.pause_rate, s.pause_seconds) >= 0, "pause_rate and pause_seconds must not be negative", "0 means no pauses"),
        (
            all(len(w.points) > 1 and w.speed > 0 for w in s.walks),
            "a walk needs two points and a positive speed",
            "Add what lacks",
        ),
        (all(below), f"walks must stay below the horizon {s.horizon:g}", "Lower their points"),
    ]
    return [(problem, cure) for fine, problem, cure in checks if not fine]
