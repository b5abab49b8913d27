"""The PMB filter that finds how noisy and how agile a target is: its tails, its scales, its
motions, what they say.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from mht_cases import RNG, run, told
from pmb_cases import EVERYTHING, NOISE, H, kalman, without_births, world
from scipy.stats import multivariate_t

from phdtrack.errors import InputError
from phdtrack.filters import PMB
from phdtrack.kernels.gaussian import all_gated
from phdtrack.types import GaussianMixture
from views import mixture_of

MEAN = np.array([300.0, 200, 2, 1, 40, 80])
COV = np.diag([9.0, 9, 4, 4, 9, 9])
# One target that is there for certain, always detected, and followed without births.
CERTAIN = without_births(world(detection=1.0, clutter=1e-9, survival=1.0))
GIVEN = GaussianMixture(np.ones(1), MEAN[:, None], COV[None])
ALONE = replace(EVERYTHING, mean_visible_time=0.0, static_clutter_prior=0.0, initial=GIVEN)


def measured(
    rng: np.random.Generator, frames: int, *, noise: float = 1.0, agility: float = 1.0
) -> list[np.ndarray]:
    """Scans of the target, all deviations ``noise`` times the model's, those of its motion
    ``agility`` times that.
    """
    x = rng.multivariate_normal(MEAN, noise**2 * COV)
    scans = []
    for _ in range(frames):
        mean, _, (q,) = CERTAIN.motion.transition(x[:, None], 1.0)
        q[:4] *= agility**2
        x = mean[:, 0] + rng.multivariate_normal(np.zeros(6), noise**2 * q, method="eigh")
        scans.append((H @ x + noise * rng.multivariate_normal(np.zeros(4), NOISE))[:, None])
    return scans


@pytest.mark.parametrize("freedom", [0.5, 4.0, 300.0])
def test_the_density_is_students_t_of_position_and_of_size(freedom: float, rng):
    """SciPy's, with position and size apart: the scale matrix is cS."""
    root = rng.normal(0, 3, (2, 2, 2))
    block = root @ root.transpose(0, 2, 1) + np.eye(2)
    cov = np.zeros((4, 4))
    scale = np.array([0.3, 2.5])
    z = rng.normal(0, 6, (20, 4))
    cov[:2, :2], cov[2:, 2:] = block
    none = np.zeros((0, 4, 4))
    tails = np.array([[*scale, freedom]])
    pairs = all_gated(
        np.arange(4),
        np.zeros((1, 4)),
        cov[None],
        none,
        z,
        none,
        (0.0,) * 4,
        np.inf,
        np.ones(1),
        tails,
    )
    wanted = sum(
        multivariate_t.logpdf(z[:, 2 * k : 2 * k + 2], None, scale[k] * block[k], freedom)
        for k in (0, 1)
    )
    assert len(pairs) == 20
    np.testing.assert_allclose(pairs["log_density"], wanted[pairs["measurement"]], rtol=1e-10)


@pytest.mark.parametrize("memory", [1e12, 4.5])
@pytest.mark.parametrize("noise", [0.4, 1.0, 3.0])
def test_one_target_has_noise_scales_and_the_kalman_state(noise: float, memory: float):
    """With all remembered c = (n₀ + Σd²)/(n₀ + 2N), the conjugate prior's; else what fades between
    frames is the model's.
    """
    start = 6.0
    kept = np.exp(-1 / memory)
    scans = measured(np.random.default_rng(4), 40, noise=noise)
    mean = MEAN
    cov = COV
    n = start
    c = np.ones(2)
    total = np.zeros(2)
    for z in scans:
        moved, spread = kalman(CERTAIN, mean, cov, None, 1.0)
        step = z[:, 0] - H @ moved
        s = H @ spread @ H.T + NOISE
        d2 = np.array(
            [step[at] @ np.linalg.solve(s[at, at], step[at]) for at in (slice(0, 2), slice(2, 4))]
        )
        known = kept * n
        n = known + (1 - kept) * start
        c = (known * c + (n - known)) / n
        c = (n * c + d2) / (n + 2)
        n = n + 2
        total = total + d2
        mean, cov = kalman(CERTAIN, mean, cov, z[:, 0], 1.0)
    state, info = run(replace(ALONE, noise_freedom=start, noise_memory=memory), scans, CERTAIN)
    (h,) = state.present.hypotheses
    found = told(state, CERTAIN)
    assert info.mass == pytest.approx(1)
    np.testing.assert_allclose(
        [h["position_scale"], h["size_scale"], h["freedom"]], [*c, n], rtol=1e-9
    )
    if memory > 1e9:
        np.testing.assert_allclose(c, (start + total) / (start + 2 * 40), rtol=1e-9)
    np.testing.assert_allclose(found.state[:, 0], mean, rtol=1e-9, atol=1e-9)
    root = np.sqrt(c.repeat([4, 2]))
    for said in (found.covariance[0], mixture_of(state).covariance[0]):
        np.testing.assert_allclose(said, root[:, None] * cov * root, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("noise", [1 / 3, 3.0])
@pytest.mark.parametrize("seed", range(4))
def test_scales_are_found(seed: int, noise: float):
    """From n₀ = 8 and 2N squares of deviation k: c has the mean (n₀ + 2Nk²)/(n₀ + 2N), and the
    deviation 2k²√N/(n₀ + 2N).
    """
    frames = 250
    filter_ = replace(ALONE, noise_freedom=8.0, noise_memory=1e12)
    state, _ = run(filter_, measured(np.random.default_rng(seed), frames, noise=noise), CERTAIN)
    (h,) = state.present.hypotheses
    n = 8 + 2 * frames
    wanted = (8 + 2 * frames * noise**2) / n
    deviation = 2 * noise**2 * np.sqrt(frames) / n
    assert wanted == pytest.approx(noise**2, rel=0.15)
    assert abs(h["position_scale"] - wanted) < 4 * deviation
    assert abs(h["size_scale"] - wanted) < 4 * deviation


@pytest.mark.parametrize("freedom", [0.0, 8.0])
@pytest.mark.parametrize("which", [0, 1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_the_factor_of_the_acceleration_is_found(seed: int, which: int, freedom: float):
    factors = (1.0, 3.1623, 10.0)
    filter_ = replace(
        ALONE, acceleration_factors=factors, noise_freedom=freedom, hypothesis_threshold=1e-6
    )
    state, _ = run(
        filter_, measured(np.random.default_rng(seed), 100, agility=factors[which]), CERTAIN
    )
    hypotheses = state.present.hypotheses
    weight = np.bincount(hypotheses["motion"], hypotheses["weight"], 3)
    assert weight.argmax() == which
    assert weight[which] > 0.5


def test_noises_are_learned_of_two_or_four_components():
    sensor = SimpleNamespace(angles=(False,), measurement_noise=lambda z: np.zeros((0, 1, 1)))
    model = replace(world(), sensor=sensor)
    filter_ = PMB(noise_freedom=3.0)
    with pytest.raises(
        InputError, match=r"^filter\.noise_freedom: .* 2 or 4 components, these have 1"
    ):
        filter_.update(filter_.start(model, RNG), np.zeros((1, 2)), model, 1.0, RNG)
    with pytest.raises(InputError, match="at least one factor"):
        PMB(acceleration_factors=())
