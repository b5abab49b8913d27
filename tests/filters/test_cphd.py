"""Laws of the cardinalised PHD filters: the PHD filter from a Poisson number, mass and mean, order, edges, one target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from phd_cases import FRAME, crowd, seen_by, with_births, world

from phdtrack.errors import InputError
from phdtrack.filters import GMCPHD, GMPHD, ParticleCPHD, ParticlePHD
from phdtrack.filters.cardinality import poisson, weigh
from phdtrack.filters.intensities import Cardinalised
from phdtrack.models import BoxMotion, BoxSensor, FixedBirth, MeasurementBirth, SplitSpawn, UniformClutter
from phdtrack.models.volumes import image_volume
from phdtrack.types import GaussianMixture, Particles
from reference import phd_twin

NOTHING = np.zeros((4, 0))
KINDS = ("gm", "particle")
ROWS = [0, 1, 4, 5]


def mixture_of(particles: Particles, rng) -> GaussianMixture:
    """Gaussians about some of the particles."""
    chosen = rng.choice(len(particles), 12, replace=False)
    root = rng.normal(0, 1.5, (12, 6, 6))
    cov = root @ root.transpose(0, 2, 1) + np.eye(6)
    return GaussianMixture(rng.uniform(0.1, 1.2, 12), np.ascontiguousarray(particles.state[:, chosen]), cov)


def case(kind: str, rng, model, targets: int = 7):
    """The cardinalised filter, the plain one, an intensity of some targets and a scan that fits it."""
    particles = crowd(rng, targets, 80)
    z = np.hstack([seen_by(rng, particles, targets), [[900.0], [900], [30], [60]]])
    if kind == "gm":
        return GMCPHD(), GMPHD(keep_mass=True), mixture_of(particles, rng), z
    return ParticleCPHD(particles_per_target=80), ParticlePHD(particles_per_target=80), particles, z


# Boxes as particles are in single precision.
NEAR = {"gm": 1e-9, "particle": 1e-5}


def mean(p: np.ndarray) -> float:
    return float(p @ np.arange(len(p)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("detection", [0.7, 1.0])
def test_a_poisson_number_gives_the_phd_update(kind: str, detection: float, rng):
    """Poisson births too: the intensity of one update is the PHD filter's to 1e-10."""
    model = with_births(world(detection_probability=detection), rate=0.05)
    ours, plain, intensity, z = case(kind, rng, model)
    state = Cardinalised(intensity, poisson(intensity.mass))
    (found, info), (wanted, told) = (
        filter_.update(s, z, model, 1.0, np.random.default_rng(3)) for filter_, s in ((ours, state), (plain, intensity))
    )
    np.testing.assert_allclose(found.intensity.weight, wanted.weight, rtol=NEAR[kind], atol=1e-8)
    assert len(wanted) > 30
    assert info.mass == pytest.approx(told.mass, rel=NEAR[kind])
    np.testing.assert_array_equal(info.evidence, told.evidence)
    assert told.cardinality.shape == (0,)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("detection", [0.7, 0.98, 1.0])
def test_the_mean_of_the_number_is_the_mass_with_what_was_born_unseen(kind: str, detection: float, rng):
    """Along a run with births, misses, clutter, empty scans and a gap.

    Births where nothing was detected are missed as all others are: after a scan so many of them are left.
    """
    model = with_births(world(detection_probability=detection), rate=0.05)
    recursion, _, _, _ = case(kind, rng, model)
    targets = crowd(rng, 5, 1)
    state, most = recursion.start(model, rng), 0.0
    for k in range(25):
        clutter = crowd(rng, 3, 1)
        z = np.hstack([seen_by(rng, targets, 4), seen_by(rng, clutter, 2)]) if k % 6 != 5 else NOTHING
        if k == 12:
            state = recursion.predict(state, model, 3.0, rng)
        before = recursion.predict(state, model, 1.0, rng)
        updated, info = recursion.update(before, z, model, 1.0, rng)
        state = recursion.reduce(updated, rng)
        births, known = model.birth.expected(z, 1 / model.rate), info.mass_predicted
        unseen = max(births - info.mass_born, 0.0)
        scan = known, (1 - detection) * known, births, unseen, info.evidence, info.clutter
        left = unseen * (1 - detection) * weigh(before.cardinality, *scan).missed
        for held in (updated, state):
            assert mean(held.cardinality) == pytest.approx(held.mass + left, rel=NEAR[kind])
        assert info.cardinality.sum() == pytest.approx(1, rel=1e-12)
        assert (info.cardinality >= 0).all()
        np.testing.assert_array_equal(info.cardinality, updated.cardinality)
        assert len(info.cardinality) < 60
        most = max(most, info.mass)
    assert 2 < most < 15


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("detection", [0.7, 1.0])
def test_the_mean_is_the_mass_exactly_where_births_are_given_whole(kind: str, detection: float, rng):
    model = world(detection_probability=detection)
    mean_state, cov = model.sensor.states(np.array([[300.0, 700], [200, 400], [40, 50], [80, 90]]))
    model = replace(model, birth=FixedBirth(GaussianMixture(np.array([0.1, 0.3]), mean_state, cov), 500))
    recursion, _, intensity, z = case(kind, rng, model)
    updated, _ = recursion.update(Cardinalised(intensity, poisson(intensity.mass)), z, model, 1.0, rng)
    assert mean(updated.cardinality) == pytest.approx(updated.mass, rel=NEAR[kind])


