import threading
import time

import numpy as np

from phdtrack.label.suggestions import Background, Suggestions, kept


def some(count=3):
    number = np.arange(count)
    return Suggestions(number + 1, number, number % 3, number / count, -number)


def settled(background):
    for _ in range(1000):
        if background().suggestions is not None or background().problem:
            break
        time.sleep(0.01)
    return background()


def test_the_share_is_told_while_it_works():
    go = threading.Event()

    def work(told):
        told(0.25)
        go.wait(30)
        return some()

    background = Background(work)
    for _ in range(1000):
        if background().share:
            break
        time.sleep(0.01)
    assert (background().share, background().suggestions) == (0.25, None)
    go.set()
    assert len(settled(background).suggestions) == 3


def test_what_goes_wrong_is_told():
    def work(told):
        raise OSError("the disk is full")

    assert settled(Background(work)).problem == "the disk is full"


def test_suggestions_are_made_once(tmp_path):
    made = []

    def make():
        made.append(1)
        return some(4)

    path = tmp_path / "suggestions.json"
    first, again = kept(path, "key", make), kept(path, "key", make)
    assert len(made) == 1
    for name in ("frame", "box", "reason", "score", "place"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
        assert getattr(first, name).dtype == getattr(again, name).dtype
    kept(path, "another key", make)
    path.write_text("not mine")
    kept(path, "another key", make)
    assert len(made) == 3
