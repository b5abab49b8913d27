"""Every name that a configuration may have: sections, their kinds, the settings of each, and which
go together, from ``registry.toml``.

The settings of a kind are the fields of a frozen dataclass, mostly the object itself (``[filter]``
of kind ``pmb`` has the fields of `filters.pmb.PMB`). The dataclasses here are of parts that are
only built once the sequence, a camera or a learned scene is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, get_type_hints

import numpy as np

from phdtrack.errors import Checked, InputError, NonNegative, Positive, PositiveCount, check
from phdtrack.files import read_toml
from phdtrack.models.volumes import EVERYWHERE, Region, check_region
from phdtrack.types import GaussianMixture

Places = list[tuple[float, float, float, float, float]]
"""Of each: x, y in metres, weight, standard deviations of position (m) and of velocity (m/s)."""


def gaussians_at(places: Places) -> GaussianMixture:
    """Gaussians at rest at given places of the ground."""
    x, y, weight, position, velocity = np.array(places, dtype=np.float64).reshape(-1, 5).T
    whole = (
        np.isfinite(x + y + weight + position + velocity)
        & (weight >= 0)
        & (position > 0)
        & (velocity > 0)
    )
    if not whole.all():
        problem = (
            "expected places as x, y, a weight from 0, deviations of position and of velocity"
            " above 0"
        )
        raise InputError(problem, where="places")
    nothing = np.zeros(len(x))
    cov = np.square(np.stack([position, position, velocity, velocity], axis=1))[
        :, :, None
    ] * np.eye(4)
    return GaussianMixture(weight.copy(), np.stack([x, y, nothing, nothing]), cov)


@dataclass(frozen=True, slots=True)
class TimeSettings(Checked):
    """Settings of the time.

    Parameters
    ----------
    units_per_second : time units per second in which noises are stated, the papers' are per frame
        at 25 Hz.
    longest_interval : seconds between pictures up to which targets move as in videos. With longer
        ones the filter's time runs slower, so that they are as long as this. 0: never.
    """

    units_per_second: Positive = 25.0
    longest_interval: NonNegative = 0.0


@dataclass(frozen=True, slots=True)
class Nothing:
    """A part that is left out, or that checks its settings itself."""


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """Between pixels and ground, for ``motion.kind=plane``.

    Parameters
    ----------
    file : camera, see `ground.read_camera`; empty for detections that are in metres already.
    region : the ground that counts, left, low, right, high in metres; all 0: what the image shows
        up to ``max_distance``, no border without a camera.
    max_distance : metres from the camera up to which the ground counts.
    first_pixel : number of the first pixel in the detections; 1 in MOTChallenge's files.
    """

    file: str = ""
    region: Region = EVERYWHERE
    max_distance: Positive = 60.0
    first_pixel: NonNegative = 0.0

    def __post_init__(self) -> None:
        check(self)
        check_region(self.region, "camera.region")


@dataclass(frozen=True, slots=True)
class SceneBirthSettings(Checked):
    """Births as `phdtrack learn` has learned them in this scene.

    Parameters
    ----------
    file : what was learned.
    particles : Jmax, newborn particles around a detection, see `models.births.MeasurementBirth`.
    births_per_detection : births per second in the neighbourhood of a box, where nothing is known
        of the place; 0: none.
    """

    file: str
    particles: PositiveCount = 500
    births_per_detection: NonNegative = 0.0


@dataclass(frozen=True, slots=True)
class SceneClutterSettings(Checked):
    """False alarms as `phdtrack learn` has learned them in this scene.

    Parameters
    ----------
    file : what was learned.
    clutter_per_detection : false alarms in the neighbourhood of a box, in addition to these.
    reject_false_tracks : withhold tracks that stay where false alarms are followed
        (`associate.rejection`), where `phdtrack learn` has seen which are.
    immediate_confirmation : confirm a track at once where there are at most so many false alarms
        for each object.
    """

    file: str
    clutter_per_detection: NonNegative = 0.0
    reject_false_tracks: bool = True
    immediate_confirmation: NonNegative = 0.1


Label = int | str


@dataclass(frozen=True, slots=True)
class ClassOptions:
    """Settings of a detector's classes. A class is called by its name, or by its number.

    Parameters
    ----------
    only : classes that are tracked; none: all.
    together : classes that the detector confuses, as [["car", "truck"]], in which a track may go
        from one to another.
    names : what the classes 0, 1, 2, … are called, where the detections have numbers only.
    each : settings of one class, as "car.sensor.detection_probability=0.9", "car.min_score=0.3" or
        "car.min_size=20" (longer side, pixels); in a file the table [classes.car.sensor], on the
        command line classes.car.min_score.
    """

    only: tuple[Label, ...] = ()
    together: tuple[tuple[Label, ...], ...] = ()
    names: tuple[str, ...] = ()
    each: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        known = [str(one).lower() for group in self.together for one in group]
        if len(known) > len(set(known)):
            raise InputError("expected each class in one group", where="classes.together")


_KINDS = {
    section: {"": kinds} if "class" in kinds else kinds
    for section, kinds in read_toml(Path(__file__).with_name("registry.toml")).items()
}
# section → kind → "module:class" of its settings; the first kind is the default. A class is
# imported when it is chosen.
SECTIONS: Mapping[str, Mapping[str, str]] = {
    section: {kind: one["class"] for kind, one in kinds.items()}
    for section, kinds in _KINDS.items()
}
# ClassSettings of other sections that a kind goes together with, the default first.
FITTING: Mapping[tuple[str, str], Mapping[str, tuple[str, ...]]] = {
    (section, kind): {other: tuple(fitting) for other, fitting in one.items() if other in _KINDS}
    for section, kinds in _KINDS.items()
    for kind, one in kinds.items()
}
# The sections whose kinds decide others', in the order to lay them over.
DECIDING = ("motion", "filter")
# Fields that come from the sequence.
FROM_SEQUENCE = {"frame_size", "initial", "camera", "hiders", "borders", "volume"}
# Fields that are mixtures of Gaussians, which a user gives as `Places`.
MIXTURES = ("places", "initial")


@cache
def record(section: str, kind: str) -> type[Any]:
    """The class that has the settings of this kind, imported now."""
    found: type[Any] = resolve_name(SECTIONS[section][kind])
    return found


def first_kind(section: str) -> str:
    """The kind that a section has where none is given."""
    return next(iter(SECTIONS[section]))


@cache
def settable(section: str, kind: str, motion: str) -> Mapping[str, Any]:
    """The names that a user may set, and the type of each, bounds included.

    Parameters
    ----------
    section, kind : of which part.
    motion : kind of ``[motion]``; ``filter.initial`` is for the plane only.
    """
    chosen = record(section, kind)
    hints = get_type_hints(chosen, include_extras=True)
    names = [field.name for field in fields(chosen) if field.name not in FROM_SEQUENCE]
    if section == "filter" and kind != "none" and motion == "plane":
        names.append("initial")
    return {name: Places if name in MIXTURES else hints[name] for name in names}


@cache
def constructor_defaults(section: str, kind: str) -> Mapping[str, Any]:
    """The defaults of the settings that have one."""
    known = [field for field in fields(record(section, kind)) if field.name not in FROM_SEQUENCE]
    return {field.name: field.default for field in known if field.default is not MISSING}
