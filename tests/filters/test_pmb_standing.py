"""Targets that stand still and static clutter in the PMB filter: their odds, when they begin to
move, which are reported; the p_D that is learned.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mht_cases import RNG, boxes, run, walk
from pmb_cases import EVERYTHING, pasts, without_births, world

from phdtrack import Tracker
from phdtrack.filters import PMB, pmb

# Static clutter is one of four first detections, and is detected half as often as targets.
STILL = replace(
    EVERYTHING,
    mean_visible_time=0.0,
    static_clutter_prior=0.25,
    static_clutter_detection_probability=0.4,
)
SENSOR = 0.8


def still(frames: int) -> tuple:
    """A box in one place, and the filter's state after each frame."""
    model = world(detection=SENSOR, survival=1.0)
    state, _ = run(STILL, [boxes((300, 200))], model)
    model = without_births(model)
    states = [state]
    for k in range(frames):
        z = boxes((300, 200)) if k % 3 else boxes()
        states.append(STILL.step(states[-1], z, model, 1.0, RNG)[0])
    return model, states


def test_detections_and_misses_change_odds_of_standing(monkeypatch):
    """A detection doubles the odds 0.05·0.75/0.25, as 0.8/0.4; a miss takes two thirds, as 0.2/0.6.

    The odds with which it moves do not change.
    """
    monkeypatch.setattr(pmb, "MEAN_STANDING_TIME", np.inf)
    _, states = still(4)
    for k, odds in enumerate([0.15, 0.05, 0.1, 0.2, 0.2 / 3]):
        h = states[k].present.hypotheses
        seen = (0, *(0 if j % 3 else -1 for j in range(k)))
        (own,) = (i for i, past in enumerate(pasts(states[k])) if past == seen and h["static"][i])
        assert h["genuine"][own] == pytest.approx(np.log(odds), rel=1e-9)
        moving = h["static"] == 0
        assert (h["genuine"][moving] == pmb.CERTAIN).all()


def test_odds_of_standing_are_bounded(monkeypatch):
    """Evidence that can change again counts for e⁸ at most, however long it lasts."""
    monkeypatch.setattr(pmb, "MEAN_STANDING_TIME", np.inf)
    model = world(detection=SENSOR, survival=1.0)
    filter_ = replace(STILL, hypothesis_threshold=1e-6, max_hypotheses=10, merge_distance=0.1)
    for z, bound in ((boxes((300, 200)), 8.0), (boxes(), -8.0)):
        state, _ = run(filter_, [boxes((300, 200))] * 3, model)
        for _ in range(20):
            state = filter_.step(state, z, without_births(model), 1.0, RNG)[0]
            h = state.present.hypotheses
            assert (abs(h["genuine"][h["static"] == 1]) <= 8.0).all()
        assert h["genuine"][h["static"] == 1][0] == bound


@pytest.mark.parametrize("seconds", [0.04, 1.0, 5.0, 1000.0])
def test_targets_begin_to_move_with_all_their_weight(seconds: float):
    """The part 1 − exp(−T/2 s) of standing targets goes to what moves, in proportion; static
    clutter stays, and so do the total weight and the presence. What stands still is then less
    likely a target, but never less than e⁻⁸.
    """
    model, states = still(3)
    before = states[-1]
    after = STILL.predict(before, model, 25 * seconds, RNG).present
    old = before.present.hypotheses
    new = after.hypotheses
    static = old["static"] == 1
    odds = np.exp(old["genuine"])
    real = np.where(static, odds / (1 + odds), 1.0)
    stays = np.exp(-seconds / 2)
    left = old["weight"] * (1 - real * (1 - stays))
    gained = old["weight"] * (
        1 + (old["weight"] - left)[static].sum() / old["weight"][~static].sum()
    )
    assert static.any()
    np.testing.assert_allclose(new["weight"], np.where(static, left, gained), rtol=1e-9)
    assert new["weight"].sum() == pytest.approx(1, abs=1e-12)
    expected = np.maximum(np.log(odds[static]) - seconds / 2, -8)
    np.testing.assert_allclose(new["genuine"][static], expected, 1e-9)
    assert after.targets["presence"].sum() == pytest.approx(before.mass, rel=1e-3)


