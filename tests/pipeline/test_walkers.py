"""People on the ground, seen by a jittery detector with misses and false alarms: every filter gives
sensible tracks.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phdtrack import Tracker
from phdtrack.metrics import Scores, evaluate
from phdtrack.models import PlaneSensor
from phdtrack.types import Detections, Truth
from plane_cases import FRAME, LevelCamera

CAMERA = LevelCamera()
RATE = 7.0
FRAMES = 50
# Place at the first frame and velocity, metres and metres per second; two pairs cross each other's
# way.
WALKS = np.array([[-5, 18, 1.2, 0.1], [5, 22, -1.1, 0], [-1, 14, 0, 1.0], [-4, 30, 0.7, -1.1]]).T


@pytest.fixture
def camera_file(tmp_path) -> Path:
    """The homography of the camera, from pixels to metres."""
    c = CAMERA.centre
    f = CAMERA.focal
    h = CAMERA.height
    horizon = CAMERA.horizon
    path = tmp_path / "H.txt"
    np.savetxt(path, [[h, 0, -c * h], [0, 0, f * h], [0, 1, -horizon]])
    return path


def scene(
    seed: int, p_detect: float = 0.85, clutter: float = 0.4
) -> tuple[Truth, list[np.ndarray]]:
    """Truth, and detections whose foot points deviate by 6 % of the width and 2 % of the height."""
    rng = np.random.default_rng(seed)
    person = PlaneSensor(camera=CAMERA)
    rows = []
    frames = []
    for k in range(FRAMES):
        x = WALKS.copy()
        x[:2] += x[2:] * k / RATE
        boxes = person.boxes(x)
        rows += [(k + 1, i + 1, *box) for i, box in enumerate(boxes)]
        seen = boxes[rng.random(len(boxes)) < p_detect]
        size = np.tile(seen[:, 2:] - seen[:, :2], 2)
        seen = seen + size * rng.normal(0, 1, seen.shape) * [0.03, 0.02, 0.03, 0.02]
        n = rng.poisson(clutter)
        false = np.stack([rng.uniform(-6, 6, n), rng.uniform(12, 32, n), np.zeros(n), np.zeros(n)])
        frames.append(np.vstack([seen, person.boxes(false)]))
    table = np.array(rows)
    frame, identity = table[:, :2].T.astype(np.int64)
    return Truth(frame, identity, table[:, 2:], np.zeros(len(table), np.bool_)), frames


def tracked(tracker: Tracker, seed: int) -> tuple[Scores, np.ndarray]:
    truth, frames = scene(seed)
    mass = []
    for boxes in frames:
        tracker.update(boxes)
        mass.append(tracker.step.info.mass)
    return evaluate(truth, tracker.tracks(), frames=FRAMES), np.array(mass)


@pytest.mark.parametrize(
    ("filter_", "extract"),
    [
        ({"kind": "pmb"}, {}),
        ({"kind": "pmb", "transform": "unscented"}, {}),
        ({"kind": "gm-phd"}, {}),
        ({"kind": "gm-cphd"}, {}),
        ({"kind": "particle-phd", "particles_per_target": 400}, {"kind": "kmeans"}),
        ({"kind": "particle-phd", "particles_per_target": 400}, {"kind": "mixture"}),
        ({"kind": "particle-cphd", "particles_per_target": 400}, {}),
    ],
    ids=["pmb", "pmb, unscented", "gm-phd", "gm-cphd", "kmeans", "mixture", "particle-cphd"],
)
def test_walkers_are_followed(filter_, extract, camera_file):
    """Mean of two realisations: four people are found, and counted to 15 % on average."""
    results = [
        tracked(
            Tracker(
                FRAME, fps=RATE, seed=seed, filter=filter_, extract=extract,
                motion={"kind": "plane"},
                camera={"file": str(camera_file)},
            ),
            seed,
        )
        for seed in range(2)
    ]  # fmt: skip
    scores, masses = zip(*results, strict=True)
    assert np.mean([s.MOTA for s in scores]) > 0.75
    assert np.mean([s.IDF1 for s in scores]) > 0.75
    assert np.mean([mass[5:].mean() for mass in masses]) == pytest.approx(4, rel=0.15)


@pytest.mark.parametrize("kind", ["pmb", "gm-phd", "particle-phd"])
def test_the_preset_of_e13_runs_with_any_filter(kind: str, camera_file):
    """Births are at E13's places, so that walkers elsewhere are none of its; with births about
    detections they are.
    """
    given = {"preset": "e13", "camera": {"file": str(camera_file)}, "filter": kind}
    elsewhere = Tracker(FRAME, fps=RATE, **given)
    near = Tracker(FRAME, fps=RATE, **given, birth={"kind": "ground"}, clutter={"density": 1e-3})
    away = []
    count = []
    for k, boxes in enumerate(scene(0, p_detect=0.7)[1]):
        elsewhere.update(boxes)
        near.update(boxes)
        place = WALKS[:2] + WALKS[2:] * k / RATE
        found = near.step.estimates.state
        away += np.hypot(*(found[:2, :, None] - place[:, None, :])).min(axis=1).tolist()
        count.append(near.step.info.mass)
    assert elsewhere.step.info.mass < 1
    assert np.mean(count[5:]) == pytest.approx(4, abs=0.8)
    assert len(away) > 2 * FRAMES
    assert np.median(away) < 0.5


@pytest.mark.parametrize(
    ("kind", "seed"), [("pmb", 0), *(("particle-phd", seed) for seed in range(8))]
)
def test_runners_are_not_lost_at_their_birth(kind: str, seed: int):
    """Two who cross the frame at 5 pixels a frame, seen clearly: the particle filter keeps two
    identities at any seed.
    """
    noise = np.random.default_rng(3).normal(0, 1, (40, 2, 2))
    tracker = Tracker((320, 240), seed=seed, filter=kind)
    for k in range(1, 41):
        corner = np.array([[20.0 + 5 * k, 60], [270.0 - 5 * k, 150]]) + noise[k - 1]
        tracker.update(np.hstack([corner, corner + np.array([24, 60])]))
    assert set(tracker.tracks().identity) == {1, 2}


@pytest.mark.parametrize("count", [3, 5])
def test_people_who_stand_in_a_circle_are_all_tracked(count: int) -> None:
    """0.7 m beside each other, seen with an error of 0.2 m, for 100 s."""
    rng = np.random.default_rng(count)
    angle = 2 * np.pi * np.arange(count) / count
    radius = 0.35 / np.sin(np.pi / count)
    place = 6 + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    tracker = Tracker(
        (1, 1),
        fps=2.5,
        motion={"kind": "plane"},
        camera={"region": [0.0, 0.0, 12.0, 12.0]},
        extract={"merge_iou": 1.0},
    )
    for _ in range(250):
        seen = place[rng.random(count) < 0.9]
        seen = seen + 0.2 * rng.standard_normal(seen.shape)
        seen = np.vstack([seen, rng.uniform(0, 12, (rng.poisson(0.5), 2))])
        n = len(seen)
        found = Detections(
            np.hstack([seen - 0.3, seen + 0.3]),
            np.ones(n),
            np.zeros(n, np.int64),
            np.tile(0.04 * np.eye(4), (n, 1, 1)),
        )
        tracker.update(found)
    rows = tracker.tracks()
    middle = (rows.xyxy[:, :2] + rows.xyxy[:, 2:]) / 2
    there = np.hypot(*(middle - 6).T) < radius + 0.6
    assert there.sum() == pytest.approx(250 * count, rel=0.1)
