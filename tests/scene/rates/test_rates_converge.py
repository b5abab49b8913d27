"""Rates learned on simulated truth, from the defaults on: near it, whatever it is, with every filter."""

import numpy as np
import pytest

from experiments.counting_scene import Counting
from phdtrack import config, pipeline
from phdtrack.simulate import DetectorModel, detect

FRAMES = 300
LEARNED = (
    "rates.kind=learned",
    "rates.cautious=false",
    *(f"rates.{name}=true" for name in ("detection", "clutter", "birth")),
)


def course(filter_name, seed, sets=(), frames=FRAMES, **detector):
    """The rates frame by frame, detections a frame, and the state at the end."""
    scene = Counting(10, frames=frames, sd_velocity=0.01, sd_size=0.03, p_survive=0.997, leaving=True)
    rng = np.random.default_rng(seed)
    truth = scene.figures(rng)
    found = detect(truth, scene.info, rng, DetectorModel(**detector)).table
    stages = config.build(config.load(None, (*LEARNED, *sets)), scene.info, filter_name)
    state, rates = pipeline.start(stages, rng), []
    for number in range(1, frames + 1):
        state, _ = pipeline.advance(stages, state, found.at(number), number, (number - 1) / scene.fps, rng)
        rates.append(state.learned.learned.rates)
    return rates, len(found) / frames, state.learned.learned


@pytest.mark.parametrize("p_detect", [0.5, 0.7, 0.9, 0.98])
@pytest.mark.parametrize("clutter", [0.0, 20.0])
def test_detection_and_clutter_converge_from_the_defaults(p_detect, clutter):
    ends, alarms = [], []
    for seed in (1, 2, 3):
        rates, detected, _ = course("gm-phd", seed, p_detect=p_detect, clutter_rate=clutter)
        ends.append(rates[-1].detection)
        alarms.append(rates[-1].clutter * detected)
        # Once it is near it stays there: no filter talks itself into another p_D.
        assert np.ptp([r.detection for r in rates[FRAMES // 2 :]]) < 0.06
    assert np.mean(ends) == pytest.approx(p_detect, abs=0.03)
    assert np.mean(alarms) == pytest.approx(clutter, rel=0.06, abs=0.4)


@pytest.mark.parametrize("filter_name", ["particle-phd", "mht"])
def test_other_filters_learn_the_same(filter_name):
    found = [course(filter_name, seed, frames=200, p_detect=0.65, clutter_rate=5.0) for seed in (1, 2)]
    assert np.mean([rates[-1].detection for rates, _, _ in found]) == pytest.approx(0.65, abs=0.05)
    assert np.mean([rates[-1].clutter * detected for rates, detected, _ in found]) == pytest.approx(5, abs=0.8)


@pytest.mark.parametrize("wrong", [0.5, 40.0])
def test_a_rate_that_is_far_off_is_mended_within_two_seconds(wrong):
    sets = ("clutter.volume=image", "birth.volume=image", f"clutter.clutter_per_frame={wrong}", "rates.update_interval=0.4")
    for seed in (1, 2):
        rates, _, _ = course("gm-phd", seed, sets, frames=60, p_detect=0.9, clutter_rate=5.0)
        assert rates[50].clutter == pytest.approx(5, rel=0.35)


def test_scores_that_tell_objects_from_false_alarms_are_found_to():
    _, _, learned = course("gm-phd", 1, p_detect=0.8, clutter_rate=10.0, scores="informative")
    # Beta(6, 2) against Beta(2, 4): the ratio is 2.1 s⁴/(1 − s)².
    at = np.array([0.35, 0.5, 0.65])
    assert np.log(learned.scale.ratio(at)) == pytest.approx(np.log(2.1 * at**4 / (1 - at) ** 2), abs=1.0)
    _, _, constant_ones = course("gm-phd", 1, frames=100, p_detect=0.8, clutter_rate=10.0)
    assert len(constant_ones.scale.at) == 0


def test_what_is_fixed_stays():
    sets = ("rates.detection=false", "sensor.detection_probability=0.6", "rates.birth=false")
    rng = np.random.default_rng(0)
    info = Counting(10).info
    stages = config.build(config.load(None, (*LEARNED, *sets)), info, "gm-phd")
    _, _, learned = course("gm-phd", 1, sets, frames=100, p_detect=0.95, clutter_rate=10.0)
    state = pipeline.start(stages, rng).learned
    model = stages.learning.model(type(state)(learned), stages.model)
    assert (model.sensor, model.birth) == (stages.model.sensor, stages.model.birth)
    assert learned.rates.detection > 0.7
    assert model.clutter.clutter_per_frame != stages.model.clutter.clutter_per_frame
