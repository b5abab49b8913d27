"""Learned scenes: where targets are born and where a detector is wrong, by training or online [M09 §IV, §VI]."""

from phdtrack.scene.em import RecursiveEM, grid
from phdtrack.scene.files import LearnedDensity, Scene, TrackedObjects, read_scene, write_scene
from phdtrack.scene.mixture import SceneDensity, marginal, uniform_density

__all__ = [
    "LearnedDensity",
    "RecursiveEM",
    "Scene",
    "SceneDensity",
    "TrackedObjects",
    "grid",
    "marginal",
    "read_scene",
    "uniform_density",
    "write_scene",
]
