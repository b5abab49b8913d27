"""What the scores of detections say: odds by score or by rank, and tracks that low boxes continue
and do not start.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack import Tracker, config
from phdtrack.errors import InputError
from phdtrack.filters import GMPHD, MHT, ParticlePHD
from phdtrack.kernels.box import following
from phdtrack.kernels.detection_scores import (
    LOGIT,
    PROBABILITY,
    RANK,
    Line,
    chained,
    newton,
    scaled,
)
from phdtrack.models.clutter import ScoredClutter, UniformClutter
from phdtrack.models.detection_scores import (
    BOUND,
    EVEN_LOGIT,
    GOOD,
    KEPT,
    DetectionScores,
    ScoresSeen,
)
from phdtrack.protocols import Model
from phdtrack.types import Detections, Estimates, SequenceInfo

RULE = DetectionScores()
NOBODY = Estimates.empty(6)
FIRST = DetectionScores().start()


def after(rule: DetectionScores, *scores: np.ndarray) -> ScoresSeen:
    """The state after frames with these scores, of boxes that overlap none."""
    state = rule.start()
    for k, score in enumerate(scores):
        corner = 100.0 * np.arange(len(score)) + 5000 * k
        found = Detections(
            np.stack([corner, corner, corner + 9, corner + 9], axis=1),
            score,
            np.zeros(len(score), np.int64),
        )
        state = rule.advance(state, SimpleNamespace(detections=found, estimates=NOBODY))
    return state


@settings(deadline=None)
@given(
    score=st.lists(st.floats(0, 1), min_size=2, max_size=20),
    scale=st.floats(1, 50),
    slope=st.floats(0.1, 5),
    even=st.floats(0.05, 0.95),
    most=st.floats(1, 1e4),
)
def test_odds_rise_with_the_score_within_their_limits(
    score, scale: float, slope: float, even: float, most: float
):
    """Also by rank, where scores are no probabilities."""
    rule = DetectionScores(slope, even, most)
    score = np.sort(score)
    for seen in (score, scale * score + 2):
        odds, lasting = rule.log_odds(seen, rule.start())
        assert (np.diff(odds) >= -1e-9).all()
        assert (np.diff(lasting) >= -1e-9).all()
        assert (np.abs(odds) <= np.log(most) * (1 + 1e-9)).all()
    odds, _ = rule.log_odds(np.array([even, 0.999]), rule.start())
    assert odds[0] == pytest.approx(0, abs=1e-9)


def test_first_scores_between_0_and_1_are_probabilities():
    """That of 0.8 are 4 to 1, over those of the score that says nothing; 0 and 1 are at the
    limits.
    """
    rule = DetectionScores(slope=2.0, even_score=0.6, max_odds=400.0)
    odds, lasting = rule.log_odds(np.array([0.8, 0.0, 1.0, np.nan]), rule.start())
    np.testing.assert_allclose(odds, [2 * np.log(4 / 1.5), -np.log(400), np.log(400), 0])
    np.testing.assert_allclose(lasting[[0, 3]], [np.log(4), 0])


# The first call compiles.
@settings(deadline=None)
@given(score=st.floats(-1e3, 1e3), count=st.integers(0, 9))
def test_equal_scores_and_none_say_nothing(score: float, count: int):
    for seen in (np.full(count, score), np.full(count, np.nan)):
        for state in (FIRST, after(RULE, seen, seen, seen)):
            np.testing.assert_array_equal(RULE.log_odds(seen, state), 0)


@settings(deadline=None)
@given(st.lists(st.integers(-50, 50), min_size=2, max_size=20), st.integers(1, 19))
def test_of_scores_on_another_scale_the_rank_counts(scores: list[int], first: int):
    """A rising change of the scale changes nothing; both scales reach beyond those of probabilities
    and log odds.
    """
    score = np.array([60.0, *scores])
    before, now = np.split(score, [min(first, len(scores))])
    wanted = RULE.log_odds(now, after(RULE, before))
    np.testing.assert_allclose(
        RULE.log_odds(now**3 + 7, after(RULE, before**3 + 7)), wanted, rtol=1e-12
    )
    unknown = RULE.log_odds(np.append(now, np.nan), after(RULE, before))
    np.testing.assert_allclose(unknown, [[*row, 0] for row in wanted], rtol=1e-12)


@settings(deadline=None)
@given(st.lists(st.floats(-3, 15), min_size=1, max_size=20))
def test_scores_of_which_some_are_negative_are_log_odds(scores: list[float]):
    """They say by how much they exceed what says nothing, up to a probability of 0.999, and are
    raised if the best is below `GOOD`; one of 100 makes them ranks.
    """
    score = np.array([-0.8, *scores, np.nan])
    wanted = np.append(np.clip(score[:-1] - EVEN_LOGIT, -BOUND, BOUND), 0)
    wanted[:-1] += max(GOOD - wanted[:-1].max(), 0)
    single, lasting = RULE.log_odds(score, FIRST)
    np.testing.assert_allclose(lasting, wanted)
    np.testing.assert_allclose(single, np.clip(wanted, -np.log(400), np.log(400)))
    single, _ = RULE.log_odds(np.array([-0.8, 100.0]), FIRST)
    np.testing.assert_allclose(single, DetectionScores().log_odds(np.array([3.0, 7.0]), FIRST)[0])


@settings(deadline=None)
@given(
    st.lists(st.one_of(st.floats(-2, 30), st.floats(0, 1), st.just(np.nan)), max_size=12),
    st.floats(-1, 40),
    st.floats(0, 9),
)
def test_scores_become_log_odds_as_defined(scores: list[float], low: float, more: float):
    score = np.array(scores)
    known = np.append(score[~np.isnan(score)], [low, low + more])
    *ends, found, each = scaled(score, low, low + more, (25.0, 2.0), 5.0, 0.01)
    assert tuple(ends) == (known.min(), known.max())
    if known.min() >= 0 and known.max() <= 1:
        kind = PROBABILITY
        share = np.clip(score, 0.01, 0.99)
        x = np.log(share / (1 - share))
    elif known.min() < 0 and known.max() <= 25:
        kind = LOGIT
        x = np.clip(score - 2, -5, 5)
    else:
        kind = RANK
        x = np.full(len(score), np.nan)
    assert found == kind
    np.testing.assert_allclose(
        each, x if known.min() < known.max() else np.full(len(score), np.nan), rtol=1e-12
    )


def plain_chains(before, boxes, x, followed, chains, overlap):
    """`chained` as it is defined."""
    waiting, held, length, _ = chains
    link = following(before, boxes, overlap)
    most = waiting.shape[1]
    now = np.full((len(x), most), np.nan)
    known = np.zeros((len(x), most), bool)
    long = np.ones(len(x), np.int64)
    true = []
    for j, i in enumerate(link):
        if i >= 0:
            now[j] = waiting[i]
            known[j] = held[i]
            long[j] = length[i] + 1
        newest = min(long[j], most) - 1
        now[j, newest] = x[j]
        known[j, newest] = followed[j]
        if long[j] >= most:
            true += now[j][~np.isnan(now[j])].tolist()
            now[j] = np.nan
    ended = np.setdiff1d(np.arange(len(before)), link)
    false, lost = waiting[ended], held[ended]
    verdicts = (np.array(true), *(false[~np.isnan(false) & at] for at in (lost, ~lost)))
    ends = np.isin(np.arange(len(before)), ended)
    return (now, known, long, x), verdicts, ends


def plain_newton(before: Line, true, false, prior: Line, remembered: float) -> Line:
    """`newton` in matrices."""
    kept = max(1 - (len(true) + len(false)) / remembered, 0.0)
    n = len(true) + len(false)
    information, precision, verdicts = (
        kept * a + (1 - kept) * b for a, b in zip(before, prior, strict=True)
    )
    verdicts = verdicts + np.array([len(true), len(false)])
    rows = np.stack([np.concatenate([true, false]), np.ones(n)])
    line = np.linalg.solve(precision, information)
    p = 1 / (1 + np.exp(-(line @ rows + np.log(verdicts[0] / verdicts[1]))))
    curvature = (p * (1 - p) * rows) @ rows.T
    label = np.arange(n) < len(true)
    return Line(
        information + curvature @ line + rows @ (label - p), precision + curvature, verdicts
    )


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(0, 8), st.integers(1, 6))
def test_verdicts_and_what_they_teach_are_as_defined(seed: int, count: int, length: int):
    rng = np.random.default_rng(seed)
    corner = rng.uniform(0, 60, (count, 2))
    boxes = np.hstack([corner, corner + 30])
    nothing = np.zeros(0)
    chains = (np.zeros((0, length)), np.zeros((0, length), bool), nothing.astype(int), nothing)
    before = np.zeros((0, 4))
    line = Line(rng.normal(0, 1, 2), np.diag(rng.uniform(1, 5, 2)), np.array([7.0, 3.0]))
    prior = Line(np.array([8.0, -2.0]), np.diag([4.0, 1.0]), np.array([7.0, 3.0]))
    for _ in range(9):
        now = (boxes + rng.normal(0, 5, boxes.shape))[rng.random(count) < 0.9]
        x = np.where(rng.random(len(now)) < 0.2, np.nan, rng.normal(0, 2, len(now)))
        followed = rng.random(len(now)) < 0.5
        wanted, ends, over = plain_chains(before, now, x, followed, chains, 0.3)
        chains, verdicts, ended = chained(before, now, x, followed, chains, 0.3)
        for a, b in zip((*chains, *verdicts, ended), (*wanted, *ends, over), strict=True):
            np.testing.assert_array_equal(a, b)
        true, false = verdicts[0], verdicts[2]
        wanted_line = plain_newton(line, true, false, prior, 50.0)
        line = Line(*newton(line, true, false, prior, 50.0))
        for a, b in zip(line, wanted_line, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
        before = now


@pytest.mark.parametrize(("slope", "even"), [(1.0, 0.3), (0.6, 0.95), (2.5, 0.7)])
@pytest.mark.parametrize("seed", range(3))
def test_the_ratio_is_learned_from_what_is_linked(seed: int, slope: float, even: float):
    """Three that stay and as many false alarms as they, all scores of one logistic law: the line is
    found to 5 deviations.

    With p(s|false alarm) = N(0, 1) in log odds x, p(s|target) is that times e^(ax + b), a normal
    distribution of mean a.
    """
    rng = np.random.default_rng(seed)
    rule = RULE
    state = FIRST
    frames = 400
    offset = slope * np.log(even / (1 - even))
    for _ in range(frames):
        place = np.concatenate(
            [np.array([[0.0, 0], [200, 0], [400, 0]]), rng.uniform(1000, 100000, (3, 2))]
        )
        # Of the density e^(a(x - x0) - a²/2) more than a false alarm's, both with deviation 1 about
        # centres a apart.
        x = rng.normal(0, 1, 6) + offset / slope - slope / 2 + slope * (np.arange(6) < 3)
        found = Detections(
            np.hstack([place, place + 50]), 1 / (1 + np.exp(-x)), np.zeros(6, np.int64)
        )
        state = rule.advance(state, SimpleNamespace(detections=found, estimates=NOBODY))
    learned, _ = rule.log_odds(
        1 / (1 + np.exp(-np.array([offset / slope, offset / slope + 1]))), state
    )
    # Fisher's information of a logistic regression of 2400 that are balanced: about 2400/8, the
    # prior's aside.
    assert learned[0] == pytest.approx(0, abs=5 * (2400 / 8) ** -0.5)
    assert learned[1] - learned[0] == pytest.approx(slope, abs=5 * (2400 / 8) ** -0.5)


@pytest.mark.parametrize(("slope", "share"), [(0.0, 0.0), (0.4, 0.4), (3.0, 1.0)])
def test_scores_that_tell_nothing_say_nothing_of_lasting_alarms(slope: float, share: float):
    """As much less of what a score claims as its slope is below half of the prior's, 1."""
    rng = np.random.default_rng(5)
    state = FIRST
    for _ in range(600):
        place = np.concatenate(
            [np.array([[0.0, 0], [200, 0], [400, 0]]), rng.uniform(1000, 100000, (3, 2))]
        )
        x = rng.normal(0, 1, 6) + slope * (np.arange(6) < 3) + GOOD
        found = Detections(
            np.hstack([place, place + 50]), 1 / (1 + np.exp(-x)), np.zeros(6, np.int64)
        )
        state = RULE.advance(state, SimpleNamespace(detections=found, estimates=NOBODY))
    score = np.array([0.1, 0.9])
    claimed = np.log(score / (1 - score))
    _, before = RULE.log_odds(score, FIRST)
    _, lasting = RULE.log_odds(score, state)
    np.testing.assert_allclose(before - before[0], claimed - claimed[0])
    assert np.ptp(lasting) == pytest.approx(share * np.ptp(claimed), abs=0.15 * np.ptp(claimed))


