"""phdtrack: multi-target tracking in video with random finite sets.

`Tracker` is the everyday name; filters, models and the other parts are one package for each step of
the method (see docs/architecture.md). Names are loaded when they are first used, so that importing
phdtrack costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

__version__ = "0.1.0"

if TYPE_CHECKING:
    from phdtrack.errors import InputError
    from phdtrack.formats import export_tracks, read_tracks
    from phdtrack.metrics import evaluate
    from phdtrack.tracker import Tracker
    from phdtrack.types import Detections, Tracks
    from phdtrack.video.ego_motion import CameraMotion


# Type checkers know the names by their imports, and find one that does not exist.
if not TYPE_CHECKING:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "CameraMotion": "phdtrack.video.ego_motion",
            "Detections": "phdtrack.types",
            "InputError": "phdtrack.errors",
            "Tracker": "phdtrack.tracker",
            "Tracks": "phdtrack.types",
            "evaluate": "phdtrack.metrics",
            "export_tracks": "phdtrack.formats",
            "read_tracks": "phdtrack.formats",
        },
    )

__all__ = [
    "CameraMotion",
    "Detections",
    "InputError",
    "Tracker",
    "Tracks",
    "evaluate",
    "export_tracks",
    "read_tracks",
]
