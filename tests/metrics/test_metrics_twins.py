"""MODA, MODP, MOTA and its logarithm, delays, OSPA(2), ATA: against plain definitions by brute
force, and pooled.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from metric_cases import close, random_case, tracks_of, truth_of

from phdtrack.arrays import iou
from phdtrack.metrics import evaluate, pool
from phdtrack.types import Tracks, Truth
from reference import metrics_twins as twins

seeds = st.integers(0, 2**32 - 1)
thresholds = st.sampled_from([0.3, 0.5, 0.7])


@given(seeds, thresholds)
@settings(max_examples=60, deadline=None)
def test_detection_scores_agree_with_plain_definition(seed: int, threshold: float):
    truth, tracks = random_case(np.random.default_rng(seed), frames=8, objects=3, side=60)
    moda, modp = twins.moda_modp(truth, tracks, threshold)
    ours = evaluate(truth, tracks, iou=threshold)
    close([ours.MODA, ours.MODP], [moda, modp], 1e-12)


@given(seeds, thresholds)
@settings(max_examples=60, deadline=None)
def test_tracking_scores_agree_with_plain_definition(seed: int, threshold: float):
    truth, tracks = random_case(np.random.default_rng(seed), frames=10, objects=3, side=60)
    twin = twins.tracking(truth, tracks, threshold)
    ours = evaluate(truth, tracks, iou=threshold)
    assert (ours.id_switches, ours.false_tracks) == (twin.switches, twin.false_tracks)
    close([ours.MOTA, ours.MOTA_log, ours.MOTP], [twin.mota, twin.mota_log, twin.motp], 1e-12)
    assert ours.objects_found == len(twin.delays)
    assert ours.delay_mean == pytest.approx(
        np.mean(list(twin.delays.values()) or [np.nan]), nan_ok=True
    )


def laid(truth: Truth, tracks: Tracks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(K, n, m) distances 1 − IoU, (K, n) and (K, m) True if each trajectory is present."""
    numbers = np.union1d(truth.frame, tracks.frame)
    names = np.unique(truth.identity)
    found = np.unique(tracks.identity)
    distance = np.ones((len(numbers), len(names), len(found)))
    there = np.zeros(distance.shape[:2], bool)
    given_ = np.zeros((len(numbers), len(found)), bool)
    for k, number in enumerate(numbers):
        t = np.flatnonzero(truth.frame == number)
        o = np.flatnonzero(tracks.frame == number)
        i = np.searchsorted(names, truth.identity[t])
        j = np.searchsorted(found, tracks.identity[o])
        there[k, i] = True
        given_[k, j] = True
        distance[k][np.ix_(i, j)] = 1 - iou(truth.xyxy[t], tracks.xyxy[o])
    return distance, there, given_


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_identity_and_hota_agree_with_brute_force(seed: int):
    truth, tracks = random_case(np.random.default_rng(seed), frames=6, objects=3, side=60)
    tracks = tracks.select(tracks.identity < 1003)
    if len(truth) or len(tracks):
        ours = evaluate(truth, tracks)
        close(
            [ours.OSPA2, ours.ATA],
            [twins.ospa2(*laid(truth, tracks), 1.0, 1.0, 1.0), twins.ata(truth, tracks)],
        )


def test_pooled_tracks_equal_concatenated_sequences():
    cases = [random_case(np.random.default_rng(i), objects=2 + i, frames=20) for i in range(3)]
    ours = pool([evaluate(truth, tracks, frames=20) for truth, tracks in cases])
    joined = [
        (
            np.concatenate([part.frame + 20 * i for i, part in enumerate(side)]),
            np.concatenate([part.identity + 10**6 * i for i, part in enumerate(side)]),
            np.concatenate([part.xyxy for part in side]),
        )
        for side in zip(*cases, strict=True)
    ]
    together = evaluate(truth_of(*joined[0]), tracks_of(*joined[1]), frames=60)
    close([ours.OSPA2, ours.SFDA, ours.ATA], [together.OSPA2, together.SFDA, together.ATA])
