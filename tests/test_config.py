"""Settings from TOML, options and presets: every name can be reached, every mistake names its place
and the nearest name.
"""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from phdtrack import config
from phdtrack.cli.show_settings import as_toml, meanings, toml_value
from phdtrack.config.presets import PRESETS, USUAL, preset_values, usual_preset
from phdtrack.config.registry import SECTIONS, constructor_defaults, record, settable
from phdtrack.errors import InputError
from phdtrack.types import SequenceInfo

INFO = SequenceInfo(640, 480, 25.0)
# What a section's kind cannot do without.
PLANE = ["motion.kind='plane'", "camera.region=[-20, -20, 20, 20]"]
PARTICLES = ["filter.kind='particle-phd'"]
NEEDED = {
    ("birth", "ground"): PLANE,
    ("birth", "places"): [*PLANE, "birth.places=[[1, 2, 0.1, 1, 1]]"],
    ("motion", "plane"): PLANE[1:],
    ("sensor", "plane"): PLANE,
    ("clutter", "ground"): PLANE,
    ("birth", "uniform"): ["motion.kind='point'", *PARTICLES],
    ("extract", "kmeans"): PARTICLES,
    ("extract", "kmeans-printed"): PARTICLES,
    ("extract", "mixture"): PARTICLES,
    ("extract", "mixture-printed"): PARTICLES,
    ("sensor", "point"): ["motion.kind='point'"],
    ("birth", "point"): ["motion.kind='point'"],
    ("clutter", "point"): ["motion.kind='point'"],
    ("extract", "components"): ["filter.kind='gm-phd'"],
    ("extract", "hypotheses"): ["filter.kind='mht'"],
    ("extract", "joint"): ["filter.kind='mcmc'"],
    ("associate", "detections"): ["filter.kind='none'"],
}

# Section, kind and name of every setting there is.
EVERY = [
    (section, kind, name)
    for section, kinds in SECTIONS.items()
    for kind in kinds
    for name in settable(section, kind)
    # Files must be there; targets before the first frame are places on the ground.
    if name not in ("file", "initial")
]


def chosen(section: str, kind: str) -> list[str]:
    """Options that choose a kind and what it needs."""
    return [*([f"{section}.kind={kind}"] if kind else []), *NEEDED.get((section, kind), [])]


WORDS = {
    "particle": "detection", "given": "fixed", "fixed": "given",
    "continuous": "piecewise", "piecewise": "continuous", "map": "eap", "box": "plane",
    "": "07:30 day", "similarity": "homography", "linear": "unscented",
    "births": "clutter", "clutter": "births",
}  # fmt: skip


def another(value, kind: str = ""):
    """A legal value that is not ``value``, of a setting of this kind."""
    match value:
        case bool():
            return not value
        case int():
            return value + 1
        case float():
            return value / 2 if value else 0.25
        case (0.0, 0.0, 0.0, 0.0):
            return (-20.0, -25.0, 15.0, 10.0)
        case tuple():
            return tuple(another(item) for item in value)
        case list():
            return [*value, tuple(item + 1 for item in value[0])]
        case "given" if kind == "mcmc":
            return "none"
        case str() if value in WORDS:
            return WORDS[value]
    raise AssertionError(f"no other value is known for {value!r}")


# Reaching every setting

# Of two rates one is 0.
OTHER_RATE = {
    "births_per_second": "births_per_detection", "births_per_detection": "births_per_second",
    "clutter_per_frame": "clutter_per_detection", "clutter_per_detection": "clutter_per_frame",
}  # fmt: skip


@pytest.mark.parametrize(
    ("section", "kind"), dict.fromkeys((section, kind) for section, kind, _ in EVERY)
)
def test_every_setting_is_reached(section: str, kind: str, tmp_path):
    """Each alone by an option, all together by a file; and what is asked for is built."""
    options = chosen(section, kind)
    before = config.load(sets=options).as_dict()[section]
    values = {
        name: another(before[name], kind)
        for where, of, name in EVERY
        if (where, of) == (section, kind)
    }
    for name, value in values.items():
        after = config.load(sets=[*options, f"{section}.{name}={toml_value(value)}"]).as_dict()[
            section
        ]
        assert after == before | {name: value} | (
            {OTHER_RATE[name]: 0.0} if OTHER_RATE.get(name) in before else {}
        )
    config.build(config.load(sets=options), INFO, moving=True)
    values |= {
        name: 0.0
        for name in ("births_per_second", "clutter_per_frame")
        if OTHER_RATE[name] in values
    }
    path = tmp_path / "settings.toml"
    lines = [f"[{section}]", *(f"{name} = {toml_value(value)}" for name, value in values.items())]
    path.write_text("\n".join([*lines, f'kind = "{kind}"' if kind else ""]), encoding="utf-8")
    needed = [option for option in options if not option.startswith(f"{section}.")]
    # Of MCMC's settings some exclude others.
    if not needed and kind != "mcmc":
        assert config.load(path).as_dict()[section] == before | values


