"""Every name that a configuration may have: sections, their kinds, the records they make, and which go together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from phdtrack.associate import GraphMatching, Labelled
from phdtrack.config import worlds
from phdtrack.detect.merged import Explained
from phdtrack.filters import GMCPHD, GMPHD, MCMC, MHT, PMB, NoFilter, ParticleCPHD, ParticlePHD, extract
from phdtrack.groups import Contours, EncounterWarning, Grouping, GroupLifeCycle
from phdtrack.models import (
    BoxMotion,
    BoxSensor,
    MeasurementBirth,
    NoSpawn,
    PlaneBirth,
    PlaneMotion,
    PlaneSensor,
    PointBirth,
    PointMotion,
    PointSensor,
    SplitSpawn,
    UniformBirth,
)
from phdtrack.protocols import AsDetected, NoLearning
from phdtrack.scene.rates import RatesSettings
from phdtrack.smooth import Smoothing
from phdtrack.video.ego_motion import GivenWarps, SparseFlow, Standing

# section → kind → record; the first kind is the default.
SECTIONS: Mapping[str, Mapping[str, type[Any]]] = {
    "time": {"": worlds.TimeSettings},
    "camera": {"": worlds.CameraSettings},
    "motion": {"box": BoxMotion, "plane": PlaneMotion, "point": PointMotion},
    "spawn": {"none": NoSpawn, "split": SplitSpawn},
    "sensor": {"box": BoxSensor, "plane": PlaneSensor, "point": PointSensor},
    "birth": {
        "measurement": MeasurementBirth,
        "uniform": UniformBirth,
        "fixed": worlds.FixedBirthSettings,
        "scene": worlds.SceneBirthSettings,
        "ground": PlaneBirth,
        "places": worlds.PlacesBirthSettings,
        "point": PointBirth,
    },
    "clutter": {
        "image": worlds.ClutterSettings,
        "scene": worlds.SceneClutterSettings,
        "ground": worlds.GroundClutterSettings,
        "point": worlds.PointClutterSettings,
    },
    "filter": {
        "pmb": PMB,
        "particle-phd": ParticlePHD,
        "gm-phd": GMPHD,
        "particle-cphd": ParticleCPHD,
        "gm-cphd": GMCPHD,
        "mcmc": MCMC,
        "mht": MHT,
        "none": NoFilter,
    },
    "extract": {
        "bernoullis": extract.BestBernoullis,
        "kmeans": extract.KMeans,
        "mixture": extract.Mixture,
        "components": extract.Components,
        "joint": extract.Joint,
        "hypotheses": extract.BestHypothesis,
    },
    "associate": {"labelled": Labelled, "graph": GraphMatching},
    "learn": {"none": NoLearning, "online": worlds.LearnSettings},
    "rates": {"none": NoLearning, "learned": RatesSettings},
    "blobs": {"none": AsDetected, "explained": Explained},
    "camera_motion": {"none": Standing, "flow": SparseFlow, "file": GivenWarps},
    "smooth": {"": Smoothing},
    "groups": {"": Grouping},
    "contours": {"": Contours},
    "life_cycle": {"": GroupLifeCycle},
    "encounters": {"": EncounterWarning},
    "detector": {"": worlds.DetectorSettings},
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
        "spawn": ("none",),
        "learn": ("none",),
        "blobs": ("none",),
        "camera_motion": ("none",),
    },
    ("motion", "point"): {
        "sensor": ("point",),
        "birth": ("point", "uniform", "fixed", "scene"),
        "clutter": ("point",),
        "spawn": ("none",),
        "learn": ("none",),
        "blobs": ("none",),
    },
    ("filter", "particle-phd"): {"extract": ("kmeans", "mixture"), "associate": ("graph",)},
    ("filter", "gm-phd"): {"extract": ("components",), "associate": ("graph",)},
    ("filter", "particle-cphd"): {"extract": ("mixture", "kmeans"), "associate": ("graph",)},
    ("filter", "gm-cphd"): {"extract": ("components",), "associate": ("graph",)},
    ("filter", "mht"): {"extract": ("hypotheses",), "associate": ("labelled", "graph")},
    ("filter", "pmb"): {"extract": ("bernoullis",), "associate": ("labelled", "graph")},
    ("filter", "mcmc"): {"extract": ("joint",), "associate": ("graph", "labelled")},
    ("filter", "none"): {"associate": ("graph",), "learn": ("none",), "rates": ("none",), "blobs": ("none",)},
}
# The sections whose kinds decide others', in the order to lay them over.
DECIDING = ("motion", "filter")
# Kinds that a filter cannot do, with what to use instead.
_NO_GAUSSIANS = {("birth", "uniform"): "birth.kind=measurement (of points: point), or fixed"}
_NO_SPAWNING = {("spawn", "split"): "spawn.kind=none"}
MISFITS: Mapping[str, Mapping[tuple[str, str], str]] = {
    "gm-phd": _NO_GAUSSIANS | _NO_SPAWNING,
    "gm-cphd": _NO_GAUSSIANS | _NO_SPAWNING,
    "particle-cphd": _NO_SPAWNING,
    "mcmc": _NO_SPAWNING,
    "mht": _NO_GAUSSIANS | _NO_SPAWNING,
    "pmb": _NO_GAUSSIANS | _NO_SPAWNING,
}
# Fields that come from the sequence.
FROM_SEQUENCE = {"frame_size", "births", "initial", "remember_size", "camera", "hiders", "borders"}
