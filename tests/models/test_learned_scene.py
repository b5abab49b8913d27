"""Births and false alarms with learned densities, also added to the usual ones, Gaussian by
Gaussian.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from experiments.common import uniform_density, with_scene
from phdtrack.models import BoxClutter, BoxMotion, BoxSensor, MeasurementBirth, UniformClutter
from phdtrack.models.scene import SceneBirth, SceneClutter
from phdtrack.models.volumes import image_volume, local_volume
from phdtrack.protocols import Model
from phdtrack.scene import LearnedDensity, SceneDensity, TrackedObjects, marginal
from phdtrack.types import F8
from reference import context_twin as twin
from views import drawn_of

SIZE = (640.0, 480.0)
LOW = np.array([0.0, 0, -30, -30, 0, 0])
HIGH = np.array([640.0, 480, 30, 30, 640, 480])
SHOWN = [0, 1, 4, 5]
SENSOR = BoxSensor()
FIXED = BoxSensor(scaling="fixed", fixed_noise=(3.0, 6.0))
MODEL = Model(
    BoxMotion(frame_size=SIZE),
    SENSOR,
    MeasurementBirth(births_per_detection=0.05, particles=300),
    BoxClutter(0.4),
)
ANYWHERE = uniform_density(LOW, HIGH)
ANY_BOX = uniform_density(LOW[SHOWN], HIGH[SHOWN])
# Of which nothing is known but that objects and births are detected anywhere.
BLANK = (
    LearnedDensity(0.01, ANYWHERE),
    LearnedDensity(0.0, ANY_BOX),
    TrackedObjects(0.3, LearnedDensity(4.0, ANY_BOX)),
)
Z = np.array([[100.0, 400], [200, 300], [40, 30], [80, 70]])


def entrance(uniform: float = 0.2) -> SceneDensity:
    """One place with people who walk to the right, the faster the further down."""
    cov = np.diag([400.0, 900, 0.5, 0.5, 25, 100])
    cov[1, 2] = cov[2, 1] = 12.0
    return SceneDensity(
        LOW, HIGH, uniform, np.ones(1), np.array([[110.0, 210, 4, 1, 42, 82]]).T, cov[None]
    )


def square() -> SceneDensity:
    """Where people are detected: mostly in the middle."""
    cov = np.diag([6400.0, 3600, 100, 400])
    return SceneDensity(
        LOW[SHOWN], HIGH[SHOWN], 0.4, np.ones(1), np.array([[320.0, 240, 40, 80]]).T, cov[None]
    )


def boxes(rng: np.random.Generator, n: int) -> F8:
    """(4, n) boxes in a few crowds and anywhere, some of them beyond the frame."""
    middle = rng.uniform([[-30.0], [-30]], [[660], [500]], (2, 5))[:, rng.integers(0, 5, n)]
    return np.vstack(
        [middle + rng.normal(0, 25, (2, n)), rng.uniform([[20.0], [50]], [[60], [120]], (2, n))]
    )


def learned(rng: np.random.Generator, d: int, count: int) -> SceneDensity:
    """Gaussians of many widths: near each other, far, and hardly inside."""
    root = rng.normal(0, 1, (count, d, d)) * rng.uniform(0.3, 6, (count, 1, 1))
    mean = rng.uniform(-25, 25, (d, count))
    mean[:, -1] = 400
    weight = rng.random(count) + 0.1
    low = np.full(d, -20.0)
    high = np.full(d, 30.0)
    return SceneDensity(
        low, high, 0.3, weight / weight.sum(), mean, root @ root.transpose(0, 2, 1) + np.eye(d)
    )


@pytest.mark.parametrize("d", [1, 2, 4, 6])
def test_a_density_and_false_alarms_at_points(d: int, rng):
    p = learned(rng, d, 7)
    x = np.hstack([rng.uniform(-30, 40, (d, 40)), p.mean[:, :3] + 0.1, np.full((d, 1), -20.0)])
    asked = (p.low, p.high, p.uniform / p.volume)
    gaussians = (p.gaussians.weight, p.mean, p.covariance)
    np.testing.assert_allclose(p(x), twin.mixture_density(x, *asked, 0.0, *gaussians), rtol=1e-10)
    np.testing.assert_allclose(p(x), np.exp(p.log(x)), rtol=1e-10)
    kappa = 2.5 * twin.mixture_density(x, *asked, asked[2], *gaussians)
    # Further rows of a measurement, such as its own noise, do not count.
    found = SceneClutter(2.5, p).intensity(np.asfortranarray(np.vstack([x, x])))
    np.testing.assert_allclose(found, kappa, rtol=1e-10)
    assert kappa.max() > 2 * kappa.min(), "Gaussians count somewhere"
    np.testing.assert_array_equal(SceneClutter(0.0, p).intensity(x), np.zeros(x.shape[1]))


def test_what_a_density_says_of_detections(rng):
    """Density through the noise, and the velocities that detections do not show given them."""
    d = 6
    rows = (0, 1, 4, 5)
    p = learned(rng, d, 9)
    n = 90
    keep = list(rows)
    root = rng.normal(0, 1, (n, d, d))
    state = rng.uniform(-30, 40, (d, n))
    noise = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(d)
    state[keep, 0] = p.mean[keep, 0]
    noise[:, [r for r in range(d) if r not in rows]] *= np.eye(d)[
        [r for r in range(d) if r not in rows]
    ]
    noise[:, :, [r for r in range(d) if r not in rows]] *= np.eye(d)[
        :, [r for r in range(d) if r not in rows]
    ]
    found, found_states = SceneBirth(2.0, p).around((state, noise), 1.5)
    shown = marginal(p, rows)
    density, mean, cov = twin.given_detections(
        state,
        noise,
        keep,
        shown.low,
        shown.high,
        p.uniform / shown.volume,
        p.gaussians.weight,
        p.mean,
        p.covariance,
    )
    # What is left out is nothing to single precision.
    np.testing.assert_allclose(found, 3.0 * density, rtol=1e-6)
    np.testing.assert_allclose(found_states[0], mean, atol=1e-3)
    np.testing.assert_allclose(found_states[1], cov, rtol=1e-4, atol=0.1)
    assert len(np.unique(density.round(12))) > 12, (
        "Gaussians count, and places beyond the volume have none"
    )
    assert (density == 0).any()


def test_without_gaussians_it_is_uniform_birth_over_the_image():
    scene = SceneBirth(0.02, ANYWHERE)
    plain = MeasurementBirth(0.02, particles=1000, frame_size=SIZE)
    covered = np.array([0.0, 0.4])
    a, b = (
        birth.sample(Z, covered, SENSOR, 1.5, np.random.default_rng(1)) for birth in (scene, plain)
    )
    assert image_volume(SIZE) == pytest.approx(ANY_BOX.volume)
    np.testing.assert_allclose(a.state, b.state)
    np.testing.assert_allclose(a.weight, b.weight)


def fixed_likelihood(z: F8, x: F8) -> F8:
    """(L,) g(z|x) of one measurement, whose noise is the same for all states."""
    return multivariate_normal.pdf(
        FIXED.predicted_measurements(x).T, z[:, 0], FIXED.covariance(z, np.zeros((6, 1)))[0]
    )


def test_the_evidence_of_newborn_is_that_of_gamma():
    """C(z) = ∫ g γ, by drawing γ; a sensor of fixed noise, for which it is exact but for the 1 %
    that is cut off.
    """
    birth = SceneBirth(1.0, entrance())
    z = Z[:, :1]
    each = fixed_likelihood(z, drawn_of(birth.density, 1_000_000, np.random.default_rng(2)))
    drawn = [birth.sample(z, np.zeros(1), FIXED, 1.0, np.random.default_rng(k)) for k in range(20)]
    found = [float(born.weight @ fixed_likelihood(z, born.state)) for born in drawn]
    assert np.mean(found) == pytest.approx(0.99 * each.mean(), rel=0.02)


def test_gaussian_births_are_learned_ones_and_a_uniform_part():
    birth = SceneBirth(0.5, entrance(uniform=0.2))
    flat = MeasurementBirth(0.5 * 0.2, particles=1000, frame_size=SIZE)
    found, uniform = (one.gaussians(Z, SENSOR, 2.0) for one in (birth, flat))
    assert found.weight[0] * birth.density.truncated_mass[0] == pytest.approx(0.5 * 2.0 * 0.8)
    np.testing.assert_array_equal(found.mean[0], birth.density.mean[:, 0])
    for ours, theirs in zip(found.around, uniform.around, strict=True):
        np.testing.assert_allclose(ours, theirs)


# Added to births and false alarms that are the same at every scale


@pytest.mark.parametrize("count", [1, 60])
def test_false_alarms_are_added_to_the_usual_ones(count: int, rng):
    p = marginal(entrance(), (0, 1, 4, 5))
    z = boxes(rng, count)
    there = twin.mixture_density(
        z, p.low, p.high, p.flat, p.flat, p.gaussians.weight, p.mean, p.covariance
    )
    found = SceneClutter(4.0, p, clutter_per_detection=0.7).intensity(np.vstack([z, z]))
    np.testing.assert_allclose(found, 0.7 / local_volume(z) + 4.0 * there, rtol=1e-10)


@pytest.mark.parametrize("among", [None, square()], ids=["anywhere", "objects"])
def test_births_are_the_usual_ones_by_place(among: SceneDensity | None, rng):
    """γ = a l(z) p(z|b)/p(z|o), neither density below its uniform part."""
    places = marginal(entrance(), (0, 1, 4, 5)), square()
    z = np.hstack([boxes(rng, 40), *(np.clip(drawn_of(p, 20, rng), 1, None) for p in places)])
    seen = SENSOR.states(z)
    objects = among or ANY_BOX
    plain, states = SceneBirth(1.0, entrance()).around(seen, 1.0)
    born = np.maximum(plain, 0.2 / ANY_BOX.volume)
    there = np.maximum(objects(z), objects.flat)
    found, same = SceneBirth(0.2, entrance(), births_per_detection=0.05, among=among).around(
        seen, 2.0
    )
    np.testing.assert_allclose(found, 0.1 / local_volume(z) * born / there, rtol=1e-9)
    for one, other in zip(states, same, strict=True):
        np.testing.assert_array_equal(one, other)
    assert found.max() > 30 * found.min(), "places count"


def test_births_around_detections_reach_beyond_the_volume():
    z = np.array([[-40.0, 320], [240, 600], [40, 40], [90, 90]])
    seen = SENSOR.states(z)
    assert (SceneBirth(0.01, entrance()).around(seen, 1.0)[0] == 0).all()
    birth = SceneBirth(0.01, entrance(), births_per_detection=0.05)
    np.testing.assert_allclose(birth.around(seen, 1.0)[0], 0.05 / local_volume(z) * 0.2, rtol=1e-12)
    assert len(birth.sample(z, np.zeros(2), SENSOR, 1.0, np.random.default_rng(0))) > 1000
    assert (birth.gaussians(z, SENSOR, 1.0).around.density > 0).all()


def test_newborn_particles_have_learned_mass_and_velocity():
    z = np.array([[115.0], [205], [40], [85]])
    birth = SceneBirth(0.01, entrance(), particles=1000, births_per_detection=0.05, among=square())
    wanted = birth.around(FIXED.states(z), 2.0)[0][0]
    drawn = [birth.sample(z, np.zeros(1), FIXED, 2.0, np.random.default_rng(k)) for k in range(20)]
    found = [float(born.weight @ fixed_likelihood(z, born.state)) for born in drawn]
    assert np.mean(found) == pytest.approx(0.99 * wanted, rel=0.02)
    assert all(born.state[2].mean() > 2 for born in drawn)


# In a whole model


def test_unknown_scene_has_the_default_densities(rng):
    model = with_scene(MODEL, BLANK[0], LearnedDensity(1.5, ANY_BOX), BLANK[2], 300)
    z = boxes(rng, 60)
    np.testing.assert_allclose(
        model.clutter.intensity(z), MODEL.clutter.intensity(z) + 1.5 / ANY_BOX.volume, rtol=1e-12
    )
    for dt in (1.0, 2.5):
        mine, default = (birth.gaussians(z, SENSOR, dt) for birth in (model.birth, MODEL.birth))
        for ours, theirs in zip(mine.around, default.around, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)
        assert model.birth.expected_count(z, dt) == pytest.approx(MODEL.birth.expected_count(z, dt))


def test_a_uniform_density_beside_a_learned_one_has_its_volume():
    """Else births over all sizes of the frame would be thousands of times thinner than what was
    learned of false alarms.
    """
    everywhere = replace(
        MODEL,
        birth=MeasurementBirth(0.25, frame_size=SIZE),
        clutter=BoxClutter(clutter_per_frame=1.0, frame_size=SIZE),
    )
    births = LearnedDensity(0.02, entrance())
    alarms = LearnedDensity(3.0, square())
    z = np.array([[200.0], [300], [40], [80]])
    model = with_scene(everywhere, None, alarms, None, 300)
    assert model.birth.density(z)[0] == pytest.approx(0.25 / alarms.density.volume)
    model = with_scene(everywhere, births, None, None, 300)
    shown = births.density.high - births.density.low
    assert model.clutter.intensity(z)[0] == pytest.approx(1 / np.prod(shown[[0, 1, 4, 5]]))
    assert with_scene(everywhere, births, alarms, None, 300).clutter.density is alarms.density


def test_what_was_not_learned_stays_as_it_is():
    births = LearnedDensity(0.02, entrance())
    clutter = LearnedDensity(3.0, square())
    followed = TrackedObjects(0.3, LearnedDensity(5.0, square()))
    assert with_scene(MODEL, None, None, followed, 300) == MODEL
    model = with_scene(MODEL, births, None, None, 300)
    assert model.clutter is MODEL.clutter
    birth = model.birth
    assert (birth.births_per_second, birth.births_per_detection) == (25 * 0.02, 0.05)
    assert (birth.particles, birth.among) == (300, None)
    model = with_scene(MODEL, None, clutter, followed, 300)
    assert model.birth is MODEL.birth
    assert (model.clutter.clutter_per_frame, model.clutter.clutter_per_detection) == (3.0, 0.4)
    assert with_scene(MODEL, births, clutter, followed, 300).birth.among is followed.objects.density
    # Births and false alarms that are spread over the image are replaced by the scene's, as M09's
    # are.
    image = replace(
        MODEL,
        birth=MeasurementBirth(0.05, particles=300, frame_size=SIZE),
        clutter=UniformClutter(2.0, ANY_BOX.volume),
    )
    own = with_scene(image, births, clutter, followed, 300)
    assert own.birth.births_per_detection == own.clutter.clutter_per_detection == 0
