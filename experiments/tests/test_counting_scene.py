"""The scene with a known model keeps to it: statistics within 4 standard errors at fixed seeds."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.counting_scene import Counting
from phdtrack.arrays import to_cxcywh
from phdtrack.errors import InputError
from phdtrack.types import Truth


def counts(truth: Truth, frames: int) -> np.ndarray:
    """(frames,) number of targets in each frame."""
    return np.bincount(truth.frame, minlength=frames + 1)[1 : frames + 1]


def test_noise_of_the_motion() -> None:
    """One step from equal states: mean, standard deviations and correlations as M09 (11) says."""
    n = 40000
    w = 30.0
    h = 80.0
    x = np.tile(np.array([[100.0], [200], [3], [-2], [w], [h]]), n)
    y = Counting(5).step(x, np.random.default_rng(0))
    mean = np.array([103, 198, 3, -2, w, h])
    sd = np.array([0.015 * w, 0.015 * h, 0.03 * w, 0.03 * h, 0.1 * w, 0.1 * h])
    assert (np.abs(y.mean(axis=1) - mean) < 4 * sd / np.sqrt(n)).all()
    assert (np.abs(y.std(axis=1) - sd) < 4 * sd / np.sqrt(2 * n)).all()
    expected = np.eye(6)
    expected[[0, 2, 1, 3], [2, 0, 3, 1]] = 1  # one noise drives position and velocity of an axis
    assert np.abs(np.corrcoef(y) - expected).max() < 4 / np.sqrt(n)


def test_second_differences_of_the_truth() -> None:
    """c(k+1) − 2c(k) + c(k−1) = (w(k−1) n(k−1) + w(k) n(k)) / 2: its scaled values have the
    standard deviation 0.03.
    """
    truth = Counting(40, sd_size=0.02).figures(np.random.default_rng(2))
    scaled = []
    for identity in np.unique(truth.identity):
        box = to_cxcywh(truth.xyxy[truth.identity == identity])
        for axis in (0, 1):
            size = box[2 + axis]
            scaled.append(np.diff(box[axis], 2) / (0.5 * np.hypot(size[:-2], size[1:-1])))
    values = np.concatenate(scaled)
    assert len(values) > 5000
    # neighbours share a noise term (correlation 1/2): the standard error of the variance grows by
    # √(1 + 2/4)
    assert abs(values.std() / 0.03 - 1) < 4 * np.sqrt(1.5 / (2 * len(values)))


def test_expected_number_stays() -> None:
    """The number is n in every frame on average: 60 runs, with the variance of survivors and
    Poisson births.
    """
    world = Counting(10, frames=100)
    n = 10
    runs = 60
    number = np.array(
        [counts(world.figures(np.random.default_rng(seed)), 100) for seed in range(runs)]
    )
    assert (number[:, 0] == n).all()
    for frame in (49, 99):
        kept = 0.99**frame
        spread = np.sqrt(n * kept * (1 - kept) + n * (1 - kept))
        assert abs(number[:, frame].mean() - n) < 4 * spread / np.sqrt(runs)


def test_leaving_targets_are_gone_and_others_go_on() -> None:
    for leaving in (True, False):
        world = Counting(30, width=200, height=200, leaving=leaving, frames=100)
        x, y, w, h = to_cxcywh(world.figures(np.random.default_rng(0)).xyxy)
        inside = (x >= 0) & (x < 200) & (y >= 0) & (y < 200)
        assert inside.all() == leaving
        assert (w > 0).all()
        assert (h > 0).all()


@pytest.mark.parametrize(
    "bad", [{"n": -1}, {"p_survive": 1.1}, {"frames": 0}, {"birth_height": (0.0, 10.0)}]
)
def test_impossible_settings_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(InputError, match="counting scene"):
        Counting(**bad)  # type: ignore[arg-type]
