import json

import numpy as np
import pytest

from experiments.common import uniform_density
from phdtrack.errors import InputError
from phdtrack.scene import (
    LearnedDensity,
    Scene,
    SceneDensity,
    TrackedObjects,
    read_scene,
    write_scene,
)


def scene():
    cov = np.array([[[9.0, 1, 0, 0], [1, 4, 0, 0], [0, 0, 2, 0], [0, 0, 0, 3]]])
    clutter = SceneDensity(
        np.zeros(4), np.full(4, 100.0), 0.3, np.ones(1), np.full((4, 1), 50.0), cov
    )
    births = uniform_density(np.full(6, -10.0), np.full(6, 10.0))
    followed = TrackedObjects(
        0.35,
        LearnedDensity(
            4.25, SceneDensity(clutter.low, clutter.high, 0.6, np.ones(1), clutter.mean, cov), 170
        ),
    )
    learned = LearnedDensity(0.02, births, 320), LearnedDensity(1.5, clutter, 1800)
    return Scene(640, 480, 25.0, "street.mp4", *learned, {"held out": -17.25}, followed)


def test_written_file_is_read_back(tmp_path):
    path = tmp_path / "scene.json"
    write_scene(path, scene())
    back = read_scene(path)
    assert (back.width, back.height, back.rate, back.source) == (640, 480, 25.0, "street.mp4")
    assert back.notes == {"held out": -17.25}
    assert back.followed.share == 0.35
    parts = [(s.births, s.clutter, s.followed.objects) for s in (scene(), back)]
    for mine, read in zip(*parts, strict=True):
        assert (read.rate, read.samples) == (mine.rate, mine.samples)
        for name in ("low", "high", "uniform", "weight", "mean", "covariance"):
            np.testing.assert_array_equal(getattr(read.density, name), getattr(mine.density, name))
    assert [file.name for file in tmp_path.iterdir()] == ["scene.json"]


def test_scene_parts_are_optional(tmp_path):
    path = tmp_path / "scene.json"
    write_scene(path, Scene(640, 480, 25.0, "street.mp4"))
    back = read_scene(path)
    assert (back.births, back.clutter, back.followed) == (None, None, None)
    write_scene(path, scene())
    document = json.loads(path.read_text())
    del document["followed"]
    path.write_text(json.dumps(document))
    back = read_scene(path)
    assert back.followed is None
    assert (back.births.rate, back.clutter.rate) == (0.02, 1.5)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda document: document.update(format=7), "format 1, got 7"),
        (lambda document: document.pop("width"), "KeyError 'width'"),
        (lambda document: document["clutter"].update(rate=-1), "a rate from 0"),
        (lambda document: document["clutter"].update(weight=[0.4]), "with sum 1"),
        (
            lambda document: document["births"].update(low=[0, 0]),
            "from 0 and 6 components, got 0.02 and 2",
        ),
        (lambda document: document["followed"].update(share=1.5), "a share from 0 to 1, got 1.5"),
        (
            lambda document: document["followed"].update(share=float("nan")),
            "a share from 0 to 1, got nan",
        ),
        (
            lambda document: document["followed"].update(objects=document["births"]),
            "and 4 components, got 0.02 and 6",
        ),
        (lambda document: document["followed"].pop("share"), "KeyError 'share'"),
    ],
)
def test_malformed_scene_files_are_refused(tmp_path, spoil, words):
    path = tmp_path / "scene.json"
    write_scene(path, scene())
    document = json.loads(path.read_text())
    spoil(document)
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=words):
        read_scene(path)
    with pytest.raises(InputError, match="there is no such file"):
        read_scene(tmp_path / "none.json")
    path.write_text("hello")
    with pytest.raises(InputError, match="expected JSON"):
        read_scene(path)
