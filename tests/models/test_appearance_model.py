"""What a stream teaches about the appearance of its objects."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from inner_kernels import from_python
from phdtrack.kernels.appearance import likeness, plain
from phdtrack.kernels.appearance_law import worth
from phdtrack.models.appearance import PAUSE, Appearance, AppearanceSeen
from phdtrack.types import F8, Detections

(worth_of,) = from_python(worth)
D = 24
RULE = Appearance()


def boxes(n: int) -> F8:
    """(n, 4) side by side."""
    left = 60.0 * np.arange(n)
    return np.stack([left, 0 * left, left + 40, 0 * left + 100], axis=1)


def frame(looks: np.ndarray) -> Detections:
    return Detections.of(boxes(len(looks)), embeddings=looks)


def taught_by(
    frames: list[np.ndarray], *, sure: int | None = None, rule: Appearance = RULE
) -> AppearanceSeen:
    """The state after frames, ten a second, in which target i has detection i without doubt; of
    only so many targets if ``sure`` says so.
    """
    state = rule.start()
    for k, looks in enumerate(frames):
        state, found = rule.looks(state, frame(looks), 0.1 * k)
        n = np.arange(len(looks) if sure is None else sure)
        state = rule.advance(state, np.stack([n, n], axis=1), found)
    return state


def views(rng: np.random.Generator, own: np.ndarray, frames: int, noise: float) -> list[np.ndarray]:
    """Views of objects (n, D) of length one, with so much noise in all dimensions together."""
    scale = noise / math.sqrt(D)
    return [own + rng.normal(0, scale, own.shape) for _ in range(frames)]


def one_of_each(count: int) -> np.ndarray:
    """(count, D) descriptors of length one, each as far from the others."""
    return np.eye(count, D)


def ratios(state: AppearanceSeen, a: np.ndarray, b: np.ndarray, rule: Appearance = RULE) -> F8:
    """(n,) log-likelihood ratios of rows of ``a`` and ``b`` (n, D), means of ten descriptors."""
    known = rule.known(state)
    assert known is not None
    n = len(a)
    mean = np.vstack([a, b]).astype(np.float32)
    number = np.full(2 * n, 10.0)
    never = np.zeros(2 * n)
    return likeness(mean, number, never, np.arange(n), n + np.arange(n), plain(known))


def test_nothing_is_worth_anything_before_lessons(rng: np.random.Generator):
    state = RULE.start()
    assert RULE.known(state) is None
    state, found = RULE.looks(state, Detections.of(boxes(2)), 0.0)
    assert found is None
    assert RULE.advance(state, np.zeros((0, 2), np.int64), found) is state
    state, found = RULE.looks(state, frame(rng.normal(0, 1, (2, D))), 0.1)
    assert found is not None
    assert found.law.weight == found.law.means_weight == 0


def test_the_worth_grows_with_lessons(rng: np.random.Generator):
    frames = views(rng, one_of_each(3), 80, 0.3)
    weights = [RULE.law(taught_by(frames[:n]).lessons).weight for n in (1, 3, 10, 30, 80)]
    assert weights[0] == 0
    assert weights == sorted(weights)
    # No two have met: it may yet turn out that looks change places then.
    assert 0.3 < weights[-1] < 0.36
    met = taught_by(frames).lessons._replace(beside=np.array([1000.0, 0.0]))
    assert 0.4 < RULE.law(met).weight < 0.5
    quick = replace(RULE, prior_lessons=0.0)
    met = taught_by(frames[:10]).lessons._replace(beside=np.array([1000.0, 0.0]))
    assert 0.48 < quick.law(met).weight < 0.5


def test_a_difference_within_its_error_is_worth_nothing():
    """What is left of the squared difference without its variance, and 0 below that."""
    for difference, expected in ((-0.1, 0.0), (0.1, 0.0), (0.2, 0.5), (0.4, 0.875), (2.0, 0.995)):
        # Five lessons count as one: 5 · (0.1/50 + 0.1/50) is 0.02.
        found = worth_of((50.0, difference, 0.1), (50.0, 0.0, 0.1), 0.0, 5.0)
        assert found == pytest.approx(expected, abs=1e-9)
    assert worth_of((50.0, 2.0, 0.1), (80.0, 0.0, 0.0), 50.0, 5.0) == pytest.approx(0.5, abs=2e-3)


def test_looks_that_change_places_where_targets_meet_say_nothing(rng: np.random.Generator):
    """Neither of pairs nor of means; a few changes say little, as do many meetings without any."""
    lessons = taught_by(views(rng, one_of_each(6), 60, 0.3)).lessons
    laws = {
        changed: RULE.law(lessons._replace(beside=np.array([100.0, changed])))
        for changed in (0.0, 0.5, 1.0, 2.5, 30.0)
    }
    first = RULE.law(lessons)
    best = laws[0.0]
    assert best.weight > 0.3
    assert best.means_weight > 0.3
    assert best.doubt == 0
    assert laws[1.0] == first
    # Of 140 lessons 2.9 have changed, so 26 % of meetings, 1.4 an eighth; a sixteenth is usual.
    for changed, law in ((0.9, laws[0.5]), (1.4, first), (2.9, laws[2.5])):
        part = math.log(1 / (changed / 140 / 0.08) - 1) / math.log(15)
        assert law.weight == pytest.approx(part * best.weight)
        assert law.means_weight == pytest.approx(part * best.means_weight)
        assert law.doubt == pytest.approx(math.log(changed / 140 / 0.005))
    assert laws[30.0].weight == laws[30.0].means_weight == 0


@pytest.mark.parametrize("swaps", [False, True])
def test_a_stream_shows_whether_looks_change_places(swaps: bool, rng: np.random.Generator):
    """Two meet again and again, and after each meeting one has the look of the other for a while,
    or each keeps its own.
    """
    people = rng.normal(0, 1, (4, D))
    state = RULE.start()
    for k in range(600):
        apart = 60 if k % 60 < 30 else 46
        place = np.array([0.0, apart, 300, 600])
        xyxy = np.stack([place, 0 * place, place + 40, 0 * place + 100], axis=1)
        shown = people[[1, 0, 2, 3]] if swaps and k % 60 in range(30, 50) else people
        seen = shown + rng.normal(0, 0.3, shown.shape)
        found = Detections.of(xyxy, embeddings=seen.astype(np.float32))
        state, looks = RULE.looks(state, found, 0.1 * k)
        state = RULE.advance(state, np.stack([np.arange(4)] * 2, axis=1), looks)
    law = RULE.law(state.lessons)
    assert state.lessons.beside[0] > 50
    assert (law.weight == 0) == swaps
    assert swaps or law.weight > 0.4


def test_one_object_alone_teaches_nothing(rng: np.random.Generator):
    """There is no other one to tell it from."""
    state = taught_by(views(rng, one_of_each(1), 60, 0.3))
    assert RULE.law(state.lessons).weight == 0


def test_constant_descriptors_are_not_known():
    """They are the stream's mean: nothing is free to compare."""
    state = taught_by([np.ones((3, D))] * 40)
    state, found = RULE.looks(state, frame(np.ones((3, D))), 9.0)
    assert found is not None
    assert not found.free.any()
    assert not found.seen.any()
    assert found.law.weight == 0


