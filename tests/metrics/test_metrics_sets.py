"""OSPA, GOSPA, T-GOSPA and RMSE: against Stone Soup, against twins that try every mapping, and by
their laws.
"""

import datetime
import importlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from metric_cases import close, perfect, random_case, real_case

from experiments.scans import ospa
from phdtrack.errors import InputError
from phdtrack.metrics import evaluate, rmse_per_target, tgospa_boxes
from phdtrack.metrics.tgospa import tgospa
from phdtrack.types import Tracks
from reference import metrics_twins as twins

stonesoup = importlib.import_module("stonesoup")
from stonesoup.base import Property  # noqa: E402
from stonesoup.measures import Euclidean, Measure  # noqa: E402
from stonesoup.metricgenerator.ospametric import GOSPAMetric, OSPAMetric  # noqa: E402
from stonesoup.types.state import State  # noqa: E402

NOW = datetime.datetime(2009, 7, 6)
seeds = st.integers(0, 2**32 - 1)


class BoxDistance(Measure):
    """1 − IoU of two xyxy state vectors, in plain Python."""

    mapping: tuple = Property(default=None)

    def __call__(self, state1, state2):
        a, b = (tuple(float(v) for v in s.state_vector.ravel()) for s in (state1, state2))
        return 1 - twins.overlap(a, b)


def states(points: np.ndarray) -> list[State]:
    return [State(column[:, None], timestamp=NOW) for column in points.T]


def theirs(x, y, c, p, measure=None) -> tuple[float, float]:
    """Stone Soup's OSPA and GOSPA."""
    measure = measure or Euclidean()
    a = states(x)
    b = states(y)
    o = OSPAMetric(c=c, p=p, measure=measure).compute_OSPA_distance(a, b).value
    g, _ = GOSPAMetric(c=c, p=p, measure=measure).compute_gospa_metric(a, b)
    return float(o), float(g.value["distance"])


