"""A learned scene laid over the shipped births and false alarms: where nothing is known it is the shipped model."""

from dataclasses import replace

import numpy as np
import pytest

from phdtrack import config
from phdtrack.filters import GMPHD, PMB
from phdtrack.filters.composed import composed_step
from phdtrack.models import BoxMotion, BoxSensor, LocalClutter, MeasurementBirth, UniformClutter
from phdtrack.models.scene import SceneBirth, SceneClutter, with_scene
from phdtrack.models.volume import local_volume
from phdtrack.protocols import Model
from phdtrack.scene import LearnedDensity, SceneDensity, TrackedObjects, marginal, uniform_density
from phdtrack.types import SequenceInfo

SIZE = (640.0, 480.0)
LOW, HIGH = np.array([0.0, 0, -30, -30, 0, 0]), np.array([640.0, 480, 30, 30, 640, 480])
SHOWN = [0, 1, 4, 5]
SENSOR = BoxSensor()
MODEL = Model(BoxMotion(frame_size=SIZE), SENSOR, MeasurementBirth(0.05, 300, "local"), LocalClutter(0.4))
ANYWHERE, ANY_BOX = uniform_density(LOW, HIGH), uniform_density(LOW[SHOWN], HIGH[SHOWN])
# Of which nothing is known but that objects and births are detected anywhere.
BLANK = LearnedDensity(0.01, ANYWHERE), LearnedDensity(0.0, ANY_BOX), TrackedObjects(0.3, LearnedDensity(4.0, ANY_BOX))


def boxes(rng: np.random.Generator, n: int) -> np.ndarray:
    """(4, n) boxes that overlap now and then, some of them beyond the frame."""
    return np.stack([rng.uniform(-50, 690, n), rng.uniform(-50, 530, n), rng.uniform(20, 60, n), rng.uniform(40, 120, n)])


def gate(uniform: float = 0.2) -> SceneDensity:
    """People who come in at one place and walk to the right."""
    cov = np.diag([400.0, 900, 0.5, 0.5, 25, 100])
    cov[1, 2] = cov[2, 1] = 12.0
    return SceneDensity(LOW, HIGH, uniform, np.ones(1), np.array([[110.0, 210, 4, 1, 42, 82]]).T, cov[None])


def square() -> SceneDensity:
    """Where people are detected: mostly in the middle."""
    cov = np.diag([6400.0, 3600, 100, 400])
    return SceneDensity(LOW[SHOWN], HIGH[SHOWN], 0.4, np.ones(1), np.array([[320.0, 240, 40, 80]]).T, cov[None])


