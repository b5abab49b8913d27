"""The precision of suggestions, by a truth of made boxes."""

import numpy as np

from experiments.suggestions import VIDEOS, precision, wrong_boxes
from phdtrack.label.suggestions import TICKED, Suggestion
from phdtrack.types import Detections, DetectionTable, Truth

OBJECTS = np.array([[0.0, 0, 20, 40], [25.0, 0, 45, 40]])
BOXES = np.array(
    [
        [1.0, 1, 21, 41],  # an object
        [0.0, 0, 45, 40],  # two that walk side by side
        [0.0, 30, 20, 40],  # legs
        [100.0, 0, 120, 40],  # nothing
        [200.0, 0, 220, 40],  # in a region that does not count
    ]
)


def truth() -> Truth:
    return Truth(
        np.array([3, 3]),
        np.array([1, 2]),
        OBJECTS,
        np.zeros(2, np.bool_),
        regions=np.array([[0.0, 190, 0, 300, 100]]),
    )


def table() -> DetectionTable:
    frames = np.repeat([2, 3], len(BOXES))
    return DetectionTable(frames, Detections.of(np.vstack([BOXES, BOXES])))


def test_what_is_false_is_said_of_frames_with_truth() -> None:
    false = wrong_boxes(table(), truth(), masks=False)
    assert np.isnan(false[:5]).all()
    np.testing.assert_array_equal(false[5:], [0, 0, 1, 1, np.nan])
    # Of masks, a tenth that moves is enough.
    false = wrong_boxes(table(), truth(), masks=True)
    np.testing.assert_array_equal(false[5:], [0, 0, 0, 1, np.nan])


def test_precision_counts_what_is_ticked_and_what_is_shown() -> None:
    false = wrong_boxes(table(), truth(), masks=False)
    found = [
        Suggestion(3, 3, "place", TICKED, 0),
        Suggestion(3, 0, "place", 0.5, 0),
        Suggestion(3, 2, "rejected", 1.0, -1),
        Suggestion(2, 3, "rejected", 1.0, -1),
    ]
    counts = precision(found, table(), false)
    assert (counts.ticked["all"], counts.ticked_false["all"]) == (2, 2)
    assert (counts.shown["place"], counts.shown_false["place"]) == (2, 1)


def test_every_video_has_a_name_of_its_own() -> None:
    assert len({video.name for video in VIDEOS}) == len(VIDEOS)
