"""The smoother against the joint density of everything at once, and the evidence for a link against
densities.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smoothing_cases import model_of, piece, sequence, walk

from phdtrack.kernels import rts
from phdtrack.protocols import Model
from phdtrack.smooth.paths import paths_of
from phdtrack.smooth.sequence import Sequence
from phdtrack.smooth.stitching import Stitching, best_successors, candidates
from phdtrack.types import MeasurementHistory
from reference import smoothing_twin as twin


def smoothed(tracks, measured, model):
    seen = Sequence.of(measured, model)
    paths = paths_of(tracks, measured)
    return paths, seen.smooth(paths), seen


@given(
    st.integers(0, 2**32 - 1), st.lists(st.booleans(), min_size=0, max_size=12), st.floats(0.2, 3.0)
)
@settings(max_examples=40, deadline=None)
def test_states_are_those_of_the_joint_density(seed: int, missed: list[bool], dt: float):
    rng = np.random.default_rng(seed)
    model = model_of()
    n = len(missed) + 2
    walked = walk(rng, n, (100, 200), rng.normal(0, 3, 2))
    shown = {k + 1: walked[k] for k in range(n) if k in (0, n - 1) or not missed[k - 1]}
    tracks, even = sequence([shown], n, model)
    measured = MeasurementHistory(even.number, dt * even.time, even.start, even.z, even.warp)
    paths, states, seen = smoothed(tracks, measured, model)
    mean, cov = twin.joint(model.motion, measured.time, seen, paths.measurement)
    np.testing.assert_allclose(states.mean, mean, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(states.covariance, cov, rtol=1e-6, atol=1e-6)


def test_paths_together_equal_each_path_alone(rng):
    model = model_of(scaled_noise=True, acceleration=0.005, size_noise=0.07)
    a = walk(rng, 30, (100, 200), (2, 0))
    b = walk(rng, 30, (400, 100), (-1, 1))
    pieces = [piece(a, 1, (1, 10), (14, 30)), piece(b, 1, (6, 25))]
    both = smoothed(*sequence(pieces, 30, model), model)
    for k, alone in enumerate(pieces):
        _, states, _ = smoothed(*sequence([alone], 30, model), model)
        rows = slice(both[0].start[k], both[0].start[k + 1])
        np.testing.assert_allclose(both[1].mean[rows], states.mean, rtol=1e-9)
        np.testing.assert_allclose(
            both[1].covariance[rows], states.covariance, rtol=1e-9, atol=1e-9
        )


def test_one_path_and_several_use_the_same_kernel(rng):
    """A kernel of its own for one path would be compiled when two tracks are joined for the first
    time, after hours.
    """
    model = model_of()
    a = walk(rng, 30, (100, 200), (2, 0))
    b = walk(rng, 30, (400, 100), (-1, 1))
    known = []
    for pieces in ([piece(a, 1, (1, 30)), piece(b, 1, (1, 30))], [piece(a, 1, (1, 30))]):
        paths, _, seen = smoothed(*sequence(pieces, 30, model), model)
        seen.smooth(paths, seen.fitting(paths))
        known.append(len(rts.filtered.signatures))
    assert known[0] == known[1]


def test_errors_match_the_covariance():
    """The normalised squared error of what was drawn from the model itself has the mean of its
    dimension.
    """
    rng = np.random.default_rng(3)
    model = model_of()
    errors = []
    n = 20
    for _ in range(150):
        start = np.array([320.0, 240.0, 0, 0, 60, 90])
        # An unknown velocity's prior is what the model says.
        start[2:4] = rng.normal(0, 4 / np.sqrt(2), 2)
        course = [start]
        for _ in range(n - 1):
            mean, _, q = model.motion.transition(course[-1][:, None], 1.0)
            course.append(rng.multivariate_normal(mean[:, 0], q[0], check_valid="ignore"))
        x = np.array(course)
        z = x[:, [0, 1, 4, 5]] + rng.normal(0, [2, 2, 3, 3], (n, 4))
        _, states, _ = smoothed(*sequence([{k + 1: z[k] for k in range(n)}], n, model), model)
        for k in (0, 10, n - 1):
            step = states.mean[k] - x[k]
            errors.append(step @ np.linalg.solve(states.covariance[k], step))
    # 450 values of mean 6 and variance 12.
    assert np.mean(errors) == pytest.approx(6, abs=5 * np.sqrt(12 / 450))


def test_variances_stay_positive_when_a_camera_zooms():
    """Exact boxes of a target that accelerates, and a camera that zooms by factors from frame to
    frame.
    """
    rng = np.random.default_rng(0)
    model = model_of(scaled_noise=True, acceleration=0.03, size_noise=1e-4)
    model = replace(
        model, sensor=replace(model.sensor, box_noise=0.001, min_noise=0.0, birth_speed=10.0)
    )
    least = []
    for _ in range(60):
        walked = np.maximum(walk(rng, 40, (100, 200), (2, 1), noise=0.2), 1.0)
        tracks, still = sequence([piece(walked, 1, (1, 15), (20, 40))], 40, model)
        zoom = np.exp(rng.normal(0, 1.0, 40))
        shift = rng.normal(0, 50, (2, 40))
        none = np.zeros(40)
        warp = np.array(
            [[zoom, none, shift[0]], [none, zoom, shift[1]], [none, none, none + 1]]
        ).transpose(2, 0, 1)
        measured = replace(still, warp=np.ascontiguousarray(warp))
        _, states, _ = smoothed(tracks, measured, model)
        least.append(np.diagonal(states.covariance, axis1=1, axis2=2).min())
    assert min(least) >= 0


FITTED = (3.0, 0.5, 0.65, 0.4)


def with_noises(model: Model, factors) -> Model:
    """The model with its deviations of acceleration, of size changes, of positions and of sizes
    times these.
    """
    drive, size, position, extent = factors
    motion = replace(
        model.motion,
        acceleration=drive * model.motion.acceleration,
        size_noise=size * model.motion.size_noise,
    )
    blur = (position * model.sensor.fixed_noise[0], extent * model.sensor.fixed_noise[1])
    return replace(model, motion=motion, sensor=replace(model.sensor, fixed_noise=blur))


def drawn(rng, model: Model, n: int) -> np.ndarray:
    """(n, 6) states from the motion."""
    course = [np.array([320.0, 240.0, *rng.normal(0, 2, 2), 60, 90])]
    for _ in range(n - 1):
        mean, _, q = model.motion.transition(course[-1][:, None], 1.0)
        course.append(rng.multivariate_normal(mean[:, 0], q[0], check_valid="ignore"))
    return np.array(course)


def test_scaled_noises_equal_a_model_with_these_noises(rng):
    model = model_of()
    fine = with_noises(model, FITTED)
    tracks, measured = sequence(
        [piece(walk(rng, 30, (100, 200), (2, 1)), 1, (1, 9), (13, 30))], 30, model
    )
    paths, want, other = smoothed(tracks, measured, fine)
    seen = Sequence.of(measured, model)
    scales = seen.scales(np.array(FITTED)[:, None])
    np.testing.assert_allclose(seen.smooth(paths, scales).mean, want.mean, rtol=1e-9)
    np.testing.assert_allclose(
        seen.smooth(paths, scales).covariance, want.covariance, rtol=1e-9, atol=1e-9
    )
    # The evidence is the density of all measurements after the first: here 26 of four components.
    density = twin.log_density(
        fine.motion, measured.time, other, paths.measurement
    ) + 26 * 2 * np.log(2 * np.pi)
    assert seen.filtered(paths, scales).evidence.sum() == pytest.approx(density, rel=1e-9)


@pytest.mark.parametrize(
    "factors", [(1.0, 1.0, 1.0, 1.0), (9.0, 0.25, 0.4, 0.4), (3.0, 0.5, 0.4, 1.0)]
)
def test_fitted_noises_are_found_and_reduce_errors(factors):
    """Of 40 tracks of 80 frames, drawn from a model with these noises."""
    rng = np.random.default_rng(11)
    model = model_of()
    made = with_noises(model, factors)
    position, extent = made.sensor.fixed_noise
    chosen = []
    gain = []
    for _ in range(40):
        x = drawn(rng, made, 80)
        z = x[:, [0, 1, 4, 5]] + rng.normal(0, [position, position, extent, extent], (80, 4))
        tracks, measured = sequence([dict(enumerate(z, start=1))], 80, model)
        paths, before, seen = smoothed(tracks, measured, model)
        fit = seen.fitting(paths)
        chosen.append(
            [fit.state[0, 0], fit.state[0, 4], fit.measurement[0, 0], fit.measurement[0, 2]]
        )
        after = seen.smooth(paths, fit)
        gain.append([np.square(s.mean - x)[:, [0, 1, 4, 5]].mean() for s in (before, after)])
    np.testing.assert_array_equal(np.median(chosen, axis=0), factors)
    without, fitted = np.array(gain).T
    error = (without - fitted).std() / np.sqrt(40)
    # With the model's own noises it must choose among 18, which costs 2 % at most.
    least = -0.02 * without.mean() - 3 * error if set(factors) == {1.0} else 3 * error
    assert (without - fitted).mean() > least


@pytest.mark.parametrize("seed", range(6))
def test_log_odds_equal_the_ratio_of_densities(seed: int):
    rng = np.random.default_rng(seed)
    model = model_of(survival_probability=1.0)
    n = 24
    walked = walk(rng, n, (200, 200), rng.normal(0, 2, 2), noise=2.0)
    walked[14:] += rng.normal(0, 6, 4)
    tracks, measured = sequence([piece(walked, 1, (1, 9)), piece(walked, 1, (15, n))], n, model)
    seen = Sequence.of(measured, model)
    paths = paths_of(tracks, measured)
    settings = Stitching(0.4 * model.rate, 2.0 * model.rate, 0.0, 0.25)
    before, after, odds = candidates(
        paths, seen.smooth(paths), seen, settings, paths.track_of(measured)
    )
    assert (before.tolist(), after.tolist()) == ([0], [1])
    one = np.concatenate([np.arange(9), np.full(5, -1), np.arange(9, 19)])
    ratio = twin.log_density(model.motion, measured.time, seen, one)
    ratio -= twin.log_density(model.motion, measured.time[:9], seen, one[:9])
    ratio -= twin.log_density(model.motion, measured.time[14:], seen, one[14:])
    # Two beginnings in 23 frames, anywhere among the measurements, seen as finely as those are.
    noise = np.sqrt(seen.covariance[0].diagonal()[seen.observed])
    volume = np.prod(np.ptp(measured.z, axis=1) + 4 * noise)
    prior = np.log(0.25 / 0.75) + np.log(np.exp(-6 / 10) / 10) - np.log(2 / (23 * volume))
    assert odds[0] == pytest.approx(ratio + prior, rel=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_successors_maximise_the_sum_of_log_odds(seed: int):
    rng = np.random.default_rng(seed)
    k = 5
    odds = np.where(rng.random((k, k)) < 0.6, rng.normal(1, 3, (k, k)), -1.0)
    before, after = np.nonzero(odds > -0.5)
    found = best_successors(before, after, odds[before, after], k)

    def best(row: int, free: frozenset[int]) -> float:
        if row == k:
            return 0.0
        return max(
            [best(row + 1, free), *(max(odds[row, c], 0) + best(row + 1, free - {c}) for c in free)]
        )

    chosen = np.flatnonzero(found >= 0)
    assert len(set(found[chosen].tolist())) == len(chosen)
    assert odds[chosen, found[chosen]].sum() == pytest.approx(best(0, frozenset(range(k))))
    assert (odds[chosen, found[chosen]] > 0).all()
