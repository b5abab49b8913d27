"""The learned rates in a model: what they replace, how scores enter the filters, states that are saved."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.counting_scene import Counting
from phdtrack import Tracker, config, pipeline
from phdtrack.errors import InputError
from phdtrack.filters import GMPHD, MHT, ParticlePHD
from phdtrack.models import FixedBirth, LocalClutter, ScoredClutter, UniformClutter
from phdtrack.models.learning import RatesState, with_clutter, with_detection
from phdtrack.scene.rates import ScoreScale
from phdtrack.simulate import DetectorModel, detect
from phdtrack.types import Detections, GaussianMixture, SequenceInfo

LEARNED = (
    "rates.kind=learned",
    "rates.cautious=false",
    *(f"rates.{name}=true" for name in ("detection", "clutter", "birth")),
)
INFO = SequenceInfo(640, 480, 25.0)
SIGMOID = ScoreScale(np.array([0.2, 0.8]), np.log([0.1, 10.0]))


def stages(*sets, filter_name="gm-phd"):
    return config.build(config.load(None, (*LEARNED, *sets)), INFO, filter_name)


def boxes(n, rng):
    corner = rng.uniform(50, 350, (n, 2))
    return np.hstack([corner, corner + rng.uniform(20, 60, (n, 2))])


def knowing(built, scale=SIGMOID, **rates):
    """The learning's state with these rates and this scale."""
    state = built.learning.start()
    learned = replace(state.learned, scale=scale, rates=replace(state.learned.rates, **rates))
    return RatesState(learned, state.other)


def test_nothing_known_leaves_the_model_as_it_is():
    built = stages()
    state = built.learning.start()
    model = built.learning.model(state, built.model)
    assert (model.sensor, model.birth, model.clutter) == (built.model.sensor, built.model.birth, built.model.clutter)
    assert built.learning.with_scores(state, model, Detections.of(boxes(3, np.random.default_rng(0)))) is model


def test_rates_replace_those_of_the_model_in_steps():
    built = stages()
    model = built.learning.model(knowing(built, detection=0.9312, clutter=0.7, births=0.003), built.model)
    assert model.sensor.detection_probability == pytest.approx(0.93)
    assert model.clutter.clutter_per_frame == pytest.approx(0.7, rel=0.03)
    assert model.birth.births_per_second == pytest.approx(25 * 0.003, rel=0.03)
    again = built.learning.model(knowing(built, detection=0.9308, clutter=0.7001, births=0.003), built.model)
    assert again.sensor is model.sensor
    assert again.clutter is model.clutter
    assert again.birth is model.birth


def test_parts_of_another_kind_stay():
    """Births at given places have no rate that is learned, nor have a sensor and false alarms of a user's own."""
    built, own = stages(), object()
    given = FixedBirth(GaussianMixture(np.ones(1), np.zeros((6, 1)), np.eye(6)[None]))
    model = replace(built.model, birth=given, sensor=own, clutter=own)
    assert with_detection(model, 0.5).sensor is own
    assert with_clutter(model, 0.5).clutter is own
    learned = built.learning.model(knowing(built, births=0.003), replace(built.model, birth=given))
    assert learned.birth is given


@pytest.mark.parametrize("volume", ["image", "local"])
def test_odds_divide_the_false_alarms(volume):
    built = stages(f"clutter.volume={volume}")
    rng = np.random.default_rng(1)
    found = Detections.of(boxes(4, rng), [0.1, 0.5, 0.9, np.nan])
    model = built.learning.with_scores(knowing(built), built.model, found)
    z = model.sensor.measure(found)
    plain = built.model.clutter.intensity(z)
    assert model.clutter.intensity(z) == pytest.approx(plain / np.array([0.1, 1.0, 10.0, 1.0]))
    with pytest.raises(InputError, match="expected the 4 detections"):
        model.clutter.intensity(z[:, :2])


@pytest.mark.parametrize("base", [UniformClutter(3.0, 1e11), LocalClutter(0.3)])
def test_the_fused_gaussian_filter_computes_what_its_definition_does_with_scores(base):
    rng = np.random.default_rng(2)
    built, recursion = stages(), GMPHD()
    state = recursion.start(built.model, rng)
    for _ in range(6):
        z = built.model.sensor.measure(Detections.of(boxes(8, np.random.default_rng(3)) + rng.normal(size=(8, 4))))
        model = replace(built.model, clutter=ScoredClutter(base, rng.uniform(0.05, 20, 8)))
        predicted = recursion.predict(state, model, 1.0, rng)
        slow, expected = recursion.update(predicted, z, model, 1.0, rng)
        state, info = recursion.step(state, z, model, 1.0, rng)
        assert info.clutter == pytest.approx(model.clutter.intensity(z))
        assert info.evidence == pytest.approx(expected.evidence)
        assert info.mass == pytest.approx(slow.mass)