@pytest.mark.parametrize("false", [0, 1, 12])
def test_false_alarms_are_learned_from_detections_that_are_alone(false: int):
    """Three that stay, and false alarms far from one another: these are the share that is alone,
    without any scores.
    """
    rng = np.random.default_rng(false)
    rule = RULE
    state = FIRST
    frames = 300
    for _ in range(frames):
        place = np.concatenate(
            [np.array([[0.0, 0], [200, 0], [400, 0]]), rng.uniform(1000, 1e6, (false, 2))]
        )
        found = Detections(
            np.hstack([place, place + 50]), np.ones(len(place)), np.zeros(len(place), np.int64)
        )
        state = rule.advance(state, SimpleNamespace(detections=found, estimates=NOBODY))
    model = Model(None, None, None, UniformClutter(2.0), rate=1.0)
    told = rule.with_scores(state, model, found).clutter.intensity(np.zeros((4, len(place))))
    # Of the (3 + false)·(frames − 1) detections with a verdict those that were not forgotten, and
    # the prior's 100.
    seen = (3 + false) * (frames - 1)
    kept = min(seen, KEPT)
    share = false / (3 + false) * kept / (kept + 100)
    # None has a neighbour: near a box a 20th of the false alarms is left.
    wanted = 0.05 * 2.0 * max(share / rule.usual_alone, 1.0)
    np.testing.assert_allclose(told, wanted, rtol=0.05)


