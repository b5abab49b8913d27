"""What appearance was worth, as a report tells it: pairs of a known scene, sentences, and why there
is nothing to tell.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from report_runs import BACK, NONE, run_record, worth

from appearance_cases import FPS, SIZE, frame_of, prototypes
from phdtrack import Tracker
from phdtrack.report import report_html, sentences
from phdtrack.report.appearance_worth import AppearanceRecorder, AppearanceWorth
from phdtrack.types import Return

PEOPLE = (0, 1, 2, 3, 4)


def seen(looks: np.ndarray, frames: int = 150, **sections) -> AppearanceWorth:
    """The worth of appearance in a scene of five people."""
    tracker = Tracker(SIZE, fps=FPS, **sections)
    recorder = AppearanceRecorder()
    for k in range(frames):
        tracker.update(frame_of(PEOPLE, k, looks))
        assert tracker.step is not None
        recorder.see(tracker.step.appeared)
    numbers = np.arange(1, frames + 1)
    return recorder.worth("colours", tracker.returns, numbers, numbers / FPS)


def told(one: AppearanceWorth) -> str:
    """The sentences of a run on it."""
    record = replace(run_record(), appearance=one)
    return "\n".join(sentences(record)).replace("\u00a0", " ")


def test_people_who_look_different_are_told_apart():
    one = seen(prototypes(8))
    assert one.told_apart > 0.95
    assert one.same.sum() >= 50
    assert one.other.sum() > one.same.sum()
    assert 2.0 <= one.apart < 2.5
    assert one.taken > 0.5
    assert one.taken_count > 250
    assert not any((one.few, one.alike, one.unused))
    x = np.linspace(-3, 3, 2000)
    for pairs, curve in zip((one.same, one.other), one.curves(x), strict=True):
        centres = (one.edges[1:] + one.edges[:-1]) / 2
        mean = pairs @ centres / pairs.sum()
        assert (x @ curve) / curve.sum() == pytest.approx(mean, abs=0.1)
        assert curve.sum() * (x[1] - x[0]) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(
    ("count", "words"),
    [(0, ""), (1, "1 pair of objects that were taken"), (2, "2 pairs of objects that were taken")],
)
def test_identities_exchanged_are_told(count: int, words: str):
    one = replace(seen(prototypes(8), frames=60), exchanged=count)
    said = told(one)
    assert ("exchanged their identities" in said) == (count > 0)
    assert words in said
    assert "\n\n" not in said


def test_people_who_look_alike_are_not():
    one = seen(np.tile(prototypes(1), (8, 1)))
    assert one.alike
    assert not abs(one.taken) >= 0.05
    assert "because all objects look alike: two are told apart in" in told(one)


def test_neighbours_are_refused():
    """Two people side by side."""
    looks = prototypes(8)

    def beside(person: int, k: int) -> np.ndarray:
        left = 100 + 3.0 * k + 70 * person
        return np.array([left, 100, left + 40, 220])

    tracker = Tracker(SIZE, fps=FPS)
    recorder = AppearanceRecorder()
    for k in range(150):
        tracker.update(frame_of((0, 1, 2), k, looks, beside))
        recorder.see(tracker.step.appeared)
    one = recorder.worth("x.npy", (), np.zeros(0, np.int64), np.zeros(0))
    assert one.refused < -0.5 < 0.5 < one.taken
    assert one.refused_count > 50
    assert "Embeddings tell two objects apart in more than 99 of 100 pairs, 2 s later." in told(one)


def test_classes_are_counted_together():
    """Each with a pipeline of its own."""
    tracker = Tracker(SIZE, fps=FPS)
    recorder = AppearanceRecorder()
    for k in range(60):
        found = frame_of(PEOPLE, k, prototypes(8))
        tracker.update(replace(found, class_id=np.array([0, 0, 0, 1, 1])))
        recorder.see(tracker.step.appeared)
    one = recorder.worth("colours", (), np.zeros(0, np.int64), np.zeros(0))
    assert len(tracker.step.appeared) == 2
    # Three pairs and one: nobody is compared with another class.
    assert one.same.sum() > 0
    assert one.other.sum() == pytest.approx(one.same.sum() * (3 * 2 + 2 * 1) / 5, rel=0.25)


@pytest.mark.parametrize(
    ("frames", "sections", "words"),
    [
        (6, {}, "too few pairs to learn from"),
        (
            30,
            {"filter": "mcmc", "associate": {"kind": "labelled"}},
            "Colours decided nothing: this filter does not use them.",
        ),
    ],
)
def test_where_nothing_is_learned_it_says_why(frames: int, sections: dict, words: str):
    assert words in told(seen(prototypes(8), frames, **sections))


def test_frames_without_descriptors_are_passed_over():
    tracker = Tracker(SIZE, fps=FPS)
    recorder = AppearanceRecorder()
    for k in range(80):
        found = frame_of(PEOPLE if k % 7 else (), k, prototypes(8))
        if k < 10 or k % 3 == 0:
            found = replace(found, embeddings=None)
        tracker.update(found)
        recorder.see(tracker.step.appeared)
    one = recorder.worth("colours", (), np.zeros(0, np.int64), np.zeros(0))
    assert one.taken_count > 0
    assert math.isfinite(one.taken)


@given(st.lists(st.integers(0, 6), min_size=8, max_size=8))
@settings(max_examples=50, deadline=None)
def test_told_apart_counts_all_pairs(counts: list[int]):
    place = [10, 40, 41, 90]
    same = NONE.copy()
    other = NONE.copy()
    same[place] = counts[:4]
    other[place] = counts[4:]
    found = worth(same=same, other=other).told_apart
    pairs = [
        (a > b) + 0.5 * (a == b)
        for a in np.repeat(place, counts[:4]).tolist()
        for b in np.repeat(place, counts[4:]).tolist()
    ]
    if pairs:
        assert found == pytest.approx(np.mean(pairs))
    else:
        assert math.isnan(found)


def test_returns_have_the_time_between():
    """Unless the frames are not known any more."""
    pair = Return(3, 9, 4, 12.4, 8.1, (30, 0), (80, 2))
    recorder = AppearanceRecorder()
    for first, seconds in ((1, 5.0), (50, math.nan)):
        numbers = np.arange(first, 101)
        (back,) = recorder.worth("colours", (pair,), numbers, numbers / 10).returns
        assert back._replace(seconds=0.0) == BACK._replace(seconds=0.0)
        assert back.seconds == pytest.approx(seconds, nan_ok=True)


def test_sentences_tell_what_it_was_worth():
    assert "Colours tell two objects apart in 97 of 100 pairs, 2 s later." in told(worth())
    assert "came back" not in told(worth())
    words = told(worth(returns=(BACK,)))
    assert "1 object came back and has its identity again; run.json lists it with its odds" in words
    words = told(worth(returns=(BACK, BACK._replace(identity=5))))
    assert "2 objects came back and have their identities again; run.json lists them" in words
    words = told(worth(returns=(BACK, BACK, BACK._replace(identity=5))))
    assert "2 objects came back, 3 times in all, and have their identities again" in words
    assert "Colours" not in "\n".join(sentences(run_record()))


def test_the_report_shows_curves_and_returns():
    record = run_record()
    page = report_html(replace(record, appearance=worth(returns=(BACK,))), {})
    page = page.replace("\u00a0", " ")
    for words in ("<h2>Appearance</h2>", "Two histograms", "5 s", "12:1", "−0.70", "200 pairs"):
        assert words in page
    assert "<h2>Appearance</h2>" not in report_html(record, {})
    few = report_html(replace(record, appearance=worth(same=NONE)), {})
    assert "too few pairs to learn from, 0 of one object and 400 of two" in few
    assert "Two histograms" not in few
