"""The MCMC filter with given associations, against exact posteriors [D14 Alg. 1, K05]."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.given_chain import Ancestors, Chain, given_chain
from experiments.given_mcmc import GivenMCMC
from phdtrack.errors import InputError
from phdtrack.filters.mcmc import JointSamples
from phdtrack.kernels.particle_models import BLOCK, move
from phdtrack.models import (
    PlaneMotion,
    PlaneSensor,
    PointBirth,
    PointMotion,
    PointSensor,
    UniformClutter,
)
from phdtrack.protocols import Model


@pytest.mark.parametrize("seed", range(4))
def test_the_greedy_chain_is_the_papers(seed: int):
    """Draw by draw: the same generator gives the proposals, D14's Alg. 1 in its own words decides
    about them.
    """
    model = gaussian_worlds()["point"]
    origin, z = gaussian_scan(np.random.default_rng(seed))
    n = 2
    many = 5
    steps = 300
    burn = 20
    running = np.tile(np.arange(1.0, many + 1), (n, 1)) / many
    ancestors = Ancestors(origin, running, np.full((n, many), -np.log(many)))
    motion = model.motion.particle_model(1.0, 1.0)
    sensor = model.sensor.particle_model(z)
    kept = np.empty((4, n * steps))
    chain = Chain(burn, 1, steps, 0.25, False, True)
    counts = given_chain(
        motion, sensor.model, sensor.table, ancestors, chain, np.random.default_rng([seed, 1]), kept
    )
    rng = np.random.default_rng([seed, 1])
    scratch = np.zeros(16 * BLOCK)

    def proposal(t: int) -> np.ndarray:
        scratch[: 4 * BLOCK : BLOCK] = origin[:, t * many + int(rng.random() * many)]
        scratch[8 * BLOCK : 12 * BLOCK : BLOCK] = [rng.standard_normal() for _ in range(4)]
        move(motion, scratch, 0)
        return scratch[: 4 * BLOCK : BLOCK].copy()

    def likelihood(t: int, state: np.ndarray) -> float:
        return float(np.exp(-0.5 * ((z[:2, t] - state[:2]) ** 2).sum()) / (2 * np.pi))

    current = [proposal(t) for t in range(n)]
    cached = [likelihood(t, current[t]) for t in range(n)]
    accepted = 0
    for s in range(burn + steps):
        t = int(rng.random() * n)
        new = proposal(t)
        weight = likelihood(t, new)
        ratio = weight / cached[t]
        if ratio >= 1:
            current[t] = new
            cached[t] = weight
            accepted = accepted + 1
        else:
            cached[t] = ratio
        if s >= burn:
            np.testing.assert_allclose(
                kept.reshape(4, n, steps)[:, :, s - burn], np.stack(current, axis=1), atol=1e-12
            )
    assert counts[0].tolist() == [burn + steps, accepted]
    assert 0 < accepted < steps


def gaussian_worlds() -> dict[str, Model]:
    rest = PointBirth(), UniformClutter(0.0, 1.0)
    return {
        "point": Model(PointMotion(), PointSensor(noise_variance=1.0), *rest),
        # One noise drives position and velocity, and the measurement's noise is no multiple of the
        # identity.
        "plane": Model(PlaneMotion(form="piecewise"), PlaneSensor(scaling="given"), *rest),
    }


def gaussian_scan(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Five samples (4, 10) of two targets, and a scan (6, 2) with covariances and labels."""
    centre = np.array([[0.0, 10], [0, 5], [1, -1], [0, 1]])
    origin = np.repeat(centre, 5, axis=1) + rng.normal(0, 1, (4, 10))
    return origin, np.array([[1.5, 9.0], [0.2, 6.5], [1, 1.2], [0.3, -0.2], [0.8, 1], [0, 1]])


