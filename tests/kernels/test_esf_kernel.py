"""Elementary symmetric functions in logarithms against sums over subsets and exact fractions, at
any magnitude.
"""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.kernels.esf import log_products, log_sums_without, thinned
from reference import esf_twin as twin


def logs(values) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.log(np.asarray(values, dtype=np.float64))


def assert_logs(found, exact, relative: float) -> None:
    """Logarithms of values that agree to ``relative``, zeros where zeros are."""
    expected = np.array([twin.log_of(value) for value in exact])
    np.testing.assert_array_equal(np.isneginf(found), np.isneginf(expected))
    here = np.isfinite(expected)
    np.testing.assert_allclose(found[here], expected[here], rtol=0, atol=relative)


# What a logarithm of size 1e4 can tell of its number, over some factors: 1e4 · 2⁻⁵³ · 30.
@pytest.mark.parametrize(("decades", "relative"), [(3, 1e-13), (300, 1e-10)])
def test_products_and_sums_without_each_at_any_magnitude(decades: int, relative: float, rng):
    for m in (1, 2, 7, 24):
        a, b, w = (10.0 ** rng.uniform(-decades, decades, n) for n in (m, m, m))
        a[rng.random(m) < 0.1] = 0.0
        b[rng.random(m) < 0.2] = 0.0
        w[rng.random(m) < 0.2] = 0.0
        products = log_products(logs(a), logs(b), m)
        assert_logs(products[-1], twin.coefficients(a, b), relative)
        assert_logs(
            log_sums_without(logs(a), logs(b), products, logs(w)),
            twin.sums_without(a, b, w),
            relative,
        )


def test_products_can_be_cut_at_the_most_targets(rng):
    a = rng.uniform(0, 1, 8)
    b = rng.uniform(0, 1, 8)
    w = rng.uniform(0, 1, 4)
    cut = log_products(logs(a), logs(b), 3)
    assert cut.shape == (9, 4)
    assert_logs(cut[-1], twin.coefficients(a, b)[:4], 1e-13)
    assert_logs(log_sums_without(logs(a), logs(b), cut, logs(w)), twin.sums_without(a, b, w), 1e-13)


def test_no_factors_give_the_constant_one():
    none = np.zeros(0)
    products = log_products(none, none, 5)
    np.testing.assert_array_equal(products, [[0.0]])
    assert log_sums_without(none, none, products, np.zeros(3)).shape == (0,)


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.99, 1.0])
def test_thinning_is_binomial(keep: float, rng):
    p = rng.dirichlet(np.ones(12))
    found = thinned(p, keep)
    np.testing.assert_allclose(found, twin.thinned(p, keep), rtol=1e-13, atol=1e-300)
    assert found.sum() == pytest.approx(1, rel=1e-14)
    assert found @ np.arange(12) == pytest.approx(keep * (p @ np.arange(12)), rel=1e-13)
