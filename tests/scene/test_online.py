"""Learning while tracking, piece by piece: evidence, recent samples, labels of detections, what is in use."""

from dataclasses import replace

import numpy as np
import pytest

from phdtrack.arrays import to_xyxy
from phdtrack.scene import LearnedDensity, SceneDensity
from phdtrack.scene.labelling import ObservedFrame, PendingFrames, label
from phdtrack.scene.online import Regime
from phdtrack.scene.online_mixture import KEPT_PER_BATCH, Batch, Evidence, OnlineMixture, _faded, _relearned
from phdtrack.scene.training import PRIOR, measurement_volume, state_volume
from phdtrack.types import Tracks

LOW, HIGH = measurement_volume(640, 360)
PLACES = np.array([[100.0, 200, 30, 80], [400, 100, 20, 50]])


def boxes(place, n, rng, jitter=0.1):
    size = np.tile(place[2:], 2)
    return place[:, None] + jitter * size[:, None] * rng.standard_normal((4, n))


# Evidence


def test_evidence_decides_by_two_standard_errors_and_else_not_at_all():
    rng = np.random.default_rng(0)
    noise = rng.normal(size=40)
    noise = (noise - noise.mean()) / noise.std()
    ones = np.ones(40)
    # The standard error is 1/√40 = 0.158.
    for shift, expected in ((0.4, 1), (0.2, 0), (-0.2, 0), (-0.4, -1)):
        assert Evidence.of(noise + shift, ones).sign == expected
    assert Evidence.of(noise[:9] + 5, ones[:9]).sign == 0


def test_evidence_fades():
    old, ones = Evidence.of(np.full(100, 2.0), np.ones(100)), np.ones(100)
    new = old.joined(Evidence.of(np.full(100, -1.0), ones), 50)
    assert new.mean == pytest.approx((100 * np.exp(-2) * 2 - 100) / (100 * np.exp(-2) + 100))


# Samples


def follow(samples, rounds=12):
    """A density that learns samples in as many batches."""
    part = OnlineMixture.unknown((LOW, HIGH), 60.0)
    density, parts = part.density, np.array_split(samples, rounds, axis=1)
    for k in range(rounds):
        age = np.repeat(np.arange(k, -1, -1), [each.shape[1] for each in parts[: k + 1]])
        density = _relearned(density, np.hstack(parts[: k + 1]), _faded(np.ones(len(age)), age, 100.0))
    return density


def test_places_are_found_beside_boxes_from_anywhere():
    rng = np.random.default_rng(2)
    anywhere = rng.uniform(0, 1, (4, 200)) * np.array([640, 360, 20, 50])[:, None] + np.array([0, 0, 20, 50])[:, None]
    samples = np.hstack([*(boxes(place, 200, rng) for place in PLACES), anywhere])
    density = follow(samples[:, rng.permutation(600)])
    for place in PLACES:
        nearest = np.argmin(np.abs(density.mean - place[:, None]).max(axis=0))
        assert np.abs(density.mean[:, nearest] - place).max() < 2
        assert density.weight[nearest] == pytest.approx(1 / 3, abs=0.1)
    # Known: the entropy of the mixture, here by the parts' own densities.
    unseen = boxes(PLACES[0], 500, rng)
    entropy = 2 * np.log(2 * np.pi * np.e) + np.log(0.1 * np.tile(PLACES[0, 2:], 2)).sum()
    assert -density.log(unseen).mean() == pytest.approx(entropy + np.log(3), abs=0.3)


# A part: rate, forgetting, trust


def batch(samples, seconds=1.0):
    return Batch(samples, np.ones(samples.shape[1]), 25 * seconds, 25.0)


def test_the_rate_follows_within_the_memory():
    rng, part = np.random.default_rng(4), OnlineMixture.unknown((LOW, HIGH), 60.0)
    for _ in range(120):
        part = part.updated(batch(boxes(PLACES[0], 50, rng)))
    assert part.rate == pytest.approx(2.0, rel=1e-6)
    for _ in range(60):
        part = part.updated(batch(boxes(PLACES[0], 25, rng)))
    assert part.rate == pytest.approx(1 + np.exp(-1) * (1 - np.exp(-2)) / (1 - np.exp(-3)), abs=0.02)
    assert len(part.weight) <= 2 * part.memory * KEPT_PER_BATCH + KEPT_PER_BATCH


