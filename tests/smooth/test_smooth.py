"""The smoother against the joint density of everything at once."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smoothing_cases import model_of, piece, sequence, walk

from phdtrack.smooth.paths import paths_of
from phdtrack.smooth.smoothing import Sequence
from phdtrack.types import MeasurementHistory
from reference import smoothing_twin as twin


def smoothed(tracks, measured, model):
    seen, paths = Sequence.of(measured, model), paths_of(tracks, measured)
    return paths, seen.smooth(paths), seen


@given(st.integers(0, 2**32 - 1), st.lists(st.booleans(), min_size=0, max_size=12), st.floats(0.2, 3.0))
@settings(max_examples=40, deadline=None)
def test_states_are_those_of_the_joint_density(seed: int, missed: list[bool], dt: float):
    rng, model = np.random.default_rng(seed), model_of()
    n = len(missed) + 2
    walked = walk(rng, n, (100, 200), rng.normal(0, 3, 2))
    shown = {k + 1: walked[k] for k in range(n) if k in (0, n - 1) or not missed[k - 1]}
    tracks, even = sequence([shown], n, model)
    measured = MeasurementHistory(even.number, dt * even.time, even.start, even.z, even.warp)
    paths, states, seen = smoothed(tracks, measured, model)
    mean, cov = twin.joint(model.motion, measured.time, seen, paths.measurement)
    np.testing.assert_allclose(states.mean, mean, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(states.covariance, cov, rtol=1e-6, atol=1e-6)


def test_paths_side_by_side_are_what_each_is_alone(rng):
    model = model_of(scaled_noise=True, acceleration=0.005, size_noise=0.07)
    a, b = walk(rng, 30, (100, 200), (2, 0)), walk(rng, 30, (400, 100), (-1, 1))
    pieces = [piece(a, 1, (1, 10), (14, 30)), piece(b, 1, (6, 25))]
    both = smoothed(*sequence(pieces, 30, model), model)
    for k, alone in enumerate(pieces):
        _, states, _ = smoothed(*sequence([alone], 30, model), model)
        rows = slice(both[0].start[k], both[0].start[k + 1])
        np.testing.assert_allclose(both[1].mean[rows], states.mean, rtol=1e-9)
        np.testing.assert_allclose(both[1].covariance[rows], states.covariance, rtol=1e-9, atol=1e-9)


def test_errors_are_as_large_as_the_covariance_says():
    """The normalised squared error of what was drawn from the model itself has the mean of its dimension."""
    rng, model = np.random.default_rng(3), model_of()
    errors, n = [], 20
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
