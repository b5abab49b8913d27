"""The past as hypotheses tell it, against a naive twin, on layers made up at random and on those of a filter."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from phdtrack.filters.bernoullis import Bernoullis, Layer
from phdtrack.filters.extract import BestBernoullis
from phdtrack.kernels.pmb_past import earlier, reported
from phdtrack.models import BoxMotion, BoxSensor, LocalClutter, MeasurementBirth
from phdtrack.protocols import Model
from reference import past_twin as twin

MODEL = Model(BoxMotion(), BoxSensor(), MeasurementBirth(volume="local"), LocalClutter(1.0))


def history(rng: np.random.Generator, frames: int, stubborn: float) -> Bernoullis:
    """Targets that come and go, with hypotheses whose parents are any of the target's; ``stubborn``: how often the best one
    is that of the best before."""
    layers: list[Layer] = []
    ended, fresh = np.zeros((2, 0), np.int64), 0
    labels, of, best, believed = np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
    for _ in range(frames):
        stay = rng.random(len(labels)) < 0.85
        gone = np.flatnonzero(~stay & (best >= 0) & (believed > 0.05))
        ended = np.hstack([ended + np.array([[1], [0]]), np.vstack([np.ones(len(gone), np.int64), best[gone]])])
        came = int(rng.integers(0, 4))
        before, old = of, np.flatnonzero(stay)
        labels = np.concatenate([labels[stay], fresh + np.arange(came)])
        fresh += came
        several = rng.integers(1, 4, len(labels))
        first = np.concatenate([[0], np.cumsum(several)])
        of = np.repeat(np.arange(len(labels)), several)
        parent = np.full(len(of), -1)
        for c, t in enumerate(of):
            if t < len(old):
                parent[c] = rng.choice(np.flatnonzero(before == old[t]))
        leading = np.array([rng.integers(a, b) for a, b in itertools.pairwise(first)], np.int64)
        for t in range(len(old)):
            if best[old[t]] >= 0 and rng.random() < stubborn:
                parent[leading[t]] = best[old[t]]
        presence = rng.uniform(0, 1, len(labels))
        best = np.where(rng.random(len(labels)) < 0.1, -1, leading)
        believed = np.maximum(presence, np.concatenate([believed[stay], np.zeros(came)]))
        count = len(of)
        mean = rng.uniform(50, 2000, (6, count))
        mean[4:] = 5.0
        layers.append(
            Layer(
                presence, labels, first, np.ones(count), mean, rng.normal(0, 1, (count, 6, 6)), np.zeros(count, np.bool_),
                np.zeros(count), rng.integers(-1, 9, count), parent, best, presence, believed,
            )
        )  # fmt: skip
    return Bernoullis(tuple(layers), ended, fresh)


def as_lists(state: Bernoullis) -> list[dict]:
    names = ("label", "best", "presence", "believed", "target", "parent")
    return [{name: getattr(layer, name).tolist() for name in names} for layer in state.layers]


@pytest.mark.parametrize("stubborn", [0.0, 0.9, 1.0])
@pytest.mark.parametrize("seed", range(8))
def test_the_past_is_that_of_the_twin(seed: int, stubborn: float):
    least, total = 0.5, 0
    state = history(np.random.default_rng(seed), 7, stubborn)
    wanted = twin.told(as_lists(state), [tuple(x) for x in state.ended.T.tolist()], least)
    found = BestBernoullis(least, merge_iou=1.0).extract(state, np.zeros((4, 0)), MODEL)
    assert len(found.past) == 6
    assert [e is None for e in found.past[::-1]] == [k >= len(wanted) for k in range(6)]
    for told, layer, estimates in zip(wanted, state.layers[-2::-1], found.past[::-1], strict=False):
        shown = sorted((label, c, r) for label, (c, r) in told.items() if r >= least)
        assert estimates.tag.tolist() == [label for label, *_ in shown]
        at = [c for _, c, _ in shown]
        np.testing.assert_array_equal(estimates.state, layer.mean[:, at])
        np.testing.assert_array_equal(estimates.covariance, layer.covariance[at])
        np.testing.assert_array_equal(estimates.detection, layer.detection[at])
        np.testing.assert_array_equal(estimates.weight, [r for *_, r in shown])
        total += len(shown)
    assert total or stubborn


def test_nobody():
    none, zeros, start = np.zeros(0, np.int64), np.zeros(0), np.zeros(1, np.int64)
    *told, same = earlier(none, zeros, none, zeros, none, start, zeros, zeros, np.zeros((2, 0), np.int64), 1, 0.5)
    assert same
    assert [len(x) for x in told] == [0, 0, 0, 0]
    shown = reported(none, zeros, 0.5, np.zeros((6, 0)), np.zeros((0, 6, 6)), none, none)
    assert [x.shape for x in shown] == [(6, 0), (0, 6, 6), (0,), (0,), (0,)]
