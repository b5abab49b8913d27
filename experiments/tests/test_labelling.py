"""Labels of detections some seconds later, from what became of them."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.labelling import ObservedFrame, PendingFrames, label
from phdtrack.arrays import to_xyxy
from phdtrack.types import Tracks

PLACES = np.array([[100.0, 200, 30, 80], [400, 100, 20, 50]])


def boxes(place, n, rng, jitter=0.1):
    size = np.tile(place[2:], 2)
    return place[:, None] + jitter * size[:, None] * rng.standard_normal((4, n))


def row(frame, identity, box, detection=0, confirmed=True):
    one = (
        np.array([frame]),
        np.array([identity]),
        to_xyxy(box[:, None]),
        np.ones(1),
        np.array([detection]),
    )
    return Tracks(*one, np.array([confirmed]))


def street(rng):
    """100 frames at 25 a second: somebody walks in from frame 10 on and is tracked from 14,
    confirmed from 18; a place fires every second frame, with a track from frame 20 on; a box is
    anywhere once a frame."""
    out = []
    truth = []
    for frame in range(1, 101):
        walker = np.array([5.0 + 4 * (frame - 10), 200, 30, 80]) + np.append(
            rng.normal(size=2), [0, 0]
        )
        place = boxes(PLACES[1], 1, rng)[:, 0]
        stray = np.array([*rng.uniform(0, 1, 2) * [300, 80] + [300, 250], 30, 80])
        parts = []
        rows = []
        source = []
        if frame >= 10:
            parts.append(walker)
            source.append(1)
            if frame >= 14:
                rows.append(row(frame, 1, walker, 0, frame >= 18))
        if frame % 2 == 0:
            if frame >= 20:
                rows.append(row(frame, 2, place, len(parts)))
            parts.append(place)
            source.append(-1)
        elif frame >= 20:
            rows.append(row(frame, 2, PLACES[1], -1))
        parts.append(stray)
        source.append(0)
        box = to_xyxy(np.array(parts).T)
        out.append(
            ObservedFrame(
                frame, (frame - 1) / 25, box, np.full(len(parts), 0.8), Tracks.concatenate(rows)
            )
        )
        truth.append(np.array(source))
    return tuple(out), truth


def test_labels_wait_for_what_became_of_a_detection():
    given, truth = street(np.random.default_rng(8))
    pending, labels = label(PendingFrames(given), 3.0, 0.9)
    assert labels.frames == 76
    assert labels.seconds == pytest.approx(76 / 25)
    source = np.concatenate(truth[:76])
    # Also the walker's first detections, before there was a track, are his.
    assert (labels.false[source == 1] == 0).all()
    assert (labels.false[source == 0] == 0.8).all()
    frame = np.concatenate([np.full(len(t), k + 1) for k, t in enumerate(truth[:76])])
    assert (labels.false[(source == -1) & (frame >= 20)] == 1).all()
    assert [frame.number for frame in pending.frames] == list(range(77, 101))


def test_labels_do_not_depend_on_how_frames_are_divided():
    given, _ = street(np.random.default_rng(9))
    _, whole = label(PendingFrames(given), 3.0, 0.9)
    pending = PendingFrames()
    parts = []
    for k, frame in enumerate(given):
        pending = replace(pending, frames=(*pending.frames, frame))
        if k + 1 in (60, 80, 100):
            pending, labels = label(pending, {60: 1.5, 80: 2.3, 100: 3.0}[k + 1], 0.9)
            parts.append(labels)
    np.testing.assert_array_equal(np.concatenate([p.false for p in parts]), whole.false)


def test_somebody_who_stands_is_no_place_and_a_place_is_nobody():
    rng = np.random.default_rng(10)
    for chance, expected in ((0.9, 0.0), (0.5, 1.0)):
        fired = rng.random(150) < chance
        fired[0] = True
        given = []
        for k in range(150):
            box = boxes(PLACES[0], 1, rng, 0.05)
            seen = to_xyxy(box)[: int(fired[k])]
            rows = row(k + 1, 5, box[:, 0], 0 if fired[k] else -1)
            given.append(ObservedFrame(k + 1, k / 25, seen, np.full(len(seen), 0.5), rows))
        _, labels = label(PendingFrames(tuple(given)), 4.0, 0.9)
        assert (labels.false == expected).all()
