"""From a request to the parts of a live camera: those of `phdtrack track`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from phdtrack import config
from phdtrack.config import Settings
from phdtrack.detect import BACKGROUND
from phdtrack.detect.base import Detector, class_names
from phdtrack.detect.detectors import make_detector, working_width
from phdtrack.errors import InputError
from phdtrack.live.engine import CameraParts
from phdtrack.models import PlaneSensor
from phdtrack.run.camera_motion import mover_of
from phdtrack.run.choices import chosen_settings
from phdtrack.run.descriptors import PictureDescriber, is_file, picture_describer
from phdtrack.run.requests import DEFAULT_APPEARANCE, TrackingRequest
from phdtrack.run.scene_pass import can_flicker, learning_flicker
from phdtrack.types import SequenceInfo

# Settings that cannot change while it runs, besides the kind of each part: what was learned or is
# delayed depends on them.
_FIXED = (
    "detector.",
    "camera.",
    "camera_motion.",
    "classes.",
    "associate.output_delay",
    "embedding.",
    "filter.acceleration_factors",
    "filter.samples",
)


@dataclass(frozen=True, slots=True)
class CameraSetup:
    """Makes detector and stages of a camera; the file of settings is read each time.

    Attributes
    ----------
    tracking : how to track.
    first : settings in place of those of preset and file.
    detector, max_width, mask : as `SourceRequest` has them.
    learn : whether it learns where the scene flickers, with a background detector.
    """

    tracking: TrackingRequest
    first: tuple[str, ...]
    detector: str
    max_width: int | None
    mask: Path | None
    learn: bool = True

    def settings(self) -> Settings:
        """The settings of `phdtrack track`, except that the past is forgotten. Raises `InputError`
        if they cannot be used.
        """
        settings = chosen_settings(self.tracking, self.first, detector=self.detector)
        return config.for_run(settings, endless=True)

    def new_detector(self, settings: Settings, max_width: int) -> Detector:
        """A detector before its first frame."""
        values = settings.values("detector")
        only = self.tracking.classes
        if only and ":" in self.detector:
            # A network knows its classes before there is a picture.
            values |= {"classes": only}
        return make_detector(self.detector, max_width=max_width, mask=self.mask, **values)

    def described_by(self, settings: Settings) -> PictureDescriber:
        """The describer of boxes, if there is one. Raises `InputError` if it cannot be used, or if
        a file is named.
        """
        appearance = self.tracking.appearance or DEFAULT_APPEARANCE
        if is_file(appearance):
            raise InputError(
                "a .npy file has a row for each row of a file of detections, and a camera has none",
                where="--appearance",
                cure="Say colours, onnx:FILE or none.",
            )
        return picture_describer(appearance, settings.values("embedding"))

    def __call__(self, info: SequenceInfo) -> CameraParts:
        """The parts for pictures of this size."""
        settings = self.settings()
        width = working_width(self.detector, self.max_width, info)
        detector = self.new_detector(settings, width)
        names = class_names(detector)
        present = frozenset(names) if names else None
        classes = config.build_classes(settings, info, names, present, moving=True)
        if self.learn and self.detector in BACKGROUND and can_flicker(settings):
            classes = learning_flicker(classes, (float(info.width), float(info.height)))
        model = classes.usual.model
        groups = None
        if isinstance(model.sensor, PlaneSensor):
            groups = config.build_groups(settings, classes.usual)
        looks = self.described_by(settings)
        fixed = _fixed(settings)
        if looks.name:
            # What a checkpoint has learned of the boxes is of this description.
            fixed["appearance"] = looks.name
        return CameraParts(
            detector,
            classes,
            info,
            settings.build("associate").output_delay,
            fixed,
            groups,
            self.tracking.seed,
            mover_of(settings, model, pictures=True),
            looks.describer,
        )


def _fixed(settings: Settings) -> dict[str, object]:
    """Names and values of the settings that cannot change while a camera runs."""
    values = {
        f"{section}.{name}": value
        for section, own in settings.as_dict().items()
        if section != "preset"
        for name, value in own.items()
    }
    return {
        name: value
        for name, value in values.items()
        if name.endswith(".kind") or name.startswith(_FIXED)
    }
