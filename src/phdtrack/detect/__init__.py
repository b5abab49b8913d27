"""From frames to measurements: detectors, interchangeable, each of them frozen settings and what it learned of the scene.

`make_detector` builds one by name. `change` is the default: it needs no model and finds whatever differs from the scene.
"""

from phdtrack.detect.cascade import FaceDetector, FaceSettings
from phdtrack.detect.change import ChangeDetector, ChangeSettings
from phdtrack.detect.components import BlobSettings
from phdtrack.detect.given import CallableDetector, TableDetector
from phdtrack.detect.mean_background import MeanBackgroundDetector, MeanBackgroundSettings
from phdtrack.detect.parameters import typed
from phdtrack.detect.person import PersonDetector, PersonSettings
from phdtrack.detect.registry import BACKGROUND, DETECTORS, detector_names, detector_parameters, make_detector
from phdtrack.detect.subtractors import SubtractorDetector, SubtractorSettings
from phdtrack.detect.wrappers import Masked, Rescaled

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
