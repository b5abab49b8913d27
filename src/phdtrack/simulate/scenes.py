"""Scenes by name, with truth and simulated detections of people who walk over flat ground, seen by
a level camera.

Arrivals are a Poisson process in time. Each person walks from one entrance to another via a point
in between, pauses now and then, and has a speed and a stature. `Scenario.walks` adds given walks.
The truth has the boxes in the frame, clipped to it; occluded people stay in it, as in benchmarks.

Lengths on the ground are in body heights. With focal length f (pixels), camera height c (body
heights), horizon row y₀ and image centre x₀, a foot point at lateral X and depth Z appears at

    x = x₀ + f X / Z        y = y₀ + f c / Z

and a figure there is f / Z = (y − y₀) / c pixels tall.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from phdtrack.arrays import share_inside
from phdtrack.errors import (
    Checked,
    Count,
    InputError,
    NonNegative,
    Positive,
    PositiveCount,
    Probability,
    did_you_mean,
)
from phdtrack.simulate.detector import DetectorModel, detect
from phdtrack.types import F8, I8, DetectionTable, SequenceInfo, Truth

Point = tuple[float, float]
# Share of a figure that must be in the frame for it to be in the truth.
_MIN_VISIBLE = 0.3


class LevelCamera(NamedTuple):
    """A camera with a horizontal axis: ``horizon``, ``centre`` and ``focal`` in pixels, ``height``
    above the ground in body heights.
    """

    centre: float
    horizon: float
    focal: float
    height: float

    def to_ground(self, xy: F8) -> F8:
        """(n, 2) lateral and depth of the foot points ``xy`` (n, 2) in pixels, which must lie below
        the horizon.
        """
        depth = self.focal * self.height / (xy[:, 1] - self.horizon)
        return np.stack([(xy[:, 0] - self.centre) * depth / self.focal, depth], axis=1)

    def to_image(self, ground: F8) -> F8:
        """(n, 2) pixels of the ground points (n, 2)."""
        x = self.centre + self.focal * ground[:, 0] / ground[:, 1]
        return np.stack([x, self.horizon + self.focal * self.height / ground[:, 1]], axis=1)


def _standing(camera: LevelCamera, foot: F8, stature: float, aspect: float) -> F8:
    """(n, 4) xyxy of figures with their feet at the pixels ``foot`` (n, 2); ``stature`` is the
    relative height, ``aspect`` width over height.
    """
    tall = stature * ((foot[:, 1] - camera.horizon) / camera.height)
    half = aspect * tall / 2
    return np.stack([foot[:, 0] - half, foot[:, 1] - tall, foot[:, 0] + half, foot[:, 1]], axis=1)


class Walk(NamedTuple):
    """The path of one person.

    Attributes
    ----------
    points : two or more foot points (x, y) as fractions of the frame's width and height; corners
        are rounded.
    at : second at which the walk begins; may be before the first frame.
    speed : body heights per second on the ground.
    stature : height relative to that of the scene.
    pauses : pairs (seconds walked until the pause, its length in seconds), ascending.
    """

    points: tuple[Point, ...]
    at: float = 0.0
    speed: float = 0.75
    stature: float = 1.0
    pauses: tuple[Point, ...] = ()


def _foot_points(walk: Walk, camera: LevelCamera, size: Point, times: F8) -> tuple[F8, I8]:
    """Foot points (n, 2) in pixels at the ``times`` (T,) during the walk, and the indices (n,) of
    these times.
    """
    line = camera.to_ground(np.array(walk.points) * np.array(size))
    # Chaikin's corner cutting, which keeps the ends.
    for _ in range(4 if len(line) > 2 else 0):
        a = line[:-1]
        b = line[1:]
        cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, 2)
        line = np.concatenate([line[:1], cut, line[-1:]])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    since = times - walk.at
    pauses_before = 0.0
    paused = np.zeros_like(since)
    for walked, pause in walk.pauses:
        paused += np.clip(since - (walked + pauses_before), 0, pause)
        pauses_before += pause
    distance = walk.speed * (since - paused)
    index = np.flatnonzero((times >= walk.at) & (distance <= length[-1]))
    distance = distance[index]
    ground = np.stack([np.interp(distance, length, line[:, axis]) for axis in (0, 1)], axis=1)
    return camera.to_image(ground), index


class Entrance(NamedTuple):
    """A border of the frame where people come and go, or a door at ``foot`` (x, y in fractions of
    the frame).

    Attributes
    ----------
    side : a border, or a door.
    foot : where the feet of those who come through a door are.
    weight : how often it is chosen, relative to the other entrances.
    """

    side: Literal["left", "right", "bottom", "door"]
    foot: Point = (0.5, 0.5)
    weight: float = 1.0


@dataclass(frozen=True, slots=True)
class Scenario(Checked):
    """Settings of a scene with people; lengths in the image are fractions of the frame's width or
    height.

    Attributes
    ----------
    name, frames, fps, width, height : of the sequence; width and height in pixels.
    horizon, focal, camera_height : row of the horizon, focal length in frame widths, height in body
        heights (`LevelCamera`).
    rows : foot rows (top, bottom) between which people walk.
    arrivals : people per second from second ``lead_in`` on, which may be negative: then some people
        are in the first frame.
    entrances : origins and destinations of the arriving people.
    speed, speed_spread : mean and standard deviation over people, in body heights per second.
    aspect, stature_spread : width over height of a figure; standard deviation of its relative
        height.
    pause_rate, pause_seconds : pauses per second of walking and their mean length.
    walks : walks in addition to the arrivals.
    obstacles : standing obstacles (left, top, right, bottom) that hide people behind them.
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
        Checked.__post_init__(self)
        low = min((y for walk in self.walks for _, y in walk.points), default=1.0)
        requirements = {
            f"at least 16x16 pixels, got {self.width}x{self.height}": (
                min(self.width, self.height) >= 16
            ),
            f"rows below the horizon {self.horizon:g}, got {self.rows}": (
                self.horizon < self.rows[0] <= self.rows[1]
            ),
            f"camera_height above the tallest head, 1.3, got {self.camera_height:g}": (
                self.camera_height > 1.3
            ),
            "walks with two points or more and a positive speed": all(
                len(w.points) > 1 and w.speed > 0 for w in self.walks
            ),
            f"walks below the horizon {self.horizon:g}, got a foot at {low:g}": low > self.horizon,
        }
        for requirement, is_met in requirements.items():
            if not is_met:
                raise InputError(
                    f"expected {requirement}",
                    where=f"scenario {self.name}",
                    cure="Change this setting of the scene",
                )

    @property
    def info(self) -> SequenceInfo:
        """Size, rate, number of frames and name of the sequence."""
        return SequenceInfo(self.width, self.height, self.fps, self.frames, self.name)

    @property
    def camera(self) -> LevelCamera:
        """The camera, in pixels."""
        return LevelCamera(
            self.width / 2, self.horizon * self.height, self.focal * self.width, self.camera_height
        )

    @property
    def obstacles_px(self) -> F8:
        """(K, 4) xyxy of the obstacles, pixels."""
        return np.asarray(
            np.array(self.obstacles, np.float64).reshape(-1, 4)
            * np.tile([self.width, self.height], 2)
        )

    @property
    def doors_px(self) -> F8:
        """(D, 4) xyxy of the doors, pixels: a quarter taller than the people, and half as wide as
        high.
        """
        doors = [entrance.foot for entrance in self.entrances if entrance.side == "door"]
        feet = np.array(doors, np.float64).reshape(-1, 2) * np.array([self.width, self.height])
        return _standing(self.camera, feet, stature=1.25, aspect=0.5)

    def figures(self, rng: np.random.Generator) -> Truth:
        """All figures that are at least partly in the frame, numbered in the order of their
        arrival; boxes are not clipped.

        Parameters
        ----------
        rng : of all draws.
        """
        walks = sorted((*self.walks, *self._arriving(rng)), key=lambda walk: walk.at)
        times = np.arange(self.frames) / self.fps
        parts = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 4)))]
        for walk in walks:
            foot, index = _foot_points(walk, self.camera, (self.width, self.height), times)
            box = _standing(self.camera, foot, walk.stature, self.aspect)
            visible = share_inside(box, self.width, self.height) > 0
            if visible.any():
                identity = np.full(int(visible.sum()), len(parts), np.int64)
                parts.append((index[visible] + 1, identity, box[visible]))
        return truth_rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def truth(self, figures: Truth) -> Truth:
        """The figures that are sufficiently inside the frame, with boxes clipped to it.

        Parameters
        ----------
        figures : of the frames, boxes in pixels.
        """
        kept = np.flatnonzero(share_inside(figures.xyxy, self.width, self.height) >= _MIN_VISIBLE)
        inside = np.clip(figures.xyxy[kept], 0.0, np.tile([self.width, self.height], 2))
        return truth_rows(figures.frame[kept], figures.identity[kept], inside)

    def _arriving(self, rng: np.random.Generator) -> list[Walk]:
        """The walks of the arriving people. Each has its own random stream, so that one more
        arrival changes no other.
        """
        seconds = max(self.frames / self.fps - self.lead_in, 0)
        if not self.entrances or not self.arrivals:
            return []
        begins = self.lead_in + np.sort(rng.random(rng.poisson(self.arrivals * seconds))) * seconds
        return [
            self._draw_walk(float(at), person)
            for at, person in zip(begins, rng.spawn(len(begins)), strict=True)
        ]

    def _draw_walk(self, at: float, rng: np.random.Generator) -> Walk:
        """The path, speed, stature and pauses of one person."""
        stature = float(np.clip(rng.normal(1, self.stature_spread), 0.7, 1.3))
        speed = float(max(rng.normal(self.speed, self.speed_spread), 0.3 * self.speed))
        weight = np.array([e.weight for e in self.entrances])
        first = int(rng.choice(len(weight), p=weight / weight.sum()))
        others = weight * (np.arange(len(weight)) != first)
        last = first
        if others.any():
            last = int(rng.choice(len(weight), p=others / others.sum()))
        start = self._foot(self.entrances[first], stature, rng)
        end = self._foot(self.entrances[last], stature, rng)
        between = (float(rng.uniform(0.2, 0.8)), float(rng.uniform(*self.rows)))
        gaps = np.zeros(0)
        if self.pause_rate:
            gaps = rng.exponential(1 / self.pause_rate, size=8)
        lengths = rng.exponential(self.pause_seconds, size=len(gaps))
        pauses = tuple(zip(np.cumsum(gaps).tolist(), lengths.tolist(), strict=True))
        return Walk((start, between, end), at, speed, stature, pauses)

    def _foot(self, entrance: Entrance, stature: float, rng: np.random.Generator) -> Point:
        """A foot point at an entrance: the figure is just outside the frame, or in the door."""
        row = float(rng.uniform(*self.rows))
        column = float(rng.uniform(0.2, 0.8))
        box = _standing(self.camera, np.array([[0.0, row * self.height]]), stature, self.aspect)
        half = float(box[0, 2]) / self.width
        match entrance.side:
            case "left":
                return -half, row
            case "right":
                return 1 + half, row
            case "bottom":
                # The head just touches the lower edge of the image.
                row = self.height - stature * self.camera.horizon / self.camera_height
                return column, row / (1 - stature / self.camera_height) / self.height
            case "door":
                return entrance.foot


