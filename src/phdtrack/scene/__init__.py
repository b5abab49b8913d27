"""Learned scenes: densities of births, of false alarms and of objects [M09 §IV]."""

from phdtrack.scene.em import grid, learn, learn_recursively
from phdtrack.scene.mixture import SceneDensity, marginal, shown_volume
from phdtrack.scene.scene_file import LearnedDensity, Scene, TrackedObjects, read_scene, write_scene

__all__ = [
    "LearnedDensity",
    "Scene",
    "SceneDensity",
    "TrackedObjects",
    "grid",
    "learn",
    "learn_recursively",
    "marginal",
    "read_scene",
    "shown_volume",
    "write_scene",
]
