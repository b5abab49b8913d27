"""Rates from sums over labelled frames: priors, limits, which tracks teach p_D."""

import numpy as np
import pytest

from experiments.labelling import TrackEvidence
from experiments.learned_rates import (
    DETECTION_LIMITS,
    PRIOR_FRAMES,
    PRIOR_TRACKED,
    CountedTracks,
    Priors,
    RateSums,
)
from phdtrack.types import Tracks

PRIORS = Priors(0.8, 5.0, False)


def walk(identity, frames, speed, confirmed=True):
    """Rows of a track that was detected in these frames, in a box of 20 × 50 that goes ``speed``
    pixels a frame.
    """
    frames = np.asarray(frames)
    left = 100.0 + speed * frames
    boxes = np.stack(
        [left, np.full(len(frames), 50.0), left + 20, np.full(len(frames), 100.0)], axis=1
    )
    n = len(frames)
    return Tracks(
        frames,
        np.full(n, identity),
        boxes,
        np.ones(n),
        np.zeros(n, np.int64),
        np.full(n, confirmed),
    )


def evidence(*tracks):
    rows = Tracks.concatenate(list(tracks))
    return TrackEvidence().with_rows(rows, rows.frame)


def test_without_frames_the_settings_hold():
    found = RateSums().rates(PRIORS)
    assert (found.detection, found.clutter, found.limited) == (0.8, 5.0, ())


def test_estimates_are_posterior_means():
    known = RateSums(hits=90, span=100, false=200, detections=400, frames=20)
    found = known.rates(PRIORS)
    assert found.detection == pytest.approx((PRIOR_TRACKED * 0.8 + 90) / (PRIOR_TRACKED + 100))
    assert found.clutter == pytest.approx((PRIOR_FRAMES * 5 + 200) / (PRIOR_FRAMES + 20))
    around = known.rates(Priors(0.8, 0.3, True))
    assert around.clutter == pytest.approx((50 * 0.3 + 200) / (50 + 400))


def test_much_evidence_outweighs_priors_within_limits():
    assert RateSums(hits=5e5, span=1e6).rates(PRIORS).detection == pytest.approx(0.5, abs=1e-4)
    low = RateSums(hits=1, span=1e6).rates(PRIORS)
    high = RateSums(hits=1e6, span=1e6).rates(PRIORS)
    assert (low.detection, high.detection) == DETECTION_LIMITS
    assert low.limited == high.limited == ("detection",)
    assert "clutter" in RateSums(false=1e9, frames=10).rates(PRIORS).limited


def test_frames_between_first_and_last_detection_teach():
    # Detected in 6 of the 9 frames after the first, up to the last.
    rows = walk(1, [1, 2, 3, 5, 7, 8, 10], 5)
    counted, known = CountedTracks().updated(evidence(rows))
    assert (known.hits, known.span) == (6, 9)
    # Asked again, it has nothing more to tell.
    assert counted.updated(evidence(rows))[1] == RateSums()
    more = counted.updated(evidence(walk(1, [1, 2, 3, 5, 7, 8, 10, 12], 5)))[1]
    assert (more.hits, more.span) == (1, 2)


def test_static_and_unconfirmed_tracks_are_not_learned_from():
    standing = walk(1, [1, 4, 9, 20], 0)
    doubtful = walk(2, np.arange(1, 30, 3), 5, confirmed=False)
    assert CountedTracks().updated(evidence(standing, doubtful))[1] == RateSums()
