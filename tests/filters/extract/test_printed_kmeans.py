"""The modified K-means as M07 prints it: a plain definition, and what becomes of targets."""

from __future__ import annotations

import numpy as np
import pytest
from extract_cases import HERE, MODEL, THERE, cloud, moved, seen, together
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.filters import KMeans, Mixture, PrintedKMeans, PrintedMixture
from phdtrack.types import Particles

# A centre that would move by less, in deviations, rests.
STILL = 0.02


def defined(state: Particles, z: np.ndarray, split: float) -> tuple[np.ndarray, np.ndarray]:
    """Masses (k,) and means (d, k) of all clusters, by the words of M07 §3."""
    centre = MODEL.sensor.states(z)[0]
    scale = MODEL.sensor.noise(centre)
    for _ in range(1000):
        for _ in range(1000):
            distance2 = np.square((state.state[:, None] - centre[:, :, None]) / scale[:, :, None])
            owner = distance2.sum(axis=0).argmin(axis=0)
            apart = distance2.sum(axis=0).min(axis=0)
            mass = np.bincount(owner, state.weight, centre.shape[1])
            mean = np.array([
                np.bincount(owner, state.weight * row, centre.shape[1]) for row in state.state
            ]) / np.maximum(mass, 1e-300)  # fmt: skip
            mean = np.where(mass > 0, mean, centre)
            going = (np.abs(mean - centre) > STILL * scale).any(axis=0)
            if not going.any():
                break
            centre = np.where(going, mean, centre)
        heavy = np.flatnonzero(mass > split)
        if len(heavy) == 0:
            break
        far = [np.where(owner == j, apart, -1.0).argmax() for j in heavy]
        centre = np.hstack([centre, state.state[:, far]])
        scale = np.hstack([scale, scale[:, heavy]])
    return mass, mean


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(0, 3), st.sampled_from([1.0, 1.5]))
@settings(max_examples=30, deadline=None)
def test_clusters_are_those_of_the_words(seed: int, targets: int, alarms: int, split: float):
    rng = np.random.default_rng(seed)
    at = [[*rng.uniform(100, 900, 2), 0, 0, 40, 90] for _ in range(targets)]
    # No number of particles weighs exactly as much as a threshold: rounding would decide.
    state = together(*(cloud(rng, x, rng.uniform(0.3, 2.5) * 0.99731, 200) for x in at))
    false = [[*rng.uniform(100, 900, 2), 0, 0, 30, 60] for _ in range(alarms)]
    z = seen(*at[: rng.integers(1, targets + 1)], *false)
    mass, mean = defined(state, z, split)
    heavy = mass >= 0.6
    found = PrintedKMeans(split_weight=split).extract(state, z, MODEL)
    assert len(found) == heavy.sum()
    mine = np.lexsort(found.state)
    other = np.lexsort(mean[:, heavy])
    np.testing.assert_allclose(found.weight[mine], mass[heavy][other], rtol=1e-9)
    np.testing.assert_allclose(found.state[:, mine], mean[:, heavy][:, other], rtol=1e-9, atol=1e-9)


def test_a_target_heavier_than_one_is_halved_and_lost(rng):
    """As one that is always detected is: 1/(1 − p_M p_S) = 1.05."""
    for mass, states in ((0.99, 1), (1.05, 0)):
        state = cloud(rng, HERE, mass)
        assert len(PrintedKMeans().extract(state, seen(HERE), MODEL)) == states
        assert len(KMeans().extract(state, seen(HERE), MODEL)) == 1
    assert len(PrintedKMeans(split_weight=1.5).extract(cloud(rng, HERE, 1.05), seen(HERE), MODEL))


@pytest.mark.parametrize(
    ("printed", "ours"), [(PrintedKMeans(), KMeans()), (PrintedMixture(), Mixture())]
)
def test_a_missed_target_belongs_to_the_nearest_detection(rng, printed, ours):
    """No cluster or component starts on mass that no detection is near, and no window bounds
    one.
    """
    state = together(cloud(rng, HERE, 0.9), cloud(rng, moved(300), 0.05))
    found = printed.extract(state, seen(HERE), MODEL)
    assert len(found) == 1
    assert found.weight[0] == pytest.approx(0.95)
    assert found.state[0, 0] > HERE[0] + 10
    assert len(printed.extract(cloud(rng, THERE, 0.9), seen(), MODEL)) == 0
    assert len(ours.extract(cloud(rng, THERE, 0.9), seen(), MODEL)) == 1