def truth_rows(frame: I8, identity: I8, xyxy: F8) -> Truth:
    """A `Truth` without distractors, sorted by frame, then identity.

    Parameters
    ----------
    frame, identity : (M,).
    xyxy : (M, 4) pixels.
    """
    order = np.lexsort((identity, frame))
    return Truth(frame[order], identity[order], xyxy[order], np.zeros(len(frame), np.bool_))


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A simulated sequence.

    Attributes
    ----------
    info : size, rate, number of frames and name.
    truth : the annotated boxes, clipped to the frame.
    figures : the figures to render: all that are at least partly in the frame, boxes not clipped.
    detections : M simulated detections of the truth, with clutter.
    source : (M,) int64 origin of each, as in `Detected`.
    places : (P, 4) xyxy of the places with persistent clutter, at which the renderer draws waving
        plants.
    obstacles : (K, 4) xyxy of standing obstacles that hide people behind them, pixels.
    doors : (D, 4) xyxy of the doors in which figures appear or vanish, pixels.
    """

    info: SequenceInfo
    truth: Truth
    figures: Truth
    detections: DetectionTable
    source: I8
    places: F8
    obstacles: F8
    doors: F8


@dataclass(frozen=True, slots=True)
class Look(Checked):
    """The appearance of the video, and how hard change detection is in it.

    Attributes
    ----------
    noise : standard deviation of the camera's noise, grey levels.
    flicker : relative standard deviation of the brightness of the whole image.
    plants : number of waving plants in a scene without persistent places; otherwise there is one
        at each place.
    wave : displacement of the top of a plant in an average gust, in plant heights.
    lamps : number of blinking lights and shimmering reflections.
    shadow : darkness of the shadows, 0 to 1.
    blown : leaves that the wind blows past the camera, expected number per frame; each is in one
        frame only.
    """

    noise: NonNegative = 2.0
    flicker: NonNegative = 0.03
    plants: Count = 4
    wave: NonNegative = 0.09
    lamps: Count = 3
    shadow: Probability = 0.35
    blown: NonNegative = 0.0


_PAIRS = (
    Walk(((-0.1, 0.70), (1.1, 0.76)), at=0.5),
    Walk(((1.1, 0.74), (-0.1, 0.70)), at=0.5, stature=0.95),
    Walk(((-0.1, 0.90), (1.1, 0.85)), at=4.0, stature=1.05),
    Walk(((1.1, 0.80), (-0.1, 0.86)), at=4.0),
    Walk(((-0.1, 0.60), (1.1, 0.62)), at=8.0, stature=0.95),
    Walk(((1.1, 0.62), (-0.1, 0.62)), at=8.0, stature=1.05),
)
_BEHIND = (
    Walk(((-0.1, 0.66), (1.1, 0.66)), at=0.5),
    Walk(((1.1, 0.72), (-0.1, 0.72)), at=2.5, speed=0.65),
    Walk(((-0.1, 0.62), (1.1, 0.62)), at=5.0, speed=0.9),
    Walk(((1.1, 0.68), (-0.1, 0.68)), at=8.0, speed=0.8),
    Walk(((-0.1, 0.93), (1.1, 0.93)), at=9.0, speed=0.7),
    Walk(((-0.1, 0.70), (1.1, 0.70)), at=12.0),
)

STREET = Scenario()
"""People cross a street in both directions and pause now and then."""
CROSSING = Scenario("crossing", frames=450, arrivals=0.0, walks=_PAIRS)
"""Three pairs of people who walk towards each other and pass closely, at three distances from the
camera.
"""
OCCLUSION = Scenario(
    "occlusion",
    frames=500,
    arrivals=0.0,
    walks=_BEHIND,
    obstacles=((0.28, 0.25, 0.35, 0.84), (0.60, 0.38, 0.72, 0.80)),
)
"""Six people who pass behind a column and a kiosk, and one of them in front."""
CROWD = Scenario(
    "crowd",
    arrivals=1.8,
    lead_in=-15.0,
    speed_spread=0.2,
    rows=(0.48, 0.97),
    entrances=(*STREET.entrances, Entrance("bottom", weight=0.5)),
)
"""A dozen or more people at a time."""
CORRIDOR = Scenario(
    "corridor",
    frames=750,
    width=384,
    height=288,
    horizon=0.02,
    focal=1.1,
    camera_height=2.2,
    rows=(0.45, 0.95),
    arrivals=0.4,
    lead_in=0.5,
    entrances=(
        Entrance("door", (0.55, 0.30)),
        Entrance("door", (0.17, 0.52)),
        Entrance("bottom"),
        Entrance("right"),
    ),
    pause_rate=0.15,
    pause_seconds=2.5,
)
"""The corridor of a shopping centre seen along its length, with the door of a shop, at CAVIAR's
image size and frame rate.
"""
_WATCHED = Scenario(
    "yard", frames=1000, width=384, height=288, rows=(0.55, 0.95), arrivals=0.3, lead_in=-10.0
)
YARD = replace(
    _WATCHED, entrances=(Entrance("left"), Entrance("right"), Entrance("door", (0.3, 0.53), 1.5))
)
"""A road in front of a house with a door, trees and blinking lights: a scene to learn, at CAVIAR's
image size.
"""
GARDEN = replace(_WATCHED, name="garden", arrivals=0.12)
"""Few people among a dozen trees in a strong wind: most detections are false, and always in the
same places.
"""
_COLUMNS = tuple((left, 0.3, left + 0.06, 0.86) for left in (0.15, 0.45, 0.75))
ARCADE = replace(_WATCHED, name="arcade", rows=(0.56, 0.82), arrivals=0.25, obstacles=_COLUMNS)
"""All people pass behind three columns, next to which tracks begin again."""
EMPTY = Scenario("empty", frames=300, arrivals=0.0)
"""No people: every detection is false."""

NAMED = MappingProxyType(
    {w.name: w for w in (STREET, CROSSING, OCCLUSION, CROWD, CORRIDOR, YARD, GARDEN, ARCADE, EMPTY)}
)
"""All scenes by name."""
# Scenes with other than the default number of places with persistent false alarms, at which plants
# grow, or with another appearance.
_PLACES = {"yard": 3, "garden": 12, "arcade": 3}
_LOOKS = {
    "yard": Look(wave=0.12),
    "garden": Look(wave=0.30, lamps=10),
    "arcade": Look(wave=0.12, lamps=4),
}


def make_scene(
    world: str | Scenario, seed: int, detector: DetectorModel | None = None, **settings: Any
) -> Scene:
    """Simulate the scene of this name or with these settings; its truth does not depend on
    ``detector``. Raises `InputError` for an unknown name or setting, or an impossible value.

    Parameters
    ----------
    world : one of `NAMED`, or your own settings.
    seed : seed of all random draws.
    detector : None for `default_detector`, which misses occluded people.
    **settings : replace settings of the scene, for example ``frames=100``.

    Returns
    -------
    The scene: truth, detections, and what a video of it needs.
    """
    if isinstance(world, str):
        if world not in NAMED:
            raise InputError(f"no scene is called {world!r}", cure=did_you_mean(world, NAMED))
        world = NAMED[world]
    names = [field.name for field in fields(world)]
    for key in settings:
        if key not in names:
            raise InputError(
                f"scene {world.name} has no setting {key!r}", cure=did_you_mean(key, names)
            )
    detector = detector or default_detector(world)
    world = replace(world, **settings)
    world_rng, detector_rng = np.random.default_rng(seed).spawn(2)
    figures = world.figures(world_rng)
    truth = world.truth(figures)
    detected = detect(truth, world.info, detector_rng, detector, obstacles=world.obstacles_px)
    return Scene(
        world.info,
        truth,
        figures,
        detected.table,
        detected.source,
        detected.places,
        world.obstacles_px,
        world.doors_px,
    )


def default_detector(world: Scenario) -> DetectorModel:
    """The detector of a scene unless another one is given.

    Parameters
    ----------
    world : the scene.

    Returns
    -------
    One that misses occluded people.
    """
    return DetectorModel(occlusion=2.0, places=_PLACES.get(world.name, 5))


def default_look(name: str) -> Look:
    """The appearance of the scene ``name`` unless another one is given.

    Parameters
    ----------
    name : one of `NAMED`.

    Returns
    -------
    The appearance.
    """
    return _LOOKS.get(name, Look())
