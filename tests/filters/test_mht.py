"""Multiple hypothesis tracking: Kalman filters where nothing is in doubt, hypotheses where
something is, and bounds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mht_cases import RNG, boxes, histories, run, scene, told, walk, world

from phdtrack import config
from phdtrack.filters import MHT
from phdtrack.models import BoxClutter, MeasurementBirth
from phdtrack.types import SequenceInfo
from reference.gm_twin import corrected


@pytest.mark.parametrize("transform", ["linear", "unscented"])
@pytest.mark.parametrize("dt", [1.0, 2.5])
def test_on_clean_data_it_is_a_kalman_filter_for_each_target(transform: str, dt: float):
    """Three targets far apart, always seen, nothing else; states and covariances of every frame,
    also as told later.
    """
    model = world(detection=0.999, clutter=1e-14, survival=0.999, birth=0.5)
    rng = np.random.default_rng(3)
    paths = [
        walk(start, v, 25, rng, 2.0)
        for start, v in (((150, 100), (3, 1)), ((450, 150), (-2, 2)), ((300, 400), (0, -3)))
    ]
    scans = [boxes(*(path[k] for path in paths)) for k in range(25)]
    state, info = run(MHT(transform=transform), scans, model, dt)
    found = told(state, model)
    assert len(found) == 3
    assert info.mass == pytest.approx(3, abs=1e-3)
    assert found.detection.tolist() == [0, 1, 2]
    h = np.eye(6)[[0, 1, 4, 5]]
    births = model.birth.places
    for j in range(3):
        mean = births.mean[:, 0]
        cov = births.covariance[0]
        means = []
        for k, z in enumerate(scans):
            if k:
                moved, f, q = model.motion.transition(mean[:, None], dt)
                mean = moved[:, 0]
                cov = f[0] @ cov @ f[0].T + q[0]
            mean, cov, _ = corrected(mean, cov, z[:, j], h, 16 * np.eye(4))
            means.append(mean)
        np.testing.assert_allclose(found.state[:, j], mean, rtol=0, atol=1e-9 * 640)
        np.testing.assert_allclose(found.covariance[j], cov, rtol=1e-9, atol=1e-9)
        assert len(found.past) == 10
        for past, mean in zip(found.past, means[-11:-1], strict=True):
            np.testing.assert_allclose(past.state[:, j], mean, rtol=0, atol=1e-9 * 640)
            assert past.tag.tolist() == found.tag.tolist()


def test_two_that_cross_keep_their_labels():
    model = world(detection=0.95)
    rng = np.random.default_rng(1)
    paths = walk((150, 180), (8, 1), 40, rng, 2.0), walk((470, 200), (-8, 0.5), 40, rng, 2.0)
    state = MHT().start(model, RNG)
    labels = []
    for k in range(40):
        state, _ = MHT().step(state, boxes(paths[0][k], paths[1][k]), model, 1.0, RNG)
        labels.append(told(state, model))
    early = labels[10]
    late = labels[-1]
    assert len(early) == len(late) == 2
    for found, k in ((early, 10), (late, 39)):
        right = found.tag[np.argmin(np.abs(found.state[0] - paths[0][k][0]))]
        assert right == early.tag[np.argmin(np.abs(early.state[0] - paths[0][10][0]))]


def test_one_that_is_hidden_for_some_frames_comes_back_as_itself():
    model = world(detection=0.8, survival=0.99)
    path = walk((200, 200), (5, 2), 30, np.random.default_rng(2), 2.0)
    state = MHT().start(model, RNG)
    weights = []
    tags = []
    for k in range(30):
        z = boxes() if 15 <= k < 20 else boxes(path[k])
        state, info = MHT().step(state, z, model, 1.0, RNG)
        assert info.evidence.shape == (z.shape[1],)
        found = told(state, model)
        weights.append(float(found.weight[0]) if len(found) else 0.0)
        tags.extend(found.tag.tolist())
    assert len(set(tags)) == 1
    # Of it alone: r p_S (1 − p_D) / (1 − r p_S p_D).
    kept = 1.0
    for k in range(15, 18):
        kept = 0.99 * kept * 0.2 / (1 - 0.99 * kept * 0.8)
        assert weights[k] == pytest.approx(kept if kept >= 0.5 else 0.0, rel=1e-2)
    assert weights[20] > 0.9


def test_what_was_wrong_is_told_anew():
    """A false alarm lies nearer to where the target is expected; the frames after it show who the
    target was.
    """
    model = world(detection=0.9, clutter=1e-8, survival=0.99)
    path = walk((200, 200), (0, 0), 16)
    path[8:] += np.arange(1, 9)[:, None] * [9.0, 0.0]
    scans = [boxes(here) for here in path]
    scans[8] = boxes(path[8], path[7] + [-1.0, 0.0])
    first, _ = run(MHT(), scans[:9], model)
    last, _ = run(MHT(), scans[:13], model)
    before = told(first, model)
    after = told(last, model)
    assert before.detection.tolist() == [1]
    assert [e.detection.tolist() for e in after.past[-5:]] == [[0]] * 5
    assert set(after.tag) == set(before.tag)


def test_an_ended_track_is_still_told_of_where_it_was():
    """After three misses the target does not exist; the frames before show it as long as they are
    reported.
    """
    model = world(detection=0.9, survival=0.9)
    path = walk((200, 200), (2, 2), 12)
    scans = [boxes(here) for here in path] + [boxes()] * 12
    for n in range(13, 25):
        found = told(run(MHT(), scans[:n], model)[0], model)
        seen = [e.detection.tolist() for e in found.past if len(e) and e.detection[0] >= 0]
        assert len(seen) == max(0, 10 - (n - 13))
    assert len(run(MHT(), scans, model)[0]) == 0, "and then forgotten"


@pytest.mark.parametrize("depth", [1, 4])
def test_what_is_older_than_the_depth_is_decided(depth: int):
    model = world(clutter=3e-8)
    rng = np.random.default_rng(5)
    filter_ = MHT(history=depth)
    state = MHT().start(world(), RNG)
    doubted = 0
    for z in scene(rng, 25, targets=6):
        state, _ = filter_.step(state, z, model, 1.0, RNG)
        assert len(state.layers) <= depth + 1
        doubted += len(state.clusters)
        past = histories(state)
        first = len(state.layers) == depth + 1
        for cluster in state.clusters:
            assert (np.diff(cluster.weight) <= 1e-12).all()
            assert cluster.weight.sum() == pytest.approx(1)
            assert cluster.weight[-1] >= 0.99e-3 * cluster.weight[0]
            for row in cluster.leaf.T if first else ():
                oldest = {
                    tuple(one for one in past[leaf] if one[0] == -1) for leaf in row if leaf >= 0
                }
                assert len(oldest) <= 1
    assert doubted > 20


def test_survival_falls_with_the_frames_missed_in_a_row():
    """λ_x: e^(−k/λ_x) of those missed k times in a row."""
    model = world(detection=0.5, survival=0.9)
    filter_ = MHT(termination_frames=4.0)
    state, _ = run(filter_, [boxes((200 + 2 * k, 200)) for k in range(8)], model)
    for k in (1, 2, 3):
        before = state.mass
        state = filter_.predict(state, model, 1.0, RNG)
        assert state.mass == pytest.approx(before * np.exp(-k / 4), rel=1e-9)


def test_fifty_false_alarms_a_frame_are_bounded():
    """Nodes, hypotheses and clusters stop growing after as many frames as the past is long."""
    stages = config.build(config.load(sets=["filter.kind=mht"]), SequenceInfo(1280, 720, 25.0))
    state = stages.filter.start(stages.model, RNG)
    sizes = []
    for z in scene(np.random.default_rng(1), 60, 10, 50, 0.9, (1280.0, 720.0)):
        state, _ = stages.filter.step(state, z, stages.model, 1.0, RNG)
        hypotheses = [len(c.weight) for c in state.clusters]
        assert max(hypotheses, default=0) <= 300
        sizes.append([len(state), sum(len(layer) for layer in state.layers), sum(hypotheses)])
    sizes = np.array(sizes)
    # About a leaf for each false alarm of the window; twice that as nodes of each layer.
    assert sizes[:, 0].max() < 11 * 60 * 2
    assert sizes[:, 1].max() < 11 * 11 * 60 * 3
    assert (sizes[40:].max(0) < 1.3 * sizes[20:40].max(0)).all()
    assert sizes[40:, 2].max() < 2000
    assert len(told(state, stages.model)) == pytest.approx(10, abs=2)


def test_overlapping_targets_are_told_of_once():
    """A detector that fires twice on one object: the track that began first is its."""
    birth = MeasurementBirth(births_per_detection=25 * 0.1, particles=100)
    model = replace(world(detection=0.95, survival=0.99), birth=birth, clutter=BoxClutter(0.1))
    scans = [
        boxes((200 + k, 200)) if k < 5 else boxes((206 + k, 203), (200 + k, 200)) for k in range(15)
    ]
    state, _ = run(MHT(), scans, model)
    assert len(told(state, model)) == 2
    once = told(state, model, 0.4)
    assert len(once) == 1
    assert once.tag[0] == told(run(MHT(), scans[:5], model)[0], model).tag[0]
    assert all(len(e) == 1 for e in once.past)