def test_what_is_learned_is_used_after_it_has_explained_what_it_had_not_learned():
    rng, part = np.random.default_rng(5), OnlineMixture.unknown((LOW, HIGH), 60.0)
    used = []
    for _ in range(12):
        new = batch(boxes(PLACES[0], 20, rng))
        part = part.scored(new).updated(new)
        used.append(part.trusted)
    assert not used[0]
    assert used[-1]
    # Now false alarms come from elsewhere.
    uniform = batch(rng.uniform(0, 1, (4, 40)) * HIGH[:, None])
    assert not part.scored(uniform).scored(uniform).trusted


def test_what_was_learned_before_counts_as_if_it_had_just_been_seen():
    covariance = np.diag((0.1 * np.tile(PLACES[0, 2:], 2)) ** 2)
    density = SceneDensity(LOW, HIGH, 0.1, np.ones(1), PLACES[0][:, None], covariance[None])
    part = OnlineMixture.unknown((LOW, HIGH), 60.0).known(LearnedDensity(2.0, density, 500), 25.0)
    assert part.trusted
    assert part.rate == 2.0
    after = part.updated(batch(boxes(PLACES[0], 50, np.random.default_rng(6))))
    unseen = boxes(PLACES[0], 500, np.random.default_rng(7))
    assert after.density.log(unseen).mean() == pytest.approx(density.log(unseen).mean(), abs=0.15)
    assert after.rate == pytest.approx(2.0, abs=1e-9)


# Labels


def row(frame, identity, box, detection=0, confirmed=True):
    one = np.array([frame]), np.array([identity]), to_xyxy(box[:, None]), np.ones(1), np.array([detection])
    return Tracks(*one, np.array([confirmed]))


def street(rng):
    """100 frames at 25 a second: somebody walks in from frame 10 on and is tracked from 14, confirmed from 18; a place fires
    every second frame, with a track from frame 20 on; a box is anywhere once a frame."""
    out, truth = [], []
    for frame in range(1, 101):
        walker = np.array([5.0 + 4 * (frame - 10), 200, 30, 80]) + np.append(rng.normal(size=2), [0, 0])
        place = boxes(PLACES[1], 1, rng)[:, 0]
        stray = np.array([*rng.uniform(0, 1, 2) * [300, 80] + [300, 250], 30, 80])
        parts, rows, source = [], [], []
        if frame >= 10:
            parts.append(walker)
            source.append(1)
            if frame >= 14:
                rows.append(row(frame, 1, walker, 0, frame >= 18))
        if frame % 2 == 0:
            if frame >= 20:
                rows.append(row(frame, 2, place, len(parts)))
            parts.append(place)
            source.append(-1)
        elif frame >= 20:
            rows.append(row(frame, 2, PLACES[1], -1))
        parts.append(stray)
        source.append(0)
        box = to_xyxy(np.array(parts).T)
        out.append(ObservedFrame(frame, (frame - 1) / 25, box, np.full(len(parts), 0.8), Tracks.concatenate(rows)))
        truth.append(np.array(source))
    return tuple(out), truth


def test_labels_wait_for_what_became_of_a_detection():
    given, truth = street(np.random.default_rng(8))
    pending, labels = label(PendingFrames(given), 3.0, 0.9, 25.0)
    assert labels.frames == 76
    assert labels.seconds == pytest.approx(76 / 25)
    source = np.concatenate(truth[:76])
    # Also the walker's first detections, before there was a track, are his.
    assert (labels.false[source == 1] == 0).all()
    assert (labels.false[source == 0] == 0.8).all()
    frame = np.concatenate([np.full(len(t), k + 1) for k, t in enumerate(truth[:76])])
    assert (labels.false[(source == -1) & (frame >= 20)] == 1).all()
    assert labels.births.shape == (6, 1)
    off = np.abs(labels.births[:, 0] - [21, 200, 4, 0, 30, 80])
    assert (off < [3, 3, 0.4, 0.4, 0.1, 0.1]).all()
    assert [frame.number for frame in pending.frames] == list(range(77, 101))


