from __future__ import annotations

import numpy as np
import pytest

from experiments.standard_scenes import PointScene, linear_gaussian
from phdtrack.errors import InputError

# start x, vx, y, vy, first and last scan, as printed in the literature
TABLE = [
    (0, 0, 0, -10, 1, 70),
    (400, -10, -600, 5, 1, 101),
    (-800, 20, -200, -5, 1, 70),
    (400, -7, -600, -4, 20, 101),
    (400, -2.5, -600, 10, 20, 101),
    (0, 7.5, 0, -5, 20, 101),
    (-800, 12, -200, 7, 40, 101),
    (-200, 15, 800, -10, 40, 101),
    (-800, 3, -200, 15, 60, 101),
    (-200, -3, 800, -15, 60, 101),
    (0, -20, 0, -15, 80, 101),
    (-200, 15, 800, -5, 80, 101),
]


@pytest.fixture(scope="module")
def scene() -> PointScene:
    return linear_gaussian(np.random.default_rng(0))


def test_truth_equals_the_table(scene: PointScene) -> None:
    for scan in range(1, 101):
        expected = {
            who: (x + vx * (scan - b), y + vy * (scan - b), vx, vy)
            for who, (x, vx, y, vy, b, d) in enumerate(TABLE, 1)
            if b <= scan <= min(d, 100)
        }
        got = dict(
            zip(scene.identity[scan - 1].tolist(), scene.state[scan - 1].T.tolist(), strict=True)
        )
        assert got.keys() == expected.keys()
        for who, state in expected.items():
            assert got[who] == pytest.approx(state)
            assert abs(state[0]) <= 1000
            assert abs(state[1]) <= 1000


@pytest.mark.parametrize(("clutter_rate", "p_d"), [(30.0, 0.98), (60.0, 0.7), (0.0, 1.0)])
def test_measurements(clutter_rate: float, p_d: float) -> None:
    scene = linear_gaussian(np.random.default_rng(5), clutter_rate, p_d)
    errors = []
    seen = 0
    there = 0
    false = []
    for k in range(100):
        z = scene.measurement[k]
        source = scene.source[k]
        assert z.shape == (2, len(source))
        order = np.searchsorted(scene.identity[k], source[source > 0])
        assert (scene.identity[k][order] == source[source > 0]).all()
        errors.append(z[:, source > 0] - scene.state[k][:2, order])
        seen = seen + int((source > 0).sum())
        there = there + len(scene.identity[k])
        false.append(z[:, source == 0])
    assert abs(seen / there - p_d) <= 4 * np.sqrt(p_d * (1 - p_d) / there)
    error = np.concatenate(errors, axis=1)
    assert (np.abs(error.mean(axis=1)) < 4 * 10 / np.sqrt(seen)).all()
    assert (np.abs(error.std(axis=1) - 10) < 4 * 10 / np.sqrt(2 * seen)).all()
    clutter = np.concatenate(false, axis=1)
    n = clutter.shape[1]
    assert abs(n / 100 - clutter_rate) <= 4 * np.sqrt(clutter_rate / 100)
    assert (np.abs(clutter) <= 1000).all()
    if n:
        assert (np.abs(clutter.mean(axis=1)) < 4 * 1000 / np.sqrt(3 * n)).all()


def test_targets_do_not_depend_on_the_clutter() -> None:
    a, b = (linear_gaussian(np.random.default_rng(2), rate) for rate in (0.0, 60.0))
    for k in range(100):
        mine, other = (np.sort(s.measurement[k][:, s.source[k] > 0], axis=1) for s in (a, b))
        assert (mine == other).all()


def test_births_are_where_targets_start(scene: PointScene) -> None:
    mean = scene.model.birth_mean[:2].T
    for x, _, y, *_ in TABLE:
        assert np.hypot(*(mean - [x, y]).T).min() < 1


@pytest.mark.parametrize(("rate", "p_d"), [(-1, 0.9), (1, 1.5), (float("nan"), 0.5)])
def test_impossible_settings_are_refused(rate: float, p_d: float) -> None:
    with pytest.raises(InputError):
        linear_gaussian(np.random.default_rng(0), rate, p_d)
