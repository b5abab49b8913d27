"""Settings, presets, and the objects that are built from them: the one place that knows every
name.
"""

from phdtrack.config.build import build, build_groups, ground_model
from phdtrack.config.class_settings import build_classes
from phdtrack.config.settings import Settings, for_run, load, overlay

__all__ = [
    "Settings",
    "build",
    "build_classes",
    "build_groups",
    "for_run",
    "ground_model",
    "load",
    "overlay",
]