@pytest.mark.parametrize("recursion", [GMPHD(), MHT(), ParticlePHD(400)])
def test_a_low_score_confirms_but_starts_nobody(recursion):
    """One detection each of a new place, scored low and high, and a second low one of somebody believed."""
    built, rng = stages(), np.random.default_rng(4)
    box = np.array([[100.0, 100, 130, 180]])

    def mass(scores):
        state = recursion.start(built.model, rng)
        for score in scores:
            found = Detections.of(box, [score])
            model = built.learning.with_scores(knowing(built), built.model, found)
            state, info = recursion.step(state, model.sensor.measure(found), model, 1.0, rng)
        return info.mass

    assert mass([0.1]) < 0.2 * mass([0.9]) < 0.2
    assert mass([0.9, 0.9, 0.9, 0.1]) > 0.9


def test_a_saved_tracker_goes_on_bit_by_bit():
    scene = Counting(6, frames=80)
    rng = np.random.default_rng(5)
    found = detect(scene.figures(rng), scene.info, rng, DetectorModel(p_detect=0.8, scores="informative")).table
    size = (scene.width, scene.height)
    whole, first, second = (
        Tracker(size, filter="gm-phd", rates={"kind": "learned", "detection": True, "clutter": True}) for _ in range(3)
    )
    for number in range(1, 81):
        rows = whole.update(found.at(number))
        if number <= 50:
            first.update(found.at(number))
            if number == 50:
                second.load_state_dict(first.state_dict())
        else:
            assert np.array_equal(second.update(found.at(number)).xyxy, rows.xyxy)
    assert whole.rates == second.rates
    assert whole.rates.time > 2.5
    assert Tracker(size, filter="gm-phd", rates={"kind": "none"}).rates is None


def test_frames_that_nobody_saw_teach_nothing():
    built, rng = stages(), np.random.default_rng(6)
    state = pipeline.start(built, rng)
    for number in range(1, 60):
        state, _ = pipeline.advance(built, state, Detections.empty(observed=False), number, number / 25, rng)
    learned = state.learned.learned
    assert learned.sums.frames == 0
    assert not learned.pending.frames
    assert learned.rates.detection == built.model.sensor.detection_probability


def test_rates_and_a_scene_are_learned_beside_each_other():
    built, rng = stages("learn.kind=online"), np.random.default_rng(7)
    state = pipeline.start(built, rng)
    place = boxes(5, rng)
    for number in range(1, 120):
        found = Detections.of(place + rng.normal(size=(5, 4)), rng.random(5))
        state, _ = pipeline.advance(built, state, found, number, number / 25, rng)
    assert state.learned.other.known.last is not None
    assert state.learned.learned.sums.frames > 0


def test_as_shipped_estimates_are_made_and_scores_are_used():
    built = config.build(config.load(None, ("rates.kind=learned",)), INFO, "gm-phd")
    state = knowing(built, detection=0.6, clutter=0.9, births=0.002)
    assert built.learning.model(state, built.model).sensor == built.model.sensor
    found = Detections.of(boxes(2, np.random.default_rng(8)), [0.1, 0.9])
    assert isinstance(built.learning.with_scores(state, built.model, found).clutter, ScoredClutter)


def test_cautious_estimates_are_used_where_nothing_else_explains_them():
    built = stages("rates.cautious=true")
    set_to, rates = built.model, built.learning.start().learned.rates
    higher, lower = {"detection": 0.95, "clutter": 0.05, "births": 1e-4}, {"detection": 0.6, "clutter": 0.9, "births": 0.05}
    model = built.learning.model(knowing(built, **higher), set_to)
    assert (
        model.sensor.detection_probability,
        model.clutter.clutter_per_frame,
        model.birth.births_per_second,
    ) == pytest.approx((rates.detection, rates.clutter, 25 * rates.births))
    model = built.learning.model(knowing(built, **lower), set_to)
    assert model.sensor.detection_probability == pytest.approx(0.6)
    assert (model.clutter.clutter_per_frame, model.birth.births_per_second) == pytest.approx((0.9, 25 * 0.05), rel=0.03)


def test_there_are_no_more_false_alarms_than_detections():
    built = stages("clutter.volume=image", "clutter.clutter_per_frame=90.0")
    state = built.learning.start()
    model = built.learning.model(state, built.model)
    assert model.clutter.clutter_per_frame == 90
    seven = built.learning.with_scores(state, model, Detections.of(boxes(7, np.random.default_rng(9))))
    assert seven.clutter.clutter_per_frame == pytest.approx(7, rel=0.03)
    many = built.learning.with_scores(state, model, Detections.of(boxes(200, np.random.default_rng(9))))
    assert many.clutter.clutter_per_frame == 90
    cautious = stages("clutter.volume=image", "clutter.clutter_per_frame=90.0", "rates.cautious=true")
    assert cautious.learning.with_scores(state, model, Detections.of(boxes(7, np.random.default_rng(9)))) is model
