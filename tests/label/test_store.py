import os
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest

from phdtrack.errors import InputError
from phdtrack.label import DRAWN, Label, LabelStore
from phdtrack.label.store import last_labeller


@pytest.fixture
def store(tmp_path):
    return LabelStore.open(tmp_path / "labels.sqlite", "street.mp4", "abc", [30, 10, 20])


def false(frame, *boxes):
    return [Label(frame, box, "false") for box in boxes]


def test_a_mark_is_there_and_can_be_taken_back(store):
    store.mark(10, false(10, 0, 3))
    store.mark(10, [Label(10, 3, "none"), Label(10, 5, "false"), Label(10, 5, "birth")])
    assert store.labels() == [Label(10, 0, "false"), Label(10, 5, "birth")]
    assert store.steps(10) == (2, 0)
    store.undo(10)
    assert store.labels() == false(10, 0, 3)
    store.undo(10)
    assert store.labels() == []
    store.undo(10)
    assert store.steps(10) == (0, 2)
    store.undo(10, again=True)
    store.undo(10, again=True)
    store.undo(10, again=True)
    assert store.steps(10) == (2, 0)
    assert store.labels(10) == [Label(10, 0, "false"), Label(10, 5, "birth")]


def test_what_was_undone_does_not_return_after_something_new(store):
    store.mark(10, false(10, 1))
    store.undo(10)
    store.mark(10, false(10, 2))
    for again in (True, False, True):
        store.undo(10, again=again)
    assert store.labels() == false(10, 2)


def test_frames_come_in_their_order_and_progress_counts(store):
    assert store.frames() == [(30, False), (10, False), (20, False)]
    store.finish(10)
    store.mark(10, [*false(10, 1, 2), Label(10, 3, "birth")])
    progress = store.progress()
    assert (progress.done, progress.frames, progress.false, progress.births) == (1, 3, 2, 1)
    store.finish(10, done=False)
    assert store.progress().done == 0


def test_done_frames_are_undone_and_redone_with_their_marks(store):
    store.mark(10, false(10, 1))
    store.finish(10)
    assert store.steps(10) == (2, 0)
    store.undo(10)
    assert (store.progress().done, store.labels()) == (0, false(10, 1))
    store.undo(10, again=True)
    assert store.frames() == [(30, False), (10, True), (20, False)]
    for _ in range(2):
        store.undo(10)
    assert (store.progress().done, store.labels()) == (0, [])


def test_a_reopened_store_keeps_labels_and_adds_frames(store, tmp_path):
    store.mark(10, false(10, 1))
    store.finish(10)
    again = LabelStore.open(tmp_path / "labels.sqlite", "street.mp4", "abc", [10, 40])
    assert again.labels() == false(10, 1)
    assert again.frames() == [(30, False), (10, True), (20, False), (40, False)]
    with pytest.raises(InputError, match="other detections"):
        LabelStore.open(tmp_path / "labels.sqlite", "street.mp4", "xyz", [1])


PLACE = (1.0, 2.0, 30.0, 40.0)


def test_drawn_and_moved_boxes_are_marks_as_others(store):
    store.mark(10, [Label(10, DRAWN + 7, "true", PLACE), Label(10, 2, "true", PLACE)], who="ann")
    store.mark(10, [Label(10, DRAWN + 7, "birth", PLACE)])
    assert store.labels() == [Label(10, 2, "true", PLACE), Label(10, DRAWN + 7, "birth", PLACE)]
    assert [label.who for label in store.labels()] == ["ann", ""]
    assert (store.progress().drawn, store.progress().births) == (1, 1)
    store.undo(10, who="ann")
    store.undo(10, who="ann")
    assert store.labels() == []
    store.undo(10, who="ann", again=True)
    store.mark(10, [Label(10, DRAWN + 7, "none")])
    assert store.labels() == [Label(10, 2, "true", PLACE)]


def test_people_undo_their_own_actions_and_those_of_nobody(store):
    store.mark(10, false(10, 1), who="ann")
    store.mark(10, false(10, 2), who="bob")
    store.finish(10, who="bob")
    assert (store.steps(10, "ann"), store.steps(10, "bob")) == ((1, 0), (2, 0))
    store.undo(10, who="ann")
    assert store.labels() == false(10, 2)
    # What bob does next leaves ann's to be redone.
    store.mark(10, false(10, 3), who="bob")
    store.undo(10, who="ann", again=True)
    assert store.labels() == false(10, 1, 2, 3)