def exact_moments(
    origin: np.ndarray, z: np.ndarray, model: Model
) -> list[tuple[np.ndarray, np.ndarray]]:
    """(8,) mean and (8, 8) covariance of both targets, with a joint ancestor and with ancestors of
    their own.

    Under the posterior of the mixture, by Kalman updates of the 25 pairs of ancestors.
    """
    weights = []
    means = []
    covs = []
    spread = model.sensor.covariance(z, origin[:, :2])
    for r in np.ndindex(5, 5):
        mean = np.zeros(8)
        cov = np.zeros((8, 8))
        log_weight = 0.0
        for t in range(2):
            m, _, q = (
                part[..., 0] if k == 0 else part[0]
                for k, part in enumerate(model.motion.transition(origin[:, [5 * t + r[t]]], 1.0))
            )
            s = q[:2, :2] + spread[t]
            gain = q[:, :2] @ np.linalg.inv(s)
            apart = z[:2, t] - m[:2]
            log_weight -= 0.5 * (apart @ np.linalg.solve(s, apart) + np.linalg.slogdet(s)[1])
            mean[4 * t : 4 * t + 4] = m + gain @ apart
            cov[4 * t : 4 * t + 4, 4 * t : 4 * t + 4] = q - gain @ q[:2]
        weights.append(log_weight)
        means.append(mean)
        covs.append(cov)
    found = []
    for pairs in (range(0, 25, 6), range(25)):
        w = np.exp(np.array(weights)[pairs] - max(weights))
        w /= w.sum()
        mean = w @ np.array(means)[pairs]
        apart = np.array(means)[pairs] - mean
        found.append(
            (
                mean,
                np.einsum("r,rij->ij", w, np.array(covs)[pairs])
                + np.einsum("r,ri,rj->ij", w, apart, apart),
            )
        )
    return found


def sampled(
    filter_: GivenMCMC, origin: np.ndarray, z: np.ndarray, model: Model, rng: np.random.Generator
):
    """(8, N) samples of both targets after one scan."""
    state = JointSamples(origin, np.ones((2, 5)), np.array([0, 1]), 2)
    after, _ = filter_.step(state, z, model, 1.0, rng)
    return after.state.reshape(4, 2, -1).transpose(1, 0, 2).reshape(8, -1)


@pytest.mark.parametrize("world", gaussian_worlds())
@pytest.mark.parametrize("ancestors", ["joint", "each"])
def test_the_chain_samples_the_exact_mixture(world: str, ancestors: str, rng):
    """Mean and covariance of both targets together, correlation through the common ancestor
    included.
    """
    model = gaussian_worlds()[world]
    origin, z = gaussian_scan(rng)
    joint, each = exact_moments(origin, z, model)
    assert np.abs(joint[1][:4, 4:]).max() > 0.02, "with a joint ancestor the targets are correlated"
    np.testing.assert_allclose(each[1][:4, 4:], 0, atol=1e-12)
    mean, cov = joint if ancestors == "joint" else each
    x = sampled(GivenMCMC(samples=400_000, ancestors=ancestors), origin, z, model, rng)
    scale = np.sqrt(np.diag(cov)) + 1e-9
    np.testing.assert_array_less(np.abs(x.mean(1) - mean) / scale, 0.04)
    np.testing.assert_array_less(np.abs(np.cov(x) - cov) / np.outer(scale, scale), 0.06)


def test_greedy_acceptance_does_not_sample(rng):
    """The chain as D14 prints it does not converge to the posterior, however long it runs."""
    model = gaussian_worlds()["point"]
    origin, z = gaussian_scan(rng)
    _, cov = exact_moments(origin, z, model)[1]
    x = sampled(GivenMCMC(samples=200_000, greedy=True), origin, z, model, rng)
    assert np.abs(np.diag(np.cov(x)) / np.diag(cov) - 1).max() > 0.2


def test_targets_come_and_go_with_their_labels(rng):
    model = gaussian_worlds()["point"]
    filter_ = GivenMCMC(samples=300)
    state = filter_.start(model, rng)

    def scan(**seen: float) -> np.ndarray:
        return np.array([[x, 2 * x, int(label[1:])] for label, x in seen.items()]).reshape(-1, 3).T

    for z, labels in (
        (scan(t3=10, t1=50), [1, 3]), (scan(t1=50, t7=90, t3=11), [1, 3, 7]), (scan(t7=90), [7]),
        (scan(), []), (scan(t1=20), [1]),
    ):  # fmt: skip
        state, info = filter_.step(state, z, model, 1.0, rng)
        np.testing.assert_array_equal(state.label, labels)
        means = state.state.reshape(4, -1, 300)[0].mean(1)
        expected = z[0][np.argsort(z[2])]
        np.testing.assert_allclose(means, expected, atol=1.5)
        assert info.mass == state.mass == len(labels)
        np.testing.assert_array_equal(np.flatnonzero(info.cardinality), [len(labels)])


@pytest.mark.parametrize("labels", [[0, 0], [0.5, 1], [-1, 2]])
def test_what_is_no_label(labels, rng):
    model = gaussian_worlds()["point"]
    filter_ = GivenMCMC()
    z = np.array([[0.0, 1], [0, 1], labels])
    with pytest.raises(InputError, match="one target's label each"):
        filter_.step(filter_.start(model, rng), z, model, 1.0, rng)
