"""Batch EM beside the uniform part, and the moves that add and remove components."""

import numpy as np
import pytest

from phdtrack.scene import ContextDensity, RecursiveEM
from phdtrack.scene.batch_em import Samples, fitted, likelihood, log_parts, moments, parameters
from phdtrack.scene.learning import learn_clutter
from phdtrack.scene.moves import criterion, improved
from phdtrack.types import F8

LOW, HIGH = np.zeros(4), np.array([640.0, 480, 120, 240])
WIDE = np.diag([180.0, 130, 8, 20]) ** 2
PLACE = np.diag([3.0, 8, 3, 8]) ** 2


def density(mean: list[list[float]], cov: list[F8], weight: list[float], uniform: float = 0.05) -> ContextDensity:
    return ContextDensity(LOW, HIGH, uniform, np.array(weight), np.array(mean, np.float64).T, np.array(cov))


def samples_of(x: F8, worth: F8 | None = None, floor: float = 1e-4) -> Samples:
    return Samples.of(x, np.ones(x.shape[1]) if worth is None else worth, np.full(len(x), floor), 1e-3)


def gaussian(x: F8, mean: F8, cov: F8) -> float:
    """log N, of one sample."""
    step = x - mean
    return float(-0.5 * (step @ np.linalg.solve(cov, step) + np.linalg.slogdet(2 * np.pi * cov)[1]))


def step_by_step(p: ContextDensity, seen: Samples) -> tuple[F8, F8, F8, float]:
    """One step of EM sample by sample: masses, means, covariances, and the uniform part's mass."""
    m, d = len(p), p.dim
    mass, first, second, flat = np.zeros(m), np.zeros((m, d)), np.zeros((m, d, d)), 0.0
    for j in range(seen.x.shape[1]):
        rows = np.flatnonzero(~np.isnan(seen.x[:, j]))
        rest = np.flatnonzero(np.isnan(seen.x[:, j]))
        x = seen.x[rows, j]
        logs = [np.log(p.uniform) - np.log((p.high - p.low)[rows]).sum()]
        for k in range(m):
            cov = p.covariance[k][np.ix_(rows, rows)]
            logs.append(np.log((1 - p.uniform) * p.weight[k]) + gaussian(x, p.mean[rows, k], cov))
        share = seen.worth[j] * np.exp(np.array(logs) - np.logaddexp.reduce(logs))
        flat += share[0]
        for k in range(m):
            whole, left = np.empty(d), np.zeros((d, d))
            gain = p.covariance[k][np.ix_(rest, rows)] @ np.linalg.inv(p.covariance[k][np.ix_(rows, rows)])
            whole[rows], whole[rest] = x, p.mean[rest, k] + gain @ (x - p.mean[rows, k])
            left[np.ix_(rest, rest)] = p.covariance[k][np.ix_(rest, rest)] - gain @ p.covariance[k][np.ix_(rows, rest)]
            left[rows, rows] += seen.floor[rows]
            mass[k] += share[k + 1]
            first[k] += share[k + 1] * whole
            second[k] += share[k + 1] * (np.outer(whole, whole) + left)
    mean = first / mass[:, None]
    cov = second / mass[:, None, None] - np.einsum("kr,ks->krs", mean, mean)
    return mass, mean, cov, flat


def two() -> ContextDensity:
    slanted = WIDE.copy()
    slanted[0, 2] = slanted[2, 0] = 700.0
    return density([[320, 240, 40, 90], [500, 100, 30, 70]], [slanted, PLACE * 4], [0.7, 0.3])


@pytest.mark.parametrize("hidden", [False, True])
def test_a_step_of_em_is_that_of_each_sample(hidden):
    rng = np.random.default_rng(1)
    p = two()
    x = p.sample(120, rng)
    if hidden:
        x[2:, ::3] = np.nan
        x[1, 1::7] = np.nan
    seen = samples_of(x, rng.uniform(0.2, 1.5, 120), 0.3)
    mass, mean, cov, flat = step_by_step(p, seen)
    parts = log_parts(p, seen)
    belongs = np.exp(parts - np.logaddexp.reduce(parts, axis=0)) * seen.worth
    np.testing.assert_allclose(belongs.sum(axis=1), [flat, *mass], rtol=1e-9)
    ours = moments(p, belongs[1:], seen)
    np.testing.assert_allclose(ours[0].T, mean, rtol=1e-9)
    np.testing.assert_allclose(ours[1], cov, rtol=1e-6, atol=1e-6)


def test_em_raises_the_likelihood_step_by_step_and_leaves_what_was_given():
    rng = np.random.default_rng(2)
    p = two()
    seen = samples_of(p.sample(300, rng), floor=1e-9)
    shifted = density([[300, 260, 45, 80], [480, 120, 33, 75]], [WIDE, PLACE * 9], [0.5, 0.5], 0.5)
    before = shifted.mean.copy(), shifted.covariance.copy()
    values = [likelihood(fitted(shifted, seen, steps), seen) for steps in range(8)]
    assert (np.diff(values) > 0).all()
    np.testing.assert_array_equal(shifted.mean, before[0])
    np.testing.assert_array_equal(shifted.covariance, before[1])
    # The truth explains what was drawn of it worse than what was fitted to it.
    assert likelihood(fitted(shifted, seen), seen) > likelihood(p, seen)


