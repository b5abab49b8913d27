"""Peaks of an intensity: modified K-means [M07 §3], as M07 prints it or as a target needs it, a
Gaussian mixture by EM [M09 §III-B], or a mixture's components.

**Clusters of particles** start on the frame's detections at rest, and on particles that no
detection is near. A cluster heavier than the split mass is divided; clusters lighter than a
threshold are dropped. Distances are scaled by the noise of the measurement and of the velocity,
component by component; without that, position would drown in size. A particle is compared only with
the centres near it, within `REACH` deviations in position. The paper splits above mass 1. But one
well-seen target settles at up to 1/(1 − p_M p_S): 1.05 at p_D = 0.95 and 1.42 at p_D = 0.7, so its
halves would both fall below the threshold of 0.6 and it would vanish. The split mass here is 1.5:
above what one target can weigh down to p_D = 0.67, below what two weigh once they are established,
and half of it is still above the threshold. `PrintedKMeans` and `PrintedMixture` are the papers'
rules word by word, for their experiments.

**Joining.** A detector that suppresses overlapping boxes never reports two objects whose boxes
overlap by much. Where two states do, it has fired twice on one object, at two scales or on two
parts of it, and the filter, for which every detection is another target, follows both. Joining them
gives up the second of two objects in line while they cover each other; the association bridges that
gap.

**Counting.** A cardinalised filter knows the number of targets better than the weight of any single
peak shows it: the peak of a target that was just missed is light. So peaks are found with a low
threshold and without division of heavy ones, and as many are reported as the most probable number
of targets [V07].
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from phdtrack.arrays import chi2_quantile, iou, iou_of_pairs
from phdtrack.errors import Checked, Positive, PositiveCount, Share
from phdtrack.filters.cardinality import Cardinalised
from phdtrack.filters.particle_blocks import in_blocks
from phdtrack.kernels.gaussian import gaussian_parts
from phdtrack.kernels.grid import make_grid, overlapping_pairs
from phdtrack.kernels.kmeans import Rule, kmeans
from phdtrack.kernels.mixtures import Gaussians, em_step
from phdtrack.kernels.particle_blocks import (
    Blocks,
    block_moments,
    claim,
    reaching,
    summarise,
    unreached,
)
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, I8, Bool, Estimates, GaussianMixture, ParticleBlocks, Particles

Intensity = Particles | ParticleBlocks
# A cluster reaches this many deviations of the measurement noise. Wide, because a target that was
# missed spreads.
REACH = 8.0
# A reach beyond every picture: no window.
UNBOUNDED = 1e9
# A component of less mass has no shape; its particles fall to its neighbours.
SHAPELESS = 1e-3
# Lightest peak that is a candidate where peaks are counted: a component of a mixture, and a K-means
# cluster.
LIGHTEST_COMPONENT = 0.05
LIGHTEST_CLUSTER = 0.1
# Heavier than any cluster: none is divided for its mass.
NEVER_SPLIT = 1e9
# Mahalanobis distance up to which a fitted component is part of a heavier one, as in the
# Gaussian-mixture filters.
MERGE_DISTANCE = 2.0
# A fitted component rests if its mean moves by less than this share of the noise.
RESTING = 0.02


class _Extraction(Checked):
    """The common part of the extractions: of a cardinalised filter, peaks are counted."""

    __slots__ = ()

    def extract(self, state: Any, z: F8, model: Model) -> Estimates:
        """The peaks heavy enough to be targets, or as many as there are targets; see
        `protocols.Extractor`.
        """
        settings: Any = self
        if isinstance(state, Cardinalised):
            found: Estimates = settings._peaks(state.intensity, z, model, counting=True)
            return heaviest(found, state.cardinality)
        plain: Estimates = settings._peaks(state, z, model, counting=False)
        return plain


@dataclass(frozen=True, slots=True)
class KMeans(_Extraction):
    """Settings of the modified K-means: states are the centres of clusters, weighted means of full
    states [M07 §3].

    Parameters
    ----------
    min_weight : T, clusters of less mass are not targets; M07's 0.6.
    split_weight : clusters of more mass are several targets.
    iterations : how often a cluster's centre may move, and again after each split of it.
    merge_iou : states whose boxes overlap by more (IoU) are one object that the detector saw twice;
        1 for never.
    """

    min_weight: Positive = 0.6
    split_weight: Positive = 1.5
    iterations: PositiveCount = 5
    merge_iou: Share = 0.4

    def _peaks(self, state: Intensity, z: F8, model: Model, *, counting: bool) -> Estimates:
        """The clusters heavy enough, the heaviest divided unless peaks are counted."""
        lightest, split = (
            (LIGHTEST_CLUSTER, NEVER_SPLIT) if counting else (self.min_weight, self.split_weight)
        )
        if state.mass < lightest:
            return Estimates.empty(model.motion.dim)
        sensor = model.sensor
        blocks = known_blocks(state)
        centres, _ = seeds(blocks, z, sensor, lightest)
        scales = np.ascontiguousarray(sensor.noise(centres).T)
        found = kmeans(
            blocks, np.ascontiguousarray(centres.T), scales, Rule(REACH, split, self.iterations)
        )
        heavy = heavy_enough(found, sensor, lightest, split)
        return finish(join_unresolved(heavy, sensor, self.merge_iou)[0], z, model)


@dataclass(frozen=True, slots=True)
class PrintedKMeans(_Extraction):
    """Settings of the modified K-means as M07 prints it [M07 §3].

    Clusters start on the detections at rest, and nowhere else: mass that no detection is near
    belongs to the nearest of them. While a cluster weighs more than ``split_weight``, a new centre
    is put on its farthest particle, and all centres move until they rest. No light clusters are
    joined. A target that weighs 1.05, as a well-seen one does if p_D is 0.95, is halved, and both
    halves are dropped.

    Parameters
    ----------
    min_weight : T, clusters of less mass are not targets; M07's 0.6.
    split_weight : clusters of more mass are several targets; M07's 1.
    iterations : how often a cluster's centre may move, and again after each split of it: more often
        than it does until it rests.
    """

    min_weight: Positive = 0.6
    split_weight: Positive = 1.0
    iterations: PositiveCount = 100

    def _peaks(self, state: Intensity, z: F8, model: Model, *, counting: bool) -> Estimates:
        """The clusters heavy enough; none in a frame without detections to start from."""
        lightest, split = (
            (LIGHTEST_CLUSTER, NEVER_SPLIT) if counting else (self.min_weight, self.split_weight)
        )
        if state.mass < lightest or z.shape[1] == 0:
            return Estimates.empty(model.motion.dim)
        centres = model.sensor.states(z)[0]
        scales = np.ascontiguousarray(model.sensor.noise(centres).T)
        rule = Rule(UNBOUNDED, split, self.iterations, until_light=True)
        found = kmeans(known_blocks(state), np.ascontiguousarray(centres.T), scales, rule)
        return finish(kept(found, found.weight >= lightest), z, model)


@dataclass(frozen=True, slots=True)
class Mixture(_Extraction):
    """Settings of the Gaussian mixture extraction: states are the means of components fitted by EM
    [M09 §III-B].

    Parameters
    ----------
    min_weight : components of less mass are not targets; M09's 0.5.
    iterations : EM iterations after the start and after each split.
    split_weight : components of more mass are several targets.
    merge_iou : states whose boxes overlap by more (IoU) are one object that the detector saw twice;
        1 for never.
    """

    min_weight: Positive = 0.5
    split_weight: Positive = 1.5
    iterations: PositiveCount = 6
    merge_iou: Share = 0.4

    def _peaks(self, state: Intensity, z: F8, model: Model, *, counting: bool) -> Estimates:
        """The components heavy enough, the heaviest divided; where they are counted, one for each
        place.
        """
        lightest, split = (
            (LIGHTEST_COMPONENT, NEVER_SPLIT) if counting else (self.min_weight, self.split_weight)
        )
        if state.mass < lightest:
            return Estimates.empty(model.motion.dim)
        sensor = model.sensor
        blocks = known_blocks(state)
        centres, free = seeds(blocks, z, sensor, lightest)
        if free.any():
            # A block with one component in reach is all that component's, but for the remnants that
            # nothing reaches.
            blocks = _without(blocks, free)
        scales = np.ascontiguousarray(sensor.noise(centres).T)
        start = kmeans(blocks, np.ascontiguousarray(centres.T), scales, Rule(REACH, math.inf, 0))
        known = block_moments(blocks)
        mixture = self._fit(blocks, known, start, sensor)
        for _ in range(math.ceil(2 * state.mass / split)):
            if not (mixture.weight > split).any():
                break
            mixture = self._fit(blocks, known, _divided(mixture, sensor, split), sensor)
        heavy = kept(mixture, mixture.weight >= lightest)
        found = finish(join_unresolved(heavy, sensor, self.merge_iou)[0], z, model)
        if counting:
            return united(found, sensor)
        return found

    def _fit(
        self, blocks: Blocks, known: Gaussians, mixture: Gaussians, sensor: Sensor
    ) -> Gaussians:
        """EM iterations from a mixture, with a floor under the covariances [M09 §III-B]."""
        mixture, scale = _floored(mixture, sensor)
        for _ in range(self.iterations):
            if len(mixture.weight) == 0:
                break
            mixture, scale = _refitted(blocks, known, mixture, sensor, REACH * scale[:2])
        return mixture


@dataclass(frozen=True, slots=True)
class PrintedMixture(_Extraction):
    """Settings of the Gaussian mixture extraction as M09 prints it [M09 §III-B].

    Components start on the detections, and nowhere else, and EM fits them to all particles until
    they rest: mass that no detection is near belongs to the components that explain it best,
    however far they are. M09 prints no mass above which a component is divided, so none is.

    Parameters
    ----------
    min_weight : components of less mass are not targets; M09's 0.5.
    iterations : EM iterations at most: more than it takes until the components rest.
    """

    min_weight: Positive = 0.5
    iterations: PositiveCount = 30

    def _peaks(self, state: Intensity, z: F8, model: Model, *, counting: bool) -> Estimates:
        """The components heavy enough; none in a frame without detections to start from."""
        lightest = LIGHTEST_COMPONENT if counting else self.min_weight
        if state.mass < lightest or z.shape[1] == 0:
            return Estimates.empty(model.motion.dim)
        sensor = model.sensor
        blocks = known_blocks(state)
        known = block_moments(blocks)
        centres = sensor.states(z)[0]
        scales = np.ascontiguousarray(sensor.noise(centres).T)
        start = kmeans(
            blocks, np.ascontiguousarray(centres.T), scales, Rule(UNBOUNDED, math.inf, 0)
        )
        mixture, scale = _floored(start, sensor)
        for _ in range(self.iterations):
            fitted, scale = _refitted(blocks, known, mixture, sensor, UNBOUNDED)
            rests = len(fitted.weight) == len(mixture.weight) and bool(
                (np.abs(fitted.mean - mixture.mean) < RESTING * scale).all()
            )
            mixture = fitted
            if rests:
                break
        return finish(kept(mixture, mixture.weight >= lightest), z, model)


@dataclass(frozen=True, slots=True)
class Components(_Extraction):
    """Settings of the extraction from a mixture: the means of its components [V06 Table III].

    Where the filter has merged what lies together, a component is a target, or several that no
    measurement has parted yet: one of weight 2.3 stands for two [V06 Table III, E13 §4]. Vo and Ma
    report it twice; two states in one place are of no use to a tracker, which is why it is reported
    once unless ``repeat`` says otherwise.

    Parameters
    ----------
    min_weight : components of less weight are not targets; Vo and Ma's 0.5.
    repeat : report a component as often as its weight says, rounded, as Vo and Ma do. Joining is
        off then.
    merge_iou : states whose boxes overlap by more (IoU) are one object that the detector saw twice;
        1 for never.
    """

    min_weight: Positive = 0.5
    repeat: bool = False
    merge_iou: Share = 0.4

    def _peaks(self, state: GaussianMixture, z: F8, model: Model, *, counting: bool) -> Estimates:
        """The components of enough weight, in their order."""
        heavy = np.flatnonzero(
            state.weight >= (LIGHTEST_COMPONENT if counting else self.min_weight)
        )
        if self.repeat:
            heavy = np.repeat(heavy, np.maximum(np.rint(state.weight[heavy]).astype(np.int64), 1))
        peaks = kept(Gaussians(state.weight, state.mean, state.covariance), heavy)
        if self.repeat:
            peaks = peaks._replace(weight=peaks.weight / np.bincount(heavy)[heavy])
        else:
            peaks, _ = join_unresolved(peaks, model.sensor, self.merge_iou)
        return finish(peaks, z, model)


# The extractions from particles.
FromParticles = KMeans | PrintedKMeans | Mixture | PrintedMixture


def known_blocks(intensity: Intensity) -> Blocks:
    """The particles of an intensity that is not empty in blocks; `ValueError` if a state is NaN
    or infinite.
    """
    if not isinstance(intensity, ParticleBlocks):
        if not np.isfinite(intensity.state).all():
            raise ValueError("states must be finite")
        intensity = in_blocks(intensity, np.dtype(np.float64))
    weight = np.array([intensity.unit], intensity.state.dtype)
    if len(intensity.share):
        weight = weight * intensity.share
    blocks: Blocks = summarise(intensity.state, weight, intensity.start)
    return blocks


def _without(blocks: Blocks, which: Bool) -> Blocks:
    """The blocks without some particles (L,)."""
    left = ~which
    weight = blocks.weight[left] if len(blocks.weight) > 1 else blocks.weight
    start = np.concatenate([[0], np.cumsum(left)])[blocks.start]
    fewer: Blocks = summarise(np.ascontiguousarray(blocks.state[:, left]), weight, start)
    return fewer


def seeds(blocks: Blocks, z: F8, sensor: Sensor, lightest: float) -> tuple[F8, Bool]:
    """First centres (d, k): the detections, at rest [M07 §3], then the middle of what none is near;
    and which are free (L,).

    A target that was missed has no detection to start from, and its particles would be drawn into a
    far cluster or lost. While more than ``lightest`` mass, that of the lightest target, is out of
    every centre's reach, some of these particles become centres: every half of it along their
    cumulative weight one claims what is in its reach and not claimed yet. Free are particles that
    no centre reaches.

    Parameters
    ----------
    blocks, z : the particles and the (m, N) measurements.
    sensor, lightest : the sensor, and the mass of the lightest target.
    """
    centres = sensor.states(z)[0]
    low, high = _windows(centres, sensor)
    free = unreached(blocks, low, high)
    # Once finds every target whose particles lie together, as blocks do; again, to be sure.
    for _ in range(2):
        left = np.flatnonzero(free)
        mass = np.cumsum(
            blocks.weight[left]
            if len(blocks.weight) > 1
            else np.full(len(left), float(blocks.weight[0]))
        )
        if len(left) == 0 or mass[-1] < lightest:
            break
        marks = np.searchsorted(mass, np.arange(0.25 * lightest, mass[-1], 0.5 * lightest))
        asked = left[np.unique(np.minimum(marks, len(left) - 1))]
        low, high = _windows(blocks.state[:, asked].astype(np.float64), sensor)
        found, free = claim(blocks, free, asked, low, high)
        centres = np.concatenate((centres, found), axis=1)
    return centres, free


def _windows(centres: F8, sensor: Sensor) -> tuple[F8, F8]:
    """Corners (2, k) of the positions that centres reach."""
    reach = REACH * sensor.noise(centres)[:2]
    return centres[:2] - reach, centres[:2] + reach


def heavy_enough(found: Gaussians, sensor: Sensor, lightest: float, split: float) -> Gaussians:
    """The clusters of at least the mass ``lightest``, after light ones that are near each other
    have been joined.

    Clusters start on every detection, so one target beside a false alarm, or detected twice, may
    lie in two halves that are each too light. The nearest, in units of the noise, are joined first,
    while one of the two is too light and both are not above ``split``, too heavy for one.

    Parameters
    ----------
    found : the clusters.
    sensor : the sensor, whose noise is the unit of distances.
    lightest : the smallest mass of a cluster that counts.
    split : the mass above which a cluster is too heavy for one target.
    """
    light = np.flatnonzero((found.weight > 0) & (found.weight < lightest))
    at = found.mean[:, light]
    scale = sensor.noise(found.mean[:, light])
    low = at[:2] - REACH * scale[:2]
    high = at[:2] + REACH * scale[:2]
    place = np.ascontiguousarray(at[:2])
    first, second = overlapping_pairs(low, high, make_grid(place, place))
    first, second = first[first < second], second[first < second]
    distance2 = np.square((at[:, first] - at[:, second]) / scale[:, first]).sum(axis=0)
    mass = found.weight.copy()
    group = np.arange(len(found.weight))
    for pair in distance2.argsort(kind="stable"):
        i = group[light[first[pair]]]
        j = group[light[second[pair]]]
        if (
            distance2[pair] <= REACH**2
            and i != j
            and min(mass[i], mass[j]) < lightest
            and mass[i] + mass[j] <= split
        ):
            mass[i] += mass[j]
            mass[j] = 0.0
            group[group == j] = i
    heavy = mass[group] >= lightest
    if (group == np.arange(len(group))).all():
        return kept(found, heavy)
    return union(kept(found, heavy), np.unique(group[heavy], return_inverse=True)[1])


def _floored(mixture: Gaussians, sensor: Sensor) -> tuple[Gaussians, F8]:
    """The components that have a shape, with a floor under their covariances, and the noise (d, k)
    at their means.
    """
    alive = mixture.weight > SHAPELESS
    mixture = mixture if alive.all() else kept(mixture, alive)
    scale = sensor.noise(mixture.mean)
    return mixture._replace(covariance=with_floor(mixture.covariance, scale)), scale


def _refitted(
    blocks: Blocks, known: Gaussians, mixture: Gaussians, sensor: Sensor, reach: F8 | float
) -> tuple[Gaussians, F8]:
    """One EM iteration with components that reach this far in position, (2, k) pixels or a number
    for all; the floored mixture, and the noise (d, k) at its means [M09 §III-B].
    """
    at = mixture.mean[:2]
    near = reaching(blocks, at - reach, at + reach)
    mass, mean, cov, *_ = em_step(blocks.state, blocks.weight, np.zeros(0), mixture, near, known)
    return _floored(Gaussians(mass, mean, cov), sensor)


def _divided(mixture: Gaussians, sensor: Sensor, split: float) -> Gaussians:
    """Components heavier than ``split`` divided: a deviation to either side on the longest axis in
    units of the noise.
    """
    heavy = mixture.weight > split
    scale = sensor.noise(mixture.mean[:, heavy]).T
    length2, axes = np.linalg.eigh(
        mixture.covariance[heavy] / (scale[:, :, None] * scale[:, None, :])
    )
    step = (scale * axes[:, :, -1] * np.sqrt(length2[:, -1:])).T
    weight = np.where(heavy, mixture.weight / 2, mixture.weight)
    mean = mixture.mean.copy()
    mean[:, heavy] -= step
    return Gaussians(
        np.concatenate([weight, weight[heavy]]),
        np.hstack([mean, mixture.mean[:, heavy] + step]),
        np.concatenate([mixture.covariance, mixture.covariance[heavy]]),
    )


def finish(peaks: Gaussians, z: F8, model: Model) -> Estimates:
    """States, in the order of the clusters: a floor under their covariances, their boxes, the
    detection that each rests on.

    A state rests on the nearest detection in whose 99 % region it lies; a detection serves one
    state, the closest first.

    Parameters
    ----------
    peaks : k masses, means and covariances.
    z, model : (m, N) measurements; its sensor says what is near.
    """
    sensor = model.sensor
    mean = peaks.mean
    at = np.ascontiguousarray(mean[:2])
    z_of, state_of = overlapping_pairs(*sensor.gate(z), make_grid(at, at))
    of = z.take(z_of, axis=1)
    seen = mean.take(state_of, axis=1)
    distance2, _ = gaussian_parts(
        sensor.innovation(of, sensor.predicted_measurements(seen)), sensor.covariance(of, seen)
    )
    region = chi2_quantile(len(sensor.observed), 0.99)
    free = np.ones(z.shape[1], np.bool_)
    detection = np.full(mean.shape[1], -1)
    for pair in distance2.argsort(kind="stable"):
        if distance2[pair] > region:
            break
        i = z_of[pair]
        j = state_of[pair]
        if free[i] and detection[j] < 0:
            detection[j] = i
            free[i] = False
    # Resampled particles can pile up on few points; a covariance of zero would claim certainty.
    return Estimates(
        mean,
        with_floor(peaks.covariance, sensor.noise(mean)),
        peaks.weight,
        sensor.boxes(mean),
        detection,
    )


def with_floor(cov: F8, noise: F8) -> F8:
    """Covariances (k, d, d) with a tenth of the deviations ``noise`` (d, k), squared, added to the
    diagonals.
    """
    out = cov.copy()
    np.einsum("jrr->jr", out)[...] += np.square(0.1 * noise).T
    return out


def kept(peaks: Gaussians, which: I8 | Bool) -> Gaussians:
    """The peaks at an index or a mask (k,)."""
    return Gaussians(
        peaks.weight[which], np.ascontiguousarray(peaks.mean[:, which]), peaks.covariance[which]
    )


def union(peaks: Gaussians, group: I8) -> Gaussians:
    """One peak for each group of peaks, with their mass, mean and covariance; ``group`` (k,)
    numbers them from 0.
    """
    if len(group) == 0:
        return peaks
    mass = np.bincount(group, peaks.weight).astype(np.float64)
    mean = np.array([np.bincount(group, peaks.weight * row) for row in peaks.mean]) / mass
    apart = peaks.mean - mean[:, group]
    cov = peaks.weight[:, None, None] * (peaks.covariance + np.einsum("ik,jk->kij", apart, apart))
    order = np.argsort(group, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(group))[:-1]])
    return Gaussians(mass, mean, np.add.reduceat(cov[order], first) / mass[:, None, None])


def join_unresolved(peaks: Gaussians, sensor: Sensor, overlap: float) -> tuple[Gaussians, I8]:
    """The m ≤ k peaks with those joined whose boxes overlap by too much, most first; and the
    heaviest part of each (m,).

    Parameters
    ----------
    peaks : k of them.
    sensor : knows their boxes; the box of a union is the mean of its parts' by mass.
    overlap : the largest IoU of two boxes that stay apart; 1: all do.
    """
    k = len(peaks.weight)
    group = np.arange(k)
    if k < 2 or overlap >= 1:
        return peaks, group
    boxes = sensor.boxes(peaks.mean)
    lower = np.ascontiguousarray(boxes[:, :2].T)
    upper = np.ascontiguousarray(boxes[:, 2:].T)
    first, second = overlapping_pairs(lower, upper, make_grid(lower, upper))
    first, second = first[first < second], second[first < second]
    # By overlap, then by number; pairs of a peak that has been joined since are passed over.
    shares = iou_of_pairs(boxes[first], boxes[second])
    queue = [
        (-s, int(i), int(j), 0, 0)
        for i, j, s in zip(first, second, shares, strict=True)
        if s > overlap
    ]
    if not queue:
        return peaks, group
    heapq.heapify(queue)
    boxes = boxes.copy()
    mass = peaks.weight.copy()
    joined = [0] * k
    while queue:
        _, i, j, *before = heapq.heappop(queue)
        if before != [joined[i], joined[j]]:
            continue
        mass[i] += mass[j]
        boxes[i] += mass[j] / mass[i] * (boxes[j] - boxes[i])
        group[group == j] = i
        boxes[j] = np.nan
        joined[i] += 1
        joined[j] += 1
        shared = iou(boxes[i : i + 1], boxes)[0]
        shared[i] = 0.0
        for c in np.flatnonzero(shared > overlap).tolist():
            low = min(i, c)
            high = max(i, c)
            heapq.heappush(queue, (-shared[c], low, high, joined[low], joined[high]))
    heads, group = np.unique(group, return_inverse=True)
    order = np.lexsort((-np.arange(k), peaks.weight))
    part = np.empty(len(heads), np.int64)
    part[group[order]] = order
    return union(peaks, group), part


def heaviest(peaks: Estimates, cardinality: F8) -> Estimates:
    """The heaviest states, as many as the most probable number of targets, in the order that they
    had.

    ``cardinality`` (n,) : probabilities of 0, 1, 2, … targets.
    """
    count = int(cardinality.argmax())
    if len(peaks) <= count:
        return peaks
    return peaks.select(np.sort(np.argsort(-peaks.weight, kind="stable")[:count]))


def united(peaks: Estimates, sensor: Sensor) -> Estimates:
    """The states, each with the lighter ones within `MERGE_DISTANCE` of it by its covariance;
    heaviest first.

    Weights add up, states are averaged, the covariance stays that of the heaviest, and so does its
    detection, unless it had none.
    """
    left = np.argsort(-peaks.weight, kind="stable")
    heads = []
    weight = peaks.weight.copy()
    state = peaks.state.copy()
    detection = peaks.detection.copy()
    while len(left):
        head = left[0]
        step = peaks.state[:, left] - peaks.state[:, [head]]
        near = (step * np.linalg.solve(peaks.covariance[head], step)).sum(
            axis=0
        ) <= MERGE_DISTANCE**2
        members = left[near]
        weight[head] = peaks.weight[members].sum()
        state[:, head] = peaks.state[:, members] @ peaks.weight[members] / weight[head]
        served = peaks.detection[members]
        detection[head] = next((int(one) for one in served if one >= 0), -1)
        heads.append(head)
        left = left[~near]
    xyxy = sensor.boxes(state)
    return replace(peaks, weight=weight, state=state, xyxy=xyxy, detection=detection).select(
        np.array(heads, np.int64)
    )
