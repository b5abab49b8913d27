"""phdtrack: multi-target tracking in video with random finite sets.

`Tracker` is the everyday name; filters, models and the other parts are one package for each step of the method (see
docs/architecture.md). Names are loaded when they are first used, so that importing phdtrack costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from phdtrack.errors import InputError
    from phdtrack.metrics import evaluate
    from phdtrack.tracker import Tracker
    from phdtrack.types import Detections, Tracks
    from phdtrack.video.ego_motion import CameraMotion


def lazy(package: str, homes: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package whose names are loaded when they are first used.

    Parameters
    ----------
    package : its ``__name__``.
    homes : the module that defines each public name.
    """

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(homes[name]), name)

    return load, lambda: sorted(homes)


__getattr__, __dir__ = lazy(
    __name__,
    {
        "CameraMotion": "phdtrack.video.ego_motion",
        "Detections": "phdtrack.types",
        "InputError": "phdtrack.errors",
        "Tracker": "phdtrack.tracker",
        "Tracks": "phdtrack.types",
        "evaluate": "phdtrack.metrics",
    },
)

__all__ = ["CameraMotion", "Detections", "InputError", "Tracker", "Tracks", "evaluate"]
