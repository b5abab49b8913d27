"""The learned rates in a model: what they replace; near the truth."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.counting_scene import Counting
from experiments.learned_rates import RateLearning, RatesLearning, RatesSettings, priors_of
from phdtrack import config, pipeline
from phdtrack.simulate import DetectorModel, detect
from phdtrack.types import Detections, SequenceInfo

FRAMES = 300
INFO = SequenceInfo(640, 480, 25.0)


def stages(*sets, filter_name="gm-phd", info=INFO, **rates):
    """The stages of the filter, with p_D and false alarms learned."""
    built = config.build(
        config.load(None, ("detection_scores.kind=none", *sets)), info, filter_name
    )
    settings = RatesSettings(**{"detection": True, "clutter": True, "cautious": False} | rates)
    learning = RateLearning(RatesLearning(settings, priors_of(built.model), settings.verdict_delay))
    return replace(built, detection_scores=learning)


def boxes(n, rng):
    corner = rng.uniform(50, 350, (n, 2))
    return np.hstack([corner, corner + rng.uniform(20, 60, (n, 2))])


def knowing(built, **rates):
    """The learning's state with these rates."""
    state = built.detection_scores.start()
    return replace(state, rates=replace(state.rates, **rates))


def test_nothing_known_leaves_the_model_as_it_is():
    built = stages()
    state = built.detection_scores.start()
    model = built.detection_scores.model(state, built.model)
    assert (model.sensor, model.birth, model.clutter) == (
        built.model.sensor,
        built.model.birth,
        built.model.clutter,
    )
    assert (
        built.detection_scores.with_scores(
            state, model, Detections.of(boxes(3, np.random.default_rng(0)))
        )
        is model
    )


def test_rates_replace_those_of_the_model_in_steps():
    built = stages()
    model = built.detection_scores.model(knowing(built, detection=0.9312, clutter=0.7), built.model)
    assert model.sensor.detection_probability == pytest.approx(0.93)
    assert model.clutter.clutter_per_detection == pytest.approx(0.7, rel=0.03)
    again = built.detection_scores.model(
        knowing(built, detection=0.9308, clutter=0.7001), built.model
    )
    assert again.sensor is model.sensor
    assert again.clutter is model.clutter


def test_frames_that_nobody_saw_teach_nothing():
    built = stages()
    rng = np.random.default_rng(6)
    state = pipeline.start(built, rng)
    for number in range(1, 60):
        state, _ = pipeline.advance(
            built, state, Detections.empty(observed=False), number, number / 25, rng
        )
    learned = state.detection_scores
    assert learned.sums.frames == 0
    assert not learned.pending.frames
    assert learned.rates.detection == built.model.sensor.detection_probability


def test_cautious_estimates_are_used_without_other_explanation():
    built = stages(cautious=True)
    set_to = built.model
    rates = built.detection_scores.start().rates
    higher = {"detection": 0.95, "clutter": 0.05}
    lower = {"detection": 0.6, "clutter": 0.9}
    model = built.detection_scores.model(knowing(built, **higher), set_to)
    found = model.sensor.detection_probability, model.clutter.clutter_per_detection
    assert found == pytest.approx((rates.detection, rates.clutter))
    model = built.detection_scores.model(knowing(built, **lower), set_to)
    assert model.sensor.detection_probability == pytest.approx(0.6)
    assert model.clutter.clutter_per_detection == pytest.approx(0.9, rel=0.03)


def test_there_are_no_more_false_alarms_than_detections():
    built = stages("clutter.clutter_per_frame=90.0")
    state = built.detection_scores.start()
    model = built.detection_scores.model(state, built.model)
    assert model.clutter.clutter_per_frame == 90
    seven = built.detection_scores.with_scores(
        state, model, Detections.of(boxes(7, np.random.default_rng(9)))
    )
    assert seven.clutter.clutter_per_frame == pytest.approx(7, rel=0.03)
    many = built.detection_scores.with_scores(
        state, model, Detections.of(boxes(200, np.random.default_rng(9)))
    )
    assert many.clutter.clutter_per_frame == 90
    cautious = stages("clutter.clutter_per_frame=90.0", cautious=True)
    assert (
        cautious.detection_scores.with_scores(
            state, model, Detections.of(boxes(7, np.random.default_rng(9)))
        )
        is model
    )


# Learned on simulated truth, from the defaults on


def course(filter_name, seed, sets=(), frames=FRAMES, interval=1.0, **detector):
    """The rates frame by frame, detections a frame, and the state at the end."""
    scene = Counting(
        10, frames=frames, sd_velocity=0.01, sd_size=0.03, p_survive=0.997, leaving=True
    )
    rng = np.random.default_rng(seed)
    truth = scene.figures(rng)
    found = detect(truth, scene.info, rng, DetectorModel(**detector)).table
    built = stages(*sets, filter_name=filter_name, info=scene.info, update_interval=interval)
    state = pipeline.start(built, rng)
    rates = []
    for number in range(1, frames + 1):
        state, _ = pipeline.advance(
            built, state, found.at(number), number, (number - 1) / scene.fps, rng
        )
        rates.append(state.detection_scores.rates)
    return rates, len(found) / frames, state.detection_scores


@pytest.mark.parametrize(
    "p_detect",
    [
        0.5,
        pytest.param(0.7, marks=pytest.mark.slow),
        pytest.param(0.9, marks=pytest.mark.slow),
        0.98,
    ],
)
@pytest.mark.parametrize("clutter", [0.0, 20.0])
def test_detection_and_clutter_converge_from_the_defaults(p_detect, clutter):
    ends = []
    alarms = []
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
    found = [
        course(filter_name, seed, frames=200, p_detect=0.65, clutter_rate=5.0) for seed in (1, 2)
    ]
    assert np.mean([rates[-1].detection for rates, _, _ in found]) == pytest.approx(0.65, abs=0.05)
    assert np.mean([rates[-1].clutter * detected for rates, detected, _ in found]) == pytest.approx(
        5, abs=0.8
    )


@pytest.mark.parametrize("wrong", [0.5, 40.0])
def test_a_rate_that_is_far_off_is_mended_within_two_seconds(wrong):
    sets = ("birth.births_per_second=0.125", f"clutter.clutter_per_frame={wrong}")
    for seed in (1, 2):
        rates, _, _ = course(
            "gm-phd", seed, sets, frames=60, interval=0.4, p_detect=0.9, clutter_rate=5.0
        )
        assert rates[50].clutter == pytest.approx(5, rel=0.35)
