"""The kernels of appearance against their definitions."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.kernels.appearance import (
    PAST,
    Law,
    Looks,
    Pasts,
    besides,
    free_parts,
    likeness,
    plain,
    ratios_of_pairs,
    remembered,
    typical_ratios,
)
from phdtrack.kernels.appearance_lessons import (
    FIRST_EARLY,
    MEAN,
    SUMS,
    Followed,
    Lessons,
    lessons_of,
    taught,
)
from phdtrack.kernels.gaussian import PAIR
from phdtrack.kernels.pmb import HYPOTHESIS
from phdtrack.models.appearance import LEAST_FREE, PAUSE, SPANS, nobody
from reference import appearance_twin as twin

SEEDS = st.integers(0, 2**32 - 1)
LENGTHS = st.sampled_from([1, 2, 5, 32])


def a_law(rng: np.random.Generator) -> Law:
    """Any law: that of the same object may be the wider one, or lie below."""
    same, other = rng.uniform(-0.2, 1, 2)
    means_same, means_other = rng.uniform(-0.2, 1, 2)
    deviation = np.where(rng.random(5) < 0.2, 0.1, rng.uniform(0.03, 0.5, 5)).tolist()
    return Law(
        rng.uniform(0.1, 1),
        same,
        -rng.uniform(0, 0.2),
        deviation[0],
        other,
        deviation[1],
        rng.uniform(0.1, 3),
        rng.uniform(0.05, 0.95),
        deviation[2],
        rng.uniform(0, 1),
        means_same,
        deviation[3],
        means_other,
        deviation[4],
        rng.uniform(0, 2),
        np.inf,
    )


def a_frame(
    rng: np.random.Generator, n: int, size: int, *, law: Law | None = None, time: float = 10.0
) -> Looks:
    """n detections, of some of which nothing is known or free."""
    raw = rng.normal(0, 1, (n, size)) + 1
    raw[rng.random(n) < 0.2] = 0
    raw /= np.maximum(np.linalg.norm(raw, axis=1), 1e-9)[:, None]
    mean = rng.normal(0.3, 0.1, size) / np.sqrt(size)
    known = np.linalg.norm(raw, axis=1) > 0
    seen = np.array([twin.direction(row, mean) for row in raw]).reshape(n, size)
    free = np.where(known & (rng.random(n) < 0.8), rng.uniform(0.1, 1, n), 0.0)
    return Looks(
        raw.astype(np.float32),
        seen.astype(np.float32),
        mean.astype(np.float32),
        free,
        law or a_law(rng),
        time,
        rng.uniform(0.5, 5),
    )


def some_pasts(rng: np.random.Generator, count: int, size: int, looks: Looks) -> list[twin.Past]:
    out = []
    for _ in range(count):
        n = int(rng.integers(1, 5))
        time = np.sort(looks.time - rng.uniform(0.01, 8, n))
        look = rng.normal(0, 1, (n, size)) + 1
        look /= np.linalg.norm(look, axis=1)[:, None]
        out.append(
            twin.Past(
                tuple(time.tolist()),
                tuple(rng.uniform(0.1, 1, n).tolist()),
                tuple(map(tuple, look.tolist())),
                float(rng.random()),
                float(rng.uniform(1, 9)),
            )
        )
    return out


def as_arrays(pasts: list[twin.Past], size: int, memory: float) -> Pasts:
    """The same as the kernels take them."""
    rows = np.zeros(len(pasts), PAST)
    rows["weight"] = [p.weights(memory).sum() for p in pasts]
    rows["time"] = [p.time[-1] for p in pasts]
    rows["number"] = [p.number for p in pasts]
    rows["odd"] = [p.odd for p in pasts]
    looks = np.array([(p.mean(memory), p.look[-1]) for p in pasts], np.float32)
    return Pasts(rows, looks.reshape(-1, 2, size))


def some_hypotheses(rng: np.random.Generator, targets: int, pasts: int, n: int) -> np.ndarray:
    """Hypotheses of targets; a past is of one target only."""
    rows = []
    for t in range(targets):
        own = np.arange(t, pasts, targets)
        for _ in range(int(rng.integers(1, 6))):
            past = -1 if not len(own) or rng.random() < 0.2 else int(rng.choice(own))
            rows.append((t, past, int(rng.integers(-1, n))))
    out = np.zeros(len(rows), HYPOTHESIS)
    if rows:
        out["target"], out["past"], out["detection"] = np.array(rows).T
    return out


@settings(max_examples=60)
@given(SEEDS, st.integers(0, 5), st.integers(0, 6), st.integers(0, 5), LENGTHS)
def test_pair_ratios_are_their_definition(seed: int, targets: int, pasts: int, n: int, size: int):
    rng = np.random.default_rng(seed)
    looks = a_frame(rng, n, size)
    known = some_pasts(rng, pasts, size, looks)
    hypotheses = some_hypotheses(rng, targets, pasts if targets else 0, n)
    each = [(c, j) for c in range(len(hypotheses)) for j in range(n)]
    pairs = np.zeros(len(each), PAIR)
    for q, (c, j) in enumerate(each):
        pairs[q]["gaussian"] = c
        pairs[q]["measurement"] = j
    before = tuple(as_arrays(known, size, looks.memory))
    found = ratios_of_pairs(pairs, hypotheses, before, plain(looks))
    if not pasts:
        assert found.shape == (0,)
        return
    wanted = []
    for c, j in each:
        past = int(hypotheses["past"][c])
        wanted.append(twin.pair_ratio(known[past] if past >= 0 else None, j, looks))
    np.testing.assert_allclose(found, wanted, rtol=1e-3, atol=2e-3)


def test_pairs_have_no_ratio_before_lessons(rng: np.random.Generator):
    looks = a_frame(rng, 3, 4)
    looks = looks._replace(law=looks.law._replace(weight=0.0))
    pasts = tuple(as_arrays(some_pasts(rng, 2, 4, looks), 4, looks.memory))
    hypotheses = np.zeros(2, HYPOTHESIS)
    assert ratios_of_pairs(np.zeros(2, PAIR), hypotheses, pasts, plain(looks)).shape == (0,)


@settings(max_examples=30)
@given(SEEDS, st.integers(0, 5), st.integers(0, 6), st.integers(1, 5), LENGTHS)
def test_pasts_after_a_frame_are_as_defined(seed: int, targets: int, pasts: int, n: int, size: int):
    """Each hypothesis has its own past, and those that saw the same share one."""
    rng = np.random.default_rng(seed)
    looks = a_frame(rng, n, size)
    known = some_pasts(rng, pasts if targets else 0, size, looks)
    hypotheses = some_hypotheses(rng, targets, len(known), n)
    before = hypotheses.copy()
    before_frame = as_arrays(known, size, looks.memory)
    after = Pasts(*remembered(hypotheses, tuple(before_frame), plain(looks)))
    shared = {}
    for c, h in enumerate(before):
        past = known[h["past"]] if h["past"] >= 0 else None
        wanted = twin.followed_by(past, int(h["detection"]), looks)
        place = int(hypotheses["past"][c])
        assert (place < 0) == (wanted is None)
        if wanted is None:
            continue
        seen = h["target"], h["past"], h["detection"] if wanted is not past else -1
        assert shared.setdefault(seen, place) == place
        (right,) = as_arrays([wanted], size, looks.memory).rows.tolist()
        np.testing.assert_allclose(after.rows[place].tolist(), right, rtol=1e-3, atol=1e-3)
        both = wanted.mean(looks.memory), wanted.look[-1]
        np.testing.assert_allclose(after.looks[place], both, rtol=1e-3, atol=1e-3)
    assert sorted(shared.values()) == list(range(len(after.rows)))


@settings(max_examples=40)
@given(SEEDS, st.integers(0, 4), st.integers(0, 4), LENGTHS)
def test_likeness_is_its_definition(seed: int, n: int, m: int, size: int):
    rng = np.random.default_rng(seed)
    looks = a_frame(rng, 0, size)
    mean = rng.normal(0.2, 0.3, (n + m, size)).astype(np.float32)
    count = rng.uniform(0.5, 20, n + m)
    seconds = rng.uniform(0, 9, n + m)
    before, after = np.indices((n, m)).reshape(2, -1)
    after = n + after
    wanted = [
        twin.likeness(mean[a], count[a], mean[b], count[b], looks, min(seconds[a], seconds[b]))
        for a, b in zip(before, after, strict=True)
    ]
    found = likeness(mean, count, seconds, before, after, plain(looks))
    np.testing.assert_allclose(found, np.array(wanted), rtol=1e-3, atol=2e-3)


@settings(max_examples=40)
@given(SEEDS, st.integers(0, 4), st.integers(0, 4), LENGTHS)
def test_typical_ratios_are_those_of_pairs(seed: int, n: int, m: int, size: int):
    """Of targets that were seen once, and did not look odd."""
    rng = np.random.default_rng(seed)
    looks = a_frame(rng, m, size)
    pasts = [replace(one, odd=0.0) for one in some_pasts(rng, n, size, looks)]
    pasts = [
        replace(one, time=one.time[-1:], free=one.free[-1:], look=one.look[-1:]) for one in pasts
    ]
    before, measurement = np.indices((n, m)).reshape(2, -1)
    wanted = [twin.pair_ratio(pasts[h], j, looks) for h, j in zip(before, measurement, strict=True)]
    known = as_arrays(pasts, size, looks.memory)
    rows = known.rows
    past = known.looks[:, 0].copy(), rows["number"].copy(), rows["time"].copy()
    found = typical_ratios(past, before, measurement, plain(looks))
    np.testing.assert_allclose(found, np.array(wanted), rtol=1e-3, atol=2e-3)


def test_likeness_of_what_is_not_known_is_even(rng: np.random.Generator):
    looks = a_frame(rng, 0, 3)
    mean = rng.normal(0, 1, (3, 3)).astype(np.float32)
    count = np.array([2.0, 0.0, 3.0])
    pairs = np.array([0, 1, 1]), np.array([1, 2, 0])
    assert not likeness(mean, count, np.zeros(len(count)), *pairs, plain(looks)).any()
    nothing = looks._replace(law=looks.law._replace(means_weight=0.0))
    found = likeness(
        mean, count, np.zeros(len(count)), np.array([0]), np.array([2]), plain(nothing)
    )
    assert not found.any()


def test_the_ratio_never_falls_with_similarity(rng: np.random.Generator):
    """Whichever Gaussian is the wider one."""
    size = 2
    angle = np.linspace(np.pi, 0, 60)
    for _ in range(20):
        law = a_law(rng)
        looks = a_frame(rng, 0, size, law=law)._replace(mean=np.zeros(size, np.float32))
        mean = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        mean = np.vstack([mean, [[1, 0]]]).astype(np.float32)
        ratio = likeness(
            mean, np.full(61, 5.0), np.zeros(61), np.arange(60), np.full(60, 60), plain(looks)
        )
        assert (np.diff(ratio) >= -1e-5).all()


@settings(max_examples=60)
@given(SEEDS, st.integers(0, 8))
def test_free_parts_are_what_others_leave(seed: int, n: int):
    rng = np.random.default_rng(seed)
    corner = rng.uniform(0, 60, (n, 2))
    boxes = np.hstack([corner, corner + rng.uniform(10, 60, (n, 2))])
    np.testing.assert_allclose(free_parts(boxes), twin.free_parts(boxes), atol=1e-12)


def test_free_parts_of_boxes_side_by_side_and_inside():
    boxes = np.array([[0.0, 0, 10, 10], [10, 0, 20, 10], [12, 2, 18, 8], [7.5, 0, 10, 10]])
    # A quarter of the first is covered, of the second .36; the others lie inside.
    np.testing.assert_allclose(free_parts(boxes), [0.5, 1 - 0.72, 0, 0])


@settings(max_examples=60)
@given(SEEDS, st.integers(0, 8))
def test_who_is_beside_whom_is_the_nearest_that_nearly_touches(seed: int, n: int):
    rng = np.random.default_rng(seed)
    corner = rng.uniform(0, 100, (n, 2))
    boxes = np.hstack([corner, corner + rng.uniform(10, 60, (n, 2))])
    centre = boxes[:, :2] + boxes[:, 2:]
    size = boxes[:, 2:] - boxes[:, :2]
    for i, found in enumerate(besides(boxes).tolist()):
        apart = [
            max(abs(centre[i] - centre[j]) / (size[i] + size[j])) if i != j else np.inf
            for j in range(n)
        ]
        nearest = int(np.argmin(apart))
        assert found == (nearest if apart[nearest] < 1.25 else -1)


@settings(max_examples=12)
@given(SEEDS, st.integers(1, 4), st.sampled_from([1, 3, 16]), st.sampled_from([20.0, 3000.0]))
def test_lessons_are_their_definition(seed: int, people: int, size: int, most: float):
    """Of targets that come, go, are doubtful or covered for a while, with descriptors that are
    sometimes not known.
    """
    rng = np.random.default_rng(seed)
    own = rng.normal(0, 1, (people, size)) + 1
    school = twin.School(SPANS, PAUSE, LEAST_FREE, most)
    followed = nobody(size)
    sums = np.zeros(SUMS)
    time = 0.0
    memory = rng.uniform(1, 5)
    mean = (own.mean(axis=0) / 3).astype(np.float32)
    for _ in range(150):
        time += float(rng.choice([0.04, 0.1, 0.6]))
        raw = own + rng.normal(0, 0.5, own.shape)
        raw[rng.random(people) < 0.1] = 0
        length = np.linalg.norm(raw, axis=1)
        raw /= np.maximum(length, 1e-9)[:, None]
        seen = np.array([twin.direction(row, mean) for row in raw]) * (length > 0)[:, None]
        free = np.where(length > 0, rng.uniform(0.3, 1, people), 0.0)
        looks = SimpleNamespace(
            raw=raw.astype(np.float32),
            seen=seen.astype(np.float32),
            mean=mean,
            free=free,
            law=a_law(rng),
            time=time,
            memory=memory,
            beside=np.where(rng.random(people) < 0.5, (np.arange(people) + 1) % people, -1),
        )
        looks.beside[looks.beside == np.arange(people)] = -1
        sure = np.flatnonzero(rng.random(people) < 0.97)
        had = np.where(rng.random(len(sure)) < 0.8, sure, -1)
        table = np.stack([10 + sure, had], axis=1)
        school.frame(table, looks)
        frame = Looks(*vars(looks).values())
        rules = (SPANS, PAUSE, LEAST_FREE, most)
        known, sums = taught(tuple(followed), sums, table, plain(frame), rules)
        followed = Followed(*known)
        assert followed.rows["label"].tolist() == list(school.people)
    lessons = lessons_of(sums)
    for name in Lessons._fields:
        # A single number may be that of the mean, but for errors of rounding.
        part = slice(0, None, 3) if size == 1 else slice(None)
        wanted = getattr(school, name)[part]
        np.testing.assert_allclose(getattr(lessons, name)[part], wanted, rtol=2e-3, atol=2e-3)
    check_followed(followed, school, memory)


def check_followed(followed: Followed, school: twin.School, memory: float) -> None:
    """What is known of each target is what all its detections say."""
    for k, one in enumerate(school.people.values()):
        row = followed.rows[k]
        looks = followed.looks[k]
        assert row["taught"] == one.taught
        assert [*np.flatnonzero(np.isfinite(followed.early[k]["time"]))] == sorted(one.early)
        if not one.seen:
            assert row["weight"] == 0
            continue
        np.testing.assert_allclose(looks[MEAN], one.mean(memory), atol=1e-3)
        assert row["time"] == one.seen[-1][0]
        for place, end in one.early.items():
            np.testing.assert_allclose(
                looks[FIRST_EARLY + place], one.mean(memory, 0, end), atol=1e-3
            )


@pytest.mark.parametrize("sure", [[], [[3, -1]], [[3, 0]]])
def test_one_target_alone_teaches_nothing_of_others(sure: list, rng: np.random.Generator):
    looks = a_frame(rng, 1, 4)._replace(free=np.ones(1))
    table = np.array(sure, np.int64).reshape(-1, 2)
    rules = (SPANS, PAUSE, LEAST_FREE, 3000.0)
    followed, after = taught(tuple(nobody(4)), np.zeros(SUMS), table, plain(looks), rules)
    assert len(Followed(*followed).rows) == len(sure)
    assert not after.any()
