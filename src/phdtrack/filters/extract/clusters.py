"""Peaks of an intensity of particles: modified K-means [M07 §3], or a Gaussian mixture by EM [M09 §III-B].

Clusters start on the frame's detections at rest, and on particles that no detection is near. A cluster heavier than the
split mass is divided; clusters lighter than a threshold are dropped. Distances are scaled by the noise of the measurement
and of the velocity, component by component; without that, position would drown in size. A particle is compared only with
the centres near it, within `REACH` deviations in position.

The paper splits above mass 1. But one well-seen target settles at up to 1/(1 − p_M p_S): 1.05 at p_D = 0.95 and 1.42 at
p_D = 0.7, so its halves would both fall below the threshold of 0.6 and it would vanish. The split mass here is 1.5: above
what one target can weigh down to p_D = 0.67, below what two weigh once they are established, and half of it is still above
the threshold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.errors import Positive, PositiveCount, Share, check
from phdtrack.filters.blocks import cut
from phdtrack.filters.extract.peaks import (
    LIGHTEST_CLUSTER,
    LIGHTEST_COMPONENT,
    NEVER_SPLIT,
    finish,
    heaviest,
    join_unresolved,
    kept,
    union,
    united,
    with_floor,
)
from phdtrack.filters.intensities import Cardinalised, parts
from phdtrack.kernels.blocks import Blocks, block_moments, claim, reaching, summarise, unreached
from phdtrack.kernels.em import em_step
from phdtrack.kernels.grid import Grid, make_grid, overlapping_pairs
from phdtrack.kernels.kmeans import Rule, kmeans
from phdtrack.kernels.mixtures import Gaussians
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, Bool, Estimates, ParticleBlocks, Particles

Intensity = Particles | ParticleBlocks
# A cluster reaches this many deviations of the measurement noise. Wide, because a target that was missed spreads.
REACH = 8.0
# A component of less mass has no shape; its particles fall to its neighbours.
SHAPELESS = 1e-3


@dataclass(frozen=True, slots=True)
class KMeans:
    """Settings of the modified K-means.

    Parameters
    ----------
    min_weight : T, clusters of less mass are not targets; M07's 0.6.
    split_weight : clusters of more mass are several targets.
    iterations : how often a cluster's centre may move, and again after each split of it.
    merge_iou : states whose boxes overlap by more (IoU) are one object that the detector saw twice; 1 for never.
    counted : of a cardinalised filter, report as many states as its number of targets says; of others it changes nothing.
    """

    min_weight: Positive = 0.6
    split_weight: Positive = 1.5
    iterations: PositiveCount = 5
    merge_iou: Share = 0.4
    counted: bool = True

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Intensity | Cardinalised[Particles], z: F8, model: Model) -> Estimates:
        """The centres of the clusters heavy enough to be targets: weighted means of full states [M07 §3].

        Parameters
        ----------
        state : the intensity.
        z : (m, N) measurements of the frame.
        model : of the world.

        Returns
        -------
        states : in no particular order.
        """
        intensity, number = parts(state, counted=self.counted)
        if number is None:
            return self._peaks(intensity, self.min_weight, self.split_weight, z, model)
        return heaviest(self._peaks(intensity, LIGHTEST_CLUSTER, NEVER_SPLIT, z, model), number)

    def _peaks(self, state: Intensity, lightest: float, split: float, z: F8, model: Model) -> Estimates:
        """The clusters of at least the mass ``lightest``; those above ``split`` are divided."""
        if state.mass < lightest:
            return Estimates.empty(model.motion.dim)
        sensor, (blocks, grid) = model.sensor, known_blocks(state)
        centres, _ = seeds(blocks, grid, z, sensor, lightest)
        scales = np.ascontiguousarray(sensor.noise(centres).T)
        found = kmeans(blocks, grid, np.ascontiguousarray(centres.T), scales, Rule(REACH, split, self.iterations))
        heavy = heavy_enough(found, sensor, lightest, split)
        return finish(join_unresolved(heavy, sensor, self.merge_iou)[0], z, model)


@dataclass(frozen=True, slots=True)
class Mixture:
    """Settings of the Gaussian mixture extraction.

    Parameters
    ----------
    min_weight : components of less mass are not targets; M09's 0.5.
    split_weight : components of more mass are several targets (see `KMeans`).
    iterations : EM iterations after the start and after each split.
    merge_iou : states whose boxes overlap by more (IoU) are one object that the detector saw twice; 1 for never.
    counted : of a cardinalised filter, report as many states as its number of targets says; of others it changes nothing.
    """

    min_weight: Positive = 0.5
    split_weight: Positive = 1.5
    iterations: PositiveCount = 6
    merge_iou: Share = 0.4
    counted: bool = True

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Intensity | Cardinalised[Particles], z: F8, model: Model) -> Estimates:
        """The means of the components heavy enough to be targets [M09 §III-B]; arguments as in `KMeans.extract`.

        Parameters
        ----------
        state : the intensity.
        z : (m, N) measurements of the frame.
        model : of the world.

        Returns
        -------
        states : in no particular order.
        """
        intensity, number = parts(state, counted=self.counted)
        if number is None:
            return self._peaks(intensity, self.min_weight, self.split_weight, z, model)
        peaks = self._peaks(intensity, LIGHTEST_COMPONENT, NEVER_SPLIT, z, model)
        return heaviest(united(peaks, model.sensor), number)

    def _peaks(self, state: Intensity, lightest: float, split: float, z: F8, model: Model) -> Estimates:
        """The components of at least the mass ``lightest``; those above ``split`` are divided."""
        if state.mass < lightest:
            return Estimates.empty(model.motion.dim)
        sensor, (blocks, grid) = model.sensor, known_blocks(state)
        centres, free = seeds(blocks, grid, z, sensor, lightest)
        if free.any():
            # A block with one component in reach is all that component's, but for the remnants that nothing reaches.
            blocks, grid = _without(blocks, free)
        scales = np.ascontiguousarray(sensor.noise(centres).T)
        start = kmeans(blocks, grid, np.ascontiguousarray(centres.T), scales, Rule(REACH, math.inf, 0))
        known = block_moments(blocks)
        mixture = self._fit(blocks, grid, known, start, sensor)
        for _ in range(math.ceil(2 * state.mass / split)):
            if not (mixture.weight > split).any():
                break
            mixture = self._fit(blocks, grid, known, _divided(mixture, sensor, split), sensor)
        heavy = kept(mixture, mixture.weight >= lightest)
        return finish(join_unresolved(heavy, sensor, self.merge_iou)[0], z, model)

    def _fit(self, blocks: Blocks, grid: Grid, known: Gaussians, mixture: Gaussians, sensor: Sensor) -> Gaussians:
        """EM iterations from a mixture, with a floor under the covariances [M09 §III-B]."""
        nothing = np.zeros(0)
        for _ in range(self.iterations):
            mixture, scale = _floored(mixture, sensor)
            if len(mixture.weight) == 0:
                break
            at, reach = mixture.mean[:2], REACH * scale[:2]
            near = reaching(blocks, grid, at - reach, at + reach)
            mass, mean, cov, *_ = em_step(blocks.state, blocks.weight, nothing, mixture, near, known)
            mixture = Gaussians(mass, mean, cov)
        return _floored(mixture, sensor)[0]


def known_blocks(intensity: Intensity) -> tuple[Blocks, Grid]:
    """The particles of an intensity that is not empty in blocks, and a grid over the blocks' boxes of positions.

    `ValueError` where a state is NaN or infinite.
    """
    if isinstance(intensity, ParticleBlocks):
        weight = np.array([intensity.unit], intensity.state.dtype)
        if len(intensity.share):
            weight = weight * intensity.share
        blocks = summarise(intensity.state, weight, intensity.start)
    else:
        if not np.isfinite(intensity.state).all():
            raise ValueError("states must be finite")
        order, start = cut(intensity.state)
        blocks = summarise(np.ascontiguousarray(intensity.state[:, order]), intensity.weight[order], start)
    if not np.isfinite(blocks.middle).all():
        raise ValueError("states must be finite")
    return blocks, make_grid(np.ascontiguousarray(blocks.low[:, :2].T), np.ascontiguousarray(blocks.high[:, :2].T))


def _without(blocks: Blocks, which: Bool) -> tuple[Blocks, Grid]:
    """The blocks without some particles (L,), and the grid over them."""
    left = ~which
    weight = blocks.weight[left] if len(blocks.weight) > 1 else blocks.weight
    start = np.concatenate([[0], np.cumsum(left)])[blocks.start]
    fewer = summarise(np.ascontiguousarray(blocks.state[:, left]), weight, start)
    return fewer, make_grid(np.ascontiguousarray(fewer.low[:, :2].T), np.ascontiguousarray(fewer.high[:, :2].T))


def seeds(blocks: Blocks, grid: Grid, z: F8, sensor: Sensor, lightest: float) -> tuple[F8, Bool]:
    """First centres (d, k): the detections, at rest [M07 §3], and the middle of what no detection is near.

    A target that was missed has no detection to start from, and its particles would be drawn into a far cluster or lost.
    While more than ``lightest`` mass is out of every centre's reach, some of these particles become centres: every half of
    ``lightest`` along their cumulative weight one claims what is in its reach and not claimed yet.

    Parameters
    ----------
    blocks, grid : the particles, and the grid over their blocks.
    z : (m, N) measurements.
    sensor : that measured them.
    lightest : mass of the lightest target.

    Returns
    -------
    centres, free : of the detections, then the others; (L,) which particles are out of their reach.
    """
    centres = sensor.states(z)[0]
    low, high = _windows(centres, sensor)
    free = unreached(blocks, reaching(blocks, grid, low, high), low, high)
    # Once finds every target whose particles lie together, as blocks do; again, to be sure.
    for _ in range(2):
        left = np.flatnonzero(free)
        mass = np.cumsum(blocks.weight[left] if len(blocks.weight) > 1 else np.full(len(left), float(blocks.weight[0])))
        if len(left) == 0 or mass[-1] < lightest:
            break
        marks = np.searchsorted(mass, np.arange(0.25 * lightest, mass[-1], 0.5 * lightest))
        asked = left[np.unique(np.minimum(marks, len(left) - 1))]
        low, high = _windows(blocks.state[:, asked].astype(np.float64), sensor)
        found, free = claim(blocks, grid, free, asked, low, high)
        centres = np.concatenate((centres, found), axis=1)
    return centres, free


def _windows(centres: F8, sensor: Sensor) -> tuple[F8, F8]:
    """Corners (2, k) of the positions that centres reach."""
    reach = REACH * sensor.noise(centres)[:2]
    return centres[:2] - reach, centres[:2] + reach


def heavy_enough(found: Gaussians, sensor: Sensor, lightest: float, split: float) -> Gaussians:
    """The clusters of at least the mass ``lightest``, after light ones that are near each other have been joined.

    Clusters start on every detection, so one target beside a false alarm, or detected twice, may lie in two halves that are
    each too light. The nearest are joined first, while one of the two is too light and both are not too heavy for one.

    Parameters
    ----------
    found : k clusters.
    sensor : whose noise is the unit of distances.
    lightest, split : mass of the lightest target, and that above which a cluster is several.

    Returns
    -------
    clusters : of at least that mass.
    """
    light = np.flatnonzero((found.weight > 0) & (found.weight < lightest))
    at, scale = found.mean[:, light], sensor.noise(found.mean[:, light])
    low, high, place = at[:2] - REACH * scale[:2], at[:2] + REACH * scale[:2], np.ascontiguousarray(at[:2])
    first, second = overlapping_pairs(low, high, make_grid(place, place))
    first, second = first[first < second], second[first < second]
    distance2 = np.square((at[:, first] - at[:, second]) / scale[:, first]).sum(axis=0)
    mass, group = found.weight.copy(), np.arange(len(found.weight))
    for pair in distance2.argsort(kind="stable"):
        i, j = group[light[first[pair]]], group[light[second[pair]]]
        if distance2[pair] <= REACH**2 and i != j and min(mass[i], mass[j]) < lightest and mass[i] + mass[j] <= split:
            mass[i] += mass[j]
            mass[j] = 0.0
            group[group == j] = i
    heavy = mass[group] >= lightest
    if (group == np.arange(len(group))).all():
        return kept(found, heavy)
    return union(kept(found, heavy), np.unique(group[heavy], return_inverse=True)[1])


def _floored(mixture: Gaussians, sensor: Sensor) -> tuple[Gaussians, F8]:
    """The components that have a shape, with a floor under their covariances, and the noise (d, k) at their means."""
    alive = mixture.weight > SHAPELESS
    mixture = mixture if alive.all() else kept(mixture, alive)
    scale = sensor.noise(mixture.mean)
    return mixture._replace(covariance=with_floor(mixture.covariance, scale)), scale


def _divided(mixture: Gaussians, sensor: Sensor, split: float) -> Gaussians:
    """Components heavier than ``split`` divided: a deviation to either side on the longest axis in units of the noise."""
    heavy = mixture.weight > split
    scale = sensor.noise(mixture.mean[:, heavy]).T
    length2, axes = np.linalg.eigh(mixture.covariance[heavy] / (scale[:, :, None] * scale[:, None, :]))
    step = (scale * axes[:, :, -1] * np.sqrt(length2[:, -1:])).T
    weight, mean = np.where(heavy, mixture.weight / 2, mixture.weight), mixture.mean.copy()
    mean[:, heavy] -= step
    return Gaussians(
        np.concatenate([weight, weight[heavy]]),
        np.hstack([mean, mixture.mean[:, heavy] + step]),
        np.concatenate([mixture.covariance, mixture.covariance[heavy]]),
    )
