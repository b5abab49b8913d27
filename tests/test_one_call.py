"""Frames in few compiled calls: the same rows as by the methods of every part, to the bit."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest

from phdtrack import Detections, Tracker, Tracks, config
from phdtrack.arrays import to_cxcywh
from phdtrack.kernels.box import centres_and_sizes
from phdtrack.kernels.grid import may_be_crowded, uncrowded
from phdtrack.models import BoxSensor
from phdtrack.types import SequenceInfo

FRAMES = 60
SIZE = (640, 480)


@dataclass(frozen=True, slots=True)
class OwnSensor(BoxSensor):
    """The sensor of boxes, of another type, which the compiled steps for boxes do not know."""


def frames(rng: np.random.Generator, moving: float) -> list[np.ndarray]:
    """Eight boxes that cross, with scores, misses and false alarms, before a camera that moves."""
    place = rng.uniform(50, 400, (8, 2))
    speed = rng.normal(0, 3, (8, 2))
    out = []
    for k in range(FRAMES):
        seen = (place + k * speed + moving * k)[rng.random(8) < 0.85]
        corner = np.vstack([seen + rng.normal(0, 1.5, seen.shape), rng.uniform(0, 400, (3, 2))])
        score = np.concatenate([rng.uniform(0.4, 1, len(seen)), rng.uniform(0.05, 0.6, 3)])
        out.append(np.column_stack([corner, corner + np.array([30, 70]), score]))
    return out


def rows(tracker: Tracker, boxes: list[np.ndarray]) -> list[np.ndarray]:
    """The columns of all online and corrected rows."""
    online = Tracks.concatenate([tracker.update(each) for each in boxes])
    both = (online, tracker.tracks())
    names = [name for name in Tracks.__slots__ if name != "data"]
    return [getattr(part, name) for part in both for name in names]


@pytest.mark.parametrize("scaling", ["particle", "fixed", "detection"])
@pytest.mark.parametrize("moving", [0.0, 4.0])
def test_boxes_in_one_call_give_the_same_rows(
    rng: np.random.Generator, scaling: str, moving: float
) -> None:
    loaded = config.load(sets=[f"sensor.scaling={scaling}", "motion.scaled_noise=true"])
    stages = config.build(loaded, SequenceInfo(*SIZE, 25.0))
    sensor = stages.model.sensor
    own = OwnSensor(**{each.name: getattr(sensor, each.name) for each in fields(sensor)})
    boxes = frames(rng, moving)
    usual = rows(Tracker(stages=stages, fps=25), boxes)
    plain = rows(
        Tracker(stages=replace(stages, model=replace(stages.model, sensor=own)), fps=25), boxes
    )
    assert len(usual[0]) > 200
    for one, other in zip(usual, plain, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("where", [(3, 1), (5, 4)])
def test_number_that_is_not_finite_is_found(where: tuple[int, int]) -> None:
    boxes = np.column_stack([frames(np.random.default_rng(0), 0.0)[0]])
    boxes[where] = np.nan
    with pytest.raises(ValueError, match=f"row {where[0]} .* is not finite"):
        Tracker(SIZE).update(boxes)
    whole = Detections.of(boxes[:, :4], boxes[:, 4])
    with pytest.raises(ValueError, match=f"row {where[0]} .* is not finite"):
        Tracker(SIZE).update(whole)


@pytest.mark.parametrize("seed", range(20))
def test_no_point_is_dropped_where_none_may_be_crowded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 60))
    at = rng.uniform(0, rng.choice([10, 100]), (2, n))
    half = rng.uniform(1, 8, (2, n))
    for most in (1, 4, 12):
        crowded = may_be_crowded(at, half, most)
        inside = (np.abs(at[:, :, None] - at[:, None]) <= half[:, :, None]).all(axis=0)
        assert crowded == (inside.sum(axis=1) > most).any()
        assert crowded or uncrowded(at, half, most).all()


def test_points_that_are_not_finite_are_in_no_place() -> None:
    at = np.zeros((2, 4))
    assert may_be_crowded(at, np.ones((2, 4)), 3)
    at[0, 1] = np.nan
    assert not may_be_crowded(at, np.ones((2, 4)), 3)


def test_compiled_centres_and_sizes_are_the_plain_ones() -> None:
    boxes = np.random.default_rng(0).uniform(0, 100, (9, 4))
    for some in (boxes, boxes[:0]):
        np.testing.assert_array_equal(centres_and_sizes(some), to_cxcywh(some))


LOADED = """
import sys
from phdtrack import Tracker
print(*sys.modules)
"""


def test_importing_the_tracker_loads_no_large_package() -> None:
    """SciPy itself is loaded by Numba, which asks for its version; none of its parts is."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    large = {"cv2", "pydantic", "matplotlib", "scipy.linalg", "scipy.special", "scipy.optimize"}
    assert loaded & (large | {"pandas", "fastapi", "onnxruntime"}) == set()
    assert "phdtrack.tracker" in loaded