def test_the_number_follows_a_scene_that_people_enter(rng):
    """One target more every other scan, births around the detections: a number that knows of no births lags behind."""
    birth = MeasurementBirth(births_per_second=25 * 0.5, frame_size=FRAME)
    model = replace(world(detection_probability=0.7, scaling="fixed"), birth=birth)
    model = replace(
        model, motion=BoxMotion(acceleration=0.001, size_noise=0.001, survival_probability=1.0, frame_size=FRAME)
    )
    recursion, errors = GMCPHD(), []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        state, everybody = recursion.start(model, rng), crowd(rng, 40, 1).state
        for k in range(80):
            present = everybody[:, : k // 2 + 1][ROWS]
            seen = present[:, rng.random(present.shape[1]) < 0.7]
            state, info = recursion.step(state, seen + rng.normal(0, 1.7, seen.shape), model, 1.0, rng)
            errors.append(mean(info.cardinality) - present.shape[1])
    # Without the births that no detection shows it is 6.6 too low.
    assert abs(np.mean(errors)) < 1


@pytest.mark.parametrize("kind", KINDS)
def test_the_order_of_detections_is_irrelevant(kind: str, rng):
    model = world(detection_probability=0.9)
    recursion, _, intensity, z = case(kind, rng, model)
    state, order = Cardinalised(intensity, poisson(3.0)), rng.permutation(z.shape[1])
    (a, told), (b, turned) = (recursion.update(state, np.ascontiguousarray(s), model, 1.0, rng) for s in (z, z[:, order]))
    np.testing.assert_allclose(turned.cardinality, told.cardinality, rtol=10 * NEAR[kind], atol=1e-9)
    np.testing.assert_allclose(turned.evidence, told.evidence[order], rtol=NEAR[kind])
    np.testing.assert_allclose(np.sort(a.intensity.weight), np.sort(b.intensity.weight), rtol=10 * NEAR[kind], atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_known_number_outlives_a_miss(kind: str, rng):
    """Seven targets for certain, nobody seen: seven are still expected, where the PHD filter expects a tenth of them."""
    model = world(detection_probability=0.9)
    ours, plain, intensity, _ = case(kind, rng, model)
    number = np.eye(8)[7]
    scaled = replace(intensity, weight=intensity.weight * 7 / intensity.mass)
    found, info = ours.update(Cardinalised(scaled, number), NOTHING, model, 1.0, rng)
    assert (info.mass, found.mass) == (pytest.approx(7), pytest.approx(7))
    np.testing.assert_allclose(info.cardinality, number, atol=1e-15)
    assert plain.update(scaled, NOTHING, model, 1.0, rng)[1].mass == pytest.approx(0.7)


@pytest.mark.parametrize("kind", KINDS)
def test_survival_thins_the_number(kind: str, rng):
    model = replace(world(), motion=BoxMotion(survival_probability=0.8**25))
    recursion, _, intensity, _ = case(kind, rng, model)
    predicted = recursion.predict(Cardinalised(intensity, poisson(intensity.mass)), model, 1.0, rng)
    expected = poisson(0.8 * intensity.mass)
    np.testing.assert_allclose(predicted.cardinality[: len(expected)], expected, atol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_forgotten_altogether_is_nobody(kind: str, rng):
    model = world()
    recursion, _, intensity, _ = case(kind, rng, model)
    faint = Cardinalised(replace(intensity, weight=intensity.weight * 1e-9), poisson(intensity.mass * 1e-9))
    state = recursion.reduce(faint, rng)
    assert len(state) == 0
    np.testing.assert_array_equal(state.cardinality, [1.0])
    state, info = recursion.step(state, NOTHING, model, 1.0, rng)
    assert info.mass == state.mass == 0


def test_one_certain_target_is_the_kalman_filter(rng):
    """p_D = 1, no clutter, no births: number 1, mean and covariance to 1e-10."""
    model = replace(
        world(detection_probability=1.0, scaling="fixed", clutter=UniformClutter(0.0, 1.0)),
        motion=BoxMotion(1.5**0.5, 2.0, survival_probability=1.0, scaled_noise=False),
    )
    start, cov = np.array([320.0, 240, 2, -1, 60, 110]), np.diag([3.0, 3, 20, 20, 6, 6])
    _, (f,), (q,) = model.motion.transition(start[:, None], 1.0)
    noise = model.sensor.covariance(np.zeros((4, 1)), start[:, None])[0]
    x, measured = start[:, None], []
    for _ in range(20):
        x = model.motion.sample(x, 1.0, rng)
        measured.append(x[ROWS, 0] + rng.normal(0, np.sqrt(np.diag(noise))))
    means, covs = phd_twin.kalman(start, cov, np.array(measured), f, q, np.eye(6)[ROWS], noise)
    recursion = GMCPHD(initial=GaussianMixture(np.ones(1), start[:, None], cov[None]))
    state = recursion.start(model, rng)
    for k, z in enumerate(measured):
        state, info = recursion.step(state, z[:, None], model, 1.0, rng)
        np.testing.assert_allclose(info.cardinality, [0, 1], atol=1e-14)
        np.testing.assert_allclose(state.intensity.mean[:, 0], means[k], rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(state.intensity.covariance[0], covs[k], rtol=1e-10, atol=1e-10)


def test_particles_and_gaussians_count_alike(rng):
    """The same linear world, births at given places: the distributions of the number agree."""
    birth = FixedBirth(
        GaussianMixture(
            np.array([0.1, 0.1]),
            np.array([[200.0, 200, 0, 0, 50, 90], [450, 300, 0, 0, 60, 100]]).T,
            np.tile(np.diag([9.0, 9, 1, 1, 4, 4]), (2, 1, 1)),
        ),
        particles=2000,
    )
    model = replace(
        world(birth, UniformClutter(1.0, image_volume(FRAME)), detection_probability=0.8, scaling="fixed"),
        motion=BoxMotion(0.5, 0.5, scaled_noise=False),
    )
    scans = [birth.mixture.mean[ROWS][:, : 1 + (k % 3 > 0)] + rng.normal(0, 1.5, (4, 1 + (k % 3 > 0))) for k in range(8)]
    told = []
    for recursion in (GMCPHD(), ParticleCPHD(particles_per_target=8000)):
        state = recursion.start(model, rng)
        for z in scans:
            state, info = recursion.step(state, z, model, 1.0, np.random.default_rng(4))
        told.append(np.pad(info.cardinality, (0, 40))[:40])
    np.testing.assert_allclose(told[1], told[0], atol=0.04)
    assert told[0].argmax() == 2


@pytest.mark.parametrize("recursion", [GMCPHD(), ParticleCPHD()], ids=KINDS)
def test_spawning_is_refused(recursion, rng):
    model = replace(world(), motion=BoxMotion(births=SplitSpawn(rate=1.0)))
    intensity = crowd(rng, 4, 50) if isinstance(recursion, ParticleCPHD) else mixture_of(crowd(rng, 4, 50), rng)
    with pytest.raises(InputError, match="no spawning"):
        recursion.predict(Cardinalised(intensity, poisson(4.0)), model, 1.0, rng)


def test_the_first_intensity_may_be_given(rng):
    given = mixture_of(crowd(rng, 4, 50), rng)
    for recursion in (GMCPHD(initial=given), ParticleCPHD(particles_per_target=100, initial=given)):
        state = recursion.start(world(), rng)
        assert state.mass == pytest.approx(given.mass)
        assert mean(state.cardinality) == pytest.approx(given.mass)


@pytest.mark.parametrize("kind", [GMCPHD, ParticleCPHD])
def test_settings_out_of_bounds(kind):
    with pytest.raises(InputError, match="least 1" if kind is ParticleCPHD else "gate"):
        kind(0) if kind is ParticleCPHD else kind(gate_probability=-1.0)


def test_a_remembered_size_will_do(rng):
    """A sensor that reads more rows of the state, and detections that bring their noise."""
    for scaling in ("previous", "given"):
        model = with_births(world(scaling=scaling), rate=0.05)
        assert isinstance(model.sensor, BoxSensor)
        rows = 8 if scaling == "given" else 4
        z = np.vstack([seen_by(rng, crowd(rng, 3, 1), 3), np.full((4, 3), 9.0)])[:rows]
        for recursion in (GMCPHD(), ParticleCPHD(particles_per_target=200)):
            state = recursion.start(model, rng)
            for _ in range(4):
                state, info = recursion.step(state, z, model, 1.0, rng)
            assert int(info.cardinality.argmax()) == 3
