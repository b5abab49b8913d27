"""The fused step of the Poisson multi-Bernoulli filter for boxes is predict, update and reduce, to rounding."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from box_scans import box_scans
from test_gm_step_kernel import laid_over, scene

from phdtrack.filters import PMB
from phdtrack.filters.bernoullis import Bernoullis
from phdtrack.filters.composed import composed_step
from phdtrack.filters.gm_box import box_model
from phdtrack.models import BoxMotion, BoxSensor, FixedBirth, LocalClutter, MeasurementBirth, ScoredClutter, UniformClutter
from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture

SIZE = (640.0, 480.0)
EVERYWHERE = UniformClutter(3.0, (SIZE[0] * SIZE[1]) ** 2)


def wide_births() -> GaussianMixture:
    """Two places that overlap, whose components are correlated."""
    mean = np.array([[250.0, 200, 1, 0, 40, 60], [400, 260, 0, 0, 60, 60]]).T
    root = np.random.default_rng(3).normal(0, 0.3, (2, 6, 6)) + np.eye(6)
    deviation = np.array([150.0, 120, 3, 3, 25, 25])
    return GaussianMixture(np.array([0.2, 0.1]), mean, root @ root.transpose(0, 2, 1) * np.outer(deviation, deviation))


LOCAL = MeasurementBirth(volume="local", births_per_second=25 * 0.05)
IMAGE = MeasurementBirth(volume="image", births_per_second=25 * 0.05, frame_size=SIZE)
MODELS = {
    "particle": Model(BoxMotion(frame_size=SIZE), BoxSensor(), IMAGE, EVERYWHERE),
    "local": Model(BoxMotion(frame_size=SIZE), BoxSensor(detection_probability=0.8), LOCAL, LocalClutter(0.4)),
    "local births": Model(BoxMotion(), BoxSensor(min_noise=0.0), LOCAL, EVERYWHERE),
    "local clutter": Model(BoxMotion(), BoxSensor(scaling="detection"), IMAGE, LocalClutter(1e-4)),
    "given": Model(BoxMotion(survival_probability=0.8**25), BoxSensor(scaling="given"), LOCAL, EVERYWHERE),
    "fixed": Model(BoxMotion(1.2, 2.0, scaled_noise=False), BoxSensor(scaling="fixed"), IMAGE, EVERYWHERE),
    "never missed": Model(
        BoxMotion(survival_probability=1.0), BoxSensor(detection_probability=1.0), IMAGE, UniformClutter(0.0, 1.0)
    ),
    "given births": Model(BoxMotion(frame_size=SIZE), BoxSensor(), FixedBirth(wide_births()), EVERYWHERE),
    "learned births": Model(BoxMotion(), BoxSensor(scaling="given"), scene(2)[0], UniformClutter(0.1, 1e11)),
    "learned clutter": Model(BoxMotion(), BoxSensor(scaling="fixed"), LOCAL, scene(3)[1]),
    "laid over": Model(BoxMotion(frame_size=SIZE), BoxSensor(), *laid_over(4)),
    "laid over, given": Model(BoxMotion(), BoxSensor(scaling="given"), laid_over(5)[0], LocalClutter(0.4)),
    "laid over, fixed": Model(BoxMotion(1.2, 2.0, scaled_noise=False), BoxSensor(scaling="fixed"), *laid_over(6)),
    "clutter laid over": Model(BoxMotion(), BoxSensor(scaling="detection"), LOCAL, laid_over(7)[1]),
    "beside a scene": Model(BoxMotion(), BoxSensor(), scene(8)[0], laid_over(8)[1]),
    "no births": Model(BoxMotion(), BoxSensor(), MeasurementBirth(births_per_second=0.0, frame_size=SIZE), EVERYWHERE),
}
FILTERS = {
    "default": PMB(),
    "always in view": PMB(mean_visible_time=0.0, static_clutter_prior=0.0),
    "no sources": PMB(static_clutter_prior=0.0, history=3),
    "sources": PMB(
        static_clutter_prior=0.5, static_clutter_detection_probability=0.9, mean_visible_time=1.0, mean_occluded_time=1.0
    ),
    "few": PMB(max_hypotheses=2, hypothesis_threshold=0.2, existence_threshold=5e-3, gate_probability=0.94),
    "all": PMB(max_hypotheses=30, hypothesis_threshold=1e-4, existence_threshold=1e-5, merge_distance=0.0),
    "merging": PMB(merge_distance=3.0),
}


def scans(seed: int, count: int) -> list[np.ndarray]:
    return box_scans(seed, count, SIZE, 60.0, 6.0)


def measured(model: Model, seed: int, count: int) -> list[np.ndarray]:
    """Scans as the model's sensor measures."""
    rows = 8 if model.sensor.scaling == "given" else 4
    return [np.ascontiguousarray(z[:rows]) for z in scans(seed, count)]


