"""What is learned of a scene: where targets are born and where a detector is wrong [M09 §IV]."""

from phdtrack.scene.density import ContextDensity, marginal, uniform_density
from phdtrack.scene.learner import RecursiveEM, grid
from phdtrack.scene.scene_file import Followed, Learned, Scene, read_scene, write_scene

__all__ = [
    "ContextDensity",
    "Followed",
    "Learned",
    "RecursiveEM",
    "Scene",
    "grid",
    "marginal",
    "read_scene",
    "uniform_density",
    "write_scene",
]
