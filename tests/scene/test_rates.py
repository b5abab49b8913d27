"""Rates from sums over labelled frames: priors, limits, which tracks teach p_D; what scores say."""

import math

import numpy as np
import pytest

from phdtrack.scene.labelling import TrackEvidence
from phdtrack.scene.rates import (
    DETECTION_LIMITS,
    MAX_LOG_RATIO,
    MAX_SCORES,
    PRIOR_FRAMES,
    PRIOR_TRACKED,
    CountedTracks,
    Priors,
    RateSums,
    ScoreScale,
    SuccessiveScores,
)
from phdtrack.types import Tracks

PRIORS = Priors(0.8, 5.0, 0.02, False, False)


def walk(identity, frames, speed, confirmed=True):
    """Rows of a track that was detected in these frames, in a box of 20 × 50 that goes ``speed`` pixels a frame."""
    frames = np.asarray(frames)
    left = 100.0 + speed * frames
    boxes = np.stack([left, np.full(len(frames), 50.0), left + 20, np.full(len(frames), 100.0)], axis=1)
    n = len(frames)
    return Tracks(frames, np.full(n, identity), boxes, np.ones(n), np.zeros(n, np.int64), np.full(n, confirmed))


def evidence(*tracks):
    rows = Tracks.concatenate(list(tracks))
    return TrackEvidence().with_rows(rows, rows.frame)


def test_without_frames_the_settings_hold():
    found = RateSums().rates(PRIORS)
    assert (found.detection, found.clutter, found.births, found.limited) == (0.8, 5.0, 0.02, ())


def test_estimates_are_posterior_means():
    known = RateSums(hits=90, span=100, false=200, detections=400, frames=20, births=4, units=100, chances=2000)
    found = known.rates(PRIORS)
    assert found.detection == pytest.approx((PRIOR_TRACKED * 0.8 + 90) / (PRIOR_TRACKED + 100))
    assert found.clutter == pytest.approx((PRIOR_FRAMES * 5 + 200) / (PRIOR_FRAMES + 20))
    assert found.births == pytest.approx((5 + 4) / (5 / 0.02 + 100))
    around = known.rates(Priors(0.8, 0.3, 0.01, True, True))
    assert around.clutter == pytest.approx((50 * 0.3 + 200) / (50 + 400))
    assert around.births == pytest.approx((5 + 4) / (5 / 0.01 + 2000))


def test_much_evidence_outweighs_any_setting_and_limits_are_named():
    assert RateSums(hits=5e5, span=1e6).rates(PRIORS).detection == pytest.approx(0.5, abs=1e-4)
    low, high = RateSums(hits=1, span=1e6).rates(PRIORS), RateSums(hits=1e6, span=1e6).rates(PRIORS)
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


def test_what_stays_in_its_place_and_what_was_not_confirmed_teaches_nothing():
    standing, doubtful = walk(1, [1, 4, 9, 20], 0), walk(2, np.arange(1, 30, 3), 5, confirmed=False)
    assert CountedTracks().updated(evidence(standing, doubtful))[1] == RateSums()


# Scores


def labelled_scores(rng, n=2000, share=0.4):
    """Scores of objects N(1, 1) and of false alarms N(0, 1), with the truth of each: odds are exp(s − ½)."""
    false = rng.random(n) < share
    return np.stack([rng.normal(np.where(false, 0.0, 1.0), 1.0), false])[:, -MAX_SCORES:]


def test_the_odds_are_those_of_the_two_densities():
    found = ScoreScale.learned(labelled_scores(np.random.default_rng(0), MAX_SCORES))
    s = np.linspace(-0.7, 1.8, 11)
    assert np.log(found.ratio(s)) == pytest.approx(s - 0.5, abs=0.55)
    assert np.mean(np.log(found.ratio(s)) - (s - 0.5)) == pytest.approx(0, abs=0.12)


