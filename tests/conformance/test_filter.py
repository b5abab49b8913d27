"""What every filter must do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shipped import (
    BIRTHS,
    CLUTTERS,
    FILTERS,
    SENSORS,
    detections,
    fixed,
    frozen,
    keeps,
    model_of,
    often,
)

from composed import composed_step
from phdtrack.filters import MCMC, PMB, ParticleCPHD, ParticlePHD
from phdtrack.filters.cardinality import Cardinalised
from phdtrack.filters.hypotheses import Hypotheses
from phdtrack.filters.pmb import Bernoullis
from phdtrack.protocols import Filter
from phdtrack.types import GaussianMixture, ParticleBlocks
from views import mixture_of

# Those whose steps draw random numbers.
RANDOM = ParticlePHD | ParticleCPHD | MCMC
pytestmark = pytest.mark.parametrize("filter_", FILTERS.values(), ids=FILTERS)


def intensity(state):
    """The intensity alone of what a filter carries."""
    if isinstance(state, Bernoullis):
        return mixture_of(state)
    if isinstance(state, Hypotheses):
        return GaussianMixture(
            state.probability * state.leaves.r, state.leaves.mean.T.copy(), state.leaves.covariance
        )
    return state.intensity if isinstance(state, Cardinalised) else state


def points(state) -> np.ndarray:
    """(d, L) the states of an intensity: its particles, or the means of its Gaussians."""
    held = intensity(state)
    return held.mean if isinstance(held, GaussianMixture) else held.state


def scans(rng, count: int) -> list[np.ndarray]:
    """Two targets that are seen, and now and then something else; some scans are empty."""
    model = model_of()
    steady = detections(rng, 2)
    out = []
    for k in range(count):
        extra = detections(rng, int(rng.integers(0, 3)))
        found = np.vstack([steady.xyxy, extra.xyxy]) if k % 4 else np.zeros((0, 4))
        out.append(fixed(model.sensor.measure(type(extra).of(found))))
    return out


def test_signatures(filter_):
    keeps(Filter, filter_)


def test_information_agrees_with_the_state(filter_, rng):
    model = model_of()
    state = filter_.start(model, rng)
    for z in scans(rng, 9):
        predicted = filter_.predict(state, model, 1.0, rng)
        updated, info = filter_.update(predicted, z, model, 1.0, rng)
        n = z.shape[1]
        assert info.evidence.shape == info.clutter.shape == info.clutter_probability.shape == (n,)
        assert ((info.clutter_probability >= 0) & (info.clutter_probability <= 1)).all()
        assert info.mass == pytest.approx(updated.mass)
        assert 0 <= info.mass_born <= info.mass_predicted + 1e-12
        assert 0 <= info.vanished <= n
        state = filter_.reduce(updated, rng)
        # Less than half a particle's worth of mass is no particle.
        assert state.mass == pytest.approx(updated.mass, abs=0.5 / 200), "reducing keeps the mass"
        assert len(state) <= max(len(updated), 200 * state.mass + 1)


def test_states_are_values_and_runs_repeat(filter_):
    """No state is written into, nothing is stored on the filter, and the same seed gives the
    same.
    """
    model = model_of()
    before = repr(filter_)
    results = []
    for _ in range(2):
        rng = np.random.default_rng(5)
        state = frozen(filter_.start(model, rng))
        for z in scans(np.random.default_rng(6), 8):
            state, _ = composed_step(filter_, state, z, model, 1.0, rng)
            frozen(state)
        results.append(state)
    np.testing.assert_array_equal(points(results[0]), points(results[1]))
    np.testing.assert_array_equal(intensity(results[0]).weight, intensity(results[1]).weight)
    assert repr(filter_) == before


def averages(advance, filter_, model, dt: float, seeds) -> np.ndarray:
    """(seeds, statistics): masses, evidence and the mean state after each of five scans."""
    rows = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        row = []
        state = filter_.start(model, rng)
        for z in scans(np.random.default_rng(6), 5):
            state, info = advance(filter_, state, z, model, dt, rng)
            row += [
                info.mass_predicted,
                info.mass_born,
                info.mass,
                state.mass,
                *info.evidence,
                *info.clutter,
            ]
        x = points(state)
        row += [*x.mean(1)] if x.shape[1] else [0.0] * len(x)
        rows.append(row)
    return np.array(rows, dtype=np.float64)


def runs(filter_, count: int) -> int:
    """How many of the seeds an average takes: half of them for the filter that takes longest by
    far, two if it is the same for every seed.
    """
    if isinstance(filter_, MCMC):
        return count // 2
    if isinstance(filter_, RANDOM):
        return count
    return 2


@pytest.mark.parametrize("dt", [1.0, 2.5])
def test_a_step_is_predict_update_and_reduce(filter_, dt: float):
    """On average over seeds, to 4.5 standard errors; what draws no random numbers to rounding."""
    model = model_of()
    count = runs(filter_, 50)
    ours = averages(type(filter_).step, filter_, model, dt, range(count))
    theirs = averages(composed_step, filter_, model, dt, range(100, 100 + count))
    error = np.sqrt((ours.var(0, ddof=1) + theirs.var(0, ddof=1)) / count)
    rounding = 1e-6 * np.abs(theirs).max(0) + 1e-30
    np.testing.assert_array_less(np.abs(ours.mean(0) - theirs.mean(0)), 4.5 * error + rounding)


def test_two_steady_targets_count_as_two(filter_, rng):
    if isinstance(filter_, PMB):
        # What does not move by a pixel would be a source of false alarms.
        filter_ = replace(filter_, static_clutter_prior=0.0)
    model = model_of()
    state = filter_.start(model, rng)
    z = model.sensor.measure(detections(np.random.default_rng(2), 2))
    for _ in range(12):
        state, info = composed_step(filter_, state, z, model, 1.0, rng)
    assert info.mass == pytest.approx(2, abs=0.35)


def test_nothing_comes_of_nothing(filter_, rng):
    model = model_of()
    state = filter_.start(model, rng)
    for _ in range(200):
        state, info = composed_step(filter_, state, np.zeros((4, 0)), model, 1.0, rng)
        assert np.isfinite(info.mass)
    assert info.mass < 0.1


@pytest.mark.parametrize("scene", ["learned", "laid over"])
def test_every_learned_scene_will_do(filter_, scene: str):
    """A step is what it is defined as, on average over seeds to 4.5 standard errors, and who is
    seen again is there.
    """
    model = replace(model_of(), birth=often(BIRTHS[scene]), clutter=CLUTTERS[scene])
    count = runs(filter_, 30)
    ours = averages(type(filter_).step, filter_, model, 1.0, range(count))
    theirs = averages(composed_step, filter_, model, 1.0, range(100, 100 + count))
    error = np.sqrt((ours.var(0, ddof=1) + theirs.var(0, ddof=1)) / count)
    rounding = 1e-6 * np.abs(theirs).max(0) + 1e-30
    if scene == "laid over" or not isinstance(filter_, PMB):
        np.testing.assert_array_less(np.abs(ours.mean(0) - theirs.mean(0)), 4.5 * error + rounding)
    rng = np.random.default_rng(0)
    z = model.sensor.measure(detections(np.random.default_rng(2), 2))
    state = filter_.start(model, rng)
    for k in range(12):
        moved = z + np.array([[3.0 * k], [2.0 * k], [0], [0]])
        state, info = filter_.step(state, moved, model, 1.0, rng)
    assert info.mass == pytest.approx(2, abs=0.35)


@pytest.mark.parametrize("scaling", ["detection", "fixed", "given"])
def test_every_sensor_will_do(filter_, scaling: str, rng):
    model = model_of(SENSORS[scaling])
    state = filter_.start(model, rng)
    z = model.sensor.measure(detections(np.random.default_rng(2), 2))
    for _ in range(6):
        state, info = composed_step(filter_, state, z, model, 1.0, rng)
    assert len(points(state)) == model.motion.dim
    assert np.isfinite(info.mass)


def seen_from(filter_, path: np.ndarray) -> np.ndarray:
    """Mass, and mean and deviation of places brought home, after scans by a camera that is shifted
    along ``path`` (n, 2).
    """
    rows = []
    for seed in range(runs(filter_, 20)):
        rng = np.random.default_rng(seed)
        model = model_of()
        state = filter_.start(model, rng)
        shift = np.zeros(2)
        for k, z in enumerate(scans(np.random.default_rng(6), len(path))):
            warp = np.eye(3)
            warp[:2, 2] = path[k] - shift
            shift = path[k]
            there = np.vstack([z[:2] + shift[:, None], z[2:]])
            state, _ = filter_.step(state, there, replace(model, warp=warp), 1.0, rng)
        held = intensity(state)
        held = held.particles() if isinstance(held, ParticleBlocks) else held
        place = points(state)[:2] - shift[:, None]
        weight = held.weight / held.weight.sum()
        rows.append(
            [held.mass, *(place @ weight), *np.sqrt(place**2 @ weight - (place @ weight) ** 2)]
        )
    return np.array(rows)


def test_a_camera_that_moves_takes_the_states_along(filter_):
    """What is there is as where the camera stands; without being told all but the last scan would
    be forgotten.
    """
    path = np.random.default_rng(1).normal(0, 60, (8, 2)).round()
    path[0] = 0
    still = seen_from(filter_, np.zeros((8, 2)))
    moved = seen_from(filter_, path)
    error = np.sqrt((still.var(0, ddof=1) + moved.var(0, ddof=1)) / len(still))
    assert (np.abs(moved.mean(0) - still.mean(0)) < 4.5 * error + 1e-6 * np.abs(still).max(0)).all()
