"""The workload's scenes, the twins in NumPy that the tracker is compared on, and the benchmark of a
learned scene.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import scene
from benchmarks.loops import Ours, race
from benchmarks.parts import SMOKE
from benchmarks.stone_soup import batch_error
from benchmarks.twins import Twin, World
from benchmarks.workload import Crowd, draw, stages
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


def test_lives_end_and_others_begin() -> None:
    stream = draw(Crowd(30, 200, life=50), 1)
    identity, length = np.unique(stream.truth.identity, return_counts=True)
    assert len(identity) == pytest.approx(30 * 5, abs=5)
    assert length.max() == 50
    assert (np.bincount(stream.truth.frame)[1:] == 30).all()


def test_the_standard_error_sees_dependent_neighbours(
    rng: np.random.Generator,
) -> None:
    alone = rng.standard_normal(2000)
    assert batch_error(alone, 10) == pytest.approx(1 / np.sqrt(2000), rel=0.25)
    assert batch_error(np.repeat(alone[:200], 10), 10) == pytest.approx(1 / np.sqrt(200), rel=0.25)


def test_the_twins_find_what_phdtrack_finds() -> None:
    crowd = Crowd(6, 24)
    size = (float(crowd.info.width), float(crowd.info.height))
    world = World.of(crowd, image_volume(size) / (size[0] * size[1]))
    loops = [
        Ours(stages(crowd, worst=True), 1),
        Twin(world, 1, gated=True),
        Twin(world, 2, gated=False),
    ]
    laps = race(loops, draw(crowd, 2), 8)
    for lap in laps:
        assert len(lap.total) == 16
        assert (lap.total > 0).all()
        assert abs(lap.count.mean()) < 1.0
        assert lap.ospa.mean() < 15.0
    ours, gated, dense = (lap.ospa.mean() for lap in laps)
    assert abs(gated - ours) < 5.0
    assert abs(dense - ours) < 5.0
    masses = [
        loops[0].state.mass,
        loops[1].unit * loops[1].state.shape[1],
        loops[2].unit * loops[2].state.shape[1],
    ]
    assert np.ptp(masses) < 0.6


def test_ratios_of_a_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene, "FILTERS", ("gm-phd",))
    outcome = scene.run(SMOKE, lambda _: None)
    assert len(outcome.rows) == len(scene.CASES)
    assert all(0 < row.value < np.inf for row in outcome.rows)
    assert set(outcome.entries) == set(scene.KEYS)
