"""What scores say of objects that move by more than their size from frame to frame, so that their
boxes form no chains.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from phdtrack import Tracker
from phdtrack.models.detection_scores import DetectionScores, ScoresSeen
from phdtrack.types import Detections, Estimates

RULE = DetectionScores()
ELSEWHERE = np.array([[5000.0, 0.0, 5040.0, 40.0]])
SIZE = 40.0


def seen(reported: bool, frames: int = 200) -> tuple[ScoresSeen, np.ndarray]:
    """The state after an object of high scores that moves by twice its size a frame, among false
    alarms of low ones, and its last box; a target rests on it if it is ``reported``.
    """
    rng = np.random.default_rng(3)
    state = RULE.start()
    box = np.zeros(4)
    for k in range(frames):
        at = np.array([2 * SIZE * k, 0.0])
        box = np.concatenate([at, at + SIZE])
        away = rng.uniform(1e5, 1e6, (2, 2))
        boxes = np.vstack([box, np.hstack([away, away + SIZE])])
        score = np.array([rng.uniform(0.85, 0.99), *rng.uniform(0.2, 0.7, 2)])
        found = Detections(boxes, score, np.zeros(3, np.int64))
        estimates = Estimates.empty(6)
        if reported:
            estimates = Estimates(
                np.zeros((6, 1)), np.zeros((1, 6, 6)), np.ones(1), box[None], np.array([0])
            )
        state = RULE.advance(state, SimpleNamespace(detections=found, estimates=estimates))
    return state, box


def odds(state: ScoresSeen, box: np.ndarray) -> float:
    """The log odds of a high score there."""
    return float(RULE.log_odds(np.array([0.95]), state, box)[0][0])


def test_scores_of_followed_objects_are_believed_without_chains():
    """All three have the same verdict by chains, that their detections were false."""
    state, _ = seen(reported=True)
    nobody, _ = seen(reported=False)
    assert odds(state, ELSEWHERE) > 4
    assert odds(nobody, ELSEWHERE) < 1


def test_beside_a_target_only_chains_tell_what_scores_mean():
    """A second box of an object has the score of an object."""
    state, box = seen(reported=True)
    assert odds(state, box[None]) == pytest.approx(odds(seen(reported=False)[0], ELSEWHERE))
    # Half of the box is in both, and nothing is.
    assert odds(state, box[None] + [0, 20, 0, 20]) < odds(state, box[None] + 2 * SIZE) - 1


def learned(row: tuple[int, int], followed: int) -> float:
    """The log odds of a high score after a frame with it and a low one, numbered by ``row``, and a
    target that rests on the row ``followed``.
    """
    boxes = np.array([[0.0, 0, 40, 40], [500, 0, 540, 40]])
    found = Detections(boxes, np.array([0.9, 0.3]), np.zeros(2, np.int64), row=np.array(row))
    target = Estimates(
        np.zeros((6, 1)), np.zeros((1, 6, 6)), np.ones(1), boxes[:1], np.array([followed])
    )
    gone = Detections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64))
    state = RULE.advance(RULE.start(), SimpleNamespace(detections=found, estimates=target))
    nobody = SimpleNamespace(detections=gone, estimates=Estimates.empty(6))
    return odds(RULE.advance(state, nobody), ELSEWHERE)


def test_targets_name_detections_by_their_rows_in_the_frame():
    """Where classes are tracked apart, each has some of the rows."""
    assert learned((2, 5), 2) == learned((0, 1), 0)
    assert learned((2, 5), 5) == learned((0, 1), 1)
    assert learned((2, 5), 3) == learned((0, 1), -1)
    assert len({learned((0, 1), k) for k in (-1, 0, 1)}) == 3


def missed(seed: int) -> tuple[int, int]:
    """In how many of 720 frames an object that crosses the picture at 4 frames a second is not
    reported, and how many false boxes are: scores tell it from two false alarms a frame.
    """
    rng = np.random.default_rng(seed)
    tracker = Tracker((1280, 720), fps=4)
    lost = false = 0
    for _ in range(45):
        y = rng.uniform(100, 600)
        for x in 60 + 70.0 * np.arange(16):
            box = np.array([x - 20, y - 20, x + 20, y + 20]) + rng.normal(0, 1, 4)
            middle = rng.uniform([40, 40], [1240, 680], (rng.poisson(2), 2))
            wrong = np.hstack([middle - 20, middle + 20, rng.uniform(0.2, 0.7, (len(middle), 1))])
            rows = tracker.update(np.vstack([[*box, rng.uniform(0.9, 1)], wrong]))
            near = np.abs(rows.xyxy - box).max(axis=1, initial=0) < 15
            lost += not near.any()
            false += int((~near).sum())
        for _ in range(6):
            tracker.update(np.zeros((0, 5)))
    return lost, false


def test_fast_objects_of_sharp_scores_are_reported_at_once():
    """By chains alone each was reported at its fifth detection, and 28 % of the boxes were lost;
    until the scores are known some are.
    """
    lost, false = missed(1)
    assert lost < 0.05 * 720
    assert false < 10