@pytest.mark.parametrize("p_detect", [0.5, 0.95])
def test_detection_probability_is_learned(p_detect: float):
    """Four targets, 400 frames: within four standard errors, besides what the sensor's 0.9 pulls,
    which counts for 30 of 1600 chances. The update takes it up to the sensor's.
    """
    rng = np.random.default_rng(0)
    model = world(detection=0.9, survival=0.9999, clutter=1e-10, birth=1e-10)
    filter_ = replace(PMB(), mean_visible_time=0.0, lasting_clutter_prior=0.0, detection_memory=1e9)
    paths = [walk((300 * k, 300 * k), (2, -1), 400, rng) for k in range(4)]
    state = filter_.start(model, RNG)
    expected = []
    for k in range(400):
        here = [path[k] for path in paths if rng.random() < p_detect]
        state, info = filter_.step(state, boxes(*here), model, 1.0, RNG)
        expected.append(info.detected)
    hits, chances, by_sensor = state.detections
    assert chances == pytest.approx(1600, rel=0.05)
    assert by_sensor == pytest.approx(0.9 * chances, rel=1e-9)
    error = 4 * np.sqrt(p_detect * (1 - p_detect) / 1600)
    assert abs(hits / chances - p_detect) < error
    pull = 30 / 1630 * abs(0.9 - p_detect)
    assert np.mean(expected[-50:]) / 4 == pytest.approx(min(p_detect, 0.9), abs=error + pull)


@pytest.mark.parametrize("fps", [1.0, 5.0, 10.0, 25.0])
def test_parked_box_is_reported_within_four_detections(fps: float):
    rng = np.random.default_rng(1)
    tracker = Tracker((1280, 720), fps=fps)
    shown = []
    for _ in range(30):
        box = np.array([[600.0, 300, 700, 380]]) + rng.normal(0, 1, (1, 4))
        tracker.update(box)
        shown.append(len(tracker.step.estimates))
    assert all(count == 1 for count in shown[3:])


@pytest.mark.parametrize("seed", range(3))
def test_place_that_fires_half_of_the_time_is_not_reported(seed: int):
    """Beside targets of p_D 0.9 that move, in most of the frames after the first two seconds."""
    rng = np.random.default_rng(seed)
    tracker = Tracker((1280, 720), fps=25.0)
    reported = []
    for k in range(250):
        corners = [[50 + 4 * k, y] for y in (50, 250, 450) if rng.random() < 0.9]
        if rng.random() < 0.5:
            corners.append([900, 600])
        corner = np.array(corners, float).reshape(-1, 2)
        box = np.hstack([corner, corner + np.array([40, 80])])
        tracker.update(box + rng.normal(0, 1, box.shape))
        away = abs(tracker.step.estimates.xyxy[:, :2] - [900, 600]).max(axis=1)
        reported.append((away < 30).any())
    assert np.mean(reported[50:]) < 0.1
    assert len(tracker.step.estimates) == 3


@pytest.mark.parametrize("speed", [200.0, 400.0, 600.0])
def test_target_that_bounces_keeps_its_identity(speed: float):
    """A box between two walls, turned at once from one frame to the next."""
    rng = np.random.default_rng(0)
    tracker = Tracker((1280, 720), fps=25.0)
    x = 200.0
    step = speed / 25
    shown = []
    for _ in range(200):
        if not 150 < x + step < 1000:
            step = -step
        x += step
        tracker.update(np.array([[x, 300, x + 60, 360]]) + rng.normal(0, 1, (1, 4)))
        shown.append(tracker.step.estimates.tag.tolist())
    assert all(tags == [0] for tags in shown[5:])
    assert set(tracker.tracks().identity) == {1}


@pytest.mark.parametrize("speed", [250.0, 500.0, 750.0, 1000.0, 1500.0, 2500.0])
def test_fast_target_is_found_by_its_fifth_detection(speed: float):
    """Alone in the picture, with boxes of 60 pixels."""
    rng = np.random.default_rng(0)
    tracker = Tracker((3840, 2160), fps=25.0)
    shown = []
    for k in range(20):
        x = 50 + k * speed / 25
        tracker.update(np.array([[x, 300, x + 60, 360]]) + rng.normal(0, 1, (1, 4)))
        shown.append(len(tracker.step.estimates))
    assert all(count == 1 for count in shown[4:])


@pytest.mark.parametrize("kind", ["gm-phd", "mht"])
def test_other_filters_follow_fast_targets_if_told_so(kind: str):
    """1000 pixels a second: the box never overlaps its next one."""
    shown = {}
    for speed in (0.1, 0.4):
        rng = np.random.default_rng(0)
        tracker = Tracker((3840, 2160), fps=25.0, filter=kind, sensor={"birth_speed": speed})
        shown[speed] = 0
        for k in range(40):
            box = np.array([[50.0 + 40 * k, 300, 110 + 40 * k, 360]]) + rng.normal(0, 1, (1, 4))
            shown[speed] += len(tracker.update(box))
    assert shown[0.4] >= 30
    assert shown[0.1] <= 10
