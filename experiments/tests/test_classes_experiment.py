"""The parts of the experiment on classes."""

from __future__ import annotations

import numpy as np

from experiments.classes import CAR, PERSON, by_majority, classes_of
from phdtrack.types import Detections, DetectionTable, Tracks


def test_the_class_of_a_track_is_that_of_most_of_its_detections() -> None:
    boxes = np.tile([0.0, 0, 9, 9], (5, 1))
    given = DetectionTable(
        np.array([1, 1, 2, 3, 3]), Detections.of(boxes, class_id=[CAR, PERSON, CAR, CAR, PERSON])
    )
    frame = np.array([1, 1, 2, 3, 3])
    identity = np.array([1, 2, 1, 1, 2])
    detection = np.array([0, 1, 0, 1, -1])
    rows = Tracks(frame, identity, boxes, np.ones(5), detection, np.ones(5, np.bool_))
    seen = classes_of(rows, given)
    assert seen.tolist() == [CAR, PERSON, CAR, PERSON, 0]
    assert by_majority(rows, seen).class_id.tolist() == [CAR, PERSON, CAR, CAR, PERSON]
