"""Learned scenes as settings: what they add, and that they change nothing else."""

import pickle
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from experiments.common import uniform_density
from phdtrack import Tracker, config
from phdtrack.associate.graph import GraphMatching
from phdtrack.associate.labels import Labelled
from phdtrack.associate.rejection import FalseTrackRejection
from phdtrack.config.presets import PRESETS, preset_values
from phdtrack.config.registry import SECTIONS
from phdtrack.errors import InputError
from phdtrack.models.scene import SceneBirth, SceneClutter
from phdtrack.scene import (
    LearnedDensity,
    Scene,
    SceneDensity,
    TrackedObjects,
    write_scene,
)
from phdtrack.types import SequenceInfo

INFO = SequenceInfo(640, 480, 25.0, 100)
FOLLOWED = TrackedObjects(
    0.1, LearnedDensity(3.0, uniform_density(np.zeros(4), np.array([640.0, 480, 640, 480])), 80)
)


BOXES = [
    name for name in PRESETS if preset_values(name).get("motion", {}).get("kind", "box") == "box"
]
# Presets and filters, the usual preset of each filter among them.
CHOICES = list(product(["", *BOXES], SECTIONS["filter"]))


def written(path: Path, **changes) -> list[str]:
    """A scene with births and false alarms, but for the changes; the option that uses it."""
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
        "clutter": LearnedDensity(1.5, clutter, 30),
    }
    write_scene(path, Scene(**(parts | changes)))
    return [f"scene={path}"]


@pytest.mark.parametrize("name", ["particle-phd", "gm-phd", "particle-cphd", "gm-cphd", "mht"])
def test_every_filter_uses_a_learned_scene(tmp_path, name):
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
    # A walker, and a detection where false alarms were marked.
    assert info.clutter_probability[0] < min(0.1, info.clutter_probability[1])


@pytest.mark.parametrize(
    ("changes", "sets", "words"),
    [
        ({"width": 320}, [], "learned on frames of 320x480, and these are 640x480"),
        ({"rate": 10.0}, [], "10 time units a second, and there are 25"),
        ({}, ["motion.kind=plane"], "does not fit motion.kind=plane"),
        ({}, ['scene.use=["people"]'], "input should be 'births' or 'clutter'"),
    ],
)
def test_a_scene_that_does_not_fit_is_refused(tmp_path, changes, sets, words):
    with pytest.raises(InputError, match=words):
        config.build(config.load(sets=[*written(tmp_path / "scene.json", **changes), *sets]), INFO)


# A scene changes its own part alone


@pytest.mark.parametrize(("preset", "filter_name"), CHOICES)
def test_a_scene_changes_only_what_it_has_learned(tmp_path, preset, filter_name):
    """Of every filter and preset. What was not learned stays the same to the bit, and settings
    other than the scene's own keep their values.
    """
    path = tmp_path / "scene.json"

    def stages(*sets: str):
        return config.build(config.load(None, sets, preset, filter_name), INFO)

    plain = stages()
    nothing = stages(*written(path, births=None, clutter=None, followed=FOLLOWED))
    assert pickle.dumps(nothing) == pickle.dumps(plain)
    both = written(path, followed=FOLLOWED)
    for used, kept in (("births", "clutter"), ("clutter", "birth")):
        model = stages(*both, f'scene.use=["{used}"]').model
        assert pickle.dumps(getattr(model, kept)) == pickle.dumps(getattr(plain.model, kept))
    model = stages(*both).model
    assert pickle.dumps((model.motion, model.sensor)) == pickle.dumps(
        (plain.model.motion, plain.model.sensor)
    )
    assert model.birth.births_per_detection == plain.model.birth.births_per_detection
    assert model.clutter.clutter_per_detection == plain.model.clutter.clutter_per_detection
    before, after = (config.load(None, sets, preset, filter_name).as_dict() for sets in ((), both))
    assert {name for name in before if before[name] != after[name]} == {"scene"}


def test_an_empty_scene_gives_the_same_tracks(tmp_path):
    path = tmp_path / "scene.json"
    written(path, births=None, clutter=None)
    rng = np.random.default_rng(2)
    rows = []
    for section in ({}, {"scene": path}):
        rng = np.random.default_rng(2)
        tracker = Tracker((640, 480), **section)
        for k in range(12):
            walkers = np.array([[100.0 + 4 * k, 200, 140 + 4 * k, 300], [400, 150, 440, 250]])
            tracker.update(walkers + rng.normal(0, 1, (2, 4)))
        rows.append(tracker.tracks())
    assert len(rows[0]) > 10
    assert pickle.dumps(rows[0]) == pickle.dumps(rows[1])


def test_births_of_a_scene_follow_its_objects(tmp_path):
    sets = written(tmp_path / "scene.json", followed=FOLLOWED)
    model = config.build(config.load(sets=sets), INFO).model
    np.testing.assert_array_equal(model.birth.among.high, FOLLOWED.objects.density.high)


# Tracks that are held back


@pytest.mark.parametrize(
    ("name", "kind"), [("pmb", Labelled), ("gm-phd", GraphMatching), ("none", GraphMatching)]
)
def test_tracks_among_false_alarms_are_rejected(tmp_path, name, kind):
    sets = written(tmp_path / "scene.json", followed=FOLLOWED)
    rejecting = config.build(
        config.load(sets=[*sets, "associate.output_delay=3"]), INFO, name
    ).associator
    assert isinstance(rejecting, FalseTrackRejection)
    assert isinstance(rejecting.associator, kind)
    assert rejecting.associator.output_delay == 3
    ratio = rejecting.ratio
    assert (ratio.clutter.rate, ratio.tracked.share, ratio.births.rate) == (1.5, 0.1, 0.05)
    # Births count if they are used.
    alone = config.build(config.load(sets=[*sets, 'scene.use=["clutter"]']), INFO, name).associator
    assert isinstance(alone, FalseTrackRejection)
    assert alone.ratio.births is None
    # No track is, if nobody has looked, or false alarms are not the scene's.
    before = written(tmp_path / "before.json")
    for given in (before, [*sets, 'scene.use=["births"]']):
        assert isinstance(config.build(config.load(sets=given), INFO, name).associator, kind)


def test_a_scene_is_named_on_top_of_a_file(tmp_path):
    path = tmp_path / "my yard.json"
    written(path)
    file = tmp_path / "mine.toml"
    file.write_text(f'scene = "{path}"\n[birth]\nbirths_per_detection = 0\n', encoding="utf-8")
    found = config.load(file).as_dict()
    assert found["scene"] == {"file": str(path), "use": ("births", "clutter")}
    assert found["birth"]["births_per_detection"] == 0
    assert config.load(sets=[f"scene={path}"]).as_dict()["scene"]["file"] == str(path)
