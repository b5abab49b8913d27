"""What detections say of their stream: how crowded it is, and how high its best scores are."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack import Tracker
from phdtrack.kernels.detection_scores import neighbours
from phdtrack.models.clutter import BoxClutter, UniformClutter
from phdtrack.models.detection_scores import GOOD, LEVEL_FRAMES, NEAR, DetectionScores, ScoresSeen
from phdtrack.protocols import Model
from phdtrack.types import Detections, Estimates

RULE = DetectionScores()
NOBODY = Estimates.empty(6)


def detections(boxes: np.ndarray, score: np.ndarray) -> Detections:
    return Detections(boxes, score, np.zeros(len(boxes), np.int64))


def seen(frames: list[Detections]) -> ScoresSeen:
    """The state after these frames."""
    state = RULE.start()
    for found in frames:
        state = RULE.advance(state, SimpleNamespace(detections=found, estimates=NOBODY))
    return state


def plain_neighbours(boxes: np.ndarray, counted: np.ndarray, asked: list[int]) -> int:
    """`neighbours` as it is defined: centres within a width and a height, 0.5 to 1.5 in size."""
    centre = (boxes[:, :2] + boxes[:, 2:]) / 2
    size = boxes[:, 2:] - boxes[:, :2]
    count = 0
    for i in asked:
        others = np.arange(len(boxes)) != i
        near = (np.abs(centre - centre[i]) < size[i]).all(axis=1)
        alike = ((size > 0.5 * size[i]) & (size < 1.5 * size[i])).all(axis=1)
        count += int((others & counted & near & alike).sum())
    return count


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(0, 150), st.integers(1, 40))
def test_neighbours_are_counted_as_defined(seed: int, count: int, most: int):
    rng = np.random.default_rng(seed)
    corner = rng.uniform(0, 200, (count, 2))
    boxes = np.hstack([corner, corner + rng.uniform(10, 60, (count, 2))])
    asked = list(range(0, count, max(count // most, 1)))
    assert len(asked) < 2 * most
    counted = rng.random(count) < 0.7
    wanted = plain_neighbours(boxes, counted, asked), len(asked)
    assert neighbours(boxes, counted, most) == wanted


def clutter_share(step: float, count: int, frames: int) -> float:
    """How many times the model's κ is, after frames of a row of boxes 40 wide, ``step`` apart."""
    left = 100 + step * np.arange(count)
    boxes = np.stack([left, np.full(count, 100.0), left + 40, np.full(count, 180.0)], axis=1)
    found = detections(boxes, np.full(count, 0.9))
    state = seen([found] * frames)
    model = Model(None, None, None, UniformClutter(2.0), rate=1.0)
    told = RULE.with_scores(state, model, found).clutter.intensity(np.zeros((4, count)))
    return float(told[0]) / 2.0


def test_false_alarms_near_boxes_are_few_in_a_sparse_stream():
    """Boxes without a neighbour count against the 30 that are assumed, down to a 20th."""
    assert clutter_share(200.0, 3, 0) == 1.0
    shares = [clutter_share(200.0, 3, frames) for frames in (1, 10, 30)]
    np.testing.assert_allclose(shares, [30 / 33, 30 / 60, 30 / 120], rtol=0.02)
    assert clutter_share(200.0, 3, 1000) == pytest.approx(0.05)


@pytest.mark.parametrize("step", [15.0, 30.0, 39.0])
def test_false_alarms_stay_as_set_in_a_crowded_stream(step: float):
    """Boxes with more neighbours than are assumed, however many."""
    for frames in (1, 30, 300):
        assert clutter_share(step, 8, frames) == 1.0


def test_false_alarms_near_boxes_are_as_many_as_the_boxes_there():
    """Two boxes of seven are side by side: 2/7 neighbours for each, of 0.6 that are assumed."""
    left = np.array([0.0, 30, 200, 400, 600, 800, 1000])
    boxes = np.stack([left, 0 * left, left + 40, 0 * left + 80], axis=1)
    found = detections(boxes, np.full(7, 0.9))
    state = seen([found] * 400)
    model = Model(None, None, None, UniformClutter(1.0), rate=1.0)
    told = RULE.with_scores(state, model, found).clutter.intensity(np.zeros((4, 7)))
    np.testing.assert_allclose(told, 2 / 7 / NEAR, rtol=0.03)


def new_share(frames: list[Detections], clutter: BoxClutter | UniformClutter) -> float:
    """The share of false alarms that are new in each frame, after these."""
    model = Model(None, None, None, clutter, rate=1.0)
    return RULE.with_scores(seen(frames), model, frames[-1]).clutter.anew


def row_of(left: np.ndarray) -> Detections:
    """Boxes 40 wide that begin there."""
    boxes = np.stack([left, 0 * left, left + 40, 0 * left + 80], axis=1)
    return detections(boxes, np.full(len(left), 0.9))


def test_false_alarms_that_are_new_are_a_fifth_at_first():
    """As long as no neighbour is known."""
    assert new_share([row_of(np.zeros(1))], BoxClutter()) == pytest.approx(0.2 * 31 / 30)


