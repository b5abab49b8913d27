"""phdtrack: multi-target tracking in video with the Probability Hypothesis Density filter.

The everyday names; the rest is one package per step of the method (see docs/architecture.md). They are loaded when they
are first used, so that importing phdtrack costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from phdtrack.errors import InputError
    from phdtrack.metrics import evaluate
    from phdtrack.tracker import Tracker
    from phdtrack.types import Detections, Tracks
    from phdtrack.video.ego_motion import CameraMotion

_HOMES = {
    "CameraMotion": "phdtrack.video.ego_motion",
    "Detections": "phdtrack.types",
    "InputError": "phdtrack.errors",
    "Tracker": "phdtrack.tracker",
    "Tracks": "phdtrack.types",
    "evaluate": "phdtrack.metrics",
}

__all__ = ["CameraMotion", "Detections", "InputError", "Tracker", "Tracks", "__version__", "evaluate"]


def __getattr__(name: str) -> Any:
    """The public names, on first use."""
    if name not in _HOMES:
        raise AttributeError(f"module 'phdtrack' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
