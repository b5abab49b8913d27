"""OSPA(2), SFDA and ATA, T-GOSPA on points: against twins that try every mapping, TrackEval, and by their laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from metric_cases import REAL, close, crude_tracks, perfect, random_case, real_detections, real_truth, tracks_of, truth_of
from trackeval_oracle import preprocessed, trackeval

from phdtrack.errors import InputError
from phdtrack.metrics import (
    PointRows,
    evaluate,
    ospa2_boxes,
    ospa2_of,
    ospa2_points,
    ospa_of,
    pool,
    tgospa_boxes,
    tgospa_of,
    tgospa_points,
)
from phdtrack.types import Tracks, Truth
from reference import metrics_twins as twins

seeds = st.integers(0, 2**32 - 1)
orders = st.sampled_from([1.0, 2.0])
BOX = [0.0, 0.0, 10.0, 10.0]


def points(seed: int, frames: int = 7, most: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """(K, n, 2) wandering points, (K, n) whether they are there; some trajectories are never."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, most))
    walk = rng.uniform(0, 30, (1, n, 2)) + np.cumsum(rng.normal(0, 2, (frames, n, 2)), axis=0)
    return walk, rng.random((frames, n)) < rng.choice([0.0, 0.4, 0.9], n, p=[0.1, 0.4, 0.5])


