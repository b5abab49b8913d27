"""The kernels of expectation and maximisation against their definition."""

import numpy as np
import pytest

from phdtrack.kernels.mixtures import Candidates, Gaussians, em_step, nothing_known, one_block
from phdtrack.types import F8
from reference import em as defined


def cloud(rng: np.random.Generator) -> tuple[F8, Gaussians]:
    """500 samples in three dimensions, and four overlapping Gaussians."""
    root = rng.normal(size=(4, 3, 3))
    mixture = Gaussians(rng.uniform(0.1, 0.3, 4), 3 * rng.normal(size=(3, 4)), root @ root.transpose(0, 2, 1) + np.eye(3))
    return 3 * rng.normal(size=(3, 500)), mixture


@pytest.mark.parametrize(("dtype", "close"), [(np.float64, 1e-10), (np.float32, 1e-3)])
def test_a_step_is_that_of_the_definition(dtype: type[np.floating], close: float) -> None:
    rng = np.random.default_rng(1)
    x, mixture = cloud(rng)
    weight, background = rng.uniform(0.2, 2, 500), rng.normal(-8, 1, 500)
    found = em_step(x.astype(dtype), weight, background, mixture, one_block(500, 4), nothing_known(3))
    for mine, expected in zip(found, defined.em_step(x, weight, background, mixture), strict=True):
        np.testing.assert_allclose(mine, expected, rtol=close, atol=close)


def test_components_explain_only_the_blocks_that_name_them() -> None:
    x, mixture = cloud(np.random.default_rng(2))
    # The first 200 samples may belong to components 0 and 2, the next 200 to component 1 alone, the others to none.
    candidates = Candidates(np.array([0, 200, 400, 500]), np.array([0, 2, 3, 3]), np.array([0, 2, 1]))
    found = em_step(x, np.ones(1), np.zeros(0), mixture, candidates, nothing_known(3))
    two = Gaussians(mixture.weight[[0, 2]], mixture.mean[:, [0, 2]], mixture.covariance[[0, 2]])
    expected = defined.em_step(x[:, :200], np.ones(200), np.full(200, -np.inf), two)
    np.testing.assert_allclose(found.mean[:, [0, 2]], expected.mean, rtol=1e-10)
    np.testing.assert_allclose(found.covariance[[0, 2]], expected.covariance, rtol=1e-10)
    np.testing.assert_allclose(found.covariance[1], np.cov(x[:, 200:400], bias=True), rtol=1e-10)
    np.testing.assert_allclose(found.mass, [expected.mass[0], 200, expected.mass[1], 0], rtol=1e-10)
    np.testing.assert_array_equal(found.mean[:, 3], mixture.mean[:, 3])
