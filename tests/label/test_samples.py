"""What marks say: births and their velocities, false alarms, objects, and what of the false alarms
a tracker follows.
"""

import numpy as np
import pytest

from phdtrack.arrays import to_cxcywh
from phdtrack.label import DRAWN, Label, LabelStore
from phdtrack.label.samples import Marks
from phdtrack.types import Detections, DetectionTable, SequenceInfo, Tracks

INFO = SequenceInfo(640, 480, 25.0, 200, "drawn")


NOTHING = DetectionTable(np.zeros(0, np.int64), Detections.empty())


def table(*rows):
    """Detections from rows (frame, centre x, centre y, width, height)."""
    ordered = np.array(sorted(rows))
    box = ordered[:, 1:]
    xyxy = np.hstack([box[:, :2] - box[:, 2:] / 2, box[:, :2] + box[:, 2:] / 2])
    return DetectionTable(ordered[:, 0].astype(np.int64), Detections.of(xyxy))


def marked(path, births, drawn=(20,), done=True):
    """A file in which ``births`` (frame, box) are marked, on drawn frames that have been looked
    at.
    """
    store = LabelStore.open(path / "labels", "drawn", "digest", drawn)
    if births:
        store.mark(drawn[0], [Label(frame, box, "birth") for frame, box in births])
    for number in drawn:
        store.finish(number, done)
    return store


def walk(first, count, start, velocity, size=(30, 80)):
    return [
        (first + k, start[0] + k * velocity[0], start[1] + k * velocity[1], *size)
        for k in range(count)
    ]


def test_watched_frames_count_once_without_the_first_of_a_clip(tmp_path):
    store = LabelStore.open(tmp_path / "l", "s", "d", (20, 25, 100))
    assert len(Marks(store, NOTHING, INFO).watched) == 0
    for number in (20, 25):
        store.finish(number)
    np.testing.assert_array_equal(Marks(store, NOTHING, INFO).watched, np.arange(11, 36))
    # Of a stretch only its own: clips end with it, and nothing comes before its first frame.
    np.testing.assert_array_equal(
        Marks(store, NOTHING, INFO, range(22, 31)).watched, np.arange(23, 31)
    )
    # 25 frames of 1/25 s, 10 time units a second.
    assert Marks(store, NOTHING, INFO).time_watched(10) == pytest.approx(10)


def test_velocity_is_that_of_the_next_three_frames(tmp_path):
    seen = table(*walk(15, 10, (100, 200), (6, -2)), *walk(10, 20, (140, 200), (-6, -2)))
    at = int(np.argmin(np.abs(to_cxcywh(seen.at(15).xyxy)[0] - 100)))
    states = Marks(marked(tmp_path, [(15, at)]), seen, INFO).birth_states(50)
    # 6 pixels a frame are 150 a second, in 50 time units.
    np.testing.assert_allclose(states, [[100], [200], [3], [-1], [30], [80]])


@pytest.mark.parametrize(
    ("others", "why"),
    [
        ([], "nothing follows"),
        (walk(16, 1, (106, 198), (0, 0)), "one frame is not enough"),
        (walk(16, 3, (160, 200), (0, 0)), "too far"),
        (walk(16, 3, (106, 198), (6, -2), size=(50, 130)), "another size"),
        # Somebody else is there already and stays: what is near is his.
        (walk(15, 4, (103, 199), (0, 0)), "somebody else's"),
    ],
)
def test_velocity_is_unknown_where_nothing_goes_on_from_the_box(tmp_path, others, why):
    seen = table((15, 100, 200, 30, 80), *others)
    at = int(np.argmin(np.abs(to_cxcywh(seen.at(15).xyxy)[0] - 100)))
    state = Marks(marked(tmp_path, [(15, at)]), seen, INFO).birth_states(25)[:, 0]
    np.testing.assert_allclose(state, [100, 200, np.nan, np.nan, 30, 80], err_msg=why)


def test_objects_are_where_they_were_drawn_or_moved_to(tmp_path):
    """By hand: of three detections one is false and one is moved; one object was missed; on another
    frame nobody looked.
    """
    seen = table(
        (20, 100, 200, 30, 80), (20, 300, 200, 30, 80), (20, 500, 200, 30, 80), (60, 1, 2, 3, 4)
    )
    store = marked(tmp_path, [(20, 0)])
    drawn = Label(20, DRAWN + 1, "true", (10.0, 20.0, 30.0, 60.0))
    elsewhere = Label(60, DRAWN, "true", (0.0, 0.0, 9.0, 9.0))
    store.mark(
        20,
        [
            Label(20, 1, "false"),
            Label(20, 2, "true", (490.0, 160.0, 520.0, 240.0)),
            drawn,
            elsewhere,
        ],
    )
    marks = Marks(store, seen, INFO)
    expected = [[100, 505, 20], [200, 200, 40], [30, 30, 20], [80, 80, 40]]
    np.testing.assert_allclose(marks.object_boxes, expected)
    assert marks.missed == [drawn]
    assert marks.false_boxes.shape == (4, 1)


