"""Causes of errors: they add up, each cause has a case made by hand, and perfect tracks have
none.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from metric_cases import perfect, random_case, tracks_of, truth_of

from phdtrack.metrics import evaluate, explain
from phdtrack.metrics.causes import CAUSES, FALSE, PLACES
from phdtrack.types import Detections, DetectionTable

seeds = st.integers(0, 2**32 - 1)
HERE = [0, 0, 20, 40]
FAR = [300, 0, 320, 40]
THERE = [600, 0, 620, 40]


def table_of(frame, xyxy) -> DetectionTable:
    order = np.argsort(frame, kind="stable")
    boxes = np.asarray(xyxy, np.float64).reshape(-1, 4)[order]
    return DetectionTable(np.asarray(frame, np.int64)[order], Detections.of(boxes))


def case(*, truth, tracks, seen=None):
    """Errors of rows (frame, identity, box)."""
    sides = [
        made(*([list(column) for column in zip(*rows, strict=True)] or [[], [], []]))
        for made, rows in ((truth_of, truth), (tracks_of, tracks))
    ]
    return explain(
        *sides, None if seen is None else table_of([k for k, _ in seen], [box for _, box in seen])
    )


def life(identity, box, *frames):
    return [(k, identity, box) for k in frames]


def misses(errors) -> dict[tuple[str, str], int]:
    table = errors.misses.sum(axis=0)
    return {
        (CAUSES[i], PLACES[j]): int(table[i, j]) for i, j in zip(*np.nonzero(table), strict=True)
    }


def false(errors) -> dict[str, int]:
    return {name: int(n) for name, n in zip(FALSE, errors.false.sum(axis=0), strict=True) if n}


@given(seeds, st.booleans(), st.sampled_from([0.3, 0.5, 0.7]))
@settings(max_examples=60, deadline=None)
def test_causes_add_up_to_the_scores(seed: int, given_detections: bool, iou: float):
    rng = np.random.default_rng(seed)
    truth, tracks = random_case(rng, objects=5, distractors=True)
    kept = rng.random(len(tracks)) < 0.7
    seen = table_of(tracks.frame[kept], tracks.xyxy[kept]) if given_detections else None
    errors = explain(truth, tracks, seen, iou=iou)
    scores = evaluate(truth, tracks, iou=iou)
    assert errors.misses.sum() == scores.misses
    assert errors.false.sum() == scores.false_positives
    assert errors.ignored == len(tracks) - scores.output_boxes
    assert errors.boxes.sum() == scores.truth_boxes
    assert errors.track_boxes.sum() == scores.output_boxes
    assert (errors.misses.sum(axis=(1, 2)) <= errors.boxes).all()
    assert (errors.false.sum(axis=1) <= errors.track_boxes).all()
    never = errors.misses[:, :, 0].sum(axis=1)
    assert ((never > 0) == (errors.last == 0)).all()
    if seen is None:
        assert not errors.misses[:, 1].any()


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_perfect_tracks_have_no_errors(seed: int):
    truth, _ = random_case(np.random.default_rng(seed), distractors=True)
    errors = explain(truth, perfect(truth), table_of(truth.frame, truth.xyxy))
    assert not errors.misses.any()
    assert not errors.false.any()
    assert not len(errors.worst_objects(5))
    assert not len(errors.worst_tracks(5))


def test_misses_by_cause_and_place():
    """Object 1 is mapped in frames 3 and 5 of 1 to 7, object 2 never; detections are in frames 2, 4
    and 7 of object 1.
    """
    errors = case(
        truth=life(1, HERE, *range(1, 8)) + life(2, FAR, 1, 2),
        tracks=life(9, HERE, 3, 5),
        seen=[(2, HERE), (4, HERE), (7, HERE), (2, FAR)],
    )
    expected = {("undetected", "head"): 1, ("unused", "head"): 1, ("unused", "gap"): 1}
    expected |= {
        ("undetected", "tail"): 1,
        ("unused", "tail"): 1,
        ("undetected", "never"): 1,
        ("unused", "never"): 1,
    }
    assert misses(errors) == expected
    assert errors.misses[0].sum() == 5
    assert errors.last.tolist() == [5, 0]


def test_misses_without_detections_have_one_cause():
    errors = case(truth=life(1, HERE, 1, 2, 3), tracks=life(9, HERE, 2))
    assert errors.causes == ("not tracked",)
    assert misses(errors) == {("undetected", "head"): 1, ("undetected", "tail"): 1}
    assert errors.as_dict(5)["misses"] == {
        "not tracked": {"never": 0, "head": 1, "gap": 0, "tail": 1}
    }


LOOSE = [0, 24, 20, 64]  # shares 16 of 64 pixels of height with HERE

BESIDE = [0, 25, 20, 65]


@pytest.mark.parametrize(
    ("cause", "truth", "tracks", "seen"),
    [
        ("loose", life(1, HERE, 1, 2), life(9, HERE, 1) + life(9, LOOSE, 2), [(2, HERE)]),
        ("ghost", life(1, HERE, 1), life(9, HERE, 1, 2), [(1, HERE)]),
        # Shown over another object, which is mapped to its own track: the detections say that
        # nothing is under it.
        (
            "ghost",
            life(1, LOOSE, 1) + life(2, HERE, 1, 2),
            life(9, LOOSE, 1, 2) + life(8, HERE, 1, 2),
            [(2, HERE)],
        ),
        ("duplicate", life(1, HERE, 1, 2), life(9, HERE, 1, 2) + life(8, HERE, 2), [(2, HERE)]),
        ("duplicate", life(1, HERE, 1, 2), life(9, HERE, 1, 2) + life(8, LOOSE, 2), [(2, HERE)]),
        ("clutter", life(1, HERE, 1), life(9, HERE, 1) + life(8, FAR, 1), [(1, FAR)]),
        # Beside an object that has its own track.
        ("clutter", life(1, HERE, 1, 2), life(9, HERE, 1, 2) + life(8, BESIDE, 2), [(2, BESIDE)]),
        # Never on an object: it follows clutter where nothing is detected, too.
        ("clutter", life(1, HERE, 1), life(9, HERE, 1) + life(8, FAR, 1), []),
        # Was on an object once, and follows a false alarm now.
        ("clutter", life(1, HERE, 1), life(9, HERE, 1) + life(9, FAR, 2), [(2, FAR)]),
    ],
)
def test_each_cause_of_a_false_positive(cause: str, truth, tracks, seen):
    assert false(case(truth=truth, tracks=tracks, seen=seen)) == {cause: 1}


def test_false_positives_without_detections():
    """A box over an object that has its own track is a duplicate, one over nothing a ghost of a
    track that was right.
    """
    truth = life(1, HERE, 1, 2) + life(2, FAR, 1)
    tracks = life(9, HERE, 1, 2) + life(8, FAR, 1) + life(8, LOOSE, 2) + life(9, FAR, 3)
    assert false(case(truth=truth, tracks=tracks)) == {"duplicate": 1, "ghost": 1}


def test_objects_are_listed_by_number_of_errors():
    truth = life(1, HERE, 1) + life(2, FAR, 1, 2, 3) + life(3, THERE, 1, 2)
    errors = case(
        truth=truth, tracks=life(9, HERE, 1) + life(8, FAR, 3) + life(7, [900, 0, 920, 9], 1, 2)
    )
    assert errors.objects[errors.worst_objects(5)].tolist() == [2, 3]
    assert errors.tracks[errors.worst_tracks(5)].tolist() == [7]
    assert len(errors.worst_objects(1)) == 1
    named = errors.as_dict(1)
    assert [one["identity"] for one in named["worst_objects"]] == [2]


def test_ignored_rows_are_counted_separately():
    truth = truth_of([1, 1], [1, 2], [HERE, FAR], [False, True])
    errors = explain(truth, tracks_of([1, 1], [9, 8], [HERE, FAR]))
    assert (errors.ignored, errors.false.sum(), errors.misses.sum()) == (1, 0, 0)


def test_nothing_at_all():
    errors = case(truth=[], tracks=[], seen=[])
    assert (errors.misses.sum(), errors.false.sum(), errors.ignored) == (0, 0, 0)
