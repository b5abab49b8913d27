"""Learned scenes as settings: who they fit, and what does not fit them."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.common import uniform_density
from phdtrack import config
from phdtrack.associate.graph import GraphMatching
from phdtrack.associate.labels import Labelled
from phdtrack.associate.rejection import FalseTrackRejection
from phdtrack.cli.options import TrackingOptions
from phdtrack.cli.show_settings import chosen, scene_settings
from phdtrack.config.registry import SECTIONS
from phdtrack.errors import InputError
from phdtrack.models.scene import SceneBirth, SceneClutter
from phdtrack.scene import (
    LearnedDensity,
    Scene,
    SceneDensity,
    TrackedObjects,
    read_scene,
    write_scene,
)
from phdtrack.types import SequenceInfo

INFO = SequenceInfo(640, 480, 25.0, 100)
FOLLOWED = TrackedObjects(
    0.1, LearnedDensity(3.0, uniform_density(np.zeros(4), np.array([640.0, 480, 640, 480])), 80)
)


def written(path, **changes):
    low = np.zeros(4)
    high = np.array([640.0, 480, 640, 480])
    mean = np.array([[600.0, 50, 20, 20]]).T
    clutter = SceneDensity(low, high, 0.5, np.ones(1), mean, 9 * np.eye(4)[None])
    births = uniform_density(
        np.array([0.0, 0, -9, -9, 0, 0]), np.array([640.0, 480, 9, 9, 640, 480])
    )
    parts = {
        "width": 640,
        "height": 480,
        "rate": 25.0,
        "source": "street",
        "births": LearnedDensity(0.05, births, 99),
    }
    write_scene(path, Scene(**(parts | {"clutter": LearnedDensity(1.5, clutter, 30)} | changes)))
    return ["birth.kind=scene", f"birth.file={path}", "clutter.kind=scene", f"clutter.file={path}"]


@pytest.mark.parametrize("name", ["particle-phd", "gm-phd", "particle-cphd", "gm-cphd", "mht"])
def test_every_filter_takes_them(tmp_path, name):
    stages = config.build(config.load(sets=written(tmp_path / "scene.json")), INFO, name)
    assert type(stages.model.birth) is SceneBirth
    assert type(stages.model.clutter) is SceneClutter
    assert (stages.model.birth.births_per_second, stages.model.clutter.clutter_per_frame) == (
        25 * 0.05,
        1.5,
    )
    rng = np.random.default_rng(0)
    state = stages.filter.start(stages.model, rng)
    for k in range(6):
        z = np.array([[100.0 + 3 * k, 600], [200, 50], [40, 20], [90, 20]])
        state, info = stages.filter.step(state, z, stages.model, 1.0, rng)
    # A walker, and what fires where false alarms were marked.
    assert info.clutter_probability[0] < min(0.1, info.clutter_probability[1])


@pytest.mark.parametrize(
    ("changes", "sets", "words"),
    [
        ({"width": 320}, [], "learned on frames of 320x480, and these are 640x480"),
        ({"births": None}, [], "births were not learned"),
        ({"clutter": None}, [], "false alarms were not learned"),
        ({"rate": 10.0}, [], "10 time units a second, and there are 25"),
        ({}, ["motion.kind=plane"], "does not fit motion.kind=plane"),
    ],
)
def test_what_does_not_fit_is_told(tmp_path, changes, sets, words):
    with pytest.raises(InputError, match=words):
        config.build(config.load(sets=[*written(tmp_path / "scene.json", **changes), *sets]), INFO)


# What is added, and which tracks are held back


@pytest.mark.parametrize("filter_name", SECTIONS["filter"])
def test_the_shipped_rates_are_added_to_a_scene(tmp_path, filter_name):
    """As much as is usual with the filter, told and built alike; nothing in a paper's preset, or
    where so asked.
    """
    sets = written(tmp_path / "scene.json", followed=FOLLOWED)
    plain = config.load(sets=[f"filter.kind={filter_name}"]).as_dict()
    settings = config.load(sets=[f"filter.kind={filter_name}", *sets])
    model = config.build(settings, INFO).model
    for section, rate in (("birth", "births_per_detection"), ("clutter", "clutter_per_detection")):
        assert (
            settings.as_dict()[section][rate]
            == getattr(getattr(model, section), rate)
            == plain[section][rate]
            > 0
        )
    np.testing.assert_array_equal(model.birth.among.high, FOLLOWED.objects.density.high)
    sets_alone = [*sets, "birth.births_per_detection=0", "clutter.clutter_per_detection=0"]
    alone = config.build(config.load(sets=sets_alone), INFO, filter_name).model
    assert alone.birth.births_per_detection == alone.clutter.clutter_per_detection == 0
    paper = config.load(preset="m09", sets=sets)
    assert (
        paper.as_dict()["birth"]["births_per_detection"]
        == paper.as_dict()["clutter"]["clutter_per_detection"]
        == 0
    )


@pytest.mark.parametrize(
    ("name", "kind"), [("pmb", Labelled), ("gm-phd", GraphMatching), ("none", GraphMatching)]
)
def test_who_stays_among_false_alarms_is_held_back(tmp_path, name, kind):
    sets = written(tmp_path / "scene.json", followed=FOLLOWED)
    vetted = config.build(
        config.load(sets=[*sets, "associate.output_delay=3"]), INFO, name
    ).associator
    assert isinstance(vetted, FalseTrackRejection)
    assert isinstance(vetted.associator, kind)
    assert vetted.associator.output_delay == 3
    assert (vetted.ratio.clutter.rate, vetted.ratio.tracked.share, vetted.ratio.births.rate) == (
        1.5,
        0.1,
        0.05,
    )
    # Births count where they are of the same scene.
    alone = config.build(config.load(sets=sets[2:]), INFO, name).associator
    assert isinstance(alone, FalseTrackRejection)
    assert alone.ratio.births is None
    other = written(tmp_path / "other.json", followed=FOLLOWED)
    assert (
        config.build(config.load(sets=[*other[:2], *sets[2:]]), INFO, name).associator.ratio.births
        is None
    )
    # Nobody is, where that is said, nobody has looked, or false alarms are not the scene's.
    before = written(tmp_path / "before.json")
    for given in ([*sets, "clutter.reject_false_tracks=false"], before, sets[:2]):
        assert isinstance(config.build(config.load(sets=given), INFO, name).associator, kind)


# --scene


def track(path, *sets, preset=""):
    return chosen(TrackingOptions(sets=list(sets), preset=preset), scene_settings(path))


def test_a_scene_is_taken_whole_and_options_change_it(tmp_path):
    path = tmp_path / "my yard.json"
    written(path, followed=FOLLOWED)
    told = track(path).as_dict()
    assert {name: told[name]["kind"] for name in ("birth", "clutter")} == {
        "birth": "scene",
        "clutter": "scene",
    }
    assert (told["birth"]["file"], told["clutter"]["reject_false_tracks"]) == (str(path), True)
    told = track(
        path, "clutter.reject_false_tracks=false", "birth.births_per_detection=0"
    ).as_dict()
    assert (told["clutter"]["reject_false_tracks"], told["birth"]["births_per_detection"]) == (
        False,
        0,
    )
    assert (
        track(path, "birth.kind=measurement").as_dict()["birth"]["births_per_detection"] == 0.0125
    ), "the kind that was chosen"
    assert track(path, "birth.kind=measurement").as_dict()["clutter"]["kind"] == "scene"
    with pytest.raises(InputError, match=r"unknown setting of \[clutter\]: clutter_per_frame"):
        track(path, "clutter.clutter_per_frame=2")


def test_what_a_scene_has_not_taught_goes_with_what_it_has(tmp_path):
    """As shipped, the same at every scale, where that is laid beside the other too; where nothing
    is, over the frame.
    """
    births = tmp_path / "births.json"
    alarms = tmp_path / "alarms.json"
    written(births)
    scene = read_scene(births)
    write_scene(births, replace(scene, clutter=None))
    write_scene(alarms, replace(scene, births=None))
    assert track(births).as_dict()["clutter"] == config.load().as_dict()["clutter"]
    assert track(alarms).as_dict()["birth"] == config.load().as_dict()["birth"]
    assert track(births, preset="m07").as_dict()["clutter"]["clutter_per_frame"] == 1.0
    assert track(alarms, preset="m07").as_dict()["birth"]["births_per_second"] == 0.25
    assert (
        track(births, "birth.births_per_detection=0").as_dict()["clutter"]["clutter_per_frame"]
        == 0.6
    )
    given = track(
        births, "birth.births_per_detection=0", "clutter.clutter_per_detection=1"
    ).as_dict()["clutter"]
    assert (given["clutter_per_frame"], given["clutter_per_detection"]) == (0.0, 1.0)
