"""Learned scenes as settings: who they fit, and what does not fit them."""

import numpy as np
import pytest

from phdtrack import config
from phdtrack.context import ContextDensity, Learned, Scene, uniform_density, write_scene
from phdtrack.errors import InputError
from phdtrack.models.learned_scene import ContextBirth, ContextClutter
from phdtrack.types import SequenceInfo

INFO = SequenceInfo(640, 480, 25.0, 100)


def written(path, **changes):
    clutter = ContextDensity(
        np.zeros(4),
        np.array([640.0, 480, 640, 480]),
        0.5,
        np.ones(1),
        np.array([[600.0, 50, 20, 20]]).T,
        9 * np.eye(4)[None],
    )
    births = uniform_density(np.array([0.0, 0, -9, -9, 0, 0]), np.array([640.0, 480, 9, 9, 640, 480]))
    parts = {"width": 640, "height": 480, "rate": 25.0, "source": "street", "births": Learned(0.05, births, 99)}
    write_scene(path, Scene(**(parts | {"clutter": Learned(1.5, clutter, 30)} | changes)))
    return ["birth.kind=scene", f"birth.file={path}", "clutter.kind=scene", f"clutter.file={path}"]


@pytest.mark.parametrize("name", ["particle-phd", "gm-phd", "particle-cphd", "gm-cphd", "mht"])
def test_every_filter_takes_them(tmp_path, name):
    stages = config.build(config.load(sets=written(tmp_path / "scene.json")), INFO, name)
    assert type(stages.model.birth) is ContextBirth
    assert type(stages.model.clutter) is ContextClutter
    assert (stages.model.birth.rate, stages.model.clutter.rate) == (0.05, 1.5)
    rng = np.random.default_rng(0)
    state = stages.filter.start(stages.model, rng)
    for k in range(6):
        z = np.array([[100.0 + 3 * k, 600], [200, 50], [40, 20], [90, 20]])
        state, info = stages.filter.step(state, z, stages.model, 1.0, rng)
    found = stages.extractor.extract(state, z, stages.model)
    # The walker is found, and what fires where false alarms were marked is taken for one.
    assert info.clutter_probability[0] < 0.1
    assert info.clutter_probability[1] > info.clutter_probability[0]
    assert len(found) >= 1
    assert np.abs(found.state[:2] - z[:2, :1]).max(axis=0).min() < 10


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


def test_a_scene_without_a_file_is_told():
    with pytest.raises(InputError, match="needs a value for file"):
        config.load(sets=["birth.kind=scene"])


@pytest.mark.parametrize("world", ["plane", "point"])
def test_without_a_size_births_have_four_components(tmp_path, world):
    low, high = np.array([-10.0, 0, -3, -3]), np.array([10.0, 40, 3, 3])
    births = ContextDensity(low, high, 0.5, np.ones(1), np.array([[1.0, 2, 0, 1]]).T, np.eye(4)[None])
    rate = 1.0 if world == "plane" else 25.0
    file = written(tmp_path / "scene.json", births=Learned(0.3, births, 40), rate=rate)[1]
    kinds = [f"motion.kind={world}", "birth.kind=scene", file, "camera.region=[-10, 0, 10, 40]"]
    birth = config.build(config.load(sets=kinds[: 4 if world == "plane" else 3]), INFO).model.birth
    np.testing.assert_array_equal(birth.density.mean, births.mean)
    assert birth.observed == (0, 1)
    with pytest.raises(InputError, match="expected births of 6 components, got 4"):
        config.build(config.load(sets=["birth.kind=scene", file, f"time.rate={rate:g}"]), INFO)