@pytest.mark.parametrize(
    ("typed", "meant"), [(".1", 0.1), ("+.25", 0.25), (" .1 ", 0.1), ("1e-1", 0.1)]
)
def test_numbers_may_begin_with_the_point(typed: str, meant: float):
    assert config.load(sets=[f"sensor.box_noise={typed}"]).as_dict()["sensor"]["box_noise"] == meant


@pytest.mark.parametrize("preset", PRESETS)
def test_as_dict_has_the_values_that_are_built(preset: str):
    said = config.load(preset=preset).as_dict()
    stages = config.build(config.load(preset=preset), SequenceInfo(768, 576, 7.0))
    records = {
        "motion": stages.model.motion,
        "sensor": stages.model.sensor,
        "birth": stages.model.birth,
        "filter": stages.filter,
        "extract": stages.extractor,
        "associate": stages.associator,
    }
    for section, made in records.items():
        for name, value in said[section].items():
            if name not in ("kind", "initial", "places"):
                assert getattr(made, name) == value, (section, name)
    assert stages.model.rate == said["time"]["units_per_second"]


def test_e13_has_its_printed_births_and_people():
    stages = config.build(config.load(preset="e13"), SequenceInfo(768, 576, 7.0))
    assert stages.model.first == pytest.approx(1 / 7)
    np.testing.assert_array_equal(stages.model.clutter.intensity(np.zeros((5, 2))), 1e-8)
    # Births of a frame of 1/7 s, and who is there before the first.
    births = stages.model.birth.gaussians(np.zeros((5, 0)), stages.model.sensor, 1 / 7)
    np.testing.assert_allclose(births.weight, [0.01, 0.001, 0.0001])
    np.testing.assert_allclose(births.mean, [[-8, 6, 0, 0], [-10, -15, 0, 0], [15, -8, 0, 0]])
    np.testing.assert_array_equal(births.covariance, np.tile(np.eye(4), (3, 1, 1)))
    initial = stages.filter.initial
    np.testing.assert_array_equal(initial.weight, 1)
    np.testing.assert_allclose(initial.covariance, np.tile(np.diag([0.1, 0.1, 1, 1]), (4, 1, 1)))
    np.testing.assert_allclose(initial.mean[:2, 3], [-7.9414, 4.3781])


def unfit(preset: str, filter_name: str) -> bool:
    """Births anywhere in the image, as d14 has them, have no Gaussian form."""
    return preset == "d14" and filter_name in ("pmb", "pmbm", "gm-phd", "gm-cphd", "mht")


@pytest.mark.parametrize(
    ("preset", "filter_name"), [p for p in product(PRESETS, SECTIONS["filter"]) if not unfit(*p)]
)
def test_printed_settings_are_read_back_to_the_same(preset: str, filter_name: str, tmp_path):
    """`phdtrack settings`, the dozen and everything, of every preset with every filter that fits
    it.
    """
    settings = config.load(preset=preset, filter_name=filter_name)
    for everything in (False, True):
        path = tmp_path / f"{everything}.toml"
        path.write_text(as_toml(settings, everything=everything), encoding="utf-8")
        assert config.load(path).as_dict() == settings.as_dict()


def test_settings_of_classes_are_read_back(tmp_path):
    """From a file and from options, the later in place of the earlier."""
    path = tmp_path / "mine.toml"
    path.write_text(
        '[classes."traffic light"]\nmin_score = 0.3\n[classes.car.sensor]\nbox_noise = 0.2\n',
        encoding="utf-8",
    )
    sets = ["classes.car.sensor.detection_probability=0.8", "classes.car.min_size=20"]
    settings = config.load(path, sets)
    assert settings.of_classes == {
        "traffic light": {"min_score": 0.3},
        "car": {"sensor": {"box_noise": 0.2, "detection_probability": 0.8}, "min_size": 20},
    }
    path.write_text(as_toml(settings, everything=False), encoding="utf-8")
    assert config.load(path).as_dict() == settings.as_dict()


