"""Every name that a configuration may have: sections, their kinds, the settings of each, and which go together.

The settings of a kind are the fields of a frozen dataclass, mostly the object itself (``[filter]`` of kind ``pmb`` has the
fields of `filters.pmb.PMB`). The dataclasses here are of parts that are only built once the sequence, a camera or a learned
scene is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cache
from importlib import import_module
from typing import Any, get_type_hints

from phdtrack.errors import NonNegative, Positive, PositiveCount, check
from phdtrack.models.volumes import EVERYWHERE, PlaneVolume, Region, Volume, check_region

Boxes = list[tuple[float, float, float, float]]
Places = list[tuple[float, float, float, float, float]]
"""Of each: x, y in metres, weight, standard deviations of position (m) and of velocity (m/s)."""


class _Checked:
    """Settings within the bounds of their annotations."""

    __slots__ = ()

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True)
class TimeSettings(_Checked):
    """``units_per_second``: time units per second in which noises are stated, the papers' are per frame at 25 Hz."""

    units_per_second: Positive = 25.0


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """Settings of a detector, checked by the detector itself."""


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """Between pixels and ground, for ``motion.kind=plane``.

    Parameters
    ----------
    file : camera, see `ground.read_camera`; empty for detections that are in metres already.
    region : the ground that counts, left, low, right, high in metres; all 0: what the image shows up to ``max_distance``,
        no border without a camera.
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
class PointClutterSettings(_Checked):
    """``clutter_per_frame``: expected false alarms per frame, points anywhere in the image."""

    clutter_per_frame: NonNegative = 1.0


@dataclass(frozen=True, slots=True)
class ClutterSettings(_Checked):
    """False alarms of boxes. ``clutter_per_frame``: expected false alarms per frame, in the image, or around each detection
    where ``volume`` is local. ``volume``: what they are spread over."""

    clutter_per_frame: NonNegative = 1.0
    volume: Volume = "image"


@dataclass(frozen=True, slots=True)
class GroundClutterSettings(_Checked):
    """False alarms on the ground. ``clutter_per_frame``: expected false alarms per frame, in the region, or around each
    detection where ``volume`` is local. ``volume``: what they are spread over. ``density``: false alarms per frame and m²,
    which replaces the other two where it is not 0."""

    clutter_per_frame: NonNegative = 0.3
    volume: PlaneVolume = "local"
    density: NonNegative = 0.0


@dataclass(frozen=True, slots=True)
class FixedBirthSettings(_Checked):
    """``boxes``: where objects appear, as left, top, right, bottom in pixels. ``births_per_second``: expected births per
    second at each. ``particles``: newborn particles per frame."""

    boxes: Boxes
    births_per_second: NonNegative = 0.25
    particles: PositiveCount = 300


@dataclass(frozen=True, slots=True)
class PlacesBirthSettings(_Checked):
    """``places``: where people appear on the ground, as x, y (m), births per second, deviations of position (m) and of
    velocity (m/s). ``particles``: newborn particles per frame."""

    places: Places
    particles: PositiveCount = 300


@dataclass(frozen=True, slots=True)
class SceneBirthSettings(_Checked):
    """Births as `phdtrack learn` has learned them in this scene.

    Parameters
    ----------
    file : what was learned.
    particles : Jmax, newborn particles around a detection, see `models.births.MeasurementBirth`.
    around_detections : births per second around detections of boxes where nothing is known of the place; 0: none.
    """

    file: str
    particles: PositiveCount = 500
    around_detections: NonNegative = 0.0


@dataclass(frozen=True, slots=True)
class SceneClutterSettings(_Checked):
    """False alarms as `phdtrack learn` has learned them in this scene.

    Parameters
    ----------
    file : what was learned.
    around_detections : false alarms per frame around detections, in addition to these.
    reject_false_tracks : withhold tracks that stay where false alarms are followed (`associate.rejection`), where
        `phdtrack learn` has seen which are.
    immediate_confirmation : confirm a track at once where there are at most so many false alarms for each object.
    """

    file: str
    around_detections: NonNegative = 0.0
    reject_false_tracks: bool = True
    immediate_confirmation: NonNegative = 0.1


@dataclass(frozen=True, slots=True)
class LearnSettings(_Checked):
    """Learning births and false alarms while tracking, see `scene.online`.

    Parameters
    ----------
    memory : minutes after which what was seen counts for 37 %.
    verdict_delay : seconds until a detection is judged, beyond ``associate.output_delay``.
    particles : Jmax, see MeasurementBirth.
    file : what was learned before; of several regimes a folder with a file of each, as a run leaves them.
    """

    memory: Positive = 10.0
    verdict_delay: NonNegative = 2.0
    particles: PositiveCount = 500
    file: str = ""


# section → kind → "module:class" of its settings; the first kind is the default. A class is imported when it is chosen.
SECTIONS: Mapping[str, Mapping[str, str]] = {
    "time": {"": f"{__name__}:TimeSettings"},
    "camera": {"": f"{__name__}:CameraSettings"},
    "motion": {
        "box": "phdtrack.models.box:BoxMotion",
        "plane": "phdtrack.models.plane:PlaneMotion",
        "point": "phdtrack.models.point:PointMotion",
    },
    "sensor": {
        "box": "phdtrack.models.box:BoxSensor",
        "plane": "phdtrack.models.plane:PlaneSensor",
        "point": "phdtrack.models.point:PointSensor",
    },
    "birth": {
        "measurement": "phdtrack.models.births:MeasurementBirth",
        "uniform": "phdtrack.models.births:UniformBirth",
        "fixed": f"{__name__}:FixedBirthSettings",
        "scene": f"{__name__}:SceneBirthSettings",
        "ground": "phdtrack.models.births:PlaneBirth",
        "places": f"{__name__}:PlacesBirthSettings",
        "point": "phdtrack.models.births:PointBirth",
    },
    "clutter": {
        "image": f"{__name__}:ClutterSettings",
        "scene": f"{__name__}:SceneClutterSettings",
        "ground": f"{__name__}:GroundClutterSettings",
        "point": f"{__name__}:PointClutterSettings",
    },
    "filter": {
        "pmb": "phdtrack.filters.pmb:PMB",
        "particle-phd": "phdtrack.filters.phd_particle:ParticlePHD",
        "gm-phd": "phdtrack.filters.phd_gaussian:GMPHD",
        "particle-cphd": "phdtrack.filters.cphd_particle:ParticleCPHD",
        "gm-cphd": "phdtrack.filters.cphd:GMCPHD",
        "mcmc": "phdtrack.filters.mcmc:MCMC",
        "mht": "phdtrack.filters.mht:MHT",
        "none": "phdtrack.filters.none:NoFilter",
    },
    "extract": {
        "bernoullis": "phdtrack.filters.pmb:BestBernoullis",
        "kmeans": "phdtrack.filters.extract.clusters:KMeans",
        "mixture": "phdtrack.filters.extract.clusters:Mixture",
        "components": "phdtrack.filters.extract.components:Components",
        "joint": "phdtrack.filters.extract.components:Joint",
        "hypotheses": "phdtrack.filters.mht:BestHypothesis",
    },
    "associate": {"labelled": "phdtrack.associate.labels:Labelled", "graph": "phdtrack.associate.graph:GraphMatching"},
    "learn": {"none": "phdtrack.protocols:NoLearning", "online": f"{__name__}:LearnSettings"},
    "rates": {"none": "phdtrack.protocols:NoLearning", "learned": "phdtrack.scene.rates:RatesSettings"},
    "merged_measurements": {
        "none": "phdtrack.protocols:AsDetected",
        "explained": "phdtrack.detect.merged:MergedMeasurements",
    },
    "camera_motion": {
        "none": "phdtrack.video.ego_motion:Standing",
        "flow": "phdtrack.video.ego_motion:SparseFlow",
        "file": "phdtrack.video.ego_motion:GivenWarps",
    },
    "smooth": {"": "phdtrack.smooth:Smoothing"},
    "groups": {"": "phdtrack.groups:Grouping"},
    "contours": {"": "phdtrack.groups:Contours"},
    "life_cycle": {"": "phdtrack.groups:GroupLifeCycle"},
    "encounters": {"": "phdtrack.groups:EncounterWarning"},
    "detector": {"": f"{__name__}:DetectorSettings"},
}
# Kinds of other sections that a kind goes together with, the default first. Without a filter nothing is extracted.
FITTING: Mapping[tuple[str, str], Mapping[str, tuple[str, ...]]] = {
    ("motion", "box"): {
        "sensor": ("box",),
        "birth": ("measurement", "uniform", "fixed", "scene"),
        "clutter": ("image", "scene"),
    },
    ("motion", "plane"): {
        "sensor": ("plane",),
        "birth": ("ground", "places", "scene"),
        "clutter": ("ground",),
        "learn": ("none",),
        "merged_measurements": ("none",),
        "camera_motion": ("none",),
    },
    ("motion", "point"): {
        "sensor": ("point",),
        "birth": ("point", "uniform", "fixed", "scene"),
        "clutter": ("point",),
        "learn": ("none",),
        "merged_measurements": ("none",),
    },
    ("filter", "particle-phd"): {"extract": ("kmeans", "mixture"), "associate": ("graph",)},
    ("filter", "gm-phd"): {"extract": ("components",), "associate": ("graph",)},
    ("filter", "particle-cphd"): {"extract": ("mixture", "kmeans"), "associate": ("graph",)},
    ("filter", "gm-cphd"): {"extract": ("components",), "associate": ("graph",)},
    ("filter", "mht"): {"extract": ("hypotheses",), "associate": ("labelled", "graph")},
    ("filter", "pmb"): {"extract": ("bernoullis",), "associate": ("labelled", "graph")},
    ("filter", "mcmc"): {"extract": ("joint",), "associate": ("graph", "labelled")},
    ("filter", "none"): {"associate": ("graph",), "learn": ("none",), "rates": ("none",), "merged_measurements": ("none",)},
}
# The sections whose kinds decide others', in the order to lay them over.
DECIDING = ("motion", "filter")
# Kinds that most filters cannot do: those filters, and what to use instead.
_GAUSSIAN = ("gm-phd", "gm-cphd", "mht", "pmb")
MISFITS = {
    ("birth", "uniform"): (_GAUSSIAN, "birth.kind=measurement (of points: point), or fixed"),
}
# Fields that come from the sequence.
FROM_SEQUENCE = {"frame_size", "initial", "remember_size", "camera", "hiders", "borders"}


@cache
def record(section: str, kind: str) -> type[Any]:
    """The class that has the settings of this kind, imported now."""
    module, _, name = SECTIONS[section][kind].partition(":")
    found: type[Any] = getattr(import_module(module), name)
    return found


def first_kind(section: str) -> str:
    """The kind that a section has where none is given."""
    return next(iter(SECTIONS[section]))


@cache
def settable(section: str, kind: str, motion: str) -> Mapping[str, Any]:
    """The settings of a kind and the type of each, bounds included; ``motion`` decides what ``filter.initial`` lists."""
    chosen = record(section, kind)
    hints = get_type_hints(chosen, include_extras=True)
    known = {field.name: hints[field.name] for field in fields(chosen) if field.name not in FROM_SEQUENCE}
    if section == "filter" and kind != "none":
        known["initial"] = Places if motion == "plane" else Boxes
    return known


@cache
def constructor_defaults(section: str, kind: str) -> Mapping[str, Any]:
    """The defaults of the settings that have one."""
    known = [field for field in fields(record(section, kind)) if field.name not in FROM_SEQUENCE]
    made = {field.name: field.default_factory() for field in known if field.default_factory is not MISSING}
    return made | {field.name: field.default for field in known if field.default is not MISSING}