def agree(a: Bernoullis, b: Bernoullis, rtol: float = 1e-9) -> None:
    """Every field of the last layer, in the same order."""
    for field in fields(a.present):
        one, other = getattr(a.present, field.name), getattr(b.present, field.name)
        assert one.shape == other.shape, field.name
        if one.dtype == np.float64:
            np.testing.assert_allclose(one, other, rtol=rtol, atol=rtol * 1e-3, err_msg=field.name)
        else:
            np.testing.assert_array_equal(one, other, err_msg=field.name)
    assert a.fresh == b.fresh
    np.testing.assert_array_equal(a.ended, b.ended)
    assert len(a.layers) == len(b.layers)


def without_mixed(state: Bernoullis) -> Bernoullis:
    """Without covariances between the axes and sizes, which first states from given births have: the kernel has none."""
    own = np.eye(6) + np.eye(6, k=2) * (np.arange(6) < 2)[:, None]
    layer = replace(state.present, covariance=state.present.covariance * (own + np.triu(own, 1).T))
    return replace(state, layers=(*state.layers[:-1], layer))


def told_alike(info, expected) -> None:
    np.testing.assert_allclose(info.evidence, expected.evidence, rtol=1e-9, atol=1e-22)
    np.testing.assert_allclose(info.clutter, expected.clutter, rtol=1e-9, atol=1e-22)
    for name in ("mass_predicted", "mass_born", "mass"):
        assert getattr(info, name) == pytest.approx(getattr(expected, name), rel=1e-9, abs=1e-15)
    assert info.vanished == expected.vanished


@pytest.mark.parametrize("settings", FILTERS.values(), ids=FILTERS)
@pytest.mark.parametrize("name", MODELS)
def test_the_fused_step_is_the_composition(name: str, settings: PMB):
    """Along a run with dropped frames and empty scans: every field, masses and evidence."""
    model, rng = MODELS[name], np.random.default_rng(0)
    assert box_model(model, 1.0) is not None, "the fused path is tested"
    state, most = settings.start(model, rng), 0
    # The first scan is empty.
    for k, z in enumerate([np.zeros((len(measured(model, 1, 1)[0]), 0)), *measured(model, len(name), 13)]):
        dt = (1.0, 0.5, 3.0)[k % 3]
        fused, info = settings.step(state, z, model, dt, rng)
        general, expected = composed_step(settings, state, z, model, dt, rng)
        agree(fused, without_mixed(general))
        told_alike(info, expected)
        most = max(most, len(fused))
        # From the same state again: rounding must not be given the time to grow.
        state = fused
    assert (most == 0) == (name == "no births"), "there was something to compare"


def test_who_leaves_the_image_is_given_up_by_both():
    model, settings, rng = MODELS["particle"], PMB(), np.random.default_rng(0)
    state = settings.start(model, rng)
    for k in range(40):
        z = np.array([[500.0 + 10 * k], [240], [40], [90]])
        fused, _ = settings.step(state, z[:, : 0 if k > 14 else 1], model, 1.0, rng)
        state, _ = composed_step(settings, state, z[:, : 0 if k > 14 else 1], model, 1.0, rng)
        agree(fused, state)
        assert k > 8 or len(state)
    assert len(state) == 0
    assert state.fresh == 1