def test_where_people_disagree_each_is_named_with_the_last_mark(store):
    store.mark(
        10,
        [*false(10, 1, 2), Label(10, 3, "true", PLACE), Label(10, DRAWN, "true", PLACE)],
        who="ann",
    )
    store.mark(
        10,
        [Label(10, 1, "none"), *false(10, 2), Label(10, 3, "none"), Label(10, DRAWN, "none")],
        who="bob",
    )
    assert store.disputes() == {
        (10, 1): {"ann": "false", "bob": "true"},
        (10, DRAWN): {"ann": "true", "bob": "none"},
    }
    assert store.progress().disputed == 2
    # The last mark counts; an earlier one of the same person does not.
    assert store.labels() == [*false(10, 2)]
    store.mark(10, [Label(10, 1, "none")], who="ann")
    assert list(store.disputes()) == [(10, DRAWN)]
    store.undo(10, who="ann")
    assert len(store.disputes()) == 2


def test_a_file_of_another_format_is_refused(store):
    with closing(sqlite3.connect(store.path)) as db, db:
        db.execute("UPDATE about SET value = '3' WHERE name = 'format'")
    with pytest.raises(InputError, match="format 2, got '3'"):
        LabelStore.open(store.path, "street.mp4", "abc", [])


@pytest.mark.parametrize(
    "wrong",
    [
        [Label(10, 0, "maybe")],
        [Label(10, -1, "false")],
        [],
        [Label(10, 1, "true")],
        [Label(10, DRAWN, "birth")],
        [Label(10, DRAWN, "false")],
        [Label(10, 1, "false", PLACE)],
        [Label(10, 1, "true", (1.0, 2.0, float("nan"), 4.0))],
        [Label(10, 1, "true", (1.0, 2.0, 1.0, 4.0))],
        [Label(10, 1, "true", (-1e308, 2.0, 1e308, 4.0))],
        [Label(10, 2**62, "true", PLACE)],
    ],
)
def test_wrong_marks_change_nothing(store, wrong):
    with pytest.raises(InputError):
        store.mark(10, wrong)
    assert store.labels() == []
    assert store.steps(10) == (0, 0)


def test_what_is_sent_twice_counts_once(store):
    for _ in range(2):
        store.mark(10, false(10, 1), key="a")
    store.mark(10, false(10, 2), key="b")
    for _ in range(2):
        store.undo(10, key="c")
    assert store.labels() == false(10, 1)
    store.mark(10, false(10, 7), key="c")
    assert store.labels() == false(10, 1)
    for done in (True, False):
        store.finish(10, done, key="d")
    assert store.progress().done == 1


def test_many_people_at_once_lose_no_click(store):
    def person(who):
        own = LabelStore(store.path)
        for k in range(40):
            own.mark(10, false(10, 100 * who + k), who=str(who))

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(person, range(6)))
    assert {label.box for label in store.labels(10)} == {
        100 * who + k for who in range(6) for k in range(40)
    }


def test_a_process_that_is_killed_loses_no_click_that_was_kept(store):
    """It is killed right after it has said that the last one was kept."""
    program = (
        "import os, signal, sys; from pathlib import Path; from phdtrack.label import Label,"
        f" LabelStore\nstore = LabelStore(Path({str(store.path)!r}))\nfor k in range(25):"
        " store.mark(10, [Label(10, k, 'false')])\nos.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], check=False)
    assert done.returncode == -9
    assert store.labels() == false(10, *range(25))


def test_the_last_labeller_is_known_beside_the_file(tmp_path):
    files = [tmp_path / f"{name}.labels.sqlite" for name in ("first", "second", "third")]
    assert last_labeller(files[0]) == ""
    stores = [LabelStore.open(file, file.stem, "abc", [10]) for file in files[:2]]
    assert last_labeller(files[0]) == ""
    stores[0].mark(10, false(10, 0), "ada")
    stores[0].mark(10, false(10, 1), "")
    assert [last_labeller(file) for file in files] == ["ada", "ada", "ada"]
    stores[1].mark(10, false(10, 0), "eve")
    # Each file remembers its own; a new one that of the newest.
    os.utime(files[0], (1, 1))
    assert [last_labeller(file) for file in files] == ["ada", "eve", "eve"]
    files[2].write_text("no file of labels")
    assert last_labeller(files[2]) == "eve"