def test_random_descriptors_teach_that_they_say_nothing(rng: np.random.Generator):
    """Both densities coincide within three standard errors, and the ratio stays near even odds."""
    frames = [rng.normal(0, 1, (4, D)) for _ in range(600)]
    state = taught_by(frames)
    law = RULE.law(state.lessons)
    lessons = state.lessons.same[0]
    error = law.other_deviation / math.sqrt(lessons)
    # A detection is in the mean that its own past is compared with, which pulls both apart.
    assert abs(law.same - law.other) < 3 * error + 0.02
    assert law.same_deviation == pytest.approx(law.other_deviation, rel=0.15)
    found = ratios(state, *rng.normal(0, 1, (2, 300, D)))
    # Lessons nearer than the memory are of the same descriptors.
    independent = state.lessons.means[[0, 3]].min() * PAUSE / RULE.memory
    assert np.abs(found).mean() < 2 * math.sqrt(2 / independent)
    assert found.max() < 1.5


def test_the_law_is_that_of_the_simulation(rng: np.random.Generator):
    """Views with as much variance in the noise as in what differs between objects."""
    count = 6
    own = one_of_each(count)
    frames = views(rng, own, 400, 1.0)
    state = taught_by(frames)
    law = RULE.law(state.lessons)
    # Of centred prototypes: −1/(n − 1) between objects; the variance of an object's own part.
    own_part = 1 - 1 / count
    signal = own_part / (own_part + 1.0)
    assert law.signal == pytest.approx(signal, abs=0.05)
    # Some thirty views with a memory of 3 s: nearly without noise, against one of a single view.
    assert law.same == pytest.approx(math.sqrt(signal), abs=0.05)
    assert law.other == pytest.approx(-math.sqrt(signal) / (count - 1), abs=0.04)
    assert law.means_same > 0.85
    assert law.means_other == pytest.approx(-1 / (count - 1), abs=0.04)
    assert abs(law.fading) < 0.03
    assert law.independent < 0.1
    assert law.other_deviation > law.same_deviation


def test_looks_that_change_teach_how_they_fade(rng: np.random.Generator):
    """Objects that turn towards another look within 20 s are less like what they were."""
    start = one_of_each(4)
    end = np.eye(D)[8:12]
    turned = [start * (1 - a) + end * a for a in np.abs(np.sin(np.arange(600) / 64))]
    changing = [own + rng.normal(0, 0.05, own.shape) for own in turned]
    steady = views(rng, start, 600, 0.25)
    fading = RULE.law(taught_by(changing).lessons).fading
    assert fading < -0.03
    assert abs(RULE.law(taught_by(steady).lessons).fading) < 0.01


