"""The workload's scenes, and that the twins in NumPy do the job that they are compared on."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.loops import Ours, race
from benchmarks.stone_soup import batch_error
from benchmarks.twins import Twin, World, in_rectangles
from benchmarks.workload import Crowd, draw, stages
from phdtrack.arrays import to_cxcywh
from phdtrack.models.volumes import image_volume


def test_the_density_is_the_same_at_every_size() -> None:
    for targets in (10, 90):
        crowd = Crowd(targets, 100)
        stream = draw(crowd, 1)
        info = crowd.info
        assert info.width * info.height == pytest.approx(targets / 10 * 720 * 480, rel=0.01)
        assert len(stream.truth) == 100 * targets
        assert len(stream.table) / 100 == pytest.approx(1.95 * targets, rel=0.05)
        box = stream.truth.xyxy
        assert box.min() >= -1e-9
        assert box[:, 2].max() <= info.width + 1e-9
        assert box[:, 3].max() <= info.height + 1e-9


def test_targets_move_steadily_and_turn_at_the_borders() -> None:
    stream = draw(Crowd(20, 400), 3)
    centre = (stream.truth.xyxy[:, :2] + stream.truth.xyxy[:, 2:]).reshape(400, 20, 2) / 2
    step = np.abs(np.diff(centre, axis=0))
    size = (stream.truth.xyxy[:, 2:] - stream.truth.xyxy[:, :2]).reshape(400, 20, 2)
    assert np.allclose(np.median(step / size[1:], axis=0), np.max(step / size[1:], axis=0), atol=1e-9)
    assert (stream.truth.identity.reshape(400, 20) == np.arange(1, 21)).all()


def test_lives_end_and_others_begin() -> None:
    stream = draw(Crowd(30, 200, life=50), 1)
    identity, length = np.unique(stream.truth.identity, return_counts=True)
    assert len(identity) == pytest.approx(30 * 5, abs=5)
    assert length.max() == 50
    assert (np.bincount(stream.truth.frame)[1:] == 30).all()


def test_detections_are_those_of_the_crowd() -> None:
    crowd = Crowd(50, 300, clutter=0.0, p_detect=0.8, jitter=0.1)
    stream = draw(crowd, 1)
    assert len(stream.table) / len(stream.truth) == pytest.approx(0.8, abs=0.01)
    heights = [np.mean(boxes[:, 3] - boxes[:, 1]) for boxes in (stream.table.detections.xyxy, stream.truth.xyxy)]
    assert heights[0] == pytest.approx(heights[1], rel=0.01)


def test_errors_may_be_in_pixels() -> None:
    stream = draw(Crowd(50, 200, clutter=0.0, p_detect=1.0, noise=(1.5, 2.5)), 1)
    found, true = (to_cxcywh(boxes) for boxes in (stream.table.detections.xyxy, stream.truth.xyxy))
    # The detections of a frame come in any order: the nearest centre is the true one, but for few.
    errors = np.concatenate(
        [
            f[:, np.abs(f[:2, :, None] - t[:2, None, :]).sum(0).argmin(0)] - t
            for f, t in zip(np.split(found, 200, 1), np.split(true, 200, 1), strict=True)
        ],
        axis=1,
    )
    deviation = 1.4826 * np.median(np.abs(errors), axis=1)
    assert deviation == pytest.approx([1.5, 1.5, 2.5, 2.5], rel=0.1)


def test_the_standard_error_sees_that_neighbours_depend_on_each_other(rng: np.random.Generator) -> None:
    alone = rng.standard_normal(2000)
    assert batch_error(alone, 10) == pytest.approx(1 / np.sqrt(2000), rel=0.25)
    assert batch_error(np.repeat(alone[:200], 10), 10) == pytest.approx(1 / np.sqrt(200), rel=0.25)


def test_rectangles_by_grid_are_all_rectangles(rng: np.random.Generator) -> None:
    x, y = rng.uniform(-5, 105, (2, 300))
    corner, size = rng.uniform(0, 100, (2, 40)), rng.uniform(1, 20, (2, 40))
    lower, upper = corner, corner + size
    point, which = in_rectangles(x, y, lower, upper)
    table = (x[:, None] >= lower[0]) & (x[:, None] <= upper[0]) & (y[:, None] >= lower[1]) & (y[:, None] <= upper[1])
    assert sorted(zip(point, which, strict=True)) == sorted(zip(*np.nonzero(table), strict=True))
    assert (np.diff(point) >= 0).all()
    assert len(in_rectangles(x, y, lower[:, :0], upper[:, :0])[0]) == 0


def test_the_twins_find_what_phdtrack_finds() -> None:
    crowd = Crowd(6, 24)
    size = (float(crowd.info.width), float(crowd.info.height))
    world = World.of(crowd, image_volume(size) / (size[0] * size[1]))
    loops = [Ours(stages(crowd, worst=True), 1), Twin(world, 1, gated=True), Twin(world, 2, gated=False)]
    laps = race(loops, draw(crowd, 2), 8)
    for lap in laps:
        assert len(lap.total) == 16
        assert (lap.total > 0).all()
        assert abs(lap.count.mean()) < 1.0
        assert lap.ospa.mean() < 15.0
    ours, gated, dense = (lap.ospa.mean() for lap in laps)
    assert abs(gated - ours) < 5.0
    assert abs(dense - ours) < 5.0
    masses = [loops[0].state.mass, loops[1].unit * loops[1].state.shape[1], loops[2].unit * loops[2].state.shape[1]]
    assert np.ptp(masses) < 0.6
