"""The Poisson multi-Bernoulli filter: existence, labels, order, sources of false alarms, who is
hidden.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mht_cases import RNG, boxes, run, scene, told, walk
from pmb_cases import PLAIN, world
from scipy.linalg import expm

from phdtrack import config
from phdtrack.filters import PMB
from phdtrack.types import SequenceInfo


def test_misses_in_a_row_are_believed_where_targets_get_hidden():
    """After half a second without a detection somebody who may be hidden is believed in, and comes
    back as himself.
    """
    model = world(detection=0.95, survival=0.999)
    path = walk((200, 200), (2, 1), 30, np.random.default_rng(1))
    scans = [boxes(here) for here in path]
    scans[12:24] = [boxes()] * 12
    gone, waiting = (
        run(f, scans[:24], model)[0].mass
        for f in (PLAIN, replace(PMB(), mean_visible_time=1.0, mean_occluded_time=2.0))
    )
    assert gone < 1e-6
    assert waiting > 0.5
    state, _ = run(replace(PMB(), mean_visible_time=1.0, mean_occluded_time=2.0), scans, model)
    assert told(state, model).tag.tolist() == [0]


@pytest.mark.parametrize("before", [0.0, 60.0])
@pytest.mark.parametrize("name", ["steady", "uneven"])
def test_births_that_stay_hidden_are_a_markov_chain(name: str, before: float):
    """λ⁺ after each interval, against the chain's matrix exponential: births are in its
    equilibrium, and what is visible is no longer undetected.
    """
    settings = replace(PLAIN, mean_visible_time=2.0, mean_occluded_time=0.5)
    model = world(clutter=1e-6, birth=1e-7, survival=0.97)
    steps = [1.0] * 8 if name == "steady" else [1.0, 30.0, 0.5, 7.0, 100.0, 2.0]
    leave = -25.0 * np.log(0.97)
    chain = np.array([[-1 / 2.0, 1 / 2.0], [1 / 0.5, -1 / 0.5]]) - leave * np.eye(2)
    equilibrium = np.array([0.8, 0.2])
    state = settings.start(model, RNG)
    unseen = np.zeros(2)
    for k, dt in enumerate(steps):
        now = replace(model, births_before=0.0 if k else before)
        unseen = unseen @ expm(chain * dt / 25.0) + now.birth_seconds(dt) * equilibrium
        # A box that is far from all before.
        z = boxes((200 + 3000 * k, 200))
        state, _ = settings.step(state, z, now, dt, RNG)
        target = state.present.targets[-1]
        first = 0.9 * 25.0 * 1e-7 * unseen[0]
        p_new = state.present.targets["r"][-1] / (first / (first + 1e-6))
        assert target["label"] == state.next_label - 1
        assert p_new == pytest.approx(1.0, abs=1e-3)
        unseen[0] = 0.0
        assert state.hidden == pytest.approx(unseen[1], rel=1e-9)


def test_without_occlusion_no_births_are_hidden():
    state = PLAIN.start(world(birth=1e-7), RNG)
    for dt in (1.0, 5.0):
        state, _ = PLAIN.step(state, boxes((200, 200)), world(birth=1e-7), dt, RNG)
        assert state.hidden == 0.0


def test_labels_are_unique_and_rise():
    rng = np.random.default_rng(0)
    model = world(clutter=1e-9, birth=1e-9, survival=0.9)
    state = PMB().start(model, RNG)
    ever = set()
    ended = set()
    for z in scene(rng, 60, targets=5, clutter=6):
        before = set(state.present.targets["label"].tolist())
        fresh = state.next_label
        state, _ = PMB().step(state, z, model, 1.0, RNG)
        label = state.present.targets["label"]
        assert (np.diff(label) > 0).all()
        new = set(label.tolist()) - before
        assert not new & ever
        assert all(fresh <= one < state.next_label for one in new)
        ended |= before - set(label.tolist())
        assert not ended & set(label.tolist())
        ever |= new
    assert len(ever) > 100
    assert len(ended) > 50


def seen_by_a_source(seed: int, frames: int = 150) -> list[np.ndarray]:
    """Half of the time something at one place, trembling a little."""
    rng = np.random.default_rng(seed)
    return [boxes(*rng.normal((300, 200), 2, (int(rng.random() < 0.5), 2))) for _ in range(frames)]


@pytest.mark.parametrize("seed", range(5))
def test_a_source_of_false_alarms_is_soon_not_reported(seed: int):
    """It fires half of the time in one place; three seconds later nobody is reported there for the
    three that follow.
    """
    model = world(detection=0.95, clutter=1e-9, birth=1e-10, survival=0.9999)
    filter_ = PMB(mean_visible_time=4.0, mean_occluded_time=0.2)
    state = filter_.start(model, RNG)
    reported = []
    for z in seen_by_a_source(seed):
        state, info = filter_.step(state, z, model, 1.0, RNG)
        reported.append(len(told(state, model)))
    assert sum(reported[75:]) == 0
    assert len(state) > 0, "it is still followed"
    assert state.present.hypotheses["static"].any()
    if z.shape[1]:
        assert info.clutter_probability[0] > 0.9


def test_who_walks_through_a_source_keeps_his_label():
    model = world(detection=0.95, clutter=1e-9, birth=1e-10, survival=0.9999)
    filter_ = PMB(mean_visible_time=4.0, mean_occluded_time=0.2)
    scans = seen_by_a_source(7, 220)
    rng = np.random.default_rng(7)
    path = walk((300 - 4 * 150, 200), (4, 0), 220, rng, 2.0)
    state = filter_.start(model, RNG)
    labels = []
    for k, z in enumerate(scans):
        if k >= 90 and rng.random() < 0.95:
            z = np.hstack([boxes(path[k]), z])
        state, _ = filter_.step(state, z, model, 1.0, RNG)
        found = told(state, model)
        if k >= 95:
            near = np.abs(found.state[0] - path[k, 0]) < 20
            assert near.any(), k
            labels.append(int(found.tag[near][0]))
    assert len(set(labels)) == 1


@pytest.mark.parametrize(
    ("seed", "share"), [(seed, share) for seed in range(5) for share in (1.0, 0.3)]
)
def test_a_person_who_stands_still_is_reported(seed: int, share: float):
    """Seen nine times of ten, with the noise that the sensor states or less; a source would be seen
    half of the time.
    """
    stages = config.build(config.load(sets=["filter.kind=pmb"]), SequenceInfo(640, 480, 25.0))
    rng = np.random.default_rng(seed)
    model = stages.model
    filter_ = stages.filter
    state = filter_.start(model, RNG)
    reported = []
    x = np.array([[300.0], [200], [0], [0], [40], [100]])
    noise = share * np.sqrt(np.diag(model.sensor.covariance(x[[0, 1, 4, 5]], x)[0]))
    for _ in range(150):
        z = x[[0, 1, 4, 5]] + noise[:, None] * rng.standard_normal((4, 1))
        state, _ = filter_.step(state, z if rng.random() < 0.9 else z[:, :0], model, 1.0, RNG)
        found = told(state, model)
        reported.append(found.tag.tolist())
    assert np.mean([len(tags) == 1 for tags in reported[25:]]) > 0.97
    assert len({tags[0] for tags in reported[25:] if tags}) == 1


def test_history_and_number_of_hypotheses_are_bounded():
    rng = np.random.default_rng(5)
    model = world(clutter=3e-9, birth=3e-9)
    sizes = []
    filter_ = PMB(history=4, max_hypotheses=5)
    state = filter_.start(model, RNG)
    for z in scene(rng, 60, targets=8, clutter=20):
        state, _ = filter_.step(state, z, model, 1.0, RNG)
        assert len(state.layers) <= 5
        assert (state.present.targets["end"] - state.present.targets["begin"]).max() <= 5
        assert (state.frame - state.ended[:, 0]).max(initial=1) <= 4
        sums = np.add.reduceat(state.present.hypotheses["weight"], state.present.targets["begin"])
        np.testing.assert_allclose(sums, 1)
        sizes.append(len(state))
    assert max(sizes[40:]) < 1.5 * max(sizes[20:40])


def test_rare_births_among_much_clutter_are_seen_a_second_time():
    """A first detection is a new target's once in 10 000: less than ``least``, and yet who stays is
    found.
    """
    model = world(clutter=1e-6, birth=1e-10)
    filter_ = PMB(mean_visible_time=0.0, static_clutter_prior=0.0)
    state = filter_.start(model, RNG)
    for k in range(25):
        state, _ = filter_.step(state, boxes((100 + 2 * k, 200)), model, 1.0, RNG)
    assert told(state, model).tag.tolist() == [0]
    assert filter_.existence_threshold > 1e-4
