"""What the scores of detections say: odds by score or by rank, and tracks that low boxes continue and do not start."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phdtrack import Tracker
from phdtrack.models.scores import ScoreOdds
from phdtrack.types import Detections

EARLIER = np.array([0.05, 0.4, 0.9])
NONE = np.zeros(0)


@given(
    score=st.lists(st.floats(0, 1), min_size=2, max_size=20), scale=st.floats(1, 50), slope=st.floats(0.1, 5),
    even=st.floats(0.05, 0.95), most=st.floats(1, 1e4),
)  # fmt: skip
def test_odds_rise_with_the_score_within_their_limits(score, scale: float, slope: float, even: float, most: float):
    """Also by rank, where scores are no probabilities."""
    rule, score = ScoreOdds(slope, even, most), np.sort(score)
    for odds in (rule.odds(score, EARLIER), rule.odds(scale * score + 2, EARLIER)):
        assert (np.diff(odds) >= -1e-9 * odds[1:]).all()
        assert (odds <= most * (1 + 1e-9)).all()
        assert (odds >= (1 - 1e-9) / most).all()
    assert rule.odds(np.array([even]), EARLIER) == pytest.approx(1)


def test_a_score_between_0_and_1_is_a_probability():
    """That of 0.8 are 4 to 1, over those of the score that says nothing; 0 and 1 are at the limits."""
    found = ScoreOdds(slope=2.0, even_score=0.6, max_odds=400.0).odds(np.array([0.8, 0.0, 1.0, np.nan]), EARLIER)
    np.testing.assert_allclose(found, [(4 / 1.5) ** 2, 1 / 400, 400, 1])


@given(score=st.floats(-1e3, 1e3), count=st.integers(0, 9))
def test_equal_scores_and_none_say_nothing(score: float, count: int):
    for seen in (np.full(count, score), np.full(count, np.nan)):
        for before in (NONE, seen, np.full(3, np.nan)):
            np.testing.assert_array_equal(ScoreOdds().odds(seen, before), 1)


@given(st.lists(st.integers(-50, 50), min_size=2, max_size=20), st.integers(1, 19))
def test_of_scores_on_another_scale_the_rank_counts(scores: list[int], first: int):
    """A rising change of the scale changes nothing; both scales reach beyond 0 … 1."""
    score = np.array([-60.0, *scores])
    before, now = np.split(score, [min(first, len(scores))])
    np.testing.assert_allclose(ScoreOdds().odds(now**3 + 7, before**3 + 7), ScoreOdds().odds(now, before), rtol=1e-12)
    unknown = ScoreOdds().odds(np.append(now, np.nan), before)
    np.testing.assert_allclose(unknown, [*ScoreOdds().odds(now, before), 1], rtol=1e-12)


def found_with(low: float) -> tuple[list[set[int]], Tracker]:
    """Identities of each frame: one person with a high score who fades to ``low``, and one who never has a higher one."""
    tracker, seen = Tracker((640, 480), preset="adaptive"), []
    for k in range(60):
        boxes = [[100 + 3.0 * k, 100, 140 + 3.0 * k, 200], [500 - 2.0 * k, 300, 540 - 2.0 * k, 400]]
        score = np.array([0.9 if k < 25 else low, low])
        rows = tracker.update(Detections(np.array(boxes), score, np.zeros(2, np.int64)))
        seen.append(set(rows.take(rows.confirmed).identity.tolist()))
    return seen, tracker


def test_low_boxes_continue_a_track_and_start_none():
    seen, tracker = found_with(0.08)
    tracks = tracker.tracks()
    assert seen[-1] == set(tracks.identity) == {1}
    assert tracks.frame.max() == 60
    np.testing.assert_allclose(tracks.xyxy[-1], [277, 100, 317, 200], atol=3)
    # The same boxes, all of one score: both are people.
    assert len(found_with(0.9)[0][-1]) == 2
