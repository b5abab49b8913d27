"""Extraction over blocks: the twin's clusters, whatever the blocks are; float32 blocks give the states of the particles."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from extract_cases import EXTRACTORS, HERE, MODEL, NAMES, THERE, cloud, seen, together
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.filters.extract import KMeans, settling
from phdtrack.filters.extract.cloud import Cloud
from phdtrack.filters.extract.clusters import seeds, starting
from phdtrack.filters.extract.mixture import _parts
from phdtrack.filters.extract.settling import FEW, REACH, Clusters, cluster
from phdtrack.kernels.block_em import em_step
from phdtrack.kernels.blocks import cut
from phdtrack.kernels.dividing import PATIENCE
from phdtrack.kernels.nearest import MIXED
from phdtrack.types import ParticleBlocks, Particles
from reference import clustering_twin as twin

both = pytest.mark.parametrize("extractor", EXTRACTORS, ids=NAMES)
random_seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(autouse=True, params=[0, FEW], ids=["islands", "one island"])
def few(request, monkeypatch):
    """Small scenes as large ones are treated, and as they are."""
    monkeypatch.setattr(settling, "FEW", request.param)


def blocks(state: Particles, rng: np.random.Generator | None = None, most: int = 256) -> ParticleBlocks:
    """Particles of equal weight in blocks; with ``rng`` the blocks in random order."""
    x, weight, start = cut(state.state, state.weight, most)
    assert np.ptp(weight) <= 1e-12 * weight[0]
    parts = [x[:, a:b] for a, b in pairwise(start)]
    if rng is not None:
        parts = [parts[i] for i in rng.permutation(len(parts))]
    sizes = [part.shape[1] for part in parts]
    assert max(sizes) <= most
    return ParticleBlocks(np.hstack(parts).astype(np.float32), np.cumsum([0, *sizes]), float(weight[0]))


def scene(rng: np.random.Generator, targets: int, alarms: int, width: float = 900.0, each: int = 200):
    """Targets that may touch or be missed, of equal weights; their detections and false alarms."""
    at = [
        [*rng.uniform(100, width, 2), *rng.normal(0, 2, 2), rng.uniform(20, 60), rng.uniform(50, 120)]
        for _ in range(targets)
    ]
    counts = rng.integers(each // 2, 2 * each, targets)
    # No number of particles weighs exactly as much as a threshold: rounding would decide.
    state = together(*(cloud(rng, x, 0.99731 * n / each, n, rng.uniform(0.3, 1.2)) for x, n in zip(at, counts, strict=True)))
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
    extractor, sensor = KMeans(merge_iou=1.0), MODEL.sensor
    if state.mass < extractor.min_weight:
        return
    centres = seeds(Cloud.of(state), z, sensor, extractor.min_weight).centre
    x, weight, _ = cut(state.state, state.weight, 256)
    mass, mean, cov = twin.kmeans(x, weight, centres, sensor.noise, extractor.min_weight, extractor.split_weight)
    found = extractor.extract(state, z, MODEL)
    mine, other = np.lexsort(found.state), np.lexsort(mean)
    found, mass, mean, cov = found.take(mine), mass[other], mean[:, other], cov[other]
    np.testing.assert_allclose(found.weight, mass, rtol=1e-9)
    np.testing.assert_allclose(found.state, mean, rtol=1e-9, atol=1e-9)
    floor = (0.1 * sensor.noise(mean)) ** 2
    np.testing.assert_allclose(found.covariance - np.array([np.diag(f) for f in floor.T]).reshape(cov.shape), cov, atol=1e-6)


@both
@given(random_seeds, st.integers(1, 6), st.integers(0, 5))
@settings(max_examples=25, deadline=None)
def test_float32_blocks_give_the_states_of_the_particles(extractor, seed: int, targets: int, alarms: int):
    """Well apart, so that no particle stands on an edge that rounding could move."""
    rng = np.random.default_rng(seed)
    at = [[200.0 + 300 * i, 500, 0, 0, rng.uniform(20, 60), rng.uniform(50, 120)] for i in range(targets)]
    state = together(*(cloud(rng, x, 1.0, 300) for x in at))
    false = np.vstack([rng.uniform(0, 2000, (1, alarms)), np.full((1, alarms), 1500), np.full((2, alarms), 50)])
    z = np.hstack([seen(*at)[:, rng.random(targets) < 0.8], false])
    a, b = extractor.extract(state, z, MODEL), extractor.extract(blocks(state, rng), z, MODEL)
    assert len(a) == len(b) == targets
    mine, other = np.argsort(a.state[0]), np.argsort(b.state[0])
    np.testing.assert_allclose(b.weight[other], a.weight[mine], rtol=1e-5)
    np.testing.assert_allclose(b.state[:, other], a.state[:, mine], atol=1e-3)
    np.testing.assert_allclose(b.covariance[other], a.covariance[mine], rtol=1e-3, atol=1e-3)
    np.testing.assert_array_equal(b.detection[other], a.detection[mine])
    assert b.weight.sum() == pytest.approx(state.mass, rel=1e-5)


@pytest.mark.parametrize("threads", [2, 3, 0])
def test_threads_do_not_change_a_bit(threads: int, rng):
    """Also where centres leave their islands: clusters that are divided beside others."""
    for targets, width in ((12, 2500.0), (12, 500.0)):
        state, z = scene(rng, targets, 8, width)
        state = blocks(Particles(state.state, 1.7 * state.weight), rng, 64)
        one, more = (replace(KMeans(), threads=n).extract(state, z, MODEL) for n in (1, threads))
        assert len(one) >= targets // 2
        for name in ("state", "covariance", "weight", "xyxy", "detection"):
            np.testing.assert_array_equal(getattr(one, name), getattr(more, name))


def of_particles(found: Clusters, part: Cloud) -> np.ndarray:
    """(L,) the cluster of each particle, −1 for none."""
    block, island = np.repeat(found.block, np.diff(part.start)), np.repeat(found.island, np.diff(part.start))
    on = np.where(block == MIXED, found.own, block)
    return np.where((island < 0) | (on < 0), -1, (found.count.cumsum() - found.count)[island] + on)


@given(
    random_seeds, st.integers(1, 7), st.sampled_from([200.0, 500.0]), st.integers(0, 6), st.sampled_from([0.4, 1.5, np.inf])
)
@settings(max_examples=40, deadline=None)
def test_every_particle_belongs_to_the_twins_cluster(seed: int, targets: int, width: float, iterations: int, split: float):
    """Only blocks near a centre that moves are looked at again: centres that appear, move on, stand still and die."""
    rng = np.random.default_rng(seed)
    state, z = scene(rng, targets, 5, width, 100)
    part, sensor = Cloud.of(state), MODEL.sensor
    # Centres beside the targets have a long way to go, and some lose all they have.
    centres, _ = sensor.states(z + rng.normal(0, 15, z.shape) * [[1], [1], [0], [0]])
    found = cluster(part, starting(part, centres, sensor)[0], split, iterations)
    rounds = int(np.ceil(2 * state.mass / split)) if split < np.inf else 0
    want, mass, mean = twin.cluster(part.state, part.weight, centres, sensor.noise(centres), split, iterations, rounds)
    labels = of_particles(found, part)
    # Clusters are in the order of their islands; those that have lost all they had keep their centres.
    names = twin.names(labels, want, len(mass))
    np.testing.assert_array_equal(np.where(labels >= 0, names[labels], -1), want)
    assert (names >= 0).sum() == len(np.unique(want[want >= 0]))
    empty, held = mass == 0.0, names >= 0
    np.testing.assert_allclose(found.mass[held], mass[names[held]], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.mean[:, held], mean[:, names[held]], rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(found.mass[~held], 0.0)
    mine, other = found.mean[:, ~held], mean[:, empty]
    np.testing.assert_allclose(mine[:, np.lexsort(mine)], other[:, np.lexsort(other)], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("most", [1, 7, 256])
def test_strays_are_not_peeled_off_without_end(most: int, rng):
    """Far too heavy, all on one point but for twelve particles each by itself, of which every division parts one."""
    pile = np.repeat(HERE[:, None], 4000, axis=1)
    pile[:, :12] += 6 * MODEL.sensor.noise(pile[:, :12]) * np.hstack([np.eye(6), -np.eye(6)])
    part = Cloud.of(blocks(Particles(pile, np.full(4000, 0.02)), rng, most))
    labels = cluster(part, starting(part, MODEL.sensor.states(seen(HERE))[0], MODEL.sensor)[0], 1.5, 5)
    assert len(labels.mass) == 1 + PATIENCE
    assert labels.mass.sum() == pytest.approx(80.0)
    assert labels.mass.max() == pytest.approx(80.0 - 0.02 * PATIENCE)


@given(random_seeds, st.integers(1, 5))
@settings(max_examples=25, deadline=None)
def test_an_iteration_of_em_is_the_twins(seed: int, targets: int):
    rng = np.random.default_rng(seed)
    state, z = scene(rng, targets, 3, 400.0)
    part, sensor = Cloud.of(state), MODEL.sensor
    mean, cov = sensor.states(z)
    if z.shape[1] == 0:
        return
    root = rng.normal(size=(z.shape[1], 6, 6)) * np.sqrt(0.1)
    cov = cov + np.sqrt(np.einsum("jrr,jss->jrs", cov, cov)) * (root @ root.transpose(0, 2, 1))
    amount, scale = rng.uniform(0.1, 1.5, z.shape[1]), sensor.noise(mean)
    mass, to, spread = em_step(
        part.state, part.weight, part.start, part.known, part.most, *_parts(part),
        amount, mean, cov, scale, REACH,
    )  # fmt: skip
    want = twin.em(state.state, state.weight, amount, mean, cov, scale)
    np.testing.assert_allclose(mass, want[0], rtol=1e-4, atol=1e-7)
    heavy = want[0] > 1e-3
    np.testing.assert_allclose(to[:, heavy], want[1][:, heavy], atol=1e-3)
    np.testing.assert_allclose(spread[heavy], want[2][heavy], rtol=1e-3, atol=1e-2)


@both
def test_edges(extractor, rng):
    nothing = ParticleBlocks.empty(6)
    assert len(extractor.extract(nothing, seen(HERE), MODEL)) == 0
    single = ParticleBlocks(HERE[:, None].astype(np.float32), np.array([0, 1]), 1.0)
    for z in (seen(), seen(HERE), seen(THERE)):
        found = extractor.extract(single, z, MODEL)
        np.testing.assert_allclose(found.state[:, 0], HERE)
        assert np.linalg.eigvalsh(found.covariance[0]).min() > 0
    pile = ParticleBlocks(np.repeat(HERE[:, None], 300, axis=1).astype(np.float32), np.array([0, 0, 256, 300]), 0.01)
    assert extractor.extract(pile, seen(HERE), MODEL).weight.sum() == pytest.approx(3.0)
    with pytest.raises(ValueError, match="finite"):
        extractor.extract(ParticleBlocks(np.full((6, 3), np.nan, np.float32), np.array([0, 3]), 1.0), seen(), MODEL)
