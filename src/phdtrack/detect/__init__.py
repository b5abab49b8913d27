"""From frames to measurements: detectors, interchangeable, each of them frozen settings and what it learned of the scene.

`make_detector` builds one by name. `change` is the default: it needs no model and finds whatever differs from the scene.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.detect.background import (
        MeanBackgroundDetector,
        MeanBackgroundSettings,
        SubtractorDetector,
        SubtractorSettings,
    )
    from phdtrack.detect.change import ChangeDetector, ChangeSettings
    from phdtrack.detect.components import BlobSettings
    from phdtrack.detect.person import FaceDetector, FaceSettings, PersonDetector, PersonSettings
    from phdtrack.detect.registry import BACKGROUND, DETECTORS, detector_names, detector_parameters, make_detector, typed
    from phdtrack.detect.wrappers import CallableDetector, Masked, Rescaled, TableDetector

__getattr__, __dir__ = lazy(
    __name__,
    {
        "BACKGROUND": "phdtrack.detect.registry",
        "BlobSettings": "phdtrack.detect.components",
        "CallableDetector": "phdtrack.detect.wrappers",
        "ChangeDetector": "phdtrack.detect.change",
        "ChangeSettings": "phdtrack.detect.change",
        "DETECTORS": "phdtrack.detect.registry",
        "FaceDetector": "phdtrack.detect.person",
        "FaceSettings": "phdtrack.detect.person",
        "Masked": "phdtrack.detect.wrappers",
        "MeanBackgroundDetector": "phdtrack.detect.background",
        "MeanBackgroundSettings": "phdtrack.detect.background",
        "PersonDetector": "phdtrack.detect.person",
        "PersonSettings": "phdtrack.detect.person",
        "Rescaled": "phdtrack.detect.wrappers",
        "SubtractorDetector": "phdtrack.detect.background",
        "SubtractorSettings": "phdtrack.detect.background",
        "TableDetector": "phdtrack.detect.wrappers",
        "detector_names": "phdtrack.detect.registry",
        "detector_parameters": "phdtrack.detect.registry",
        "make_detector": "phdtrack.detect.registry",
        "typed": "phdtrack.detect.registry",
    },
)

__all__ = [
    "BACKGROUND",
    "DETECTORS",
    "BlobSettings",
    "CallableDetector",
    "ChangeDetector",
    "ChangeSettings",
    "FaceDetector",
    "FaceSettings",
    "Masked",
    "MeanBackgroundDetector",
    "MeanBackgroundSettings",
    "PersonDetector",
    "PersonSettings",
    "Rescaled",
    "SubtractorDetector",
    "SubtractorSettings",
    "TableDetector",
    "detector_names",
    "detector_parameters",
    "make_detector",
    "typed",
]
