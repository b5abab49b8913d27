"""From frames to measurements: detectors, interchangeable, each of them settings and what it
learned of the scene.

`make_detector` builds one by name. `change` is the default: it needs no model and finds whatever
differs from the scene.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.detect.detectors import (
        BACKGROUND,
        DETECTORS,
        TableDetector,
        detector_parameters,
        knowledge,
        make_detector,
        restore,
    )

__all__ = [
    "BACKGROUND",
    "DETECTORS",
    "TableDetector",
    "detector_parameters",
    "knowledge",
    "make_detector",
    "restore",
]

__getattr__, __dir__ = lazy(__name__, dict.fromkeys(__all__, f"{__name__}.detectors"))