def test_with_scores():
    """κ by measurement, in whatever order the kernel looks at them."""
    rng = np.random.default_rng(2)
    settings, state = PMB(), PMB().start(MODELS["particle"], rng)
    for z in measured(MODELS["particle"], 3, 14):
        model = replace(MODELS["particle"], clutter=ScoredClutter(EVERYWHERE, 10 ** rng.normal(0, 1, z.shape[1])))
        assert box_model(model, 1.0) is not None
        fused, info = settings.step(state, z, model, 1.0, rng)
        state, expected = composed_step(settings, state, z, model, 1.0, rng)
        agree(fused, state)
        told_alike(info, expected)
    assert len(state) > 3


def seen_from(turn: float) -> list[tuple[Bernoullis, Bernoullis]]:
    """Fused and general, each from the general state before, as a camera shakes, zooms and turns by so much a frame."""
    rng, settings, state = np.random.default_rng(2), PMB(), PMB().start(MODELS["particle"], np.random.default_rng(0))
    out = []
    for k, z in enumerate(measured(MODELS["particle"], 3, 14)):
        warp = np.array([[1.01, turn, 5.0 * (-1) ** k], [-turn, 1.01, 3.0], [0, 0, 1]])
        model = replace(MODELS["particle"], warp=warp)
        fused, _ = settings.step(state, z, model, 1.0, rng)
        state, _ = composed_step(settings, state, z, model, 1.0, rng)
        out.append((fused, state))
    return out


def test_with_a_camera_that_shakes_and_zooms():
    for fused, general in seen_from(0.0):
        agree(fused, general)
    assert len(general) > 3


def test_with_a_camera_that_turns():
    """A degree a frame: what is left out moves nobody by a fifth of his deviation."""
    worst, apart = 0.0, 0.0
    for fused, general in seen_from(0.02):
        assert fused.present.label.tolist() == general.present.label.tolist()
        worst = max(worst, np.abs(fused.present.exist - general.present.exist).max(initial=0))
        there = fused.present.presence > 0.5
        best = general.present.best[there]
        step = fused.present.mean[:2, best] - general.present.mean[:2, best]
        apart = max(apart, np.abs(step / np.sqrt(general.present.covariance[best][:, (0, 1), (0, 1)].T)).max(initial=0))
    assert worst < 1e-3
    assert 0 < apart < 0.2


@pytest.mark.parametrize("name", ["particle", "local", "given"])
def test_over_a_run_they_stay_together(name: str):
    """Each from its own state: frames with gaps, and at the end the same targets."""
    model, settings, rng = MODELS[name], PMB(), np.random.default_rng(0)
    fused = general = settings.start(model, rng)
    for k, z in enumerate(measured(model, 7, 50)):
        fused, _ = settings.step(fused, z, model, 1.0 + (k % 9 == 8), rng)
        general, _ = composed_step(settings, general, z, model, 1.0 + (k % 9 == 8), rng)
    agree(fused, general, 1e-6)
    assert fused.fresh > 40


def test_more_pairs_than_there_is_room_for(rng):
    """Buffers grow: every hypothesis meets every measurement."""
    model, settings = MODELS["fixed"], FILTERS["all"]
    state = settings.start(model, rng)
    for _ in range(4):
        z = np.array([[300.0], [200], [40], [100]]) + rng.normal(0, 3, (4, 25))
        fused, _ = settings.step(state, z, model, 1.0, rng)
        state, _ = composed_step(settings, state, z, model, 1.0, rng)
        agree(fused, state, 1e-7)
    assert len(state) > 100


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_measurements_that_are_no_numbers_are_refused(bad: float, rng):
    z = np.array([[100.0, bad], [200, 100], [40, 40], [100, 100]])
    with pytest.raises(ValueError, match="finite"):
        PMB().step(PMB().start(MODELS["particle"], rng), z, MODELS["particle"], 1.0, rng)