def test_a_drawn_birth_is_linked_to_later_detections(tmp_path):
    seen = table(*walk(16, 6, (106, 198), (6, -2)))
    store = marked(tmp_path, [])
    store.mark(20, [Label(15, DRAWN, "birth", (85.0, 160.0, 115.0, 240.0))])
    states = Marks(store, seen, INFO).birth_states(50)
    np.testing.assert_allclose(states, [[100], [200], [3], [-1], [30], [80]])


def test_marks_count_only_where_births_were_looked_for(tmp_path):
    seen = table(*walk(8, 40, (100, 200), (6, -2)))
    # The clip of frame 20 is 10 … 30; what is there in its first frame may have been there before.
    store = marked(tmp_path, [(10, 0), (11, 0), (30, 0), (31, 0)])
    assert Marks(store, seen, INFO).birth_states(25)[0].tolist() == [118, 232]
    store.finish(20, False)
    assert Marks(store, seen, INFO).birth_states(25).shape == (6, 0)


# Three detections on each of five frames.
BOXES = np.array([[10.0 * k, 20 + i, 10 * k + 30, 80 + i] for k in range(1, 6) for i in range(3)])
FIVE = DetectionTable(np.repeat(np.arange(1, 6), 3), Detections.of(BOXES))
FALSE = [(2, 0), (2, 1), (4, 0), (5, 1), (3, 2)]


def five(path, looked=(2, 4), stretch=None):
    """Frames 2, 4 and 5 were drawn, of which two were looked at; marks as false, and a birth, which
    is an object's.
    """
    store = LabelStore.open(path / "labels", "five", "digest", [4, 2, 5])
    store.mark(2, [Label(*pair, "false") for pair in FALSE])
    store.mark(4, [Label(4, 2, "birth")])
    for number in looked:
        store.finish(number)
    return Marks(store, FIVE, INFO, stretch)


def same_boxes(found, *pairs):
    wanted = to_cxcywh(np.array([FIVE.at(frame).xyxy[k] for frame, k in pairs]))
    np.testing.assert_array_equal(found[:, np.lexsort(found)], wanted[:, np.lexsort(wanted)])


def resting(*pairs):
    """Rows of tracks (frame, detection)."""
    frame, detection = (np.array(column, np.int64) for column in zip(*pairs, strict=True))
    n = len(pairs)
    return Tracks(
        frame, np.ones(n, np.int64), np.ones((n, 4)), np.ones(n), detection, np.ones(n, np.bool_)
    )


def test_unmarked_boxes_of_finished_frames_are_objects(tmp_path):
    marks = five(tmp_path)
    same_boxes(marks.object_boxes, (2, 2), (4, 1), (4, 2))
    same_boxes(marks.false_boxes, (2, 0), (2, 1), (4, 0))


def test_of_a_stretch_only_its_frames_count(tmp_path):
    run = resting((2, 0), (4, 0), (5, 2))
    marks = five(tmp_path, (2, 4, 5), range(4, 6))
    same_boxes(marks.object_boxes, (4, 1), (4, 2), (5, 0), (5, 2))
    assert marks.share_followed(run) == (1 + 1) / (2 + 2)
    nothing = five(tmp_path, (2, 4, 5), range(3, 4))
    assert nothing.object_boxes.shape == (4, 0)
    assert nothing.share_followed(run) == 0.5


def test_the_share_of_false_alarms_on_which_tracks_rest(tmp_path):
    """By hand: of three on frames 2 and 4 two are followed, (2 + 1)/(3 + 2); others, and objects,
    do not count.
    """
    marks = five(tmp_path)
    assert marks.share_followed(resting((2, 0), (4, 0), (2, 2), (3, 2), (5, 1))) == pytest.approx(
        3 / 5
    )
    # Two tracks on one detection count once, rows that rest on none not at all.
    assert marks.share_followed(resting((2, 0), (2, 0), (4, -1))) == pytest.approx(2 / 5)
    assert marks.share_followed(resting(*FALSE)) == pytest.approx(4 / 5)
    assert marks.share_followed(Tracks.empty()) == pytest.approx(1 / 5)