def between(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.sqrt(((x[:, :, None] - y[:, None]) ** 2).sum(axis=-1))


def rows_of(walk: np.ndarray, there: np.ndarray) -> PointRows:
    frame, identity = np.nonzero(there)
    return PointRows(frame + 1, identity, walk[there].T)


@given(seeds, orders, orders, st.sampled_from([3.0, 20.0]))
@settings(max_examples=80, deadline=None)
def test_ospa2_agrees_with_every_mapping_tried(seed: int, p: float, q: float, c: float):
    (x, there), (y, given_) = points(seed), points(seed ^ 99)
    distance = between(x, y)
    ours = ospa2_of(distance, there, given_, c, p, q)
    assert ours == pytest.approx([twins.ospa2(distance, there, given_, c, p, q)], abs=1e-7)
    sliding = ospa2_of(distance, there, given_, c, p, q, window=3)
    for k in range(len(distance)):
        part = slice(max(0, k - 2), k + 1)
        assert sliding[k] == pytest.approx(twins.ospa2(distance[part], there[part], given_[part], c, p, q), abs=1e-7)


@given(seeds, orders, orders, st.sampled_from([3.0, 20.0]))
@settings(max_examples=150, deadline=None)
def test_ospa2_is_a_metric(seed: int, p: float, q: float, c: float):
    tracks = [points(seed ^ salt) for salt in (0, 1, 2)]

    def d(a: int, b: int) -> float:
        (x, there), (y, given_) = tracks[a], tracks[b]
        return float(ospa2_of(between(x, y), there, given_, c, p, q)[0])

    assert d(0, 0) == pytest.approx(0, abs=1e-7)
    assert d(0, 1) == pytest.approx(d(1, 0), abs=1e-9)
    assert d(0, 2) <= d(0, 1) + d(1, 2) + 1e-9
    assert 0 <= d(0, 1) <= c + 1e-12
    x, there = tracks[0]
    if there.any():
        assert ospa2_of(np.zeros((len(x), x.shape[1], 0)), there, np.zeros((len(x), 0), bool), c, p, q) == pytest.approx([c])


@given(seeds, orders)
@settings(max_examples=40, deadline=None)
def test_a_window_of_one_frame_is_ospa(seed: int, p: float):
    (x, there), (y, given_) = points(seed), points(seed ^ 5)
    distance = between(x, y)
    ours = ospa2_of(distance, there, given_, 6.0, p, 1.0, window=1)
    for k, value in enumerate(ours):
        assert value == pytest.approx(ospa_of(distance[k][np.ix_(there[k], given_[k])], 6.0, p), abs=1e-7)


def test_ospa2_knows_a_switch_where_ospa_sees_none():
    truth = truth_of([1, 2, 3, 4], [1] * 4, [BOX] * 4)
    switched = tracks_of([1, 2, 3, 4], [7, 7, 8, 8], [BOX] * 4)
    scores = evaluate(truth, switched)
    assert scores.OSPA == 0
    # One of two output tracks is the object's for half of its life; the other is one too many.
    close([scores.OSPA2, scores.ATA], [(0.5 + 1) / 2, 2 * 0.5 / (1 + 2)])
    assert scores.SFDA == 1
    # Looking back on two frames the switch is seen in frame 3 alone.
    assert ospa2_boxes(truth, switched, window=2) == pytest.approx([0, 0, (0.5 + 1) / 2, 0])


def test_frames_without_anything_are_at_distance_0():
    truth = truth_of([2], [1], [BOX])
    assert ospa2_boxes(truth, Tracks.empty(), frames=5, window=2).tolist() == [0, 1, 1, 0, 0]
    assert ospa2_boxes(truth, Tracks.empty(), frames=1).tolist() == [0]


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_points_and_distances_say_the_same(seed: int):
    (x, there), (y, given_) = points(seed), points(seed ^ 5)
    distance, rows = between(x, y), (rows_of(x, there), rows_of(y, given_))
    assert ospa2_points(*rows, 9.0, 2.0) == pytest.approx(ospa2_of(distance, there, given_, 9.0, 2.0), abs=1e-7)
    sliding = ospa2_of(distance, there, given_, 9.0, window=4)
    assert ospa2_points(*rows, 9.0, frames=len(x), window=4) == pytest.approx(sliding, abs=1e-7)
    ours = tgospa_points(rows_of(x, there), rows[1], 9.0, gamma=2.0)
    assert ours.distance == pytest.approx(tgospa_of(distance, there, given_, 9.0, gamma=2.0).distance, abs=1e-6)


@given(seeds, st.sampled_from([0.3, 0.5]))
@settings(max_examples=40, deadline=None)
def test_vace_scores_agree_with_every_mapping_tried(seed: int, threshold: float):
    truth, tracks = random_case(np.random.default_rng(seed), frames=6, objects=3, side=60)
    tracks = tracks.take(tracks.identity < 1003)
    if not len(truth) and not len(tracks):
        return
    ours = evaluate(truth, tracks, iou=threshold)
    close(ours.SFDA, twins.sfda(truth, tracks), 1e-12)
    close([ours.ATA, ours.ATA_matched], [twins.ata(truth, tracks), twins.ata(truth, tracks, threshold)], 1e-12)


def vace(truth: Truth, tracks: Tracks, frames: int) -> dict[str, float]:
    """TrackEval's; its ATA is the relaxed one at 0.5."""
    metric = trackeval.metrics.VACE()
    return metric.eval_sequence(preprocessed(truth, tracks, frames))


@pytest.mark.parametrize("seed", range(20))
def test_vace_scores_agree_with_trackeval(seed: int):
    truth, tracks = random_case(np.random.default_rng(seed), objects=1 + seed % 8, distractors=seed % 2 == 0)
    ours, theirs = evaluate(truth, tracks, frames=32), vace(truth, tracks, 32)
    close([ours.SFDA, ours.ATA_matched], [theirs["SFDA"], theirs["ATA"]])


@pytest.mark.data
@pytest.mark.parametrize(("sequence", "detector"), REAL)
def test_real_sequences(data, sequence: str, detector: str):
    """TrackEval's figures, and OSPA(2) of whole tracks by its own code."""
    truth = real_truth(data, sequence)
    tracks = crude_tracks(real_detections(data, sequence, detector))
    ours = evaluate(truth, tracks)
    theirs = vace(truth, tracks, ours.frames)
    close([ours.SFDA, ours.ATA_matched], [theirs["SFDA"], theirs["ATA"]])
    close(ours.OSPA2, float(ospa2_boxes(truth, tracks)[0]))


def test_pooled_tracks_are_those_of_the_sequences_one_after_the_other():
    cases = [random_case(np.random.default_rng(i), objects=2 + i, frames=20) for i in range(3)]
    ours = pool([evaluate(truth, tracks, frames=20) for truth, tracks in cases])
    truths = [t for t, _ in cases]
    shift = [np.full(len(t), 20 * i) for i, t in enumerate(truths)]
    truth = truth_of(
        np.concatenate([t.frame + s for t, s in zip(truths, shift, strict=True)]),
        np.concatenate([t.identity + 10**6 * (s // 20) for t, s in zip(truths, shift, strict=True)]),
        np.concatenate([t.xyxy for t in truths]),
    )
    given_ = [o for _, o in cases]
    tracks = tracks_of(
        np.concatenate([o.frame + 20 * i for i, o in enumerate(given_)]),
        np.concatenate([o.identity + 10**6 * i for i, o in enumerate(given_)]),
        np.concatenate([o.xyxy for o in given_]),
    )
    together = evaluate(truth, tracks, frames=60)
    close([ours.OSPA2, ours.SFDA, ours.ATA], [together.OSPA2, together.SFDA, together.ATA])
    close(together.OSPA2, float(ospa2_boxes(truth, tracks)[0]))


def test_tgospa_of_groups_that_share_nothing_is_the_sum_over_them():
    truth, tracks = random_case(np.random.default_rng(2), frames=25, objects=6)
    here = tgospa_boxes(truth, tracks)
    twice = tgospa_boxes(
        truth_of(
            np.tile(truth.frame, 2),
            np.concatenate([truth.identity, truth.identity + 10**6]),
            np.concatenate([truth.xyxy, truth.xyxy + 10**4]),
        ),
        tracks_of(
            np.tile(tracks.frame, 2),
            np.concatenate([tracks.identity, tracks.identity + 10**6]),
            np.concatenate([tracks.xyxy, tracks.xyxy + 10**4]),
        ),
    )
    assert here.switching > 0
    assert twice.distance == pytest.approx(2 * here.distance)


def test_extremes():
    truth, _ = random_case(np.random.default_rng(0))
    assert ospa2_boxes(truth, perfect(truth)) == pytest.approx([0], abs=1e-12)
    assert evaluate(truth, Tracks.empty()).OSPA2 == 1
    assert ospa2_boxes(truth, Tracks.empty()).tolist() == [1]


ONE = np.ones(1, np.int64)


@pytest.mark.parametrize(
    "call",
    [
        lambda: PointRows(ONE, ONE, np.zeros((2, 2))),
        lambda: PointRows(ONE, ONE, np.zeros(1)),
        lambda: PointRows(0 * ONE, ONE, np.zeros((2, 1))),
        lambda: PointRows(np.repeat(ONE, 2), np.repeat(ONE, 2), np.zeros((2, 2))),
        lambda: ospa2_of(np.zeros((2, 1, 1)), np.ones((2, 1), bool), np.ones((3, 1), bool), 1.0),
        lambda: ospa2_of(np.zeros((2, 1, 1)), np.ones((2, 1), bool), np.ones((2, 1), bool), 1.0, q=0.5),
        lambda: ospa2_points(PointRows(ONE, ONE, np.zeros((2, 1))), PointRows(ONE, ONE, np.zeros((2, 1))), 0.0),
        lambda: ospa2_points(PointRows(ONE, ONE, np.zeros((2, 1))), PointRows(ONE, ONE, np.zeros((3, 1))), 1.0),
        lambda: ospa2_boxes(truth_of([1], [1], [BOX]), Tracks.empty(), window=-1),
        lambda: tgospa_points(PointRows(ONE, ONE, np.zeros((2, 1))), PointRows(ONE, ONE, np.zeros((2, 1))), 1.0, gamma=-1),
    ],
)
def test_bad_input_is_refused(call):
    with pytest.raises(InputError, match="expected"):
        call()
