"""What all extractions share: states that are one object are joined, as many are kept as there are targets, and each rests
on a detection.

**Joining.** A detector that suppresses overlapping boxes never reports two objects whose boxes overlap by much. Where two
states do, it has fired twice on one object, at two scales or on two parts of it, and the filter, for which every detection
is another target, follows both. Joining them gives up the second of two objects in line while they cover each other; the
association bridges that gap.

**Counting.** A cardinalised filter knows the number of targets better than the weight of any single peak shows it: the peak
of a target that was just missed is light. So peaks are found with a low threshold and without division of heavy ones, and
as many are reported as the most probable number of targets [V07].
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.arrays import chi2_quantile, iou
from phdtrack.kernels.grid import make_grid, overlapping_pairs
from phdtrack.kernels.mixtures import Gaussians
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, I8, Bool, Estimates

# Lightest peak that is a candidate where peaks are counted: a component of a mixture, and a K-means cluster.
LIGHTEST_COMPONENT, LIGHTEST_CLUSTER = 0.05, 0.1
# Heavier than any cluster: none is divided for its mass.
NEVER_SPLIT = 1e9
# Mahalanobis distance up to which a fitted component is part of a heavier one, as in the Gaussian-mixture filters.
MERGE_DISTANCE = 2.0


def finish(peaks: Gaussians, z: F8, model: Model) -> Estimates:
    """States from clusters: a floor under their covariances, their boxes, and the detection that each rests on.

    A state rests on the nearest detection in whose 99 % region it lies; a detection serves one state, the closest first.

    Parameters
    ----------
    peaks : k masses, means and covariances.
    z : (m, N) measurements.
    model : whose sensor says what is near.

    Returns
    -------
    states : k of them, in the same order.
    """
    sensor, mean = model.sensor, peaks.mean
    at = np.ascontiguousarray(mean[:2])
    z_of, state_of = overlapping_pairs(*sensor.gate(z), make_grid(at, at))
    distance2 = sensor.distance2(z.take(z_of, axis=1), mean.take(state_of, axis=1))
    region, free = chi2_quantile(len(sensor.observed), 0.99), np.ones(z.shape[1], np.bool_)
    detection = np.full(mean.shape[1], -1)
    for pair in distance2.argsort(kind="stable"):
        if distance2[pair] > region:
            break
        i, j = z_of[pair], state_of[pair]
        if free[i] and detection[j] < 0:
            detection[j], free[i] = i, False
    # Resampled particles can pile up on few points; a covariance of zero would claim certainty.
    return Estimates(mean, with_floor(peaks.covariance, sensor.noise(mean)), peaks.weight, sensor.boxes(mean), detection)


def with_floor(cov: F8, noise: F8) -> F8:
    """Covariances (k, d, d) with a tenth of the deviations ``noise`` (d, k), squared, added to the diagonals."""
    out = cov.copy()
    np.einsum("jrr->jr", out)[...] += np.square(0.1 * noise).T
    return out


def kept(peaks: Gaussians, which: I8 | Bool) -> Gaussians:
    """The peaks at an index or a mask (k,)."""
    return Gaussians(peaks.weight[which], np.ascontiguousarray(peaks.mean[:, which]), peaks.covariance[which])


def union(peaks: Gaussians, group: I8) -> Gaussians:
    """One peak for each group of peaks, with their mass, mean and covariance; ``group`` (k,) numbers them from 0."""
    mass = np.bincount(group, peaks.weight).astype(np.float64)
    mean = np.array([np.bincount(group, peaks.weight * row) for row in peaks.mean]) / mass
    apart, cov = peaks.mean - mean[:, group], np.zeros((len(mass), len(mean), len(mean)))
    np.add.at(cov, group, peaks.weight[:, None, None] * (peaks.covariance + np.einsum("ik,jk->kij", apart, apart)))
    return Gaussians(mass, mean, cov / mass[:, None, None])


def join_unresolved(peaks: Gaussians, sensor: Sensor, overlap: float) -> tuple[Gaussians, I8]:
    """The peaks with those joined whose boxes overlap by too much, most first; and the heaviest part of each (m,).

    Parameters
    ----------
    peaks : k of them.
    sensor : knows their boxes; the box of a union is the mean of its parts' by mass.
    overlap : the largest IoU of two boxes that stay apart; 1: all do.

    Returns
    -------
    peaks, part : m ≤ k peaks, and of which of the k each has most.
    """
    k = len(peaks.weight)
    group = np.arange(k)
    if k < 2 or overlap >= 1:
        return peaks, group
    boxes = sensor.boxes(peaks.mean)
    lower, upper = np.ascontiguousarray(boxes[:, :2].T), np.ascontiguousarray(boxes[:, 2:].T)
    first, second = overlapping_pairs(lower, upper, make_grid(lower, upper))
    first, second = first[first < second], second[first < second]
    pairs = {
        (int(i), int(j)): share for i, j, share in zip(first, second, _iou(boxes[first], boxes[second]), strict=True)
        if share > overlap
    }  # fmt: skip
    if not pairs:
        return peaks, group
    boxes, mass = boxes.copy(), peaks.weight.copy()
    while pairs:
        i, j = min(pairs, key=lambda pair: (-pairs[pair], pair))
        mass[i] += mass[j]
        boxes[i] += mass[j] / mass[i] * (boxes[j] - boxes[i])
        group[group == j] = i
        boxes[j] = np.nan
        pairs = {pair: share for pair, share in pairs.items() if i not in pair and j not in pair}
        shared = iou(boxes[i : i + 1], boxes)[0]
        shared[i] = 0.0
        pairs |= {(min(i, int(a)), max(i, int(a))): shared[a] for a in np.flatnonzero(shared > overlap)}
    heads, group = np.unique(group, return_inverse=True)
    order = np.lexsort((-np.arange(k), peaks.weight))
    part = np.empty(len(heads), np.int64)
    part[group[order]] = order
    return union(peaks, group), part


def _iou(a: F8, b: F8) -> F8:
    """(P,) intersection over union of the boxes (P, 4), pair by pair."""
    sides = np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
    both = sides.clip(0).prod(axis=1)
    total = (a[:, 2:] - a[:, :2]).prod(axis=1) + (b[:, 2:] - b[:, :2]).prod(axis=1) - both
    out: F8 = np.divide(both, total, out=np.zeros_like(both), where=total > 0)
    return out


def heaviest(peaks: Estimates, cardinality: F8) -> Estimates:
    """The heaviest states, as many as the most probable number of targets, in the order that they had.

    ``cardinality`` (n,) : probabilities of 0, 1, 2, … targets.
    """
    count = int(cardinality.argmax())
    if len(peaks) <= count:
        return peaks
    return peaks.take(np.sort(np.argsort(-peaks.weight, kind="stable")[:count]))


def united(peaks: Estimates, sensor: Sensor) -> Estimates:
    """The states, each with the lighter ones within `MERGE_DISTANCE` of it by its covariance; heaviest first.

    Weights add up, states are averaged, the covariance stays that of the heaviest, and so does its detection, unless it had
    none.
    """
    left, heads = np.argsort(-peaks.weight, kind="stable"), []
    weight, state, detection = peaks.weight.copy(), peaks.state.copy(), peaks.detection.copy()
    while len(left):
        head = left[0]
        step = peaks.state[:, left] - peaks.state[:, [head]]
        near = (step * np.linalg.solve(peaks.covariance[head], step)).sum(axis=0) <= MERGE_DISTANCE**2
        members = left[near]
        weight[head] = peaks.weight[members].sum()
        state[:, head] = peaks.state[:, members] @ peaks.weight[members] / weight[head]
        served = peaks.detection[members]
        detection[head] = next((int(one) for one in served if one >= 0), -1)
        heads.append(head)
        left = left[~near]
    xyxy = sensor.boxes(state)
    return replace(peaks, weight=weight, state=state, xyxy=xyxy, detection=detection).take(np.array(heads, np.int64))
