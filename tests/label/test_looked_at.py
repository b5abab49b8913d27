"""What marks say of the frames that were looked at: false alarms, objects, and what of the former a tracker follows."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.arrays import to_cxcywh
from phdtrack.label import Label, LabelStore
from phdtrack.label.session import false_boxes, object_boxes, share_followed
from phdtrack.types import Detections, DetectionTable, Tracks

# Three detections on each of five frames.
BOXES = np.array([[10.0 * k, 20 + i, 10 * k + 30, 80 + i] for k in range(1, 6) for i in range(3)])
TABLE = DetectionTable(np.repeat(np.arange(1, 6), 3), Detections.of(BOXES))


def marked(path, *false: tuple[int, int], looked=(2, 4)) -> LabelStore:
    """Frames 2, 4 and 5 were drawn, of which two were looked at; marks as false, and a birth, which is an object's."""
    store = LabelStore.open(path / "labels", "five", "digest", [4, 2, 5])
    if false:
        store.mark(2, [Label(*pair, "false") for pair in false])
    store.mark(4, [Label(4, 2, "birth")])
    for number in looked:
        store.finish(number)
    return store


def boxes(*pairs: tuple[int, int]) -> np.ndarray:
    return to_cxcywh(np.array([TABLE.at(frame).xyxy[k] for frame, k in pairs]).reshape(-1, 4))


def in_order(z: np.ndarray) -> np.ndarray:
    return z[:, np.lexsort(z)]


def resting(*pairs: tuple[int, int]) -> Tracks:
    """Rows of tracks (frame, detection)."""
    frame, detection = (np.array(column, np.int64) for column in zip(*pairs, strict=True))
    n = len(pairs)
    return Tracks(frame, np.ones(n, np.int64), np.ones((n, 4)), np.ones(n), detection, np.ones(n, np.bool_))


FALSE = [(2, 0), (2, 1), (4, 0), (5, 1), (3, 2)]


def test_objects_are_what_was_not_marked_on_frames_that_were_looked_at(tmp_path):
    store = marked(tmp_path, *FALSE)
    np.testing.assert_array_equal(in_order(object_boxes(store, TABLE)), in_order(boxes((2, 2), (4, 1), (4, 2))))
    np.testing.assert_array_equal(in_order(false_boxes(store, TABLE)), in_order(boxes((2, 0), (2, 1), (4, 0))))


def test_of_a_stretch_only_its_frames_count(tmp_path):
    store = marked(tmp_path, *FALSE, looked=(2, 4, 5))
    np.testing.assert_array_equal(
        in_order(object_boxes(store, TABLE, range(4, 6))), in_order(boxes((4, 1), (4, 2), (5, 0), (5, 2)))
    )
    assert object_boxes(store, TABLE, range(3, 4)).shape == (4, 0)
    run = resting((2, 0), (4, 0), (5, 2))
    assert share_followed(store, run, range(4, 6)) == (1 + 1) / (2 + 2)
    assert share_followed(store, run, range(3, 4)) == 0.5


def test_the_share_of_false_alarms_on_which_tracks_rest(tmp_path):
    """By hand: of three on frames 2 and 4 two are followed, (2 + 1)/(3 + 2); of others, and of objects, nothing is asked."""
    store = marked(tmp_path, *FALSE)
    assert share_followed(store, resting((2, 0), (4, 0), (2, 2), (3, 2), (5, 1))) == pytest.approx(3 / 5)
    # Two tracks on one detection count once, rows that rest on none not at all.
    assert share_followed(store, resting((2, 0), (2, 0), (4, -1))) == pytest.approx(2 / 5)
    assert share_followed(store, resting(*FALSE)) == pytest.approx(4 / 5)
    assert share_followed(store, Tracks.empty()) == pytest.approx(1 / 5)
