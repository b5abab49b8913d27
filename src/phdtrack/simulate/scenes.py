"""Scenes by name, with truth and simulated detections of people who walk over flat ground, seen by
a level camera.

Arrivals are a Poisson process in time. Each person walks from an entrance to another one over a
point between, pauses now and then, and has a speed and a stature. `Scenario.walks` adds given
walks. The truth is what lies in the frame, clipped to it; occluded people stay in it, as annotators
of benchmarks keep them.

Lengths on the ground are in body heights. With focal length f (pixels), camera height c (body
heights), horizon row y₀ and image centre x₀, a foot point at lateral X and depth Z is seen at

    x = x₀ + f X / Z        y = y₀ + f c / Z        and a figure there is   f / Z = (y − y₀) / c
    pixels tall.
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
# Part of a figure that must be in the frame for it to be in the truth.
_MIN_VISIBLE = 0.3


class Camera(NamedTuple):
    """``horizon`` and ``centre`` in pixels, ``focal`` in pixels, ``height`` above the ground in
    body heights.
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

    def to_picture(self, ground: F8) -> F8:
        """(n, 2) pixels of the ground points (n, 2)."""
        x = self.centre + self.focal * ground[:, 0] / ground[:, 1]
        return np.stack([x, self.horizon + self.focal * self.height / ground[:, 1]], axis=1)


def _standing(camera: Camera, foot: F8, stature: float, aspect: float) -> F8:
    """(n, 4) xyxy of figures that stand at the pixels ``foot`` (n, 2); their relative height, width
    over height.
    """
    tall = stature * ((foot[:, 1] - camera.horizon) / camera.height)
    half = aspect * tall / 2
    return np.stack([foot[:, 0] - half, foot[:, 1] - tall, foot[:, 0] + half, foot[:, 1]], axis=1)


