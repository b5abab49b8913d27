"""Delays count from the first detection of each object."""

import numpy as np
import pytest

from experiments.delays import first_output_delays
from phdtrack.metrics import evaluate
from phdtrack.types import Detections, DetectionTable, Tracks, Truth


def test_delay_counts_from_the_first_detection():
    frame = np.array([1, 2, 3, 4, 5] * 2 + [2])
    identity = np.array([4] * 5 + [9] * 5 + [2])
    boxes = np.array([[0.0, 0, 10, 10]] * 5 + [[50, 0, 60, 10]] * 5 + [[90, 0, 99, 9]])
    truth = Truth(frame, identity, boxes, np.zeros(11, bool))
    table = DetectionTable(
        np.array([1, 2, 4, 5]),
        Detections.of([[30, 30, 40, 40], [0, 0, 10, 9], [0, 0, 10, 10], [50, 0, 60, 10]]),
    )
    rows = np.array([[0.0, 0, 10, 10]] * 2 + [[50, 0, 60, 9]])
    tracks = Tracks(
        np.array([4, 5, 2]), np.array([1, 1, 3]), rows, np.ones(3), np.full(3, -1), np.ones(3, bool)
    )
    delays = first_output_delays(truth, tracks, table)
    assert delays.identity.tolist() == [2, 4, 9]
    assert delays.detected.tolist() == [0, 2, 5]
    assert delays.mapped.tolist() == [0, 4, 2]
    assert delays.delay == pytest.approx([np.nan, 2, -3], nan_ok=True)
    assert evaluate(truth, tracks).delay_mean == (3 + 1) / 2
