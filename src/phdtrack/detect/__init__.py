"""From frames to measurements: detectors, interchangeable, each of them frozen settings and what it learned of the scene.

`make_detector` builds one by name. `change` is the default: it needs no model and finds whatever differs from the scene.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.detect.registry import (
        BACKGROUND,
        DETECTORS,
        CallableDetector,
        TableDetector,
        detector_names,
        detector_parameters,
        make_detector,
        typed,
    )

__all__ = [
    "BACKGROUND",
    "DETECTORS",
    "CallableDetector",
    "TableDetector",
    "detector_names",
    "detector_parameters",
    "make_detector",
    "typed",
]

__getattr__, __dir__ = lazy(__name__, dict.fromkeys(__all__, f"{__name__}.registry"))
