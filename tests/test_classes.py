"""Several classes: no track goes from one to another, each is tracked as if it were alone, and
groups vote.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from phdtrack import InputError, Tracker
from phdtrack.simulate import DetectorModel, make_scene
from phdtrack.types import Detections, Tracks
from tracker_cases import SIZE, equal

CAR = 2
PERSON = 7


@cache
def crossing(late: int = 1) -> tuple[Detections, ...]:
    """Two streets laid over each other, one of each class; the cars begin at frame ``late``."""
    both = [
        make_scene("street", seed, DetectorModel(clutter_rate=1), frames=90, lead_in=-4.0)
        for seed in (3, 4)
    ]
    frames = []
    for k in range(1, 91):
        cars, people = (one.detections.at(k) for one in both)
        cars = cars if k >= late else Detections.empty()
        label = np.repeat([CAR, PERSON], [len(cars), len(people)])
        boxes = np.vstack([cars.xyxy, people.xyxy])
        score = np.concatenate([cars.confidence, people.confidence])
        frames.append(
            Detections(boxes, score, label).select(np.random.default_rng(k).permutation(len(label)))
        )
    return tuple(frames)


def run(frames, **settings) -> tuple[Tracker, Tracks]:
    tracker = Tracker(SIZE, **settings)
    return tracker, Tracks.concatenate(
        [*(tracker.update(found) for found in frames), tracker.flush()]
    )


def rows_of(rows: Tracks, label: int, frames) -> np.ndarray:
    """Frame, box and confidence of a class, and the box of its detection, in an order that
    identities do not decide.
    """
    rows = rows.select(rows.class_id == label)
    used = [
        frames[f - 1].xyxy[d] if d >= 0 else np.zeros(4)
        for f, d in zip(rows.frame, rows.detection, strict=True)
    ]
    table = np.column_stack([rows.frame, rows.xyxy, rows.confidence, np.reshape(used, (-1, 4))])
    return table[np.lexsort(table.T[::-1])]


def classes_of(rows: Tracks) -> list[set[int]]:
    return [set(rows.class_id[rows.identity == one].tolist()) for one in np.unique(rows.identity)]


@pytest.mark.parametrize("late", [1, 30])
@pytest.mark.parametrize(
    "settings", [{}, {"preset": "default"}, {"associate": {"output_delay": 3}}], ids=str
)
def test_each_class_is_tracked_as_if_alone(late: int, settings) -> None:
    frames = crossing(late)
    tracker, online = run(frames, **settings)
    corrected = tracker.tracks()
    for label in (CAR, PERSON):
        mine = [found.select(found.class_id == label) for found in frames]
        alone, rows = run(mine, **settings)
        for a, b in ((online, rows), (corrected, alone.tracks())):
            np.testing.assert_array_equal(rows_of(a, label, frames), rows_of(b, label, mine))
    assert all(len(each) == 1 for rows in (online, corrected) for each in classes_of(rows))
    assert np.unique(corrected.identity).tolist() == list(range(1, corrected.identity.max() + 1))


def test_one_class_is_tracked_as_without_classes() -> None:
    frames = crossing()
    rows = run([Detections.of(found.xyxy, found.confidence) for found in frames], preset="mot15")[
        0
    ].tracks()
    rows = rows.select(rows.detection >= 0)
    label = np.array(
        [frames[f - 1].class_id[d] for f, d in zip(rows.frame, rows.detection, strict=True)]
    )
    assert max(map(len, classes_of(replace(rows, class_id=label)))) == 2
    one, none = (
        run([replace(found, class_id=0 * found.class_id + k) for found in frames]) for k in (CAR, 0)
    )
    for a, b in ((one[1], none[1]), (one[0].tracks(), none[0].tracks())):
        assert (set(a.class_id.tolist()), set(b.class_id.tolist())) == ({CAR}, {0})
        assert equal(replace(a, class_id=b.class_id), b)


def walking(k: int, label: int, score: float = 0.9, x: float = 0.0) -> list[float]:
    return [100 + 3 * k + x, 100, 140 + 3 * k + x, 200, score, label]


def test_classes_tracked_together_vote_with_their_scores() -> None:
    """A truck is called a car in every other frame, but with low scores; a car stays one."""
    tracker = Tracker(
        SIZE, classes={"names": ["person", "car", "truck"], "together": [["car", "truck"]]}
    )
    frames = [
        [walking(k, *((1, 0.5) if k % 2 else (2, 0.9))), walking(k, 1, x=300.0)] for k in range(40)
    ]
    rows = [tracker.update(found) for found in frames]
    assert sorted(map(sorted, classes_of(tracker.tracks()))) == [[1], [2]]
    assert sorted(rows[-1].class_id.tolist()) == [1, 2]
    assert set(Tracks.concatenate(rows).identity.tolist()) == {1, 2}


def test_unselected_classes_are_left_out_and_rows_keep_numbers() -> None:
    own = {
        "1": {"min_score": 0.5},
        "2": {"min_size": 101.0},
        "3": {"associate": {"min_track_length": 30}},
    }
    tracker = Tracker(SIZE, classes={"only": [1, 2, 3], **own})
    for k in range(20):
        seen = (0,), (2, 0.9, 200.0), (1, 0.4, 300.0), (1, 0.6, 400.0), (3, 0.9, 100.0)
        tracker.update([walking(k, *one) for one in seen])
    rows = tracker.tracks()
    assert (set(rows.class_id.tolist()), set(rows.detection.tolist())) == ({1}, {3})
    assert (tracker.left_out.unwanted, tracker.left_out.empty) == (60, 0)


@pytest.mark.parametrize(("settings", "message"), [
    ({"only": ["car"]}, "classes.only: there is no class car .* classes.names"),
    ({"names": ["a", "b"], "together": [["a", "c"]]}, "there is no class c .* There are a, b"),
    ({"together": [[1, 2], [2, 3]]}, "each class in one group"),
    ({"1": {"motion": {"kind": "point"}}}, "cannot have motion = {'kind': 'point'} of its own"),
    ({"1": {"detector": {"min_area": 1}}}, "cannot have detector = .* of its own"),
    ({"1": {"min_score": "much"}}, "expected a number"),
    ({"1": {"sensor": {"detection_probability": 2.0}}}, "detection_probability"),
    ({"onyl": [1]}, "unknown setting of .classes."),
], ids=str)  # fmt: skip
def test_mistakes_are_told(settings, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Tracker(SIZE, classes=settings)


@pytest.mark.parametrize("settings", [{}, {"together": [[CAR, PERSON]]}], ids=str)
def test_a_saved_state_goes_on_and_a_step_holds_all_classes(settings) -> None:
    frames = crossing(30)
    first, _ = run(frames[:50], classes=settings, associate={"output_delay": 3})
    again = Tracker(SIZE, classes=settings, associate={"output_delay": 3})
    again.load_state_dict(first.state_dict())
    for found in frames[50:]:
        assert equal(first.update(found), again.update(found))
    assert equal(first.tracks(), again.tracks())
    seen = first.step.estimates.detection
    step = first.step
    assert len(step.info.evidence) == len(step.info.clutter) == len(found) == len(step.detections)
    assert np.abs(step.estimates.xyxy - found.xyxy[seen])[seen >= 0].max() < 60
    assert len(set(step.estimates.tag.tolist())) == len(step.estimates)
    assert len(first.states) == 2 - len(settings)


def test_names_may_be_a_table_by_number():
    """As a model of Ultralytics has them; a class without a name has its number."""
    by_number = Tracker(SIZE, classes={"names": {0: "person", 2: "car"}, "only": ["car"]})
    assert by_number.classes.names == {0: "person", 1: "1", 2: "car"}
    assert by_number.classes.only == (2,)
    words = Tracker(SIZE, classes={"names": {"1": "car", "0": "person"}})
    assert words.classes.names == {0: "person", 1: "car"}
    for no_names in ({"min_score": 0.3}, {-1: "person"}, {0: 5}):
        with pytest.raises(InputError, match=r"classes\.names: input should be a valid"):
            Tracker(SIZE, classes={"names": no_names})


def test_a_class_may_be_called_by_its_number():
    tracker = Tracker(SIZE, classes={0: {"min_size": 20}, "2": {"min_score": 0.3}})
    assert tracker.classes.least == {0: (-np.inf, 20.0), 2: (0.3, 0.0)}
    for table in ({"only": {0: "car"}}, {"together": {0: ["car"]}}):
        with pytest.raises(InputError, match="input should be a valid tuple"):
            Tracker(SIZE, classes=table)
