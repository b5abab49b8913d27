"""From frames to measurements: detectors, interchangeable, each of them frozen settings and what it learned of the scene.

`make_detector` builds one by name. `change` is the default: it needs no model and finds whatever differs from the scene.
"""

from phdtrack.detect.background import MeanBackgroundDetector, MeanBackgroundSettings, SubtractorDetector, SubtractorSettings
from phdtrack.detect.change import ChangeDetector, ChangeSettings
from phdtrack.detect.components import BlobSettings
from phdtrack.detect.person import FaceDetector, FaceSettings, PersonDetector, PersonSettings
from phdtrack.detect.registry import BACKGROUND, DETECTORS, detector_names, detector_parameters, make_detector, typed
from phdtrack.detect.wrappers import CallableDetector, Masked, Rescaled, TableDetector

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
