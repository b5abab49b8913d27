"""The Poisson multi-Bernoulli filter: existence, labels, order, sources of false alarms, who is hidden."""

from __future__ import annotations

from dataclasses import replace

import mht_cases
import numpy as np
import pytest
from pmb_cases import FRAME, PLAIN, RNG, run, told, walk, without_births, world

from phdtrack import config
from phdtrack.errors import InputError
from phdtrack.filters import PMB
from phdtrack.models import BoxMotion, SplitSpawn
from phdtrack.types import GaussianMixture, SequenceInfo

boxes = mht_cases.boxes


def test_an_empty_scan_makes_a_target_less_believed():
    """r p_S (1 − p_D) / (1 − r p_S p_D)."""
    model = world(detection=0.8, survival=0.9)
    state, _ = run(PLAIN, [boxes((200, 200)), boxes((201, 202))], model)
    r = state.present.targets["r"][0]
    for _ in range(3):
        state, info = PLAIN.step(state, boxes(), model, 1.0, RNG)
        r = 0.9 * r * 0.2 / (1 - 0.9 * r * 0.8)
        assert state.present.targets["r"][0] == pytest.approx(r, rel=1e-9)
    assert info.evidence.shape == (0,)


def chain(hidden: float, filter_: PMB, seconds: float) -> float:
    """Probability of the second state of a two-state Markov chain after ``seconds``."""
    rate, settled = (
        1 / filter_.mean_visible_time + 1 / filter_.mean_occluded_time,
        filter_.mean_occluded_time / (filter_.mean_visible_time + filter_.mean_occluded_time),
    )
    return settled + (hidden - settled) * np.exp(-rate * seconds)


@pytest.mark.parametrize(
    "settings",
    [{}, {"mean_visible_time": 0.3, "mean_occluded_time": 5.0}, {"mean_visible_time": 100.0, "mean_occluded_time": 0.01}],
)
def test_who_is_in_view_gets_hidden_as_a_markov_chain(settings: dict):
    filter_, model = replace(PMB(static_clutter_prior=0.0), **settings), world(survival=1.0)
    state, _ = run(filter_, [boxes((200, 200))], model)
    assert state.present.hypotheses["occluded"].tolist() == [0]
    whole = filter_.predict(state, model, 5.0, RNG)
    assert whole.present.hypotheses["occluded"][0] == pytest.approx(chain(0.0, filter_, 0.2), rel=1e-12)
    halves = filter_.predict(filter_.predict(state, model, 2.5, RNG), model, 2.5, RNG)
    assert halves.present.hypotheses["occluded"][0] == pytest.approx(whole.present.hypotheses["occluded"][0], rel=1e-12)
    late = filter_.predict(whole, model, 1e6, RNG)
    assert late.present.hypotheses["occluded"][0] == pytest.approx(
        filter_.mean_occluded_time / (filter_.mean_visible_time + filter_.mean_occluded_time)
    )
    assert replace(filter_, mean_visible_time=0.0).predict(state, model, 5.0, RNG).present.hypotheses["occluded"][0] == 0


def test_misses_in_a_row_are_believed_where_targets_get_hidden():
    """After half a second without a detection somebody who may be hidden is believed in, and comes back as himself."""
    model, path = world(detection=0.95, survival=0.999), walk((200, 200), (2, 1), 30, np.random.default_rng(1))
    scans = [boxes(here) for here in path]
    scans[12:24] = [boxes()] * 12
    gone, waiting = (
        run(f, scans[:24], model)[0].mass for f in (PLAIN, replace(PMB(), mean_visible_time=1.0, mean_occluded_time=2.0))
    )
    assert gone < 1e-6
    assert waiting > 0.5
    state, _ = run(replace(PMB(), mean_visible_time=1.0, mean_occluded_time=2.0), scans, model)
    assert told(state, model).tag.tolist() == [0]


def test_labels_are_unique_and_rise():
    rng, model = np.random.default_rng(0), world(clutter=1e-9, birth=1e-9, survival=0.9)
    state, ever, ended = PMB().start(model, RNG), set(), set()
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


def scene(rng, frames: int, targets: int = 4, clutter: int = 3, detection: float = 0.85) -> list[np.ndarray]:
    """Targets that walk among false alarms."""
    start, velocity = rng.uniform([100, 80], [540, 400], (targets, 2)), rng.normal(0, 3, (targets, 2))
    scans = []
    for k in range(frames):
        here = (start + k * velocity + 3 * rng.standard_normal((targets, 2)))[rng.random(targets) < detection]
        scans.append(boxes(*here, *rng.uniform([0, 0], FRAME, (clutter, 2))))
    return scans


@pytest.mark.parametrize("transform", ["linear", "unscented"])
@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_the_detections_does_not_matter(seed: int, transform: str):
    """But for which labels are given; fused and not."""
    rng = np.random.default_rng(seed)
    model, scans = world(clutter=1e-9, birth=1e-9), scene(rng, 20)
    filter_ = PMB(transform=transform)
    mixed = [z[:, rng.permutation(z.shape[1])] for z in scans]
    (one, first), (two, second) = run(filter_, scans, model), run(filter_, mixed, model)
    assert first.mass == pytest.approx(second.mass, rel=1e-6)
    np.testing.assert_allclose(np.sort(first.clutter_probability), np.sort(second.clutter_probability), atol=1e-6)
    a, b = one.mixture(), two.mixture()
    assert len(a) == len(b) > 5
    order, other = np.argsort(a.weight), np.argsort(b.weight)
    np.testing.assert_allclose(a.weight[order], b.weight[other], rtol=1e-5, atol=1e-8)
    sure = a.weight[order] > 0.3
    np.testing.assert_allclose(a.mean[:, order][:, sure], b.mean[:, other][:, sure], rtol=1e-6, atol=1e-6)