def test_new_false_alarms_are_counted_from_isolated_neighbours():
    """Of three boxes side by side one jumps away in each frame, that of the middle: it is the only
    isolated one and a neighbour of both others.
    """
    frames = [row_of(np.array([0.0, 30 if k % 2 else 2000 + 100 * k, 60])) for k in range(601)]
    state = seen(frames)
    # Two neighbours in half of the frames, of three detections in all.
    np.testing.assert_allclose(state.near_alone[0] / state.near_alone[1], 1 / 3, rtol=0.03)


def test_lasting_neighbours_are_no_new_false_alarms():
    """They last; in a sparse stream at least a 20th of 0.6 are new, and so all that are left."""
    beside = [row_of(np.array([0.0, 30, 60]))] * 400
    assert new_share(beside, BoxClutter()) == pytest.approx(0.05)
    apart = [row_of(np.array([0.0, 300, 600]))] * 1000
    assert new_share(apart, BoxClutter()) == pytest.approx(1.0)


def test_stated_false_alarms_do_not_depend_on_the_interval():
    stated = BoxClutter(clutter_per_frame=3.0, frame_size=(640, 480))
    assert new_share([row_of(np.array([0.0, 30, 60]))] * 20, stated) == 1.0


def log_odds(score: np.ndarray, frames: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """Log odds of scores after frames with them, of boxes that no next frame links."""
    count = len(score)
    left = 100.0 * np.arange(count)
    boxes = np.stack([left, left, left + 9, left + 9], axis=1)
    return RULE.log_odds(score, seen([detections(boxes, score)] * min(frames, 4)))


def scaled_to(best: float, score: np.ndarray) -> np.ndarray:
    """Scores whose log odds are shifted so that the highest is ``best``."""
    x = np.log(score / (1 - score))
    return 1 / (1 + np.exp(-(x - x.max() + np.log(best / (1 - best)))))


def test_scores_of_a_low_level_are_read_by_their_best():
    """Of a stream whose best score is .4 they say the same as with .8 for its best, and nearly the
    same as with .9.
    """
    score = np.array([0.4, 0.3, 0.2, 0.1])
    low = log_odds(score)
    np.testing.assert_allclose(low, log_odds(scaled_to(0.8, score)), rtol=1e-9)
    high = log_odds(scaled_to(0.9, score))
    np.testing.assert_allclose(low[1], high[1] - (np.log(9) - GOOD), rtol=1e-9)
    assert (np.abs(low[0] - high[0]) < 2.1 * (np.log(9) - GOOD)).all()
    # Read as they are, they would be of false alarms.
    assert low[0][0] > 1 > 0 > np.log(0.4 / 0.6)


def test_scores_of_a_high_level_are_read_as_they_are():
    score = np.array([0.9, 0.5, 0.2])
    _, lasting = log_odds(score)
    np.testing.assert_allclose(lasting, np.log(score / (1 - score)), rtol=1e-12)


def test_level_falls_slowly_after_high_scores():
    """After one high score lower ones are read as they are, and gradually by their best."""
    boxes = np.array([[0.0, 0, 50, 50], [200, 0, 250, 50]])
    low = np.array([0.4, 0.2])
    x = np.log(low / (1 - low))
    state = seen([detections(boxes, np.array([0.9, 0.2]))])
    _, lasting = RULE.log_odds(low, state)
    np.testing.assert_allclose(lasting - x, 0, atol=1e-9)
    frames = 1000
    for _ in range(frames):
        state = RULE.advance(
            state, SimpleNamespace(detections=detections(boxes, low), estimates=NOBODY)
        )
    level = x[0] + (np.log(9) - x[0]) * (1 - 1 / LEVEL_FRAMES) ** frames
    assert state.level == pytest.approx(level)
    # The scores of a frame count for its own level.
    level -= (level - x[0]) / LEVEL_FRAMES
    _, lasting = RULE.log_odds(low, state)
    np.testing.assert_allclose(lasting - x, GOOD - level, rtol=1e-9)


def test_targets_with_low_scores_are_tracked():
    """Two people with scores about .35, and false alarms with scores about .1 in no place twice:
    the people are shown.
    """
    rng = np.random.default_rng(3)
    tracker = Tracker((640, 480), fps=25)
    shown = []
    for k in range(60):
        people = np.array([[100 + 3.0 * k, 100.0], [500 - 2.0 * k, 300]])
        corner = np.vstack([people, rng.uniform([0, 0], [590, 370], (3, 2))])
        boxes = np.hstack([corner, corner + np.array([40.0, 100])])
        score = np.append(rng.uniform(0.32, 0.38, 2), rng.uniform(0.06, 0.14, 3))
        rows = tracker.update(detections(boxes, score))
        shown.append(rows.select(rows.confirmed))
    assert [len(rows) for rows in shown[-20:]] == [2] * 20
    assert len(set(np.concatenate([rows.identity for rows in shown[-40:]]).tolist())) == 2