def sets(seed: int, most: int = 8) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    n, m = rng.integers(0, most, 2)
    x = rng.uniform(0, 100, (2, n))
    y = np.concatenate(
        [x[:, : m // 2] + rng.normal(0, 5, (2, min(n, m // 2))), rng.uniform(0, 100, (2, m))],
        axis=1,
    )[:, :m]
    return x, y


@pytest.mark.parametrize("c", [10.0, 50.0])
@pytest.mark.parametrize("seed", range(40))
def test_points_agree_with_stone_soup(seed: int, c: float):
    x, y = sets(seed)
    if not x.size and not y.size:
        return
    assert ospa(x, y, c) == pytest.approx(theirs(x, y, c, 1.0)[0], abs=1e-9)


@pytest.mark.data
@pytest.mark.parametrize("sequence", ["TUD-Campus", "PETS09-S2L1"])
def test_real_sequences_agree_with_stone_soup(data, sequence: str):
    """Boxes by 1 − IoU through `evaluate`, and their centres in pixels."""
    truth, tracks = real_case(data, sequence, "det_public")
    frames = range(1, min(tracks.frame.max(), 120) + 1)
    on_boxes = []
    for k in frames:
        t = truth.xyxy[truth.frame == k]
        o = tracks.xyxy[tracks.frame == k]
        on_boxes.append(
            theirs(t.T, o.T, 1.0, 1.0, BoxDistance()) if len(t) + len(o) else (0.0, 0.0)
        )
        x, y = ((box[:, :2] + box[:, 2:]).T / 2 for box in (t, o))
        assert ospa(x, y, 40.0) == pytest.approx(theirs(x, y, 40.0, 1.0)[0], abs=1e-9)
    scores = evaluate(truth, tracks, frames=len(frames))
    close([scores.OSPA, scores.GOSPA], np.mean(on_boxes, axis=0))


@given(seeds, st.sampled_from([5.0, 30.0]), st.sampled_from([1.0, 2.0, 3.5]))
@settings(max_examples=60, deadline=None)
def test_set_metrics_agree_with_brute_force(seed: int, c: float, p: float):
    x, y = sets(seed, most=5)
    distance = np.hypot(*(x[:, :, None] - y[:, None, :]))
    n, m = distance.shape
    assert ospa(x, y, c, p) == pytest.approx(twins.ospa(distance, n, m, c, p))


@given(seeds, st.sampled_from([1.0, 2.0]))
@settings(max_examples=60, deadline=None)
def test_ospa_is_a_metric(seed: int, p: float):
    x, y = sets(seed)
    z, _ = sets(seed ^ 12345)
    assert ospa(x, x, 20.0, p) == pytest.approx(0, abs=1e-12)
    assert ospa(x, y, 20.0, p) == pytest.approx(ospa(y, x, 20.0, p))
    assert ospa(x, z, 20.0, p) <= ospa(x, y, 20.0, p) + ospa(y, z, 20.0, p) + 1e-9
    assert ospa(x, y, 20.0, p) <= 20.0


def trajectories(seed: int, frames: int = 6, n: int = 2, m: int = 3):
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(0, 2.5, (frames, n, m)),
        rng.random((frames, n)) < 0.8,
        rng.random((frames, m)) < 0.7,
    )


@given(seeds, st.sampled_from([0.0, 0.3, 1.0, 4.0]))
@settings(max_examples=40, deadline=None)
def test_single_trajectory_agrees_with_brute_force(seed: int, gamma: float):
    """With one object the programme is a shortest path, and its weights are 0 or 1."""
    distance, there, given_ = trajectories(seed, n=1)
    ours = tgospa(distance, there, given_, gamma)
    power = twins.tgospa_power(distance, there, given_, 1.0, 1.0, gamma)
    assert ours.distance == pytest.approx(power, abs=1e-7)
    assert ours.localisation + ours.missed + ours.false + ours.switching == pytest.approx(
        power, abs=1e-7
    )


@given(seeds, st.sampled_from([0.2, 1.0]))
@settings(max_examples=25, deadline=None)
def test_relaxation_bounds_the_integer_optimum(seed: int, gamma: float):
    distance, there, given_ = trajectories(seed)
    ours = tgospa(distance, there, given_, gamma).distance
    power = twins.tgospa_power(distance, there, given_, 1.0, 1.0, gamma)
    apart = [d[np.ix_(t, g)] for d, t, g in zip(distance, there, given_, strict=True)]
    without = sum(twins.gospa(d, *d.shape, 1.0, 1.0) for d in apart)
    assert without - 1e-7 <= ours <= power + 1e-7
    assert tgospa(distance, there, given_, 0.0).distance == pytest.approx(without, abs=1e-7)


def test_trajectory_metric_of_boxes():
    truth, tracks = random_case(np.random.default_rng(2), frames=25, objects=6)
    scores = evaluate(truth, tracks)
    assert tgospa_boxes(truth, tracks, gamma=0.0).distance == pytest.approx(
        scores.GOSPA * scores.frames
    )
    assert tgospa_boxes(truth, tracks).switching > 0
    assert tgospa_boxes(truth, perfect(truth)).distance == pytest.approx(0, abs=1e-9)
    assert tgospa_boxes(truth, Tracks.empty()).missed == len(truth) / 2
    with pytest.raises(InputError, match="switching penalty"):
        tgospa_boxes(truth, tracks, gamma=-1.0)


def test_rmse_of_known_errors():
    frame = np.repeat([1, 2, 3], 2)
    truth = np.array([[0, 100, 0, 100, 0, 100], [0, 0, 0, 0, 0, 0]], float)
    estimate = truth + np.array([[3, 0, 0, 1, 3, 40], [0, 0, 4, 0, 0, 0]])
    errors = rmse_per_target(
        frame, np.tile([7, 3], 3), truth, frame[::-1], estimate[:, ::-1], gate=20.0
    )
    assert errors.identity.tolist() == [3, 7]
    assert errors.mapped.tolist() == [2, 3]
    assert errors.frames.tolist() == [3, 3]
    assert errors.rmse == pytest.approx([np.sqrt(1 / 2), np.sqrt((9 + 16 + 9) / 3)])
    assert errors.rmse_axis[:, 1] == pytest.approx([np.sqrt(18 / 3), np.sqrt(16 / 3)])
    assert errors.overall == pytest.approx(np.sqrt((1 + 34) / 5))


def test_rmse_without_estimates_is_undefined():
    one = np.ones(1, np.int64)
    errors = rmse_per_target(
        one, one, np.zeros((2, 1)), np.zeros(0, np.int64), np.zeros((2, 0)), gate=5.0
    )
    assert np.isnan(errors.rmse).all()
    assert np.isnan(errors.overall)
    assert errors.mapped.tolist() == [0]
    with pytest.raises(InputError, match="gate"):
        rmse_per_target(one, one, np.zeros((2, 1)), one, np.zeros((2, 1)), gate=0.0)
    with pytest.raises(InputError, match="columns"):
        rmse_per_target(one, one, np.zeros((2, 1)), one, np.zeros((2, 2)), gate=1.0)
    with pytest.raises(InputError, match="expected a frame and an identity"):
        rmse_per_target(one, one, np.zeros((2, 1)), one, np.zeros((3, 1)), gate=1.0)
