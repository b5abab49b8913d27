"""The recursion of the number of targets: Bayes' rule by enumeration, Poisson numbers, extremes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import poisson as scipy_poisson

from phdtrack.filters.cardinality import factors, poisson, trimmed
from phdtrack.kernels.esf import thinned
from reference import cphd_twin as twin


def mean(p: np.ndarray) -> float:
    return float(p @ np.arange(len(p)))


@pytest.mark.parametrize("clutter", [[], [0.7], [0.3, 2.0], [0.0, 0.4], [0.0, 0.0]])
@pytest.mark.parametrize(
    "p_detect", [[0.9, 0.9, 0.9], [0.2, 0.7, 0.95], [1.0, 1.0, 1.0], [0.0, 0.0, 0.5]]
)
def test_bayes_rule_by_enumeration(clutter: list[float], p_detect: list[float], rng):
    """Up to three targets anywhere in three cells, up to two measurements: number and intensity are
    the posterior's.
    """
    certain = [[0.0, 0.5, 0.0, 0.5], [0.0, 0.0, 1.0]]
    # Where no target can be missed, a number that is known contradicts most scans.
    for cardinality in [[0.1, 0.2, 0.3, 0.4], *(certain if min(p_detect) < 1 else [])]:
        where = rng.dirichlet(np.ones(3))
        likelihood = rng.uniform(0.1, 2, (len(clutter), 3))
        number, expected = twin.posterior(cardinality, where, p_detect, likelihood, clutter)
        mass = mean(np.array(cardinality))
        weight = mass * where
        seen = np.array(p_detect)
        share = likelihood * seen * weight
        found = factors(
            np.array(cardinality),
            mass,
            float(((1 - seen) * weight).sum()),
            share.sum(1),
            np.array(clutter),
        )
        intensity = found.missed * (1 - seen) * weight + found.detected @ share
        np.testing.assert_allclose(intensity, expected, rtol=1e-12)
        np.testing.assert_allclose(
            found.cardinality, number[: len(found.cardinality)], rtol=1e-12, atol=1e-14
        )


@pytest.mark.parametrize("mass", [0.02, 1.0, 9.5, 140.0])
def test_a_poisson_number_gives_the_factors_of_the_phd_filter(mass: float, rng):
    n = 60
    evidence = mass * 10.0 ** rng.uniform(-12, 3, n)
    clutter = 10.0 ** rng.uniform(-9, 1, n)
    # More targets than one would expect beforehand are possible too.
    prior = np.exp(scipy_poisson.logpmf(np.arange(400), mass))
    found = factors(prior, mass, 0.1 * mass, evidence, clutter)
    assert found.missed == pytest.approx(1, rel=1e-10)
    np.testing.assert_allclose(found.detected, 1 / (clutter + evidence), rtol=1e-10)


def test_an_impossible_scan_is_taken_as_the_phd_filter_takes_it():
    """Two targets at most, three detections, no clutter, no births."""
    evidence = np.array([3.0, 1.0, 0.5])
    found = factors(np.array([0.1, 0.1, 0.8]), 1.7, 0.17, evidence, np.zeros(3))
    assert found.missed == pytest.approx(1)
    np.testing.assert_allclose(found.detected, 1 / evidence)
    assert mean(found.cardinality) == pytest.approx(3.17)


def test_numbers_stay_finite_at_the_ends_of_the_scale(rng):
    p = poisson(20.0)
    for evidence, clutter in (
        (1e300, 1e-300),
        (1e-300, 1e300),
        (1e300, 1e300),
        (1e-300, 1e-300),
        (1e-320, 1.0),
        (1.0, 0.0),
    ):
        found = factors(p, 20.0, 0.4, np.full(30, evidence), np.full(30, clutter))
        assert np.isfinite(found.missed)
        assert np.isfinite(found.detected).all()
        assert np.isfinite(found.cardinality).all()
        assert found.cardinality.sum() == pytest.approx(1)
        assert (found.detected * evidence <= 1 + 1e-9).all()


def test_detections_that_nothing_explains_change_nothing():
    p = poisson(3.0)
    evidence = np.array([2.0, 0.3])
    clutter = np.array([0.1, 0.2])
    alone = factors(p, 3.0, 0.3, evidence, clutter)
    among = factors(p, 3.0, 0.3, np.array([0.0, 2.0, 0.3, 0.0]), np.array([5.0, 0.1, 0.2, 0.0]))
    np.testing.assert_allclose(among.cardinality, alone.cardinality)
    np.testing.assert_allclose(among.detected, [0, *alone.detected, 0])


@pytest.mark.parametrize("births", [0.0, 1e-3, 2.0, 300.0])
def test_poisson_numbers_add_and_thin_to_poisson_numbers(births: float):
    before = poisson(7.0)
    after = np.convolve(thinned(before, 0.9), poisson(births, 5))
    expected = scipy_poisson.pmf(np.arange(len(after)), 6.3 + births)
    np.testing.assert_allclose(after, expected, atol=1e-13)
    assert mean(after) == pytest.approx(6.3 + births, rel=1e-11)


def test_no_targets_stay_no_targets():
    found = factors(np.ones(1), 0.0, 0.0, np.zeros(2), np.ones(2))
    np.testing.assert_array_equal(found.cardinality, [1.0])
    np.testing.assert_array_equal(found.detected, [0.0, 0.0])


def test_the_upper_end_is_cut_where_it_adds_nothing_to_the_mean():
    long = np.concatenate([poisson(4.0), np.full(50, 1e-19)])
    kept = trimmed(long)
    assert len(kept) <= len(poisson(4.0)) + 1
    assert mean(kept) == pytest.approx(4.0, rel=1e-12)
    np.testing.assert_array_equal(trimmed(np.array([1.0, 0, 0])), [1.0])
