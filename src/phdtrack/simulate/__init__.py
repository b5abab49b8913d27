"""Scenes with truth, as detections and as video.

`make_scene` gives one of the scenes in `NAMED`; `detect` and `add_clutter` work on any truth or detections; `render` turns a
scene into a video.
"""

from phdtrack.simulate.detector import Detected, DetectorModel, add_clutter, detect
from phdtrack.simulate.render import Rendered, render
from phdtrack.simulate.scenario import Entrance, Scenario, Walk
from phdtrack.simulate.scenes import NAMED, Look, Scene, build_scene, default_detector, default_look, make_scene

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
    "build_scene",
    "default_detector",
    "default_look",
    "detect",
    "make_scene",
    "render",
]
