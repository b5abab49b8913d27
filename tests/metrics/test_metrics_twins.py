"""MODA, MODP, MOTA and its logarithm, delays: against twins that try every mapping."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from metric_cases import close, random_case

from phdtrack.metrics import evaluate
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
