"""MODA, MODP, MOTA and its logarithm, delays: against twins that try every mapping."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from metric_cases import close, random_case, tracks_of, truth_of

from phdtrack.metrics import evaluate, first_output_delays
from phdtrack.types import Detections, DetectionTable
from reference import metrics_twins as twins

seeds = st.integers(0, 2**32 - 1)
thresholds = st.sampled_from([0.3, 0.5, 0.7])


@given(seeds, thresholds)
@settings(max_examples=60, deadline=None)
def test_detection_scores(seed: int, threshold: float):
    truth, tracks = random_case(np.random.default_rng(seed), frames=8, objects=3, side=60)
    moda, modp = twins.moda_modp(truth, tracks, threshold)
    ours = evaluate(truth, tracks, iou=threshold)
    close([ours.MODA, ours.MODP], [moda, modp], 1e-12)


@given(seeds, thresholds)
@settings(max_examples=60, deadline=None)
def test_tracking_scores(seed: int, threshold: float):
    truth, tracks = random_case(np.random.default_rng(seed), frames=10, objects=3, side=60)
    twin = twins.tracking(truth, tracks, threshold)
    ours = evaluate(truth, tracks, iou=threshold)
    assert (ours.id_switches, ours.false_tracks) == (twin.switches, twin.false_tracks)
    close([ours.MOTA, ours.MOTA_log, ours.MOTP], [twin.mota, twin.mota_log, twin.motp], 1e-12)
    assert ours.objects_found == len(twin.delays)
    assert ours.delay_mean == pytest.approx(np.mean(list(twin.delays.values()) or [np.nan]), nan_ok=True)


def test_both_mappings_differ_where_a_newcomer_overlaps_more():
    """The track keeps its object at IoU 0.6 although a second output overlaps it at 0.8: no switch."""
    box = np.array([0.0, 0.0, 10.0, 10.0])
    truth = truth_of([1, 2], [1, 1], [box, box])
    tracks = tracks_of([1, 2, 2], [7, 7, 8], [box, [0, 0, 6, 10], [0, 0, 8, 10]])
    scores = evaluate(truth, tracks)
    assert scores.id_switches == 0
    close([scores.MOTP, scores.MODP], [(1 + 0.6) / 2, (1 + 0.8) / 2])


def test_log_of_switches_is_per_frame():
    """Two objects swap outputs in frame 2 and again in frame 4: two frames with two switches."""
    boxes = np.array([[0, 0, 10, 10], [50, 0, 60, 10]], float)
    truth = truth_of(np.repeat([1, 2, 3, 4], 2), np.tile([1, 2], 4), np.tile(boxes, (4, 1)))
    tracks = tracks_of(np.repeat([1, 2, 3, 4], 2), [1, 2, 2, 1, 2, 1, 1, 2], np.tile(boxes, (4, 1)))
    scores = evaluate(truth, tracks)
    assert scores.id_switches == 4
    assert scores.fragments == 0
    close([scores.MOTA, scores.MOTA_log], [1 - 4 / 8, 1 - 2 * np.log(3) / 8])


def test_fragments_count_resumed_mappings():
    box = [0, 0, 10, 10]
    truth = truth_of(np.repeat(range(1, 7), 2), [1, 2] * 6, [box, [50, 0, 60, 10]] * 6)
    seen = [1, 2, 4, 6]
    tracks = tracks_of([*seen, *range(1, 7)], [1] * 4 + [2] * 6, [box] * 4 + [[50, 0, 60, 10]] * 6)
    scores = evaluate(truth, tracks)
    assert (scores.fragments, scores.misses, scores.id_switches) == (2, 2, 0)
    assert (scores.mostly_tracked, scores.mostly_lost) == (1, 0)


def test_delay_counts_from_the_first_detection():
    truth = truth_of(
        [1, 2, 3, 4, 5] * 2 + [2], [4] * 5 + [9] * 5 + [2], [[0, 0, 10, 10]] * 5 + [[50, 0, 60, 10]] * 5 + [[90, 0, 99, 9]]
    )
    table = DetectionTable(
        np.array([1, 2, 4, 5]), Detections.of([[30, 30, 40, 40], [0, 0, 10, 9], [0, 0, 10, 10], [50, 0, 60, 10]])
    )
    tracks = tracks_of([4, 5, 2], [1, 1, 3], [[0, 0, 10, 10]] * 2 + [[50, 0, 60, 9]])
    delays = first_output_delays(truth, tracks, table)
    assert delays.identity.tolist() == [2, 4, 9]
    assert delays.detected.tolist() == [0, 2, 5]
    assert delays.mapped.tolist() == [0, 4, 2]
    assert delays.delay == pytest.approx([np.nan, 2, -3], nan_ok=True)
    assert evaluate(truth, tracks).delay_mean == (3 + 1) / 2
