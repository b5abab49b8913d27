"""Presets: complete sets of values, written as what differs from the defaults of the classes' constructors.

`values_of` gives the values of a preset with any filter and kind of motion; `phdtrack settings --all` prints them.
A table has a section for each part; ``birth.scene`` stands for ``[birth]`` where the user chooses ``kind = "scene"`` there.

``default``: what `phdtrack track` uses: the Poisson multi-Bernoulli filter with M09's model, of targets that keep their
velocity and their size better, live longer and are detected less surely, as today's detectors have it; newborn that may be
faster, births and clutter around the detections. What else differs from filter to filter stands in `_BY_FILTER`
(docs/results/defaults.md has why).
``m07``: Maggio et al. 2007: likelihood scaled by the detection, births and clutter around the detections, K-means.
``m09``: Maggio and Cavallaro 2009: M07's numbers (M09 prints none of its own) with the likelihood scaled by the particle, no
floor, births and clutter uniform over the image, and extraction by a Gaussian mixture at 0.5.
``fv``: M09's fixed variances: constant noises in pixels.
``m09-mht``: the multiple hypothesis tracker that M09 compares with, on fixed variances. Its densities of new targets and of
false alarms are read as per pixel² and frame, with any size up to the frame's, and its gate of 20 as a squared distance.
``e13``: Edman et al. 2013: people on the ground plane, GM-PHD, with the places of its sequence (PETS 2009 S1.L1, 7 Hz). Its
births are per frame of 1/7 s and stand here per second. It needs ``camera.file``, or detections in metres.
``d14``: D14's SMC PHD filter for point targets: p_D = p_S = 1, no clutter, ten newborn particles anywhere in each frame, no
update where nothing is detected. Its N is the total number of particles, so ``particles_per_target`` and ``max_particles``
are both N: the mass is a whole number of targets, and never more than N particles are drawn. Without clutter whatever
explains a detection best explains it, however far it is, as long as its density is a number: the gate is where
double precision ends (37.5 deviations at D14's variances). Detections of which nothing is that near are counted as vanished.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from phdtrack.config.kinds import FITTING, first_kind

Table = Mapping[str, Mapping[str, Any]]

NO_SMOOTHING: Mapping[str, Any] = {"stitching": False, "smoothing": False}
_PAPER: Table = {
    "motion": {"acceleration": 0.03, "size_noise": 0.1, "survival_probability": 0.99**25},
    "sensor": {"detection_probability": 0.95, "box_noise": 0.15},
    "birth": {"births_per_second": 25 * 0.01, "particles": 1000},
    "clutter": {"clutter_per_frame": 1.0},
    "filter": {"kind": "particle-phd", "particles_per_target": 1500},
    "associate": {"kind": "graph"},
    # No paper joins states that overlap, or touches tracks that have ended.
    "extract": {"kind": "kmeans", "min_weight": 0.6, "merge_iou": 1.0},
    "smooth": NO_SMOOTHING,
}
_M09: Table = {
    **_PAPER,
    "sensor": {**_PAPER["sensor"], "min_noise": 0.0, "scaling": "particle"},
    "extract": {"kind": "mixture", "min_weight": 0.5, "merge_iou": 1.0},
}
_FV: Table = {
    **_M09,
    "motion": {"acceleration": 1.5**0.5, "size_noise": 2.0, "survival_probability": 0.99**25, "scaled_noise": False},
    "sensor": {"detection_probability": 0.95, "scaling": "fixed"},
}

# On the ground a second without a state costs as much as elsewhere 0.6 s.
_ON_THE_GROUND: Table = {"time": {"units_per_second": 1.0}, "associate": {"gap_cost": 1.609}}


def _around(births: float, alarms: float) -> Table:
    """So many births and false alarms around each detection, and as many next to those that a scene has taught."""
    return {
        "birth": {"births_per_second": 25 * births},
        "birth.scene": {"around_detections": 25 * births},
        "clutter": {"clutter_per_frame": alarms},
        "clutter.scene": {"around_detections": alarms},
    }


# The default's values with each filter, of boxes. A PHD filter has no labels: where the sensor is wide, neighbours share
# their measurements, and what is near is taken for the same.
_PHD: Table = {"motion": {"size_noise": 0.07}, "sensor": {"box_noise": 0.15}, **_around(0.01, 0.3)}
_PMB: Table = {"motion": {"size_noise": 0.05}, "sensor": {"box_noise": 0.25}, **_around(0.005, 1.5)}
_PARTICLES: Table = {**_PHD, "filter": {"particles_per_target": 750}}
_BY_FILTER: Mapping[str, Table] = {"pmb": _PMB, "particle-phd": _PARTICLES, "particle-cphd": _PARTICLES}

PRESETS: Mapping[str, Table] = {
    "default": {
        "motion": {"acceleration": 0.005, "survival_probability": 0.997**25, "roughening": 0.005},
        "sensor": {"detection_probability": 0.8, "birth_speed": 0.1, "scaling": "particle"},
        "birth": {"particles": 500, "volume": "local"},
        "clutter": {"volume": "local"},
    },
    "m07": {
        **_PAPER,
        "sensor": {**_PAPER["sensor"], "scaling": "detection"},
        "birth": {**_PAPER["birth"], "volume": "local"},
        "clutter": {**_PAPER["clutter"], "volume": "local"},
    },
    "m09": _M09,
    "fv": _FV,
    "m09-mht": {
        **_FV,
        "sensor": {"detection_probability": 0.97, "scaling": "fixed"},
        "filter": {
            "kind": "mht",
            "new_target_density": 0.0025,
            "false_alarm_density": 0.00007,
            "termination_frames": 150.0,
            # A squared distance of 20 in four dimensions.
            "gate_probability": 0.9995,
            "history": 10,
            "hypothesis_threshold": 0.001,
            "max_hypotheses": 300,
        },
        "extract": {"kind": "hypotheses", "min_weight": 0.5, "merge_iou": 1.0},
        "associate": {"kind": "labelled"},
    },
    "e13": {
        "time": {"units_per_second": 1.0},
        "associate": {"kind": "graph", "gap_cost": 1.609},
        "motion": {"kind": "plane", "acceleration": 1.0, "survival_probability": 0.99**7, "form": "piecewise"},
        "sensor": {
            "kind": "plane",
            "detection_probability": 0.7,
            "scaling": "fixed",
            "fixed_noise": 0.5**0.5,
            "birth_speed": 2**0.5,
            "view": False,
            "occlusion": False,
        },
        "birth": {
            "kind": "places",
            "places": [(-8.0, 6.0, 0.07, 1.0, 1.0), (-10.0, -15.0, 0.007, 1.0, 1.0), (15.0, -8.0, 0.0007, 1.0, 1.0)],
        },
        "clutter": {"kind": "ground", "density": 1e-8},
        "filter": {
            "kind": "gm-phd",
            "weight_threshold": 1e-5,
            "merge_distance": 2.0,
            "max_components": 100,
            "initial": [
                (-11.2197, -13.1848, 1.0, 0.1**0.5, 1.0),
                (-11.1650, -14.1883, 1.0, 0.1**0.5, 1.0),
                (-9.2323, -13.8840, 1.0, 0.1**0.5, 1.0),
                (-7.9414, 4.3781, 1.0, 0.1**0.5, 1.0),
            ],
        },
        "extract": {"kind": "components", "min_weight": 0.5, "merge_iou": 1.0},
        "smooth": NO_SMOOTHING,
    },
    "d14": {
        "motion": {"kind": "point", "noise_variance": 2.0, "survival_probability": 1.0},
        "sensor": {"kind": "point", "detection_probability": 1.0, "noise_variance": 1.0, "gate_probability": 1.0},
        "birth": {"kind": "uniform", "births_per_second": 25 * 0.1, "particles": 10},
        "clutter": {"kind": "point", "clutter_per_frame": 0.0},
        "filter": {"kind": "particle-phd", "particles_per_target": 4000, "max_particles": 4000, "skip_empty_frames": True},
        "extract": {"kind": "kmeans", "min_weight": 0.6, "merge_iou": 1.0},
        "associate": {"kind": "graph"},
        "smooth": NO_SMOOTHING,
    },
}


def values_of(preset: str, motion: str = "", filter_name: str = "") -> dict[str, dict[str, Any]]:
    """The values of a preset by section, with their ``kind``; what a section leaves out has its constructor's default.

    Parameters
    ----------
    preset : a name of `PRESETS`.
    motion, filter_name : other kinds of ``[motion]`` and ``[filter]`` than the preset's; empty for the preset's.
        Sections whose kind does not fit get the first that does, and keep the values that both kinds of a section know.
    """
    table = {section: dict(values) for section, values in PRESETS[preset].items()}
    moving, filtering = (table.get(section, {}).get("kind", first_kind(section)) for section in ("motion", "filter"))
    motion, filter_name = motion or moving, filter_name or filtering
    if motion != moving:
        table["motion"] = {"kind": motion}
        for section, kinds in FITTING["motion", motion].items():
            table[section] = {"kind": kinds[0]}
    if filter_name != filtering:
        table["filter"] = {"kind": filter_name}
        for section, kinds in FITTING["filter", filter_name].items():
            table[section] = table.get(section, {}) | {"kind": kinds[0]}
    if motion == "plane":
        _add(table, _ON_THE_GROUND)
    if preset == "default" and motion == "box":
        _add(table, _BY_FILTER.get(filter_name, _PHD))
    if filter_name == "none":
        # A raw detection has no known velocity, so that the links of true tracks gain less than those of filtered states.
        _add(table, {"associate": {"min_link_gain": 0.6}})
    return table


def _add(table: dict[str, dict[str, Any]], more: Table) -> None:
    """Put the values of ``more`` into ``table`` where it has none of the same name."""
    for section, values in more.items():
        table[section] = {**values, **table.get(section, {})}