class Walk(NamedTuple):
    """One person's way.

    Attributes
    ----------
    points : two or more foot points (x, y) as fractions of the frame's width and height; corners
        are rounded.
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
    """Foot points (n, 2) in pixels at those ``times`` (T,) at which the walk is under way, and
    which (n,) these are.
    """
    line = camera.to_ground(np.array(walk.points) * np.array(size))
    for _ in range(4 if len(line) > 2 else 0):  # the corners are cut (Chaikin), the ends stay
        a = line[:-1]
        b = line[1:]
        cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, 2)
        line = np.concatenate([line[:1], cut, line[-1:]])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    since = times - walk.at
    paused = 0.0
    spent = np.zeros_like(since)
    for walked, pause in walk.pauses:
        spent += np.clip(since - (walked + paused), 0, pause)
        paused += pause
    gone = walk.speed * (since - spent)
    index = np.flatnonzero((times >= walk.at) & (gone <= length[-1]))
    ground = np.stack([np.interp(gone[index], length, line[:, axis]) for axis in (0, 1)], axis=1)
    return camera.to_picture(ground), index


class Entrance(NamedTuple):
    """Where people come and go: a border of the frame, or a door at ``foot`` (x, y in fractions of
    the frame).
    """

    side: Literal["left", "right", "bottom", "door"]
    foot: Point = (0.5, 0.5)
    weight: float = 1.0


@dataclass(frozen=True, slots=True)
class Scenario(Checked):
    """Settings of a scene with people; lengths in the picture are fractions of the frame's width or
    height.

    Attributes
    ----------
    name, frames, fps, width, height : of the sequence; width and height in pixels.
    horizon, focal, camera_height : row of the horizon, focal length in frame widths, height in body
        heights (`Camera`).
    rows : foot rows (top, bottom) between which people walk.
    arrivals : people per second; they begin at second ``lead_in``, which may be negative: then some
        are there at once.
    entrances : where the arriving come from and go to.
    speed, speed_spread : mean and standard deviation over people, in body heights per second.
    aspect, stature_spread : width over height of a figure; standard deviation of its relative
        height.
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
        Checked.__post_init__(self)
        low = min((y for walk in self.walks for _, y in walk.points), default=1.0)
        expected = {
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
        for what, met in expected.items():
            if not met:
                raise InputError(
                    f"expected {what}",
                    where=f"scenario {self.name}",
                    cure="Change this setting of the scene",
                )

    @property
    def info(self) -> SequenceInfo:
        """Size, rate, number of frames and name of the sequence."""
        return SequenceInfo(self.width, self.height, self.fps, self.frames, self.name)

    @property
    def camera(self) -> Camera:
        """The camera, in pixels."""
        return Camera(
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
        feet = np.array(
            [e.foot for e in self.entrances if e.side == "door"], dtype=np.float64
        ).reshape(-1, 2)
        return _standing(
            self.camera, feet * np.array([self.width, self.height]), stature=1.25, aspect=0.5
        )

    def figures(self, rng: np.random.Generator) -> Truth:
        """All figures with any part in the frame, numbered in the order of their arrival; boxes not
        clipped.
        """
        walks = sorted((*self.walks, *self._arriving(rng)), key=lambda walk: walk.at)
        times = np.arange(self.frames) / self.fps
        parts = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 4)))]
        for walk in walks:
            foot, index = _followed(walk, self.camera, (self.width, self.height), times)
            box = _standing(self.camera, foot, walk.stature, self.aspect)
            seen = share_inside(box, self.width, self.height) > 0
            if seen.any():
                parts.append(
                    (index[seen] + 1, np.full(int(seen.sum()), len(parts), np.int64), box[seen])
                )
        frame, identity, boxes = (np.concatenate(column) for column in zip(*parts, strict=True))
        return truth_rows(frame, identity, boxes)

    def truth(self, figures: Truth) -> Truth:
        """The figures of which enough is in the frame, boxes clipped to it."""
        kept = np.flatnonzero(share_inside(figures.xyxy, self.width, self.height) >= _MIN_VISIBLE)
        inside = np.clip(figures.xyxy[kept], 0.0, np.tile([self.width, self.height], 2))
        return truth_rows(figures.frame[kept], figures.identity[kept], inside)

    def _arriving(self, rng: np.random.Generator) -> list[Walk]:
        """The walks of the people who arrive by chance; a random stream each, so that one more
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
        """The way, speed, stature and pauses of one person."""
        stature = float(np.clip(rng.normal(1, self.stature_spread), 0.7, 1.3))
        speed = float(max(rng.normal(self.speed, self.speed_spread), 0.3 * self.speed))
        weight = np.array([e.weight for e in self.entrances])
        first = int(rng.choice(len(weight), p=weight / weight.sum()))
        others = weight * (np.arange(len(weight)) != first)
        if others.any():
            last = int(rng.choice(len(weight), p=others / others.sum()))
        else:
            last = first
        start, end = (self._foot(self.entrances[i], stature, rng) for i in (first, last))
        between = (float(rng.uniform(0.2, 0.8)), float(rng.uniform(*self.rows)))
        if self.pause_rate:
            gaps = rng.exponential(1 / self.pause_rate, size=8)
        else:
            gaps = np.zeros(0)
        lengths = rng.exponential(self.pause_seconds, size=len(gaps))
        pauses = tuple(zip(np.cumsum(gaps).tolist(), lengths.tolist(), strict=True))
        return Walk((start, between, end), at, speed, stature, pauses)

    def _foot(self, entrance: Entrance, stature: float, rng: np.random.Generator) -> Point:
        """A foot point at an entrance at which the figure is just outside the frame, or in the
        door.
        """
        row = float(rng.uniform(*self.rows))
        column = float(rng.uniform(0.2, 0.8))
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
    """A `Truth` of rows of which all count, sorted by frame, then identity.

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
    truth : what an annotator would mark, boxes clipped to the frame.
    figures : what the renderer draws: all figures of which any part is in the frame, boxes not
        clipped.
    detections : M simulated detections of the truth, with clutter.
    source : (M,) int64 where each came from, as in `Detected`.
    places : (P, 4) xyxy of the places with persistent clutter, where the renderer lets leaves wave.
    obstacles : (K, 4) xyxy of standing things that hide what is behind them, pixels.
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
    """What the picture looks like, and how hard it is to see change in it.

    Attributes
    ----------
    noise : standard deviation of the camera's noise, grey levels.
    flicker : relative standard deviation of the brightness of the whole picture.
    plants : number of waving plants where the scene has no persistent places; where it has, one
        grows at each.
    wave : how far the top of a plant moves in a usual gust, in plant heights.
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
"""Three pairs that walk towards each other and pass close by, at three distances from the
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
"""A dozen people or more at a time."""
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
"""A shopping centre's corridor seen along its length, with the door of a shop, at CAVIAR's size and
rate.
"""
_WATCHED = Scenario(
    "yard", frames=1000, width=384, height=288, rows=(0.55, 0.95), arrivals=0.3, lead_in=-10.0
)
YARD = replace(
    _WATCHED, entrances=(Entrance("left"), Entrance("right"), Entrance("door", (0.3, 0.53), 1.5))
)
"""A house with a door and a road before it, trees and blinking lights: a scene to learn, at
CAVIAR's size.
"""
GARDEN = replace(_WATCHED, name="garden", arrivals=0.12)
"""Few people among a dozen trees in a strong wind: most detections are false, and always in the
same places.
"""
_COLUMNS = tuple((left, 0.3, left + 0.06, 0.86) for left in (0.15, 0.45, 0.75))
ARCADE = replace(_WATCHED, name="arcade", rows=(0.56, 0.82), arrivals=0.25, obstacles=_COLUMNS)
"""All people pass behind three columns, and tracks begin again next to them."""
EMPTY = Scenario("empty", frames=300, arrivals=0.0)
"""No people: every detection is false."""

