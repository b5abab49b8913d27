"""Which way a score is better, against what the scores do when tracks get worse."""

from __future__ import annotations

import numpy as np

from phdtrack.metrics import evaluate
from phdtrack.report.pages import score_meanings
from phdtrack.types import Tracks, Truth

FRAMES, PEOPLE = 20, 3
# Neither way: numbers of what there is, and an error with a sign.
PLAIN = {"frames", "truth_boxes", "output_boxes", "truth_objects", "output_identities", "count_error_mean"}


def walkers() -> Truth:
    frame, who = (grid.ravel() for grid in np.mgrid[1 : FRAMES + 1, 1 : PEOPLE + 1])
    corner = np.stack([5.0 * frame, 150.0 * who], axis=1)
    return Truth(frame, who, np.hstack([corner, corner + np.array([40, 80])]), np.zeros(len(frame), np.bool_))


def tracks(frame: np.ndarray, identity: np.ndarray, xyxy: np.ndarray) -> Tracks:
    n = len(frame)
    return Tracks(frame, identity, xyxy, np.ones(n), np.zeros(n, np.int64), np.ones(n, np.bool_))


def worse(truth: Truth) -> dict[str, Tracks]:
    """The truth with one kind of mistake each."""
    frame, who, xyxy = truth.frame, truth.identity, truth.xyxy
    held = {
        "late": frame > 4,
        "never": who != 2,
        "gaps": (frame < 8) | (frame > 11) | (who == 3),
        "hardly": (who != 1) | (frame == 3),
    }
    out = {name: tracks(frame[rows], who[rows], xyxy[rows]) for name, rows in held.items()}
    out["shifted"] = tracks(frame, who, xyxy + 3)
    out["switched"] = tracks(frame, np.where(frame > 10, who % PEOPLE + 1, who), xyxy)
    out["nobody"] = tracks(np.tile(frame, 2), np.append(who, who + 10), np.vstack([xyxy, xyxy + np.array([300, 0, 300, 0])]))
    return out


def test_every_score_gets_worse_that_way() -> None:
    truth = walkers()
    best = evaluate(truth, tracks(truth.frame, truth.identity, truth.xyxy)).as_dict()
    found = [evaluate(truth, each).as_dict() for each in worse(truth).values()]
    lower = {name for name, meaning in score_meanings().items() if meaning.endswith("; lower is better")}
    assert set(best) >= PLAIN
    for name in set(best) - PLAIN:
        sign = -1 if name in lower else 1
        changes = sign * np.array([float(each[name]) - best[name] for each in found if each[name] is not None])
        assert changes.max() <= 1e-12, name
        assert changes.min() < -1e-6, name
