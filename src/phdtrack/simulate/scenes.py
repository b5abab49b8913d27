"""Scenes by name, with truth and simulated detections."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from phdtrack.errors import Checked, Count, InputError, NonNegative, Probability, did_you_mean
from phdtrack.simulate.detector import DetectorModel, detect
from phdtrack.simulate.scenario import Entrance, Scenario, Walk
from phdtrack.types import F8, I8, DetectionTable, SequenceInfo, Truth


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A simulated sequence.

    Attributes
    ----------
    info : size, rate, number of frames and name.
    truth : what an annotator would mark, boxes clipped to the frame.
    figures : what the renderer draws: all figures of which any part is in the frame, boxes not clipped.
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
    plants : number of waving plants where the scene has no persistent places; where it has, one grows at each.
    wave : how far the top of a plant moves in a usual gust, in plant heights.
    lamps : number of blinking lights and shimmering reflections.
    shadow : darkness of the shadows, 0 to 1.
    blown : leaves that the wind blows past the camera, expected number per frame; each is in one frame only.
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
"""Three pairs that walk towards each other and pass close by, at three distances from the camera."""
OCCLUSION = Scenario(
    "occlusion", frames=500, arrivals=0.0, walks=_BEHIND, obstacles=((0.28, 0.25, 0.35, 0.84), (0.60, 0.38, 0.72, 0.80))
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
    entrances=(Entrance("door", (0.55, 0.30)), Entrance("door", (0.17, 0.52)), Entrance("bottom"), Entrance("right")),
    pause_rate=0.15,
    pause_seconds=2.5,
)
"""A shopping centre's corridor seen along its length, with the door of a shop, at CAVIAR's size and rate."""
_WATCHED = Scenario("yard", frames=1000, width=384, height=288, rows=(0.55, 0.95), arrivals=0.3, lead_in=-10.0)
YARD = replace(_WATCHED, entrances=(Entrance("left"), Entrance("right"), Entrance("door", (0.3, 0.53), 1.5)))
"""A house with a door and a road before it, trees and blinking lights: a scene to learn, at CAVIAR's size."""
GARDEN = replace(_WATCHED, name="garden", arrivals=0.12)
"""Few people among a dozen trees in a strong wind: most detections are false, and always in the same places."""
_COLUMNS = tuple((left, 0.3, left + 0.06, 0.86) for left in (0.15, 0.45, 0.75))
ARCADE = replace(_WATCHED, name="arcade", rows=(0.56, 0.82), arrivals=0.25, obstacles=_COLUMNS)
"""All people pass behind three columns, and tracks begin again next to them."""
EMPTY = Scenario("empty", frames=300, arrivals=0.0)
"""No people: every detection is false."""

NAMED: MappingProxyType[str, Scenario] = MappingProxyType(
    {w.name: w for w in (STREET, CROSSING, OCCLUSION, CROWD, CORRIDOR, YARD, GARDEN, ARCADE, EMPTY)}
)
"""All scenes by name."""
# Where a scene is not as usual: places with persistent false alarms, at which plants grow, and the look of the video.
_PLACES = {"yard": 3, "garden": 12, "arcade": 3}
_LOOKS = {"yard": Look(wave=0.12), "garden": Look(wave=0.30, lamps=10), "arcade": Look(wave=0.12, lamps=4)}


def make_scene(name: str, seed: int, detector: DetectorModel | None = None, **settings: Any) -> Scene:
    """The scene of that name; its truth does not depend on ``detector``.

    Parameters
    ----------
    name : one of `NAMED`.
    seed : what is drawn by chance is drawn from it.
    detector : None for `default_detector`, with misses where people hide each other.
    **settings : other settings than the scene's own, as ``frames=100``.

    Returns
    -------
    scene : truth, figures and detections.

    Raises
    ------
    InputError : no scene has this name, it has no such setting, or the value is impossible.
    """
    if name not in NAMED:
        raise InputError(f"no scene is called {name!r}", cure=did_you_mean(name, NAMED))
    world = NAMED[name]
    known = [field.name for field in fields(world)]
    for key in settings:
        if key not in known:
            raise InputError(f"scene {name} has no setting {key!r}", cure=did_you_mean(key, known))
    return build_scene(replace(world, **settings), seed, detector or default_detector(world))


def build_scene(world: Scenario, seed: int, detector: DetectorModel) -> Scene:
    """The scene of a world with any settings.

    Parameters
    ----------
    world : its settings.
    seed : decides all that is drawn by chance.
    detector : that sees it.

    Returns
    -------
    Truth, figures and detections.
    """
    world_rng, detector_rng = np.random.default_rng(seed).spawn(2)
    figures = world.figures(world_rng)
    truth = world.truth(figures)
    found = detect(truth, world.info, detector_rng, detector, obstacles=world.obstacles_px)
    return Scene(world.info, truth, figures, found.table, found.source, found.places, world.obstacles_px, world.doors_px)


def default_detector(world: Scenario) -> DetectorModel:
    """The detector that a scene is given where none is asked for."""
    return DetectorModel(occlusion=2.0, places=_PLACES.get(world.name, 5))


def default_look(name: str) -> Look:
    """What the video of the scene ``name`` looks like where nothing else is asked for."""
    return _LOOKS.get(name, Look())
