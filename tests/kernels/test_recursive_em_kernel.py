import numpy as np
import pytest

from phdtrack.kernels.recursive_em import recursive_em
from reference.recursive_em_twin import recursive_em as twin


def mixture(rng, count, dim):
    root = rng.normal(size=(count, dim, dim))
    weight = rng.random(count) + 0.1
    return weight / weight.sum(), 5 * rng.normal(size=(count, dim)), root @ root.transpose(0, 2, 1) + 0.5 * np.eye(dim)


def compare(rng, count, dim, memory, samples, worth):
    """Kernel and twin on the same samples: what is left of the components is the same."""
    weight, mean, cov = mixture(rng, count, dim)
    n = len(samples)
    tau, floor, extent = (dim + dim * (dim + 1) / 2) / 2, np.full(dim, 0.01), np.linspace(30, 60, dim)
    expected = twin(weight, mean, cov, 0.9, samples, tau, memory, extent, 1e-3, floor, worth)
    settings = np.array([tau, memory, 1e-3])
    alive, uniform = recursive_em(
        weight, mean, cov, count, 0.9, samples, worth, np.arange(n), settings, np.log(extent), floor, n
    )
    ours, theirs = np.argsort(weight[:alive]), np.argsort(expected[0])
    assert alive == len(theirs)
    assert uniform == pytest.approx(expected[3])
    for found, asked in zip((weight, mean, cov), expected[:3], strict=True):
        np.testing.assert_allclose(found[:alive][ours], asked[theirs], rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize(("count", "dim", "memory"), [(6, 2, 40), (5, 4, 30), (3, 6, 200)])
def test_is_the_rule_as_printed(count, dim, memory):
    rng = np.random.default_rng(count)
    compare(rng, count, dim, memory, 4 * rng.normal(size=(150, dim)), np.ones(150))


@pytest.mark.parametrize(("count", "dim", "memory"), [(5, 4, 30), (3, 6, 200)])
def test_weights_and_what_samples_do_not_show(count, dim, memory):
    rng = np.random.default_rng(10 + count)
    samples = 4 * rng.normal(size=(120, dim))
    # Velocities of some, and of others any rows but one.
    samples[::3, 2:4] = np.nan
    missing = rng.random(samples.shape) < 0.4
    missing[:, 1] = False
    samples[1::3][missing[1::3]] = np.nan
    assert 0 < np.isnan(samples).sum() < samples.size / 2
    compare(rng, count, dim, memory, samples, rng.exponential(size=120))


def test_components_go_in_these_cases():
    # The comparison above would say little of removal if nothing were removed.
    rng = np.random.default_rng(6)
    weight, mean, cov = mixture(rng, 6, 2)
    left = twin(weight, mean, cov, 0.9, 4 * rng.normal(size=(150, 2)), 2.5, 40, np.ones(2), 1e-3, np.full(2, 0.01))
    assert 1 <= len(left[0]) < 6


def test_weights_add_up_to_one_before_any_component_is_removed():
    # As the rule stands, before the kernel divides by the sum: Σ_m [(o_m − τβ)/(1 − Mτβ)] = 1.
    rng = np.random.default_rng(1)
    weight, mean, cov = mixture(rng, 4, 3)
    tau, rate = 4.5, 1e-3
    x = rng.normal(size=3)
    density = [
        w * np.exp(-0.5 * (x - m) @ np.linalg.solve(c, x - m)) / np.sqrt(np.linalg.det(c))
        for w, m, c in zip(weight, mean, cov, strict=True)
    ]
    o = np.array(density) / np.sum(density)
    asked = weight + rate * ((o - tau * rate) / (1 - 4 * tau * rate) - weight)
    assert asked.sum() == pytest.approx(1, abs=1e-14)
    settings, extent = np.array([tau, 1 / rate, 1e-3]), np.full(3, 1.7)
    recursive_em(
        weight, mean, cov, 4, 0.5, x[None], np.ones(1), np.zeros(1, np.int64), settings, extent, np.full(3, 0.01), 1
    )
    np.testing.assert_allclose(weight, asked, rtol=1e-12)


def test_a_rate_that_falls_lets_the_estimate_settle():
    rng = np.random.default_rng(2)
    samples = rng.normal(size=(400, 2))
    order = np.concatenate([rng.permutation(400) for _ in range(40)])
    spread = []
    for steady in (len(order), 400):
        found = []
        for shift in range(6):
            weight, mean, cov = np.ones(1), np.zeros((1, 2)), np.eye(2)[None].copy()
            settings, extent = np.array([2.5, 30.0, 1e-3]), np.full(2, 4.0)
            turned = np.roll(order, 977 * shift)
            floor, worth = np.full(2, 1e-3), np.ones(400)
            recursive_em(weight, mean, cov, 1, 0.5, samples, worth, turned, settings, extent, floor, steady)
            found.append(mean[0])
        spread.append(np.std(found, axis=0).max())
    # Of a rate 1/30 the mean scatters by about √(1/60); after a fall over 39 passes by a few hundredths of that.
    assert spread[1] < 0.3 * spread[0]
