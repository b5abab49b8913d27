"""What scores are worth: laws of the scale that is learned from judged detections."""

import math

import numpy as np
import pytest

from phdtrack.rates import Judged, Scale
from phdtrack.rates.scores import MOST, NEWEST, scale


def judged(rng, n=2000, share=0.4):
    """Scores of objects N(1, 1) and of false alarms N(0, 1), with the truth of each: odds are exp(s − ½)."""
    false = rng.random(n) < share
    return Judged().joined(rng.normal(np.where(false, 0.0, 1.0), 1.0), false.astype(float))


def test_the_odds_are_those_of_the_two_densities():
    found = scale(judged(np.random.default_rng(0), NEWEST))
    s = np.linspace(-0.7, 1.8, 11)
    assert np.log(found.odds(s)) == pytest.approx(s - 0.5, abs=0.4)
    assert np.mean(np.log(found.odds(s)) - (s - 0.5)) == pytest.approx(0, abs=0.12)


def test_only_the_order_of_scores_counts():
    told = judged(np.random.default_rng(1))
    s = told.score[:50]
    plain, bent = scale(told), scale(Judged(1e6 * np.exp(3 * told.score), told.false))
    at = np.searchsorted(plain.at, s)
    assert np.array_equal(plain.worth, bent.worth)
    # Between the same two parts whatever the range.
    assert np.array_equal(at, np.searchsorted(bent.at, 1e6 * np.exp(3 * s)))


def test_odds_never_fall_with_the_score_and_are_bounded():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 300))
        told = Judged().joined(np.round(rng.normal(size=n), 1), rng.random(n))
        odds = scale(told).odds(np.sort(rng.normal(scale=3, size=100)))
        assert (np.diff(odds) >= -1e-12).all()
        assert (np.abs(np.log(odds)) <= MOST + 1e-12).all()


def test_constant_scores_say_nothing_exactly():
    rng = np.random.default_rng(2)
    found = scale(Judged().joined(np.full(500, 0.7), (rng.random(500) < 0.5).astype(float)))
    assert (found.odds(np.array([0.7, 0.1, 5.0])) == 1).all()
    assert (Scale().odds(np.array([0.3, np.nan])) == 1).all()


def test_scores_without_bounds_and_without_value():
    rng = np.random.default_rng(3)
    told = judged(rng)
    wild = np.concatenate([told.score, [np.inf, np.inf, -np.inf, np.nan]])
    found = scale(Judged().joined(wild, np.concatenate([told.false, [0.0, 0.0, 1.0, 0.0]])))
    assert np.isfinite(found.at).all()
    assert np.isfinite(found.worth).all()
    odds = found.odds(np.array([-np.inf, 0.5, np.inf, np.nan]))
    assert odds[0] < odds[1] < odds[2]
    assert odds[3] == 1


def test_infinite_scores_alone_say_what_their_sign_says():
    told = Judged().joined(np.repeat([-np.inf, np.inf], 100), np.repeat([1.0, 0.0], 100))
    assert (np.isfinite(scale(told).odds(np.array([-np.inf, 0.0, np.inf])))).all()


def test_few_detections_say_little():
    told = Judged().joined(np.array([0.1, 0.9]), np.array([1.0, 0.0]))
    assert np.abs(np.log(scale(told).odds(told.score))).max() < 0.4
    many = Judged().joined(np.repeat([0.1, 0.9], 500), np.repeat([1.0, 0.0], 500))
    assert np.log(scale(many).odds(np.array([0.1, 0.9]))) == pytest.approx([-MOST, MOST], abs=0.2)


def test_what_says_nothing_is_worth_one_within_its_noise():
    rng = np.random.default_rng(4)
    told = Judged().joined(rng.normal(size=3000), (rng.random(3000) < 0.3).astype(float))
    assert np.abs(np.log(scale(told).odds(rng.normal(size=200)))).max() < math.log(1.6)


def test_the_newest_count():
    told = Judged().joined(np.zeros(NEWEST), np.ones(NEWEST)).joined(np.ones(10), np.zeros(10))
    assert len(told.score) == NEWEST
    assert (told.score[-10:] == 1).all()