def test_only_the_order_of_scores_counts():
    labelled = labelled_scores(np.random.default_rng(1))
    s = labelled[0, :50]
    plain, bent = (
        ScoreScale.learned(labelled),
        ScoreScale.learned(np.stack([1e6 * np.exp(3 * labelled[0]), labelled[1]])),
    )
    at = np.searchsorted(plain.at, s)
    assert np.array_equal(plain.log_ratio, bent.log_ratio)
    # Between the same two parts whatever the range.
    assert np.array_equal(at, np.searchsorted(bent.at, 1e6 * np.exp(3 * s)))


def test_odds_never_fall_with_the_score_and_are_bounded():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 300))
        labelled = np.stack([np.round(rng.normal(size=n), 1), rng.random(n)])
        odds = ScoreScale.learned(labelled).ratio(np.sort(rng.normal(scale=3, size=100)))
        assert (np.diff(odds) >= -1e-12).all()
        assert (np.abs(np.log(odds)) <= MAX_LOG_RATIO + 1e-12).all()


def test_constant_scores_say_nothing_exactly():
    rng = np.random.default_rng(2)
    found = ScoreScale.learned(np.stack([np.full(500, 0.7), rng.random(500) < 0.5]))
    assert (found.ratio(np.array([0.7, 0.1, 5.0])) == 1).all()
    assert (ScoreScale().ratio(np.array([0.3, np.nan])) == 1).all()


def test_scores_without_bounds_and_without_value():
    rng = np.random.default_rng(3)
    labelled = labelled_scores(rng)
    wild = np.array([[np.inf, np.inf, -np.inf], [0.0, 0.0, 1.0]])
    found = ScoreScale.learned(np.hstack([labelled, wild]))
    assert np.isfinite(found.at).all()
    assert np.isfinite(found.log_ratio).all()
    odds = found.ratio(np.array([-np.inf, 0.5, np.inf, np.nan]))
    assert odds[0] < odds[1] < odds[2]
    assert odds[3] == 1


def series(rng, tracks, frames, correlation):
    """Rows of so many tracks in random order, and their scores, which are autoregressive."""
    value = np.empty((tracks, frames))
    value[:, 0] = rng.normal(size=tracks)
    for k in range(1, frames):
        value[:, k] = correlation * value[:, k - 1] + (1 - correlation**2) ** 0.5 * rng.normal(size=tracks)
    identity, frame = np.repeat(np.arange(1, tracks + 1), frames), np.tile(np.arange(1, frames + 1), tracks)
    order = rng.permutation(len(frame))
    return rows_of(identity[order], frame[order]), value.ravel()[order]


def rows_of(identity, frame):
    n = len(frame)
    return Tracks(frame, identity, np.zeros((n, 4)), np.ones(n), np.zeros(n, np.int64), np.ones(n, bool))


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_scores_that_are_alike_from_frame_to_frame_count_less(correlation):
    found = SuccessiveScores().joined(*series(np.random.default_rng(0), 50, 60, correlation))
    assert len(found.first) == min(MAX_SCORES, 50 * 59)
    # Ranks of a Gaussian series are correlated by 6/π asin(ρ/2).
    ranks = 6 / math.pi * math.asin(correlation / 2)
    assert found.share == pytest.approx((1 - ranks) / (1 + ranks), abs=0.12)


def test_pairs_are_the_same_whether_frames_come_at_once_or_one_by_one():
    rows, score = series(np.random.default_rng(1), 6, 15, 0.5)
    at_once, one_by_one = SuccessiveScores().joined(rows, score), SuccessiveScores()
    for k in range(1, 16):
        one_by_one = one_by_one.joined(rows.take(rows.frame == k), score[rows.frame == k])
    assert sorted(zip(at_once.first, at_once.second, strict=True)) == sorted(
        zip(one_by_one.first, one_by_one.second, strict=True)
    )
    assert at_once.share == pytest.approx(one_by_one.share)


def test_without_pairs_or_with_constant_ones_a_frame_says_nothing_new():
    assert SuccessiveScores().share == 0
    rows = rows_of(np.ones(9, np.int64), np.arange(9))
    ones = SuccessiveScores().joined(rows, np.full(9, 0.5))
    assert ones.share == 0
    unknown = SuccessiveScores().joined(rows, np.full(9, np.nan))
    assert len(unknown.first) == 0