def test_a_component_with_less_than_half_its_parameters_goes_and_the_last_stays():
    x = two().sample(100, np.random.default_rng(3))
    far = density([[320, 240, 40, 90], [10, 10, 5, 5]], [WIDE, PLACE], [0.9, 0.1])
    assert len(fitted(far, samples_of(x))) == 1
    # Worth little, one component is kept all the same.
    assert len(fitted(far, samples_of(x, np.full(100, 0.01)))) == 1


def test_the_criterion_is_what_it_says():
    p = two()
    seen = samples_of(p.sample(50, np.random.default_rng(4)))
    assert parameters(4) == 14
    explained = 50 * 0.95 * p.weight
    prices = [7 * (np.log(n) + 6 / (n - 6)) + 0.5 * np.log(50) for n in explained]
    expected = sum(prices) - likelihood(p, seen)
    assert criterion(p, seen) == pytest.approx(expected)


def places(rng: np.random.Generator) -> F8:
    """Twenty samples each of two places, four hundred spread out."""
    spread = np.array([640.0, 480, 1, 1])[:, None] * rng.uniform(0, 1, (4, 400))
    spread[2:] = np.array([[30.0], [75]]) * np.exp(0.25 * rng.standard_normal(400))
    mean = np.array([[300.0, 200, 32, 80], [500, 330, 28, 70]]).T
    each = [m[:, None] + np.array([[3.0], [8], [3], [8]]) * rng.standard_normal((4, 20)) for m in mean.T]
    return np.hstack([spread, *each])[:, rng.permutation(440)]


@pytest.mark.parametrize("seed", range(6))
def test_a_place_that_a_wide_component_has_swallowed_is_found(seed):
    seen = samples_of(places(np.random.default_rng(seed)), floor=0.1)
    found = improved(density([[320, 240, 30, 75]], [WIDE], [1.0]), seen, 20)
    for place in ([300.0, 200, 32, 80], [500, 330, 28, 70]):
        deviation = np.sqrt(np.einsum("mrr->rm", found.covariance))
        near = np.flatnonzero((np.abs(found.mean - np.array(place)[:, None]) < [[3], [8], [3], [8]]).all(axis=0))
        assert len(near) == 1
        assert (deviation[:2, near[0]] < [6, 16]).all()
        assert 440 * (1 - found.uniform) * found.weight[near[0]] == pytest.approx(20, abs=6)


def test_components_too_many_go():
    rng = np.random.default_rng(5)
    flat = rng.uniform(LOW[:, None], HIGH[:, None], (4, 60))
    place = np.array([[300.0], [200], [32], [80]]) + np.array([[3.0], [8], [3], [8]]) * rng.standard_normal((4, 200))
    seen = samples_of(np.hstack([flat, place]))
    same = [[297, 195, 30, 75], [303, 205, 34, 85]]
    begun = density([*same, [320, 240, 60, 120]], [PLACE, PLACE, np.diag([180.0, 130, 35, 70]) ** 2], [0.4, 0.4, 0.2], 1e-3)
    found = improved(begun, seen, 20)
    # One for the place; what is spread evenly over the volume is the uniform part's.
    assert len(found) == 1
    assert found.uniform == pytest.approx(60 / 260, abs=0.01)
    assert len(improved(begun, seen, 0)) == 3


def test_two_places_that_share_a_component_are_parted():
    rng = np.random.default_rng(6)
    means = np.array([[300.0, 200, 32, 80], [330, 200, 32, 80]])
    x = np.hstack([m[:, None] + np.array([[3.0], [8], [3], [8]]) * rng.standard_normal((4, 60)) for m in means])
    found = improved(density([[315, 200, 32, 80]], [np.diag([16.0, 8, 3, 8]) ** 2], [1.0]), samples_of(x), 20)
    assert len(found) == 2
    np.testing.assert_allclose(np.sort(found.mean[0]), [300, 330], atol=3)


def test_what_a_few_samples_tell_is_as_wide_as_the_next_one_is_uncertain():
    """Fresh samples lie as far as their dimension says, squared and on average; by the samples' own covariance further."""
    rng, inside, own = np.random.default_rng(7), [], []
    place = np.array([[300.0], [200], [60], [80]])
    for _ in range(12):
        drawn, fresh = (place + 5 * rng.standard_normal((4, n)) for n in (20, 500))
        p = learn_clutter(drawn, 40, (640.0, 480.0), RecursiveEM(moves=0, floor=1e-6)).learned.density
        assert len(p) == 1
        for cov, out in ((p.covariance[0], inside), (np.cov(drawn, bias=True), own)):
            step = fresh - drawn.mean(axis=1)[:, None]
            out.append(float(np.einsum("rn,rn->n", step, np.linalg.solve(cov, step)).mean()))
    assert np.mean(inside) == pytest.approx(4, rel=0.15)
    assert np.mean(own) > 5
