"""Simulated scenes with truth, as detections and as video.

`make_scene` makes one of the scenes in `NAMED`; `detect` and `add_clutter` work on any truth or
detections; `Rendered` is a scene as a video.
"""

from phdtrack.simulate.detector import Detected, DetectorModel, add_clutter, detect
from phdtrack.simulate.render import Rendered
from phdtrack.simulate.scenes import (
    NAMED,
    Entrance,
    Look,
    Scenario,
    Scene,
    Walk,
    default_detector,
    default_look,
    make_scene,
)

__all__ = [
    "NAMED",
    "Detected",
    "DetectorModel",
    "Entrance",
    "Look",
    "Rendered",
    "Scenario",
    "Scene",
    "Walk",
    "add_clutter",
    "default_detector",
    "default_look",
    "detect",
    "make_scene",
]