def near(rng: np.random.Generator, p: SceneDensity, n: int) -> np.ndarray:
    """(4, n) boxes, half of them drawn of ``p``, half anywhere."""
    return np.ascontiguousarray(np.hstack([p.sample(n // 2, rng), boxes(rng, n - n // 2)]))


def test_a_scene_of_which_nothing_is_known_has_the_shipped_densities(rng):
    model = with_scene(MODEL, BLANK[0], LearnedDensity(1.5, ANY_BOX), BLANK[2], 300)
    z = boxes(rng, 60)
    np.testing.assert_allclose(model.clutter.intensity(z), MODEL.clutter.intensity(z) + 1.5 / ANY_BOX.volume, rtol=1e-12)
    assert (MODEL.clutter.intensity(z) > 100 * 1.5 / ANY_BOX.volume).all(), "what comes to κ is little"
    for dt in (1.0, 2.5):
        ours = model.birth.around(SENSOR.states(z), dt)
        np.testing.assert_allclose(ours.density, MODEL.birth.density(z) * dt, rtol=1e-12)
        np.testing.assert_array_equal(ours.mean, SENSOR.states(z)[0])
        np.testing.assert_allclose(ours.covariance, SENSOR.states(z)[1], rtol=1e-12)
        mine, shipped = (birth.components(z, np.zeros(60), SENSOR, dt) for birth in (model.birth, MODEL.birth))
        for name in ("weight", "mean", "covariance"):
            np.testing.assert_allclose(getattr(mine, name), getattr(shipped, name), rtol=1e-9, atol=1e-12, err_msg=name)
        assert model.birth.expected(z, dt) == pytest.approx(MODEL.birth.expected(z, dt))


@pytest.mark.parametrize("composed", [False, True], ids=["fused", "composed"])
@pytest.mark.parametrize("recursion", [PMB(), GMPHD()], ids=["pmb", "gm-phd"])
def test_filters_do_there_what_they_do_with_the_shipped_model(recursion, composed: bool, rng):
    """Walkers among false alarms, frame by frame, with gaps: the same targets."""
    model = with_scene(MODEL, *BLANK, 300)
    states = [recursion.start(MODEL, rng)] * 2
    walkers = np.array([[100.0, 500], [200, 210], [40, 50], [90, 100]])
    for k in range(15):
        walkers[:2] += np.array([[4.0, -5], [1, 1]])
        z = np.ascontiguousarray(np.hstack([walkers + rng.normal(0, 1, (4, 2)), boxes(rng, 3)]))
        dt = 1.0 + (k % 5 == 4)
        step = [composed_step(recursion, s, z, m, dt, rng) if composed else recursion.step(s, z, m, dt, rng)
                for s, m in zip(states, (model, MODEL), strict=True)]  # fmt: skip
        (states, told) = zip(*step, strict=True)
        np.testing.assert_allclose(told[0].evidence, told[1].evidence, rtol=1e-6)
        np.testing.assert_allclose(told[0].clutter, told[1].clutter, rtol=1e-6)
        assert told[0].mass == pytest.approx(told[1].mass, rel=1e-6)
    ours, theirs = (s.mixture() if isinstance(recursion, PMB) else s for s in states)
    np.testing.assert_allclose(np.sort(ours.mean), np.sort(theirs.mean), rtol=1e-6, atol=1e-6)
    assert told[0].mass > 1.5


def test_newborn_particles_have_the_evidence_of_gamma():
    """∫ g γ at a detection, but for the 1 % that is cut off."""
    sensor, z = BoxSensor(scaling="fixed", fixed_noise=(3.0, 6.0)), np.array([[115.0], [205], [40], [85]])
    birth = SceneBirth(0.01, gate(), particles=1000, around_detections=0.05, among=square())
    wanted = birth.around(sensor.states(z), 2.0).density[0]
    found = []
    for k in range(20):
        born = birth.sample(z, np.zeros(1), sensor, 2.0, np.random.default_rng(k))
        found.append(float(born.weight @ np.exp(sensor.log_likelihood(z, born.state))))
        assert born.state[2].mean() > 2, "they walk as those do who come in there"
    assert np.mean(found) == pytest.approx(0.99 * wanted, rel=0.02)


def test_births_are_as_those_that_were_seen_and_fewer_where_objects_are(rng):
    """γ = beside l(z) p(z|b)/p(z|o), neither density below its uniform part."""
    z = np.hstack([near(rng, marginal(gate(), SHOWN), 40), near(rng, square(), 40)])
    seen = SENSOR.states(z)
    shown = np.maximum(SceneBirth(1.0, gate()).around(seen, 1.0).density, 0.2 / ANY_BOX.volume)
    alone = SceneBirth(0.01, gate(), around_detections=0.05).around(seen, 1.0).density
    np.testing.assert_allclose(alone, 0.05 * LocalClutter(1.0).intensity(z) * shown * ANY_BOX.volume, rtol=1e-9)
    among = SceneBirth(0.01, gate(), around_detections=0.05, among=square()).around(seen, 1.0).density
    there = np.maximum(square()(z), square().flat)
    np.testing.assert_allclose(among / alone, 1 / (there * ANY_BOX.volume), rtol=1e-9)
    assert (among > 3 * alone / 2).any()
    assert (among < alone / 20).any()


def test_where_objects_are_twice_as_dense_births_are_half(rng):
    z = boxes(rng, 30)
    narrow = uniform_density(LOW[SHOWN], HIGH[SHOWN] * np.array([1, 1, 1, 0.5]))
    plain = SceneBirth(0.01, ANYWHERE, around_detections=0.05, among=ANY_BOX).around(SENSOR.states(z), 1.0).density
    twice = SceneBirth(0.01, ANYWHERE, around_detections=0.05, among=narrow).around(SENSOR.states(z), 1.0).density
    np.testing.assert_allclose(twice, plain / 2, rtol=1e-12)


def test_births_reach_beyond_the_volume():
    z = np.array([[-40.0, 320], [240, 600], [40, 40], [90, 90]])
    seen = SENSOR.states(z)
    assert (SceneBirth(0.01, gate()).around(seen, 1.0).density == 0).all()
    birth = SceneBirth(0.01, gate(), around_detections=0.05)
    np.testing.assert_allclose(birth.around(seen, 1.0).density, 0.05 / local_volume(z) * 0.2, rtol=1e-12)
    assert len(birth.sample(z, np.zeros(2), SENSOR, 1.0, np.random.default_rng(0))) > 1000
    assert len(birth.components(z, np.zeros(2), SENSOR, 1.0)) == 2


def test_kappa_is_the_sum(rng):
    p = square()
    z = near(rng, p, 60)
    both = SceneClutter(3.0, p, around_detections=0.4).intensity(z)
    parts = SceneClutter(3.0, p).intensity(z), LocalClutter(0.4).intensity(z)
    np.testing.assert_allclose(both, parts[0] + parts[1], rtol=1e-12)
    assert all((part > 0).all() for part in parts)
    assert SceneClutter(3.0, p, around_detections=0.4).intensity(z[:, :0]).shape == (0,)


def test_in_single_precision_it_is_the_same(rng):
    sensor, z = BoxSensor(scaling="fixed"), near(rng, marginal(gate(), SHOWN), 60)
    birth = SceneBirth(0.01, gate(), around_detections=0.05, among=square())
    state, cov = sensor.states(z)
    density, _ = birth.about(state, np.sqrt(np.einsum("nii->in", cov)), 1.5)
    np.testing.assert_allclose(density, birth.around((state, cov), 1.5).density, rtol=2e-3)
    assert density.dtype == np.float32


@pytest.mark.parametrize("among", [None, square()], ids=["alone", "among objects"])
def test_gaussian_newborn_have_gamma_at_their_detection_and_the_velocity_of_the_place(among):
    """Seen through the noise; the second and the third detection share what lies between them."""
    z = np.array([[500.0, 110, 112], [400, 215, 216], [40, 42, 42], [80, 84, 85]])
    birth = SceneBirth(0.01, gate(), around_detections=0.05, among=among)
    at, mixture = birth.around(SENSOR.states(z), 1.0), birth.components(z, np.zeros(3), SENSOR, 1.0)
    np.testing.assert_array_equal(mixture.mean, at.mean)
    np.testing.assert_array_equal(mixture.covariance[:, 2:4, 2:4], at.covariance[:, 2:4, 2:4])
    assert abs(mixture.mean[2, 0]) < 0.1
    assert mixture.mean[2, 1] > 3.5
    seen = mixture.covariance[:, SHOWN][:, :, SHOWN] + SENSOR.covariance(z, mixture.mean)
    step = z[:, :, None] - mixture.mean[SHOWN][:, None, :]
    distance2 = np.einsum("rji,irs,sji->ji", step, np.linalg.inv(seen), step)
    density = (mixture.weight / np.sqrt(np.linalg.det(2 * np.pi * seen)) * np.exp(-0.5 * distance2)).sum(1)
    # What two of different γ share is between them: here one is a tenth above the other.
    np.testing.assert_allclose(density, at.density, rtol=0.05)
    np.testing.assert_allclose([density[0], density[1:].sum()], [at.density[0], at.density[1:].sum()], rtol=0.01)
    assert len(birth.components(z, np.ones(3), SENSOR, 1.0)) == 0, "where something is expected already nobody is born"


def test_as_many_are_expected_as_there_are_detections(rng):
    z = boxes(rng, 7)
    assert SceneBirth(0.01, gate(), around_detections=0.05).expected(z, 2.0) == pytest.approx(7 * 0.05 * 2)
    assert SceneBirth(0.01, gate()).expected(z, 2.0) == pytest.approx(0.02)


def test_what_was_not_learned_stays_as_it_is():
    births, clutter, followed = (
        LearnedDensity(0.02, gate()),
        LearnedDensity(3.0, square()),
        TrackedObjects(0.3, LearnedDensity(5.0, square())),
    )
    assert with_scene(MODEL, None, None, followed, 300) == MODEL
    model = with_scene(MODEL, births, None, None, 300)
    assert model.clutter is MODEL.clutter
    assert (model.birth.births_per_second, model.birth.around_detections, model.birth.particles, model.birth.among) == (
        25 * 0.02,
        0.05,
        300,
        None,
    )
    model = with_scene(MODEL, None, clutter, followed, 300)
    assert model.birth is MODEL.birth
    assert (model.clutter.clutter_per_frame, model.clutter.around_detections) == (3.0, 0.4)
    both = with_scene(MODEL, births, clutter, followed, 300)
    assert both.birth.among is followed.objects.density
    assert both.motion is MODEL.motion
    # Births and false alarms that are spread over the image are replaced by the scene's, as M09's are.
    image = replace(MODEL, birth=MeasurementBirth(0.05, 300, "image", SIZE), clutter=UniformClutter(2.0, ANY_BOX.volume))
    own = with_scene(image, births, clutter, followed, 300)
    assert own.birth.around_detections == own.clutter.around_detections == 0


def test_the_shipped_settings_are_laid_under():
    """What a scene comes beside by default: births and false alarms around each detection."""
    model = config.build(config.load(), SequenceInfo(640, 480, 25.0)).model
    over = with_scene(model, *BLANK, 300)
    assert over.birth.around_detections == model.birth.births_per_second > 0
    assert over.clutter.around_detections == model.clutter.clutter_per_frame > 0