@pytest.mark.parametrize("filter_name", [name for name in SECTIONS["filter"] if unfit("d14", name)])
def test_uniform_births_are_refused_by_gaussian_filters(filter_name: str):
    with pytest.raises(InputError, match="birth"):
        config.load(preset="d14", filter_name=filter_name)


@pytest.mark.parametrize("section", SECTIONS)
def test_every_setting_has_a_meaning(section: str):
    for kind in SECTIONS[section]:
        names = {name for where, of, name in EVERY if (where, of) == (section, kind)}
        assert names <= meanings(record(section, kind)).keys()


def test_the_last_named_wins(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        'preset = "m07"\n[sensor]\ndetection_probability = 0.8\nbox_noise = 0.3\n', encoding="utf-8"
    )
    sensor = config.load(path, ["sensor.box_noise=0.4", "sensor.box_noise=0.5"]).as_dict()["sensor"]
    assert (sensor["scaling"], sensor["detection_probability"], sensor["box_noise"]) == (
        "detection",
        0.8,
        0.5,
    )
    assert config.load(path, preset="m09").as_dict()["sensor"]["scaling"] == "particle"
    assert config.load(path, preset="m09").preset == "m09"
    over = config.overlay(config.load(path), {"sensor": {"detection_probability": 0.6}})
    assert over.as_dict()["sensor"]["detection_probability"] == 0.6
    # The settings laid over stay what they were.
    assert config.load(path).as_dict()["sensor"]["detection_probability"] == 0.8


# Presets


# The sections that decide how a preset tracks, and settings of them that only a run decides.
TRACKING = (
    "time", "motion", "sensor", "birth", "clutter", "filter", "extract", "associate",
    "detection_scores", "merged_measurements", "common_motion", "smooth",
)  # fmt: skip
OF_THE_RUN = {"history", "output_delay", "threads", "initial"}
# Raw detections have another one than filtered states; a preset need not choose.
OF_THE_STATES = {"min_link_gain"}


@pytest.mark.parametrize("preset", [name for name in PRESETS if name != "default"])
def test_a_preset_is_a_complete_table(preset: str):
    """Except that one for several filters leaves their own settings to them."""
    values = preset_values(preset)
    several = "kind" not in values["filter"]
    for section in TRACKING:
        if several and section in ("filter", "extract"):
            continue
        kind = values[section].get("kind", "")
        assert kind in SECTIONS[section]
        assert set(settable(section, kind)) - OF_THE_RUN - OF_THE_STATES <= set(values[section]), (
            section
        )
    for section, stated in values.items():
        known = {name for kind in SECTIONS[section] for name in settable(section, kind)}
        assert set(stated) <= known | {"kind"}


@pytest.mark.parametrize(
    ("tracked", "filter_name"),
    [(tracked, name) for tracked in USUAL for name in SECTIONS["filter"]],
)
def test_the_usual_preset_follows_from_one_table(tracked: str, filter_name: str):
    motion = tracked.partition(" ")[0]
    detectors = {"box of a background detector": "mog2", "box of another built-in detector": "face"}
    detector = detectors.get(tracked, "")
    preset = usual_preset(motion, filter_name, detector)
    assert preset == USUAL[tracked].get(filter_name, USUAL[tracked].get(""))
    sets = [f"motion.kind={motion}", "camera.region=[-20, -20, 20, 20]"]
    settings = config.load(sets=sets, filter_name=filter_name, detector=detector)
    assert settings.preset == settings.as_dict()["preset"] == preset
    # Named, it has the same values.
    named = config.load(sets=sets, filter_name=filter_name, preset=preset)
    assert named.as_dict() == settings.as_dict()


def test_a_network_has_the_preset_of_a_file():
    assert config.load(detector="onnx:yolo.onnx").preset == "default"


