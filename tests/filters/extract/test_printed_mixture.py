"""The Gaussian mixture as M09 prints it: a plain definition, and what becomes of targets."""

from __future__ import annotations

import numpy as np
from extract_cases import HERE, MODEL, cloud, moved, seen, together
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from phdtrack.filters import Mixture, PrintedMixture
from phdtrack.types import Particles


def floored(cov: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Covariances (k, d, d) with a tenth of the noise at the means (d, k) under the deviations."""
    scale = 0.1 * MODEL.sensor.noise(mean)
    return cov + np.array([np.diag(column**2) for column in scale.T])


def moments(share: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses (k,), means (d, k) and covariances of particles x (d, n) by their shares (k, n)."""
    mass = share.sum(axis=1)
    mean = (x @ share.T) / mass
    apart = x[:, None] - mean[:, :, None]
    cov = np.einsum("ikn,jkn,kn->kij", apart, apart, share) / mass[:, None, None]
    return mass, mean, floored(cov, mean)


def defined(state: Particles, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Masses (k,) and means (d, k) of all components, by the words of M09 §III-B: EM from the
    detections, to which the particles belong by the nearest.
    """
    centre = MODEL.sensor.states(z)[0]
    scale = MODEL.sensor.noise(centre)
    distance2 = np.square((state.state[:, None] - centre[:, :, None]) / scale[:, :, None])
    owner = distance2.sum(axis=0).argmin(axis=0)
    share = state.weight * (owner == np.arange(centre.shape[1])[:, None])
    kept = share.sum(axis=1) > 1e-3
    mass, mean, cov = moments(share[kept], state.state)
    for _ in range(400):
        log = np.array([
            np.log(m) + multivariate_normal(at, c).logpdf(state.state.T)
            for m, at, c in zip(mass, mean.T, cov, strict=True)
        ])  # fmt: skip
        share = state.weight * np.exp(log - logsumexp(log, axis=0))
        mass, mean, cov = moments(share[share.sum(axis=1) > 1e-3], state.state)
    return mass, mean


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(0, 2))
@settings(max_examples=20, deadline=None)
def test_components_are_those_of_the_words(seed: int, targets: int, alarms: int):
    """Targets far from each other, some without a detection; false alarms take what is near."""
    rng = np.random.default_rng(seed)
    at = [[400.0 * k + 200, rng.uniform(100, 900), 0, 0, 40, 90] for k in range(targets)]
    state = together(*(cloud(rng, x, rng.uniform(0.1, 1.4), 200) for x in at))
    false = [[*rng.uniform(2500, 3900, 2), 0, 0, 30, 60] for _ in range(alarms)]
    z = seen(*at[: rng.integers(1, targets + 1)], *false)
    mass, mean = defined(state, z)
    heavy = mass >= 0.5
    found = PrintedMixture(iterations=400).extract(state, z, MODEL)
    assert len(found) == heavy.sum()
    mine = np.lexsort(found.state)
    other = np.lexsort(mean[:, heavy])
    np.testing.assert_allclose(found.weight[mine], mass[heavy][other], rtol=0.01)
    apart = np.abs(found.state[:, mine] - mean[:, heavy][:, other])
    assert (apart < 0.1 * MODEL.sensor.noise(found.state[:, mine])).all()


def test_a_heavy_component_is_not_divided(rng):
    """Two targets behind one detection are one state; ours are two."""
    state = together(cloud(rng, HERE, 1.0), cloud(rng, moved(120), 1.0))
    assert len(PrintedMixture().extract(state, seen(HERE), MODEL)) == 1
    assert len(Mixture(merge_iou=1.0).extract(state, seen(HERE), MODEL)) == 2
