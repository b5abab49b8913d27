"""Detectors: from frames to measurements.

`make_detector` builds one by name. `change`, the default, needs no model and finds whatever differs
from the scene.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.detect.detectors import DETECTORS, detector_parameters, make_detector
    from phdtrack.detect.moving_regions import BACKGROUND
    from phdtrack.detect.scene_knowledge import knowledge, restore
    from phdtrack.detect.table_detector import TableDetector

_MODULES = {
    "BACKGROUND": "moving_regions",
    "DETECTORS": "detectors",
    "TableDetector": "table_detector",
    "detector_parameters": "detectors",
    "knowledge": "scene_knowledge",
    "make_detector": "detectors",
    "restore": "scene_knowledge",
}
__all__ = [
    "BACKGROUND",
    "DETECTORS",
    "TableDetector",
    "detector_parameters",
    "knowledge",
    "make_detector",
    "restore",
]

# Type checkers know the names by their imports, and find one that does not exist.
if not TYPE_CHECKING:
    __getattr__, __dir__ = lazy(
        __name__, {name: f"{__name__}.{module}" for name, module in _MODULES.items()}
    )
