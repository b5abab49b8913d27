"""What is learned of a scene: where targets are born and where a detector is wrong [M09 §IV]."""

from phdtrack.context.density import ContextDensity, uniform_density
from phdtrack.context.learner import RecursiveEM, grid

__all__ = ["ContextDensity", "RecursiveEM", "grid", "uniform_density"]