NAMED = MappingProxyType(
    {w.name: w for w in (STREET, CROSSING, OCCLUSION, CROWD, CORRIDOR, YARD, GARDEN, ARCADE, EMPTY)}
)
"""All scenes by name."""
# Where a scene is not as usual: places with persistent false alarms, at which plants grow, and the
# look of the video.
_PLACES = {"yard": 3, "garden": 12, "arcade": 3}
_LOOKS = {
    "yard": Look(wave=0.12),
    "garden": Look(wave=0.30, lamps=10),
    "arcade": Look(wave=0.12, lamps=4),
}


def make_scene(
    world: str | Scenario, seed: int, detector: DetectorModel | None = None, **settings: Any
) -> Scene:
    """The scene of that name or with these settings; its truth does not depend on ``detector``.
    Raises `InputError` where no scene has this name, it has no such setting, or the value is
    impossible.

    Parameters
    ----------
    world : one of `NAMED`, or settings of one's own.
    seed : what is drawn by chance is drawn from it.
    detector : None for `default_detector`, with misses where people hide each other.
    **settings : other settings than the scene's own, as ``frames=100``.
    """
    if isinstance(world, str):
        if world not in NAMED:
            raise InputError(f"no scene is called {world!r}", cure=did_you_mean(world, NAMED))
        world = NAMED[world]
    known = [field.name for field in fields(world)]
    for key in settings:
        if key not in known:
            raise InputError(
                f"scene {world.name} has no setting {key!r}", cure=did_you_mean(key, known)
            )
    world, detector = replace(world, **settings), detector or default_detector(world)
    world_rng, detector_rng = np.random.default_rng(seed).spawn(2)
    figures = world.figures(world_rng)
    truth = world.truth(figures)
    found = detect(truth, world.info, detector_rng, detector, obstacles=world.obstacles_px)
    return Scene(
        world.info,
        truth,
        figures,
        found.table,
        found.source,
        found.places,
        world.obstacles_px,
        world.doors_px,
    )


def default_detector(world: Scenario) -> DetectorModel:
    """The detector that a scene is given where none is asked for."""
    return DetectorModel(occlusion=2.0, places=_PLACES.get(world.name, 5))


def default_look(name: str) -> Look:
    """What the video of the scene ``name`` looks like where nothing else is asked for."""
    return _LOOKS.get(name, Look())