def test_looks_alike_and_apart_are_told_by_their_ratio(rng: np.random.Generator):
    own = one_of_each(5)
    state = taught_by(views(rng, own, 200, 0.4))
    means = own + rng.normal(0, 0.02, own.shape)
    again = own + rng.normal(0, 0.02, own.shape)
    assert (ratios(state, means, again) > 2).all()
    # No picture alone says that an object is another one: at least log 0.05.
    others = ratios(state, means, np.roll(again, 1, axis=0))
    assert (others < -1.5).all()
    assert (others >= math.log(0.05)).all()


def test_only_targets_without_doubt_teach(rng: np.random.Generator):
    """Others change nothing, whatever they look like."""
    own = one_of_each(5)
    quiet = views(rng, own, 60, 0.3)
    loud = [np.vstack([looks[:3], rng.normal(0, 1, (2, D))]) for looks in quiet]
    # Of the same mean, which all detections have a part in.
    few = [taught_by(frames, sure=3) for frames in (quiet, loud)]
    for state in few:
        assert state.followed.rows["label"].tolist() == [0, 1, 2]
    assert few[0].lessons.same[0] == few[1].lessons.same[0]
    assert taught_by(quiet, sure=1).lessons.other[0] == 0
    assert not taught_by(quiet, sure=0).lessons.same.any()


def test_covered_boxes_teach_nothing(rng: np.random.Generator):
    """Those of which others cover more than a quarter."""
    state = RULE.start()
    pair = np.array([[0.0, 0, 40, 100], [18, 0, 58, 100], [500, 0, 540, 100], [900, 0, 940, 100]])
    sure = np.stack([np.arange(4), np.arange(4)], axis=1)
    for k in range(50):
        found = Detections.of(pair, embeddings=one_of_each(4) + rng.normal(0, 0.05, (4, D)))
        state, looks = RULE.looks(state, found, 0.1 * k)
        assert looks is not None
        np.testing.assert_allclose(looks.free, [0, 0, 1, 1], atol=0.11)
        state = RULE.advance(state, sure, looks)
    assert (state.followed.rows["weight"] > 0).tolist() == [False, False, True, True]


@pytest.mark.parametrize("unknown", [0.0, np.nan])
def test_rows_without_descriptor_are_not_known(unknown: float, rng: np.random.Generator):
    """They have no part in the mean, teach nothing and have no likelihood."""
    frames = views(rng, one_of_each(3), 50, 0.3)
    holes = [looks.copy() for looks in frames]
    for looks in holes:
        looks[2] = unknown
    state = taught_by(holes)
    two = taught_by([looks[:2] for looks in frames])
    np.testing.assert_array_equal(state.mean, two.mean)
    np.testing.assert_allclose(state.lessons.same, two.lessons.same, rtol=1e-6)
    np.testing.assert_allclose(state.lessons.other, two.lessons.other, rtol=1e-6)
    _, found = RULE.looks(state, frame(holes[0]), 9.0)
    assert found is not None
    assert found.free[2] == 0
    assert np.isfinite(found.raw).all()
    assert not found.seen[2].any()


def test_descriptors_of_another_length_begin_anew(rng: np.random.Generator):
    state = taught_by(views(rng, one_of_each(3), 50, 0.3))
    state, found = RULE.looks(state, frame(rng.normal(0, 1, (3, 5))), 9.0)
    assert found is not None
    assert found.raw.shape == (3, 5)
    assert found.law.weight == 0
    assert not state.lessons.same.any()
    assert len(state.followed.rows) == 0


def test_frames_without_descriptors_keep_what_is_known(rng: np.random.Generator):
    """Their detections are not known, and verdicts on targets still count."""
    state = taught_by(views(rng, one_of_each(3), 50, 0.3))
    for nothing in (Detections.of(boxes(3)), Detections.empty()):
        after, found = RULE.looks(state, nothing, 9.0)
        assert found is not None
        assert found.law.weight > 0
        assert found.free.tolist() == [0.0] * len(nothing)
        kept = RULE.advance(after, np.array([[0, -1], [2, -1]]), found)
        assert kept.followed.rows["label"].tolist() == [0, 2]
        assert (kept.followed.rows["weight"] > 0).all()
        np.testing.assert_array_equal(kept.lessons.same, state.lessons.same)


def test_scale_of_descriptors_says_nothing(rng: np.random.Generator):
    frames = views(rng, one_of_each(3), 40, 0.3)
    large = [looks * rng.uniform(1e-3, 1e3, (3, 1)) for looks in frames]
    a = RULE.law(taught_by(frames).lessons)
    b = RULE.law(taught_by(large).lessons)
    np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4)


def test_numbers_of_one_descriptor_may_be_single(rng: np.random.Generator):
    """D = 1: only the sign is left."""
    frames = [np.array([[1.0], [-1.0], [1.0]]) * rng.uniform(0.5, 2) for _ in range(40)]
    law = RULE.law(taught_by(frames).lessons)
    assert all(math.isfinite(value) for value in law[:-1])
    assert law.same > 0.9
