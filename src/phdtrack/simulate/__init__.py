"""Scenarios with truth, as detections and as video.

`make_scene` gives a named scene (one of `NAMED`: street, crossing, … constant) with truth, simulated detections and where
each came from; `detect` and `add_clutter` work on any truth or detections; `linear_gaussian` and `turning` are the standard
scenarios of points; `render` turns a scene into a video that a change detector can work on.
"""

from phdtrack.simulate.clutter import add_clutter
from phdtrack.simulate.counting import Counting, constant
from phdtrack.simulate.detector import DetectorModel, detect
from phdtrack.simulate.ground import Walk
from phdtrack.simulate.look import Look
from phdtrack.simulate.named import NAMED, build_scene, default_detector, default_look, make_scene
from phdtrack.simulate.points import LinearGaussian, PointScene, linear_gaussian
from phdtrack.simulate.records import Detected, Scene, World
from phdtrack.simulate.renderer import Rendered, render
from phdtrack.simulate.scenario import Entrance, Scenario
from phdtrack.simulate.turning import Turning, turning

__all__ = [
    "NAMED",
    "Counting",
    "Detected",
    "DetectorModel",
    "Entrance",
    "LinearGaussian",
    "Look",
    "PointScene",
    "Rendered",
    "Scenario",
    "Scene",
    "Turning",
    "Walk",
    "World",
    "add_clutter",
    "build_scene",
    "constant",
    "default_detector",
    "default_look",
    "detect",
    "linear_gaussian",
    "make_scene",
    "render",
    "turning",
]
