"""Settings, presets, and the objects that are built from them: the one place that knows every
name.
"""

from phdtrack.config.build import build, build_groups, for_detector, ground_model
from phdtrack.config.class_settings import build_classes
from phdtrack.config.settings import Settings, load, overlay

__all__ = [
    "Settings",
    "build",
    "build_classes",
    "build_groups",
    "for_detector",
    "ground_model",
    "load",
    "overlay",
]
