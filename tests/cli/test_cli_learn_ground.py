"""``phdtrack learn`` and ``track --scene`` where people walk on the ground: births are places in metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack

from phdtrack.models import PlaneSensor
from phdtrack.scene import read_scene
from plane_cases import LevelCamera

CAMERA, RATE, FRAMES, EVERY, STAY = LevelCamera(), 7.0, 560, 8, 26
# Two doors and the ways of those who come out of them, metres and metres per second.
DOORS = np.array([[-5.0, 18, 1.2, 0.1], [5, 24, -1.1, 0.0]])


@pytest.fixture(scope="module")
def walkers(tmp_path_factory) -> Path:
    """Detections and truth of people who come out of the doors in turn, and the camera's homography."""
    folder, rng, person = tmp_path_factory.mktemp("walkers"), np.random.default_rng(0), PlaneSensor(camera=CAMERA)
    c, f, h, horizon = CAMERA.centre, CAMERA.focal, CAMERA.height, CAMERA.horizon
    np.savetxt(folder / "H.txt", [[h, 0, -c * h], [0, 0, f * h], [0, 1, -horizon]])
    seen, true = [], []
    for who, begin in enumerate(range(3, FRAMES - STAY, EVERY), start=1):
        at = DOORS[who % 2] + rng.normal(0, 0.3, 4) * [1, 1, 0.2, 0.2]
        for k in range(STAY):
            x = at.copy()
            x[:2] += x[2:] * k / RATE
            box = person.boxes(x[:, None])[0]
            true.append((begin + k, who, *box[:2], *(box[2:] - box[:2]), 1, 1, 1))
            size = np.tile(box[2:] - box[:2], 2)
            box = box + size * rng.normal(0, 1, 4) * [0.03, 0.02, 0.03, 0.02]
            if rng.random() < 0.9:
                seen.append((begin + k, -1, *box[:2], *(box[2:] - box[:2]), 1, -1, -1, -1))
    np.savetxt(folder / "det.txt", sorted(seen), fmt="%g", delimiter=",")
    np.savetxt(folder / "gt.txt", sorted(true), fmt="%g", delimiter=",")
    return folder


def options(walkers: Path) -> tuple:
    given = ("--detections", walkers / "det.txt", "--frame-size", "640x480", "--fps", RATE, "--set", "motion.kind=plane")
    return (*given, "--set", f"camera.file={walkers / 'H.txt'}", "--set", "camera.max_distance=40")


@pytest.fixture(scope="module")
def scene(walkers: Path) -> Path:
    said = phdtrack("learn", *options(walkers), "--out", walkers / "scene.json")
    assert said.status == 0, said.err
    assert "for boxes in the image only" in said.out
    return walkers / "scene.json"


def test_doors_are_learned_in_metres(scene: Path):
    learned = read_scene(scene)
    births = learned.births
    assert learned.rate == 1
    assert births.density.dim == 4
    assert births.rate == pytest.approx(RATE / EVERY, rel=0.15)
    heaviest = np.argsort(-births.density.weight)[:2]
    found = births.density.mean[:, heaviest]
    for door in DOORS:
        assert np.abs(found - door[:, None]).max(axis=0).min() < 0.8
    assert births.density.uniform < 0.3
    assert learned.clutter is None
    assert learned.notes["births gain"] > 1
    assert scene.with_suffix(".html").read_text().count("<img") == 1, "a plan of the births"


@pytest.mark.parametrize("name", ["particle-phd", "gm-phd"])
def test_who_comes_out_of_a_door_is_followed(walkers: Path, scene: Path, name: str, tmp_path: Path):
    told = ("--truth", walkers / "gt.txt", "--filter", name, "--no-video", "--json", "--scene", scene)
    scores = phdtrack("track", *options(walkers), *told, "--out", tmp_path / "run").object["scores"]
    assert scores["MOTA"] > 0.75
    assert scores["false_tracks"] == 0
