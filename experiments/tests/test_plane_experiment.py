"""Comparison of rows on the ground with true positions."""

import numpy as np
import pytest

from experiments.plane import (
    VARIANTS,
    GroundErrors,
    GroundScores,
    Places,
    changes,
    errors,
    ground_scene,
    pairs_of_variants,
    with_detections,
)
from phdtrack.metrics.matching import tracking_mapping
from phdtrack.types import Detections, DetectionTable, Tracks


def places(frame, identity, *points):
    return Places(np.array(frame), np.array(identity), np.array(points, np.float64).T)


def test_half_an_overlap_is_the_distance_of_a_match() -> None:
    truth = places([1, 1, 2], [7, 9, 9], (0, 0), (10, 0), (10, 0))
    found = places([1, 2, 3], [4, 4, 5], (0.5, 0), (10, 1.0), (np.nan, np.nan))
    scene = ground_scene(truth, found, 3, 1.0)
    assert [pair.iou.tolist() for pair in scene.pairs] == [[[0.75], [0.0]], [[0.5]], []]
    assert tracking_mapping(scene, 0.5).iou.tolist() == [0.75, 0.5]
    assert scene.boxes.sum(axis=1).tolist() == [3, 3]


def test_a_match_is_no_farther_than_near() -> None:
    scene = ground_scene(places([1], [1], (0, 0)), places([1], [1], (0, 1.01)), 1, 1.0)
    assert len(tracking_mapping(scene, 0.5).iou) == 0


def test_errors_are_of_pairs_one_to_one_of_the_same_frame() -> None:
    truth = places([1, 1, 2], [1, 2, 1], (0, 0), (1, 0), (5, 5))
    found = places([1, 1, 1, 3], [1, 2, 3, 1], (0.5, 0), (1.5, 0), (np.nan, 0), (5, 5))
    assert errors(truth, found, 2.0) == pytest.approx([0.5, 0.5])
    assert len(errors(truth, found, 0.4)) == 0


def test_rows_take_the_boxes_of_their_detections() -> None:
    boxes = np.array([[0, 0, 1, 1], [5, 5, 6, 6], [8, 8, 9, 9]], np.float64)
    found = DetectionTable(np.array([1, 2, 2]), Detections.of(boxes))
    own = np.full((3, 4), 3.0)
    tracks = Tracks(
        np.array([1, 2, 3]),
        np.array([1, 1, 1]),
        own,
        np.ones(3),
        np.array([0, 1, -1]),
        np.ones(3, np.bool_),
    )
    assert with_detections(tracks, found).xyxy.tolist() == [
        boxes[0].tolist(),
        boxes[2].tolist(),
        own[2].tolist(),
    ]
    assert (own == 3.0).all()


def outcome(mota: float, states: float) -> GroundErrors:
    """A run with this MOTA on the ground and error of the number of states."""
    return GroundErrors(
        (0.5, 0.6), (0.4, 0.4), GroundScores(mota, 0.7, 0.3, 0.2, 0.9), 1, states, 0
    )


def test_changes_are_differences_seed_by_seed() -> None:
    """The particle filter with and without occlusion; other variants were not run."""
    new, old = (
        next(
            place
            for place, one in enumerate(VARIANTS)
            if one.random and one.plane and one.occlusion is wanted
        )
        for wanted in (True, False)
    )
    each = {
        ("public", new): [outcome(0.8, 1.0), outcome(0.9, 1.0)],
        ("public", old): [outcome(0.7, 1.5), outcome(0.6, 1.5)],
    }
    (row,) = changes(each)
    assert row[:3] == ("occlusion in p_D", "particle PHD", "public")
    assert row[3] == "+0.200 ± 0.100"
    assert row[-1] == "-0.500 ± 0.000"


def test_pairs_of_variants_differ_in_what_is_changed() -> None:
    pairs = [(words, name) for words, name, _, _ in pairs_of_variants()]
    assert [name for words, name in pairs if words.startswith("on the ground")] == [
        "GM-PHD",
        "particle PHD",
        "PMB",
    ]
    assert ("states joined", "GM-PHD") in pairs
    assert ("cardinalised", "GM-PHD") in pairs