def found_with(low: float) -> tuple[list[set[int]], Tracker]:
    """Identities of each frame: one person with a high score who fades to ``low``, and one who
    never has a higher one.
    """
    tracker = Tracker((640, 480), preset="default")
    seen = []
    for k in range(60):
        boxes = [[100 + 3.0 * k, 100, 140 + 3.0 * k, 200], [500 - 2.0 * k, 300, 540 - 2.0 * k, 400]]
        score = np.array([0.9 if k < 25 else low, low])
        rows = tracker.update(Detections(np.array(boxes), score, np.zeros(2, np.int64)))
        seen.append(set(rows.select(rows.confirmed).identity.tolist()))
    return seen, tracker


def test_low_boxes_continue_a_track_and_start_none():
    seen, tracker = found_with(0.08)
    tracks = tracker.tracks()
    assert seen[-1] == set(tracks.identity) == {1}
    assert tracks.frame.max() == 60
    np.testing.assert_allclose(tracks.xyxy[-1], [277, 100, 317, 200], atol=3)
    # The same boxes, all of one score: both are people.
    assert len(found_with(0.9)[0][-1]) == 2


@pytest.mark.parametrize("rate", ["clutter_per_frame", "clutter_per_detection"])
def test_odds_divide_the_false_alarms(rate: str):
    model = config.build(
        config.load(None, (f"clutter.{rate}=1.5",)), SequenceInfo(640, 480, 25.0)
    ).model
    corner = np.random.default_rng(1).uniform(50, 350, (4, 2))
    z = model.sensor.measure(Detections.of(np.hstack([corner, corner + 40])))
    scored = ScoredClutter(model.clutter, np.array([0.1, 1.0, 10.0, 1.0]), np.zeros(4))
    assert scored.intensity(z) == pytest.approx(
        model.clutter.intensity(z) / np.array([0.1, 1.0, 10.0, 1.0])
    )
    with pytest.raises(InputError, match="expected the 4 detections"):
        scored.intensity(z[:, :2])


@pytest.mark.parametrize("recursion", [GMPHD(), MHT(), ParticlePHD(400)])
def test_a_low_score_confirms_but_starts_nobody(recursion):
    """One detection each of a new place, scored low and high, and a second low one of a confirmed
    target.
    """
    built = config.build(config.load(), SequenceInfo(640, 480, 25.0), "gm-phd")
    rng = np.random.default_rng(4)
    z = built.model.sensor.measure(Detections.of(np.array([[100.0, 100, 130, 180]])))

    def mass(odds):
        state = recursion.start(built.model, rng)
        for one in odds:
            model = replace(
                built.model,
                clutter=ScoredClutter(built.model.clutter, np.array([one]), np.log([one])),
            )
            state, info = recursion.step(state, z, model, 1.0, rng)
        return info.mass

    assert mass([0.1]) < 0.2 * mass([10.0]) < 0.2
    assert mass([10.0, 10.0, 10.0, 0.1]) > 0.9
