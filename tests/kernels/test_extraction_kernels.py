"""Blocks, which particles windows reach, clusters that are joined, and steps of EM: against plain
loops.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.filters.extract import heavy_enough
from phdtrack.filters.particle_blocks import cut
from phdtrack.kernels.mixtures import Candidates, Gaussians, em_step, nothing_known, one_block
from phdtrack.kernels.particle_blocks import block_moments, claim, reaching, summarise, unreached
from phdtrack.models import BoxSensor
from phdtrack.types import F8
from reference import clustering_twin as twin
from reference import em as defined

seeds = st.integers(0, 2**32 - 1)


class Noise:
    """A sensor whose noise grows with the first component."""

    def noise(self, x: np.ndarray) -> np.ndarray:
        return 2 + np.abs(x[:1]) / 30 + np.zeros_like(x)


@given(seeds, st.integers(1, 60), st.integers(1, 8), st.sampled_from([1.0, 1e6]))
@settings(max_examples=40, deadline=None)
def test_cut_keeps_every_particle_in_small_blocks(seed: int, count: int, most: int, outlier: float):
    rng = np.random.default_rng(seed)
    state = rng.normal(0, 30, (3, count))
    weight = rng.exponential(size=count)
    state[0, 0] *= outlier
    order, start = cut(state, most)
    x = state[:, order]
    w = weight[order]
    assert start[0] == 0
    assert start[-1] == count
    assert np.diff(start).min() >= 1
    assert np.diff(start).max() <= most
    before = np.vstack([state, weight])
    after = np.vstack([x, w])
    np.testing.assert_array_equal(before[:, np.lexsort(before)], after[:, np.lexsort(after)])


@given(seeds, st.integers(1, 8), st.sampled_from([np.float32, np.float64]), st.booleans())
@settings(max_examples=30, deadline=None)
def test_summaries_of_blocks_are_exact(seed: int, d: int, kind: type, equal: bool):
    rng = np.random.default_rng(seed)
    start = np.cumsum([0, *rng.integers(0, 20, 4)])
    state = rng.normal(rng.choice([0.0, 500.0]), 10, (max(d, 2), start[-1])).astype(kind)
    weight = np.full(1, 0.25, kind) if equal else rng.exponential(size=start[-1]).astype(kind)
    known = summarise(state, weight, start)
    moments = block_moments(known)
    exact = 1e-4 if kind == np.float32 else 1e-10
    for b in range(4):
        x = state[:, start[b] : start[b + 1]].astype(float)
        w = np.full(x.shape[1], 0.25) if equal else weight[start[b] : start[b + 1]].astype(float)
        assert known.mass[b] == pytest.approx(w.sum(), rel=1e-5)
        if x.shape[1] == 0:
            continue
        np.testing.assert_array_equal([known.low[b], known.high[b]], [x.min(1), x.max(1)])
        assert ((known.low[b] <= known.middle[b]) & (known.middle[b] <= known.high[b])).all()
        np.testing.assert_array_equal(known.middle[b], known.middle[b].astype(kind))
        np.testing.assert_allclose(
            known.first[b], (x - known.middle[b][:, None]) @ w, rtol=exact, atol=100 * exact
        )
        cov = np.cov(x, aweights=w, ddof=0)
        np.testing.assert_allclose(
            moments.mean[:, b], np.average(x, axis=1, weights=w), rtol=exact, atol=10 * exact
        )
        np.testing.assert_allclose(moments.covariance[b], cov, rtol=10 * exact, atol=300 * exact)


@given(seeds, st.integers(0, 8), st.integers(1, 9))
@settings(max_examples=40, deadline=None)
def test_windows_reach_the_blocks_they_overlap(seed: int, count: int, most: int):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 100, (2, 60))
    order, start = cut(x, most)
    parts = summarise(x[:, order], np.ones(1), start)
    at = rng.uniform(0, 100, (2, count))
    half = rng.uniform(0, 40, (2, count))
    low = at - half
    high = at + half
    near = reaching(parts, low, high)
    apart = (low.T[:, None] > parts.high) | (high.T[:, None] < parts.low)
    for b in range(len(start) - 1):
        np.testing.assert_array_equal(
            near.component[near.first[b] : near.first[b + 1]], np.flatnonzero(~apart.any(2)[:, b])
        )
    inside = (np.abs(parts.state[:, :, None] - at[:, None]) <= half[:, None]).all(0)
    np.testing.assert_array_equal(unreached(parts, low, high), ~inside.any(1))


def test_seeds_claim_free_particles_in_their_windows():
    """The second asks for what the first has; the third for the rest."""
    x = np.array([[0.0, 1, 2, 10, 11], [0, 0, 0, 0, 0]])
    weight = np.array([1.0, 1, 2, 1, 0])
    parts = summarise(x, weight, np.array([0, 3, 5]))
    low = np.array([[-1.0, 0, 1.5], [-1, -1, -1]])
    high = np.array([[1.0, 2, 20], [1, 1, 1]])
    centre, left = claim(parts, np.ones(5, bool), np.array([0, 1, 3]), low, high)
    np.testing.assert_allclose(centre, [[0.5, (2 * 2 + 10) / 3], [0, 0]])
    assert not left.any()


@given(seeds, st.integers(0, 14))
@settings(max_examples=60, deadline=None)
def test_light_clusters_are_joined_and_the_heavy_enough_kept(seed: int, k: int):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 120, (3, 60))
    k = max(k, 1)
    labels = rng.integers(0, k, 60)
    weight = rng.uniform(0, 1 / 15, 60)
    mass, mean, cov = twin.moments(x, twin.members(labels, weight, k), k)
    noise = Noise().noise
    found = heavy_enough(Gaussians(mass, mean, cov), Noise(), 0.6, 1.5)
    root = twin.join_light(mass, mean, noise, 0.6, 1.5)
    want = twin.moments(x, twin.members(root[labels], weight, k), k)
    for mine, exact in zip(found, want, strict=True):
        np.testing.assert_allclose(
            mine.T,
            exact.T[want[0] >= 0.6] if exact.ndim < 3 else exact[want[0] >= 0.6].T,
            atol=1e-9,
        )


def test_states_of_boxes_and_their_noise(rng):
    z = rng.uniform(5, 90, (4, 7))
    sensor = BoxSensor(min_noise=6.0, box_noise=0.15, birth_speed=0.06)
    x, _ = sensor.states(z)
    np.testing.assert_array_equal(x[[0, 1, 4, 5]], z)
    np.testing.assert_array_equal(x[2:4], 0)
    np.testing.assert_allclose(sensor.boxes(x)[:, 2:] - sensor.boxes(x)[:, :2], z[2:].T)
    np.testing.assert_allclose(sensor.boxes(x)[:, 2:] + sensor.boxes(x)[:, :2], 2 * z[:2].T)
    noise = sensor.noise(x)
    sigma = np.maximum(0.15 * z[2:], 6.0)
    np.testing.assert_allclose(noise[[0, 1, 4, 5]], np.vstack([sigma / 2, sigma]))
    np.testing.assert_allclose(noise[2], 0.06 * np.sqrt(z[2] * z[3]) / math.sqrt(2))


def cloud(rng: np.random.Generator) -> tuple[F8, Gaussians]:
    """500 samples in three dimensions, and four overlapping Gaussians."""
    root = rng.normal(size=(4, 3, 3))
    mixture = Gaussians(
        rng.uniform(0.1, 0.3, 4),
        3 * rng.normal(size=(3, 4)),
        root @ root.transpose(0, 2, 1) + np.eye(3),
    )
    return 3 * rng.normal(size=(3, 500)), mixture


@pytest.mark.parametrize(("dtype", "close"), [(np.float64, 1e-10), (np.float32, 1e-3)])
def test_em_step_is_that_of_the_definition(dtype: type[np.floating], close: float) -> None:
    rng = np.random.default_rng(1)
    x, mixture = cloud(rng)
    weight = rng.uniform(0.2, 2, 500)
    background = rng.normal(-8, 1, 500)
    found = em_step(
        x.astype(dtype), weight, background, mixture, one_block(500, 4), nothing_known(3)
    )
    for mine, expected in zip(found, defined.em_step(x, weight, background, mixture), strict=True):
        np.testing.assert_allclose(mine, expected, rtol=close, atol=close)


def test_components_explain_only_their_blocks() -> None:
    x, mixture = cloud(np.random.default_rng(2))
    # The first 200 samples may belong to components 0 and 2, the next 200 to component 1 alone, the
    # others to none.
    candidates = Candidates(
        np.array([0, 200, 400, 500]), np.array([0, 2, 3, 3]), np.array([0, 2, 1])
    )
    found = em_step(x, np.ones(1), np.zeros(0), mixture, candidates, nothing_known(3))
    two = Gaussians(mixture.weight[[0, 2]], mixture.mean[:, [0, 2]], mixture.covariance[[0, 2]])
    expected = defined.em_step(x[:, :200], np.ones(200), np.full(200, -np.inf), two)
    np.testing.assert_allclose(found.mean[:, [0, 2]], expected.mean, rtol=1e-10)
    np.testing.assert_allclose(found.covariance[[0, 2]], expected.covariance, rtol=1e-10)
    np.testing.assert_allclose(found.covariance[1], np.cov(x[:, 200:400], bias=True), rtol=1e-10)
    np.testing.assert_allclose(found.mass, [expected.mass[0], 200, expected.mass[1], 0], rtol=1e-10)
    np.testing.assert_array_equal(found.mean[:, 3], mixture.mean[:, 3])
