"""The fused GM-PHD step for boxes is the composition of predict, update and reduce, to rounding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from box_scans import box_scans

from phdtrack.filters import GMPHD
from phdtrack.filters.composed import composed_step
from phdtrack.filters.gm_box import box_model
from phdtrack.models import (
    BoxMotion,
    BoxSensor,
    FixedBirth,
    LocalClutter,
    MeasurementBirth,
    SplitSpawn,
    UniformClutter,
)
from phdtrack.models.scene import SceneBirth, SceneClutter
from phdtrack.protocols import Model
from phdtrack.scene import SceneDensity, marginal
from phdtrack.types import GaussianMixture

SIZE = (640.0, 480.0)
CLUTTER = UniformClutter(3.0, (SIZE[0] * SIZE[1]) ** 2)


def given_births() -> GaussianMixture:
    mean = np.array([[100.0, 200, 1, 0, 40, 100], [300, 100, 0, 0, 30, 60]]).T
    root = np.random.default_rng(3).normal(0, 2, (2, 6, 6))
    return GaussianMixture(np.array([0.02, 0.01]), mean, root @ root.transpose(0, 2, 1) + 4 * np.eye(6))


def scene(seed: int, count: int = 12) -> tuple[SceneBirth, SceneClutter]:
    """Births and false alarms with learned densities: wide Gaussians, narrow ones, and one that leaks."""
    rng = np.random.default_rng(seed)
    low, high = np.array([0.0, 0, -30, -30, 0, 0]), np.array([640.0, 480, 30, 30, 640, 480])
    mean = rng.uniform([50, 50, -5, -5, 20, 20], [600, 430, 5, 5, 90, 90], (count, 6)).T
    mean[0, 0] = 5.0
    root = rng.normal(0, 1, (count, 6, 6)) * rng.uniform(1, 8, (count, 1, 1)) * np.array([4, 4, 0.2, 0.2, 1, 1])[:, None]
    p = SceneDensity(low, high, 0.3, np.full(count, 1 / count), mean, root @ root.transpose(0, 2, 1) + np.eye(6))
    return SceneBirth(0.2, p), SceneClutter(4.0, marginal(p, (0, 1, 4, 5)))


def laid_over(seed: int) -> tuple[SceneBirth, SceneClutter]:
    """The same beside births and false alarms around each detection, among objects that are elsewhere."""
    birth, clutter = scene(seed)
    return replace(birth, around_detections=0.1, among=scene(seed + 1)[1].density), replace(clutter, around_detections=0.4)


LOCAL = MeasurementBirth(volume="local")
MODELS = {
    "particle": Model(BoxMotion(frame_size=SIZE), BoxSensor(), MeasurementBirth(frame_size=SIZE), CLUTTER),
    "local": Model(BoxMotion(frame_size=SIZE), BoxSensor(detection_probability=0.8), LOCAL, LocalClutter(0.4)),
    "mixed": Model(BoxMotion(), BoxSensor(min_noise=0.0), LOCAL, CLUTTER),
    "detection": Model(BoxMotion(), BoxSensor(scaling="detection"), MeasurementBirth(frame_size=SIZE), LocalClutter(1.0)),
    "given": Model(
        BoxMotion(), BoxSensor(scaling="given"), MeasurementBirth(volume="local", births_per_second=25 * 0.1), CLUTTER
    ),
    "fixed": Model(
        BoxMotion(1.2, 2.0, scaled_noise=False), BoxSensor(scaling="fixed"), MeasurementBirth(frame_size=SIZE), CLUTTER
    ),
    "given births": Model(BoxMotion(frame_size=SIZE), BoxSensor(), FixedBirth(given_births()), CLUTTER),
    "no clutter": Model(
        BoxMotion(), BoxSensor(detection_probability=1.0), FixedBirth(given_births()), UniformClutter(0.0, 1.0)
    ),
    "scene": Model(BoxMotion(frame_size=SIZE), BoxSensor(), *scene(1)),
    "laid over": Model(BoxMotion(frame_size=SIZE), BoxSensor(), *laid_over(4)),
    "laid over, given": Model(BoxMotion(), BoxSensor(scaling="given"), laid_over(5)[0], LocalClutter(0.4)),
    "laid over, fixed": Model(BoxMotion(1.2, 2.0, scaled_noise=False), BoxSensor(scaling="fixed"), *laid_over(6)),
    "clutter laid over": Model(BoxMotion(), BoxSensor(scaling="detection"), LOCAL, laid_over(7)[1]),
    "beside a scene": Model(BoxMotion(), BoxSensor(), scene(8)[0], laid_over(8)[1]),
    "learned births": Model(BoxMotion(), BoxSensor(scaling="given"), scene(2)[0], LocalClutter(0.4)),
    "learned clutter": Model(BoxMotion(), BoxSensor(scaling="fixed"), LOCAL, scene(3)[1]),
}
FILTERS = {
    "default": GMPHD(),
    "few": GMPHD(max_components=6, merge_distance=4.0),
    "as printed": GMPHD(keep_mass=False, weight_threshold=1e-4, gate_probability=0.94),
    "skipping": GMPHD(skip_empty_frames=True, max_components=0),
}


def scans(seed: int, count: int) -> list[np.ndarray]:
    return box_scans(seed, count, SIZE, 100.0, 4.0)


def ordered(mixture: GaussianMixture) -> GaussianMixture:
    order = np.lexsort((mixture.weight, mixture.mean[0].round(6)))
    tag = mixture.tag[order]
    return GaussianMixture(mixture.weight[order], mixture.mean[:, order], mixture.covariance[order], tag, mixture.fresh)


def heavier(mixture: GaussianMixture) -> GaussianMixture:
    """Without the lightest: newborn of equal weight, of which a cap keeps those that rounding favours."""
    kept = mixture.weight > mixture.weight.min() * (1 + 1e-9)
    tag = mixture.tag[kept]
    return GaussianMixture(mixture.weight[kept], mixture.mean[:, kept], mixture.covariance[kept], tag, mixture.fresh)


def agree(a: GaussianMixture, b: GaussianMixture, most: int = 0) -> None:
    assert len(a) == len(b)
    if most and len(a) == most:
        a, b = heavier(a), heavier(b)
        assert len(a) == len(b)
    a, b = ordered(a), ordered(b)
    np.testing.assert_allclose(a.weight, b.weight, rtol=1e-9)
    np.testing.assert_allclose(a.mean, b.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-8, atol=1e-8)
    # Of Gaussians that share a tag and weigh the same, rounding says which keeps it.
    for i in np.flatnonzero(a.tag != b.tag):
        alike = np.isclose(a.weight, a.weight[i], rtol=1e-9, atol=0)
        assert sorted(a.tag[alike]) == sorted(b.tag[alike])
        assert np.count_nonzero(alike) > 1
    assert a.fresh == b.fresh


@pytest.mark.parametrize("settings", FILTERS.values(), ids=FILTERS)
@pytest.mark.parametrize("name", MODELS)
def test_the_fused_step_is_the_composition(name: str, settings: GMPHD):
    """Along a run with dropped frames, from a mixture that is given: masses, evidence, and every Gaussian."""
    model, rng = MODELS[name], np.random.default_rng(0)
    assert box_model(model, 1.0) is not None, "the fused path is tested"
    measured = [z if model.sensor.scaling == "given" else np.ascontiguousarray(z[:4]) for z in scans(len(name), 12)]
    initial = GaussianMixture(np.full(measured[0].shape[1], 0.5), *model.sensor.states(measured[0]))
    state = replace(settings, initial=initial).start(model, rng)
    heaviest = 0.0
    for k, z in enumerate(measured):
        dt = (1.0, 0.5, 3.0)[k % 3]
        fused, info = settings.step(state, z, model, dt, rng)
        general, expected = composed_step(settings, state, z, model, dt, rng)
        agree(fused, general, settings.most)
        np.testing.assert_allclose(info.evidence, expected.evidence, rtol=1e-9, atol=1e-300)
        np.testing.assert_allclose(info.clutter, expected.clutter, rtol=1e-12)
        for name_ in ("mass_predicted", "mass_born", "mass"):
            assert getattr(info, name_) == pytest.approx(getattr(expected, name_), rel=1e-9, abs=1e-15)
        assert info.vanished == expected.vanished
        heaviest = max(heaviest, info.mass)
        # From the same state again: rounding must not be given the time to grow.
        state = general
    assert heaviest > 1.5, "there was something to compare"


def test_more_births_than_there_is_room_for(rng):
    """Buffers grow: many given births, and every Gaussian meets every measurement."""
    model, z = MODELS["given births"], np.ascontiguousarray(np.repeat([[100.0], [200], [40], [100]], 30, axis=1))
    z = z + rng.normal(0, 1, z.shape)
    given = given_births()
    birth = FixedBirth(
        GaussianMixture(np.tile(given.weight, 40), np.tile(given.mean, 40), np.tile(given.covariance, (40, 1, 1)))
    )
    model, settings = replace(model, birth=birth), GMPHD(merge_distance=0.0, max_components=0)
    state = settings.start(model, rng)
    agree(settings.step(state, z, model, 1.0, rng)[0], composed_step(settings, state, z, model, 1.0, rng)[0])


@pytest.mark.parametrize("name", ["scene", "particle"])
def test_over_long_runs_they_stay_together(name: str):
    """Each from its own state: hundreds of frames with gaps, and at the end the same targets and masses."""
    model, settings, rng = MODELS[name], GMPHD(), np.random.default_rng(0)
    fused, general, mass = settings.start(model, rng), settings.start(model, rng), []
    for k, z in enumerate(scans(7, 60) * 5):
        boxes = np.ascontiguousarray(z[:4])
        fused, info = settings.step(fused, boxes, model, 1.0 + (k % 9 == 8), rng)
        general, expected = composed_step(settings, general, boxes, model, 1.0 + (k % 9 == 8), rng)
        np.testing.assert_allclose(info.evidence, expected.evidence, rtol=1e-6, atol=1e-14)
        mass.append((info.mass, expected.mass))
    np.testing.assert_allclose(*np.array(mass).T, rtol=1e-6)
    assert fused.fresh == general.fresh
    assert np.max(mass) > 3, "there was something to compare"


class Walking(BoxMotion):
    """Another motion: what is derived may override anything."""


def test_other_models_take_the_general_path():
    """And a step is possible for each."""
    model = MODELS["particle"]
    assert box_model(replace(model, motion=Walking()), 1.0) is None
    assert box_model(replace(model, motion=BoxMotion(births=SplitSpawn())), 1.0) is None
    previous = replace(model, motion=BoxMotion(remember_size=True), sensor=BoxSensor(scaling="previous"))
    assert box_model(previous, 1.0) is None
    rng, z = np.random.default_rng(0), np.array([[100.0], [200], [40], [100]])
    for other in (replace(model, motion=Walking()), previous):
        state, info = GMPHD().step(GMPHD().start(other, rng), z, other, 1.0, rng)
        assert len(state.mean) == other.motion.dim
        assert info.mass > 0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_measurements_that_are_no_numbers_are_refused(bad: float, rng):
    z = np.array([[100.0, bad], [200, 100], [40, 40], [100, 100]])
    with pytest.raises(ValueError, match="finite"):
        GMPHD().step(GMPHD().start(MODELS["particle"], rng), z, MODELS["particle"], 1.0, rng)