def test_the_order_of_the_targets_does_not_matter():
    rng, model = np.random.default_rng(4), without_births(world(clutter=1e-8))
    mean = np.vstack([rng.uniform(250, 330, (2, 6)), rng.normal(0, 2, (2, 6)), np.full((1, 6), 40.0), np.full((1, 6), 80.0)])
    root = rng.normal(0, 3, (6, 6, 6)) * np.eye(6)
    cov, weight = root @ root.transpose(0, 2, 1) + 4 * np.eye(6), rng.uniform(0.1, 1, 6)
    z, order = boxes(*rng.uniform(250, 330, (7, 2))), rng.permutation(6)
    one, first = run(replace(PMB(), initial=GaussianMixture(weight, mean, cov)), [z, z + 1], model)
    given = GaussianMixture(weight[order], mean[:, order], cov[order])
    two, second = run(replace(PMB(), initial=given), [z, z + 1], model)
    assert first.mass == pytest.approx(second.mass, rel=1e-6)
    at = np.searchsorted(two.present.targets["label"], np.argsort(order)[one.present.targets["label"]])
    np.testing.assert_allclose(two.present.targets["r"][at], one.present.targets["r"], rtol=1e-5, atol=1e-9)


def seen_by_a_source(seed: int, frames: int = 150) -> list[np.ndarray]:
    """Half of the time something at one place, trembling a little."""
    rng = np.random.default_rng(seed)
    return [boxes(*rng.normal((300, 200), 2, (int(rng.random() < 0.5), 2))) for _ in range(frames)]


@pytest.mark.parametrize("seed", range(5))
def test_a_source_of_false_alarms_is_soon_not_reported(seed: int):
    """It fires half of the time in one place; three seconds later nobody is reported there for the three that follow."""
    model, filter_ = (
        world(detection=0.95, clutter=1e-9, birth=1e-10, survival=0.9999),
        PMB(mean_visible_time=4.0, mean_occluded_time=0.2),
    )
    state, reported = filter_.start(model, RNG), []
    for z in seen_by_a_source(seed):
        state, info = filter_.step(state, z, model, 1.0, RNG)
        reported.append(len(told(state, model)))
    assert sum(reported[75:]) == 0
    assert len(state) > 0, "it is still followed"
    assert state.present.hypotheses["static"].any()
    if z.shape[1]:
        assert info.clutter_probability[0] > 0.9


def test_who_walks_through_a_source_keeps_his_label():
    model, filter_ = (
        world(detection=0.95, clutter=1e-9, birth=1e-10, survival=0.9999),
        PMB(mean_visible_time=4.0, mean_occluded_time=0.2),
    )
    scans, rng = seen_by_a_source(7, 220), np.random.default_rng(7)
    path = walk((300 - 4 * 150, 200), (4, 0), 220, rng, 2.0)
    state, labels = filter_.start(model, RNG), []
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


@pytest.mark.parametrize(("seed", "share"), [(seed, share) for seed in range(5) for share in (1.0, 0.3)])
def test_a_person_who_stands_still_is_reported(seed: int, share: float):
    """Seen nine times of ten, with the noise that the sensor states or less; a source would be seen half of the time."""
    stages = config.build(config.load(sets=["filter.kind=pmb"]), SequenceInfo(640, 480, 25.0))
    rng, model, filter_ = np.random.default_rng(seed), stages.model, stages.filter
    state, reported = filter_.start(model, RNG), []
    x = np.array([[300.0], [200], [0], [0], [40], [100]])
    noise = share * np.sqrt(np.diag(model.sensor.covariance(x[[0, 1, 4, 5]], x)[0]))
    for _ in range(150):
        z = x[[0, 1, 4, 5]] + noise[:, None] * rng.standard_normal((4, 1))
        state, _ = filter_.step(state, z if rng.random() < 0.9 else z[:, :0], model, 1.0, RNG)
        found = told(state, model)
        reported.append(found.tag.tolist())
    assert np.mean([len(tags) == 1 for tags in reported[25:]]) > 0.97
    assert len({tags[0] for tags in reported[25:] if tags}) == 1


def test_the_past_that_is_kept_and_the_number_of_hypotheses_are_bounded():
    rng, model, sizes = np.random.default_rng(5), world(clutter=3e-9, birth=3e-9), []
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


def test_spawning_has_no_form():
    model = replace(world(), motion=BoxMotion(births=SplitSpawn(rate=0.1), frame_size=FRAME))
    state, _ = run(PMB(), [boxes((300, 200))], world())
    with pytest.raises(InputError, match="spawning"):
        PMB().step(state, boxes((301, 200)), model, 1.0, RNG)


@pytest.mark.parametrize(
    "wrong",
    [
        {"static_clutter_prior": 1.5},
        {"mean_occluded_time": 0.0},
        {"max_hypotheses": 0},
        {"mean_visible_time": -1.0},
        {"existence_threshold": 0.0},
    ],
)
def test_settings_out_of_bounds_are_refused(wrong: dict):
    with pytest.raises(InputError, match=next(iter(wrong))):
        PMB(**wrong)


def test_rare_births_among_much_clutter_are_seen_a_second_time():
    """A first detection is a new target's once in 10 000: less than ``least``, and yet who stays is found."""
    model, filter_ = world(clutter=1e-6, birth=1e-10), PMB(mean_visible_time=0.0, static_clutter_prior=0.0)
    state = filter_.start(model, RNG)
    for k in range(25):
        state, _ = filter_.step(state, boxes((100 + 2 * k, 200)), model, 1.0, RNG)
    assert told(state, model).tag.tolist() == [0]
    assert filter_.existence_threshold > 1e-4
