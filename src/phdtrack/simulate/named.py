"""Scenes by name, and the one function that makes them."""

from __future__ import annotations

import difflib
from dataclasses import fields, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.simulate.counting import PAPER_DETECTOR, Counting
from phdtrack.simulate.detector import DetectorModel, detect
from phdtrack.simulate.ground import Walk
from phdtrack.simulate.look import Look
from phdtrack.simulate.records import Scene, World
from phdtrack.simulate.scenario import Entrance, Scenario

_PAIRS = tuple(
    Walk(((-0.1, row), (1.1, row + lean)) if rightward else ((1.1, row), (-0.1, row + lean)), at, 0.75, stature)
    for at, row, lean, rightward, stature in (
        (0.5, 0.70, 0.06, True, 1.0),
        (0.5, 0.74, -0.04, False, 0.95),
        (4.0, 0.90, -0.05, True, 1.05),
        (4.0, 0.80, 0.06, False, 1.0),
        (8.0, 0.60, 0.02, True, 0.95),
        (8.0, 0.62, 0.0, False, 1.05),
    )
)

_BEHIND = tuple(
    Walk(((-0.1, row), (1.1, row)) if rightward else ((1.1, row), (-0.1, row)), at, speed)
    for at, row, rightward, speed in (
        (0.5, 0.66, True, 0.75),
        (2.5, 0.72, False, 0.65),
        (5.0, 0.62, True, 0.9),
        (8.0, 0.68, False, 0.8),
        (9.0, 0.93, True, 0.7),
        (12.0, 0.70, True, 0.75),
    )
)

STREET = Scenario()
"""People cross a street in both directions and stop now and then."""
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
"""Few people among a dozen trees in a strong wind: most of what is reported is false, and always in the same places."""
ARCADE = replace(
    _WATCHED,
    name="arcade",
    rows=(0.56, 0.82),
    arrivals=0.25,
    obstacles=tuple((left, 0.3, left + 0.06, 0.86) for left in (0.15, 0.45, 0.75)),
)
"""Everybody passes behind three columns, and tracks begin again beside them."""
EMPTY = Scenario("empty", frames=300, arrivals=0.0)
"""Nobody comes: everything that is reported is false."""

NAMED: MappingProxyType[str, Scenario | Counting] = MappingProxyType(
    {w.name: w for w in (STREET, CROSSING, OCCLUSION, CROWD, CORRIDOR, YARD, GARDEN, ARCADE, EMPTY, Counting())}
)
"""All scenes by name."""
# Where a scene is not as usual: places with persistent false alarms, at which plants grow, and the look of the video.
_USUAL_PLACES = 5
_PLACES = {"yard": 3, "garden": 12, "arcade": 3}
_LOOKS = {
    "yard": Look(wave=0.12, lamps=3),
    "garden": Look(wave=0.30, lamps=10),
    "arcade": Look(wave=0.12, lamps=4),
}


def make_scene(name: str, seed: int, detector: DetectorModel | None = None, **settings: Any) -> Scene:
    """The scene ``name`` of `NAMED`, with other ``settings`` than its own where given, e.g. ``frames=100``.

    World and detector draw from streams of their own: the truth does not depend on ``detector``. Its default is
    `DetectorModel()`, with occlusion-dependent misses where people hide each other; for ``constant`` the papers' sensor.

    Raises
    ------
    InputError : no scene has this name, it has no such setting, or the value is impossible.
    """
    if name not in NAMED:
        raise InputError(f"no scene is called {name!r}", cure=f"There are {', '.join(NAMED)}{_nearest(name, list(NAMED))}")
    world = NAMED[name]
    return build_scene(_changed(world, settings), seed, detector or default_detector(world))


def build_scene(world: World, seed: int, detector: DetectorModel) -> Scene:
    """The scene of any `World`, detected by ``detector``."""
    world_rng, detector_rng = np.random.default_rng(seed).spawn(2)
    figures = world.figures(world_rng)
    truth = world.truth(figures)
    found = detect(truth, world.info, detector_rng, detector, obstacles=world.obstacles_px)
    return Scene(world.info, truth, figures, found.table, found.source, found.places, world.obstacles_px, world.doors_px)


def default_detector(world: Scenario | Counting) -> DetectorModel:
    """The detector that a scene is given where none is asked for."""
    if isinstance(world, Counting):
        return PAPER_DETECTOR
    return DetectorModel(occlusion=2.0, places=_PLACES.get(world.name, _USUAL_PLACES))


def default_look(name: str) -> Look:
    """What the video of the scene ``name`` looks like where nothing else is asked for."""
    return _LOOKS.get(name, Look())


def _changed(world: Scenario | Counting, settings: dict[str, Any]) -> Scenario | Counting:
    """The world with other settings."""
    known = [f.name for f in fields(world)]
    for key in settings:
        if key not in known:
            raise InputError(
                f"scene {world.name} has no setting {key!r}", cure=f"There are {', '.join(known)}{_nearest(key, known)}"
            )
    return replace(world, **settings)


def _nearest(word: str, known: list[str]) -> str:
    """A hint at the nearest known word."""
    close = difflib.get_close_matches(word, known, 1)
    return f"; did you mean {close[0]}?" if close else ""