def test_labels_do_not_depend_on_how_frames_are_divided():
    given, _ = street(np.random.default_rng(9))
    _, whole = label(PendingFrames(given), 3.0, 0.9, 25.0)
    pending, parts = PendingFrames(), []
    for k, frame in enumerate(given):
        pending = replace(pending, frames=(*pending.frames, frame))
        if k + 1 in (60, 80, 100):
            pending, labels = label(pending, {60: 1.5, 80: 2.3, 100: 3.0}[k + 1], 0.9, 25.0)
            parts.append(labels)
    np.testing.assert_array_equal(np.concatenate([p.false for p in parts]), whole.false)
    np.testing.assert_array_equal(np.hstack([p.births for p in parts]), whole.births)


def test_somebody_who_stands_is_no_place_and_a_place_is_nobody():
    rng = np.random.default_rng(10)
    for chance, expected in ((0.9, 0.0), (0.5, 1.0)):
        fired = rng.random(150) < chance
        fired[0] = True
        given = []
        for k in range(150):
            box = boxes(PLACES[0], 1, rng, 0.05)
            seen = to_xyxy(box)[: int(fired[k])]
            rows = row(k + 1, 5, box[:, 0], 0 if fired[k] else -1)
            given.append(ObservedFrame(k + 1, k / 25, seen, np.full(len(seen), 0.5), rows))
        _, labels = label(PendingFrames(tuple(given)), 4.0, 0.9, 25.0)
        assert (labels.false == expected).all()


# Births against detections of objects


WALK = np.array([320.0, 180, 30, 80])


def walkers(n, rng):
    """First states, or boxes with velocities of people anywhere along the image's middle."""
    box = boxes(WALK, n, rng)
    box[0] = rng.uniform(20, 620, n)
    return box


def states(box):
    return np.stack([box[0], box[1], np.zeros(box.shape[1]), np.zeros(box.shape[1]), box[2], box[3]])


def lived(entered, rounds, rng):
    """A regime after so many batches of 40 boxes of people and 4 births where ``entered`` says."""
    unknown = (
        OnlineMixture.unknown(state_volume((640, 360), 20), 60.0),
        OnlineMixture.unknown((LOW, HIGH), 60.0),
        OnlineMixture.unknown((LOW, HIGH), 60.0),
    )
    now, nothing = Regime("day", *unknown), Batch(np.zeros((4, 0)), np.zeros(0), 25, 25.0)
    for _ in range(rounds):
        new = batch(states(entered(4, rng))), nothing, batch(walkers(40, rng))
        now = now.updated(new)
    return now


def door(n, rng):
    return boxes(np.array([40.0, 180, 30, 80]), n, rng)


def test_births_are_used_where_people_come_in_otherwise_than_they_are():
    rng = np.random.default_rng(12)
    at_door, anywhere = lived(door, 25, rng), lived(walkers, 25, rng)
    assert at_door.births_used
    # At the door births have a deviation of 3 pixels, and on 600 pixels of the way people are anywhere: log(600/12.4).
    assert at_door.births.evidence.mean == pytest.approx(np.log(600 / 12.4), abs=1.5)
    assert not anywhere.births_used
    assert anywhere.births.evidence.mean < 0.2
    # The door is closed, and a dozen people come in anywhere.
    nothing = Batch(np.zeros((4, 0)), np.zeros(0), 25, 25.0)
    assert not at_door.updated((batch(states(walkers(12, rng))), nothing, nothing)).births_used


def after(rng, n):
    """What is used of false alarms after two lessons of ``n`` boxes of a place."""
    part = OnlineMixture.unknown((LOW, HIGH), 60.0)
    for _ in range(2):
        part = part.updated(batch(boxes(PLACES[0], n, rng)))
    births = OnlineMixture.unknown(state_volume((640, 360), 20), 60.0)
    return Regime("day", births, part, OnlineMixture.unknown((LOW, HIGH), 60.0)).known[1]


def test_what_is_used_is_no_surer_than_its_samples():
    rng = np.random.default_rng(14)
    few, many = (after(rng, n) for n in (6, 12))
    for learned, n in ((few, 12), (many, 24)):
        assert learned.samples == n
        assert learned.density.uniform >= PRIOR / (n + PRIOR)
        wide = np.sqrt(np.diag(learned.density.covariance[0])) / (0.1 * np.tile(PLACES[0, 2:], 2))
        # All are of one component: (n + 1)/(n − 6) of their covariance.
        assert 0.6 * np.sqrt((n + 1) / (n - 6)) < wide.mean() < 2 * np.sqrt((n + 1) / (n - 6))
    assert few.density.covariance[0, 0, 0] > many.density.covariance[0, 0, 0]
