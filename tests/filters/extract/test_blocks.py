"""Extraction over blocks: the twin's clusters, whatever the blocks are; float32 blocks give the
states of the particles.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from extract_cases import EXTRACTORS, HERE, MODEL, NAMES, THERE, cloud, moved, seen, together
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.filters.extract import REACH, KMeans, known_blocks, seeds
from phdtrack.filters.particle_blocks import cut
from phdtrack.kernels.kmeans import PATIENCE, Rule, kmeans
from phdtrack.kernels.mixtures import Gaussians, em_step, nothing_known
from phdtrack.kernels.particle_blocks import block_moments, reaching
from phdtrack.types import ParticleBlocks, Particles
from reference import clustering_twin as twin

both = pytest.mark.parametrize("extractor", EXTRACTORS, ids=NAMES)
random_seeds = st.integers(0, 2**32 - 1)


def blocks(
    state: Particles, rng: np.random.Generator | None = None, most: int = 256
) -> ParticleBlocks:
    """Particles of equal weight in blocks; with ``rng`` the blocks in random order."""
    order, start = cut(state.state, most)
    x = state.state[:, order]
    weight = state.weight[order]
    assert np.ptp(weight) <= 1e-12 * weight[0]
    parts = [x[:, a:b] for a, b in pairwise(start)]
    if rng is not None:
        parts = [parts[i] for i in rng.permutation(len(parts))]
    sizes = [part.shape[1] for part in parts]
    assert max(sizes) <= most
    return ParticleBlocks(
        np.hstack(parts).astype(np.float32), np.cumsum([0, *sizes]), float(weight[0])
    )


def scene(
    rng: np.random.Generator, targets: int, alarms: int, width: float = 900.0, each: int = 200
):
    """Targets that may touch or be missed, of equal weights; their detections and false alarms."""
    at = [
        [
            *rng.uniform(100, width, 2),
            *rng.normal(0, 2, 2),
            rng.uniform(20, 60),
            rng.uniform(50, 120),
        ]
        for _ in range(targets)
    ]
    counts = rng.integers(each // 2, 2 * each, targets)
    # No number of particles weighs exactly as much as a threshold: rounding would decide.
    state = together(
        *(
            cloud(rng, x, 0.99731 * n / each, n, rng.uniform(0.3, 1.2))
            for x, n in zip(at, counts, strict=True)
        )
    )
    z = np.hstack(
        [
            seen(*(x for x in at if rng.random() < 0.8)),
            np.vstack([rng.uniform(100, width, (2, alarms)), rng.uniform(20, 90, (2, alarms))]),
        ]
    )
    return state, z + rng.normal(0, 1, z.shape)


@given(random_seeds, st.integers(1, 7), st.integers(0, 6), st.sampled_from([300.0, 900.0]))
@settings(max_examples=40, deadline=None)
def test_clusters_are_the_twins(seed: int, targets: int, alarms: int, width: float):
    """From the same seeds on the same particles, in float64 to rounding."""
    rng = np.random.default_rng(seed)
    state, z = scene(rng, targets, alarms, width)
    extractor = KMeans(merge_iou=1.0)
    sensor = MODEL.sensor
    if state.mass < extractor.min_weight:
        return
    centres, _ = seeds(known_blocks(state), z, sensor, extractor.min_weight)
    order, _ = cut(state.state)
    mass, mean, cov = twin.kmeans(
        state.state[:, order],
        state.weight[order],
        centres,
        sensor.noise,
        extractor.min_weight,
        extractor.split_weight,
    )
    found = extractor.extract(state, z, MODEL)
    mine = np.lexsort(found.state)
    other = np.lexsort(mean)
    found = found.select(mine)
    mass = mass[other]
    mean = mean[:, other]
    cov = cov[other]
    np.testing.assert_allclose(found.weight, mass, rtol=1e-9)
    np.testing.assert_allclose(found.state, mean, rtol=1e-9, atol=1e-9)
    floor = (0.1 * sensor.noise(mean)) ** 2
    np.testing.assert_allclose(
        found.covariance - np.array([np.diag(f) for f in floor.T]).reshape(cov.shape),
        cov,
        atol=1e-6,
    )


@both
@given(random_seeds, st.integers(1, 6), st.integers(0, 5))
@settings(max_examples=25, deadline=None)
def test_float32_blocks_give_the_states_of_the_particles(
    extractor, seed: int, targets: int, alarms: int
):
    """Well apart, so that no particle stands on an edge that rounding could move."""
    rng = np.random.default_rng(seed)
    at = [
        [200.0 + 300 * i, 500, 0, 0, rng.uniform(20, 60), rng.uniform(50, 120)]
        for i in range(targets)
    ]
    state = together(*(cloud(rng, x, 1.0, 300) for x in at))
    false = np.vstack(
        [rng.uniform(0, 2000, (1, alarms)), np.full((1, alarms), 1500), np.full((2, alarms), 50)]
    )
    z = np.hstack([seen(*at)[:, rng.random(targets) < 0.8], false])
    a = extractor.extract(state, z, MODEL)
    b = extractor.extract(blocks(state, rng), z, MODEL)
    assert len(a) == len(b) == targets
    mine = np.argsort(a.state[0])
    other = np.argsort(b.state[0])
    np.testing.assert_allclose(b.weight[other], a.weight[mine], rtol=1e-5)
    np.testing.assert_allclose(b.state[:, other], a.state[:, mine], atol=1e-3)
    np.testing.assert_allclose(b.covariance[other], a.covariance[mine], rtol=1e-3, atol=1e-3)
    np.testing.assert_array_equal(b.detection[other], a.detection[mine])
    assert b.weight.sum() == pytest.approx(state.mass, rel=1e-5)


@pytest.mark.parametrize("most", [1, 7, 256])
def test_the_size_of_blocks_does_not_matter(most: int, rng):
    state, z = scene(rng, 6, 4, 500.0)
    a, b = (KMeans(merge_iou=1.0).extract(blocks(state, most=m), z, MODEL) for m in (64, most))
    np.testing.assert_allclose(np.sort(b.state[0]), np.sort(a.state[0]), atol=1e-2)
    assert b.weight.sum() == pytest.approx(a.weight.sum(), rel=1e-5)


@given(
    random_seeds,
    st.integers(1, 7),
    st.sampled_from([200.0, 500.0]),
    st.integers(0, 6),
    st.sampled_from([0.4, 1.5, np.inf]),
)
@settings(max_examples=40, deadline=None)
def test_clusters_from_any_centres_are_the_twins(
    seed: int, targets: int, width: float, iterations: int, split: float
):
    """Only blocks near a centre that moves are looked at again: centres that appear, move on, stand
    still and die.
    """
    rng = np.random.default_rng(seed)
    state, z = scene(rng, targets, 5, width, 100)
    # Centres beside the targets have a long way to go, and some lose all they have.
    centres, _ = MODEL.sensor.states(z + rng.normal(0, 15, z.shape) * [[1], [1], [0], [0]])
    scale = MODEL.sensor.noise(centres)
    parts = known_blocks(state)
    found = kmeans(parts, centres.T.copy(), scale.T.copy(), Rule(REACH, split, iterations))
    labels, mass, mean = twin.cluster(parts.state, parts.weight, centres, scale, split, iterations)
    cov = twin.moments(parts.state, twin.members(labels, parts.weight, len(mass)), len(mass))[2]
    np.testing.assert_allclose(found.weight, mass, rtol=1e-9, atol=1e-12)
    held = mass > 0
    np.testing.assert_allclose(found.mean[:, held], mean[:, held], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.covariance[held], cov[held], rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("most", [1, 7, 256])
def test_strays_are_not_peeled_off_without_end(most: int, rng):
    """Far too heavy, all on one point but for twelve particles each by itself, of which every
    division parts one.
    """
    pile = np.repeat(HERE[:, None], 4000, axis=1)
    pile[:, :12] += 6 * MODEL.sensor.noise(pile[:, :12]) * np.hstack([np.eye(6), -np.eye(6)])
    scale = MODEL.sensor.noise(HERE[:, None]).T.copy()
    parts = known_blocks(blocks(Particles(pile, np.full(4000, 0.02)), rng, most))
    mass = kmeans(parts, HERE[None], scale, Rule(REACH, 1.5, 5)).weight
    assert len(mass) == 1 + PATIENCE
    assert mass.sum() == pytest.approx(80.0)
    assert mass.max() == pytest.approx(80.0 - 0.02 * PATIENCE)


@given(random_seeds, st.integers(1, 5), st.booleans())
@settings(max_examples=15, deadline=None)
def test_em_over_blocks_whose_moments_are_known(seed: int, targets: int, equal: bool):
    """Blocks with one component in reach are not looked at; the moments are those of looking at
    every particle.
    """
    rng = np.random.default_rng(seed)
    state, z = scene(rng, targets, 3, 400.0)
    parts = known_blocks(blocks(state) if equal else state)
    mean, cov = MODEL.sensor.states(z)
    if z.shape[1] == 0:
        return
    mixture = Gaussians(rng.uniform(0.1, 1.5, z.shape[1]), mean, cov)
    reach = REACH * MODEL.sensor.noise(mean)[:2]
    near = reaching(parts, mean[:2] - reach, mean[:2] + reach)
    given_all = (parts.state, parts.weight, np.zeros(0), mixture, near)
    found = em_step(*given_all, block_moments(parts))
    want = em_step(*given_all, nothing_known(6))
    exact = 1e-3 if equal else 1e-9
    np.testing.assert_allclose(found.mass, want.mass, rtol=exact, atol=1e-9)
    heavy = want.mass > 1e-3
    np.testing.assert_allclose(
        found.mean[:, heavy], want.mean[:, heavy], rtol=exact, atol=10 * exact
    )
    np.testing.assert_allclose(
        found.covariance[heavy], want.covariance[heavy], rtol=exact, atol=100 * exact
    )


@both
def test_edges(extractor, rng):
    nothing = ParticleBlocks.empty(6)
    assert len(extractor.extract(nothing, seen(HERE), MODEL)) == 0
    single = ParticleBlocks(HERE[:, None].astype(np.float32), np.array([0, 1]), 1.0)
    for z in (seen(), seen(HERE), seen(THERE)):
        found = extractor.extract(single, z, MODEL)
        np.testing.assert_allclose(found.state[:, 0], HERE)
        assert np.linalg.eigvalsh(found.covariance[0]).min() > 0
    pile = ParticleBlocks(
        np.repeat(HERE[:, None], 300, axis=1).astype(np.float32), np.array([0, 0, 256, 300]), 0.01
    )
    assert extractor.extract(pile, seen(HERE), MODEL).weight.sum() == pytest.approx(3.0)
    with pytest.raises(ValueError, match="finite"):
        extractor.extract(
            ParticleBlocks(np.full((6, 3), np.nan, np.float32), np.array([0, 3]), 1.0),
            seen(),
            MODEL,
        )


@both
def test_crossing_targets_are_two(extractor, rng):
    crossing = HERE * [1, 1, -1, 1, 1, 1] + [6, 0, -6, 0, 0, 0]
    state = together(cloud(rng, moved(0, 0, 6), 1.0), cloud(rng, crossing, 1.0))
    assert len(extractor.extract(blocks(state), seen(HERE, crossing), MODEL)) == 2


@both
def test_a_thousand_targets(extractor, rng):
    at = np.array([[200.0 * (i % 40), 300.0 * (i // 40), 0, 0, 40, 100] for i in range(1000)])
    state = together(*(cloud(rng, x, 1.0, 30) for x in at))
    found = extractor.extract(blocks(state), seen(*at[rng.random(1000) < 0.95]), MODEL)
    assert len(found) == 1000
    assert found.weight.sum() == pytest.approx(1000, rel=1e-4)
