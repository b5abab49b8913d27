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
EMPTY = Scenario("empty", frames=300, arrivals=0.0)
"""Nobody comes: everything that is reported is false."""

NAMED: MappingProxyType[str, Scenario | Counting] = MappingProxyType(
    {w.name: w for w in (STREET, CROSSING, OCCLUSION, CROWD, CORRIDOR, EMPTY, Counting())}
)
"""All scenes by name."""


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
    return PAPER_DETECTOR if isinstance(world, Counting) else DetectorModel(occlusion=2.0, places=5)


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