def test_a_named_preset_holds_for_every_detector(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('preset = "m07"\n', encoding="utf-8")
    assert config.load(preset="default", detector="change").preset == "default"
    assert config.load(path, detector="change").preset == "m07"
    path.write_text("[sensor]\nbox_noise = 0.2\n", encoding="utf-8")
    assert config.load(path, detector="change").preset == "background"


def test_a_preset_of_another_world_is_refused():
    with pytest.raises(InputError, match=r"preset m09 is for motion\.kind=box, not plane"):
        config.load(sets=["motion.kind=plane"], preset="m09")


@pytest.mark.parametrize("kind", SECTIONS["filter"])
def test_a_filter_has_the_values_of_its_usual_preset(kind: str):
    """Built as printed, whatever the filter was before; not in a paper's preset, and never over
    what the user states.
    """
    usual = (0.14, 0.6) if kind == "pmb" else (0.15, 0.43)
    model = config.build(config.load(), INFO, kind).model
    assert (model.sensor.box_noise, model.clutter.clutter_per_detection) == usual

    def stated(*sets: str, preset: str = "") -> tuple[float, float]:
        found = config.load(sets=sets, preset=preset).as_dict()
        return found["sensor"]["box_noise"], found["clutter"]["clutter_per_detection"]

    assert stated(f"filter.kind={kind}") == usual
    assert stated(
        "sensor.box_noise=0.7", f"filter.kind={kind}", "clutter.clutter_per_detection=0.01"
    ) == (0.7, 0.01)
    assert stated(f"filter.kind={kind}", preset="m07") == (0.15, 1.0)


# Kinds


@pytest.mark.parametrize(("first", "other", "shared"), [
    ("filter.kind=pmb", "filter.kind=mht", ["filter.max_hypotheses=7", "filter.history=4"]),
    ("filter.kind=particle-phd", "filter.kind=particle-cphd", ["filter.particles_per_target=300"]),
    ("filter.kind=pmb", "filter.kind=gm-phd", ["extract.merge_iou=0.3", "associate.max_coast=0.7"]),
    ("motion.kind=box", "motion.kind=point", ["motion.survival_probability=0.5"]),
])  # fmt: skip
def test_shared_settings_keep_their_value(first: str, other: str, shared: list[str]):
    """When another kind is chosen, in one step or later."""
    section, _, kind = other.replace(".kind=", " ").partition(" ")
    before = config.load(sets=[first, *shared])
    for after in (
        config.load(sets=[*shared, other]),
        config.overlay(before, {section: {"kind": kind}}),
    ):
        for option in shared:
            place, _, value = option.partition("=")
            where, _, name = place.partition(".")
            assert after.as_dict()[where][name] == float(value)


def test_of_two_rates_the_one_that_is_named_last_holds():
    """``births_per_second`` are anywhere, ``births_per_detection`` around each detection; so it is
    with clutter.
    """

    def rates(*sets: str) -> tuple[float, ...]:
        found = config.load(sets=[f"clutter.clutter_per_{one}" for one in sets]).as_dict()[
            "clutter"
        ]
        return found["clutter_per_frame"], found["clutter_per_detection"]

    assert rates() == (0.0, 0.6)
    assert rates("frame=3") == (3.0, 0.0)
    assert rates("frame=3", "detection=0.5") == (0.0, 0.5)
    assert rates("frame=0") == (0.0, 0.6)


# How many settings there are


def test_at_most_a_hundred_settings_each_varied_somewhere():
    """By a preset, an experiment, a benchmark or a how-to page."""
    root = Path(__file__).parents[1]
    text = "\n".join(
        path.read_text(encoding="utf-8")
        for folder in ("experiments", "benchmarks", "docs/how-to")
        for path in sorted((root / folder).rglob("*"))
        if path.suffix in (".py", ".md")
    )
    names = {
        (section, name)
        for section, kinds in SECTIONS.items()
        for kind in kinds
        for name in settable(section, kind)
    }
    assert len(names) <= 100
    assert not [pair for pair in sorted(names) if not (in_a_preset(*pair) or in_text(*pair, text))]


def in_a_preset(section: str, name: str) -> bool:
    """Whether a preset has another value than the part's default."""
    return any(
        name in values
        and any(values[name] != constructor_defaults(section, kind).get(name, values[name])
                for kind in SECTIONS[section])
        for values in (preset_values(preset).get(section, {}) for preset in PRESETS)
    )  # fmt: skip


def in_text(section: str, name: str, text: str) -> bool:
    """Whether a setting is named, as a setting or as an argument."""
    return bool(re.search(rf"\b{section}\.{name}\b|\b{name}=|\"{name}\": ", text))
