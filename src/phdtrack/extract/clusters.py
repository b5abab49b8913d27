"""What K-means and EM share: where clusters start, which particles are near them, and how they become states.

Distances are scaled by the noise of the measurement and of the velocity, component by component; without that, position
would drown in size. A particle is compared only with the centres near it: those within ``REACH`` deviations in position.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phdtrack.extract.cloud import Cloud, even
from phdtrack.extract.rectangles import Rectangles
from phdtrack.kernels.clustering import cluster_moments, outside
from phdtrack.kernels.joining import claim
from phdtrack.kernels.kmeans import kmeans
from phdtrack.kernels.nearest import CENTRE, MASS
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, I8, Bool, Estimates, Particles

I4 = NDArray[np.int32]

# A cluster reaches this many deviations of the measurement noise. Wide, because a target that was missed spreads.
REACH = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """Which cluster each particle belongs to.

    Attributes
    ----------
    block, own : clusters of whole blocks (B,) and of the particles of mixed ones (L,), as in `kernels.kmeans`.
    mass, mean : (k,) masses and (d, k) means of the clusters; an empty one keeps its centre.
    """

    block: I4
    own: I4
    mass: F8
    mean: F8


def seeds(cloud: Cloud, z: F8, sensor: Sensor, lightest: float) -> F8:
    """(d, k) first centres: the detections, at rest [M07 §3], and what no detection is near.

    A target that was missed has no detection to start from, and its particles would be drawn into a far cluster or lost.
    While more than ``lightest`` mass is out of every centre's reach, some of these particles become centres.
    """
    centres, _ = sensor.states(z)
    left = _out_of_reach(cloud, centres, REACH * sensor.noise(centres)[:2])
    # Once finds every target whose particles lie together, as blocks do; again, to be sure.
    for _ in range(2):
        rest = cloud.take(left)
        if rest.mass < lightest:
            break
        found, claimed = _lonely_centres(rest, sensor, lightest)
        centres = np.concatenate((centres, found), axis=1)
        left = left[~claimed]
    return centres


def _out_of_reach(cloud: Cloud, centres: F8, reach: F8) -> I8:
    """The particles that none of the centres (d, k) reaches, ``reach`` (2, k) from each."""
    lower, upper = centres[:2] - reach, centres[:2] + reach
    which, block = cloud.grid.meeting(lower, upper)
    count = cloud.state.shape[1]
    out = np.empty(count, np.int64)
    covered, free = np.empty(len(cloud.known), np.bool_), np.empty(count, np.bool_)
    found = outside(cloud.state, cloud.start, cloud.known, lower, upper, which, block, covered, free, out)
    return out[:found]


def _lonely_centres(rest: Particles, sensor: Sensor, lightest: float) -> tuple[F8, Bool]:
    """Centres (d, k) among particles that no detection is near, and which particles (L,) they have claimed.

    Every half of ``lightest`` along the cumulative weight one particle is asked: it claims what is in its reach and not
    claimed yet, and the mean of that is a centre.
    """
    mass = np.cumsum(rest.weight)
    teeth = np.arange(0.25 * lightest, mass[-1], 0.5 * lightest)
    asked = np.unique(np.minimum(np.searchsorted(mass, teeth), len(mass) - 1))
    centre = rest.state.take(asked, axis=1)
    reach = REACH * sensor.noise(centre)[:2]
    points = Rectangles.of(rest.state[:2], rest.state[:2])
    which, point = points.meeting(centre[:2] - reach, centre[:2] + reach)
    claimed = np.zeros(len(rest), np.bool_)
    found = claim(rest.state, rest.weight, asked, which, point, claimed, centre)
    return centre[:, :found], claimed


def cluster(cloud: Cloud, centres: F8, sensor: Sensor, split: float, iterations: int) -> Labels:
    """K-means from the centres (d, k): clusters heavier than ``split`` are divided, and it settles in ``iterations``.

    Distances are measured in the noise at the first centres; that changes little as the centres move, and asking the
    sensor in every iteration would cost as much as the iteration.
    """
    (d, k), blocks, kind = centres.shape, len(cloud.known), cloud.state.dtype
    # Each division adds a cluster, and a mass M holds at most M/split too heavy ones: the bound only guards rounding.
    rounds = math.ceil(2 * float(cloud.known[:, 0].sum()) / split) if split < math.inf else 0
    # As many as there could be if every division parted as little as does not count as a stray (`kernels.kmeans.STRAY`).
    room = k + 10 * rounds
    table, flags = np.empty((room, CENTRE + 4 * d)), np.empty((room, 6), np.int64)
    block, own = np.empty(blocks, np.int32), np.empty(cloud.state.shape[1], np.int32)
    k = kmeans(
        cloud.state, cloud.weight, cloud.start, cloud.known, cloud.grid.lower, cloud.grid.upper, *cloud.grid.grid,
        np.ascontiguousarray(centres), sensor.noise(centres), REACH, split, iterations, rounds,
        table, flags, block, own, np.empty(blocks, np.int64), np.empty((2, 2 * blocks + 64), np.int64),
        np.empty(max(room, blocks), np.int64), np.empty((d + 2, cloud.most), kind), np.empty(cloud.most, np.int32),
    )  # fmt: skip
    return Labels(block, own, table[:k, MASS].copy(), table[:k, CENTRE + 2 * d : CENTRE + 3 * d].T.copy())


def moments(cloud: Cloud, labels: Labels, place: I8, reference: F8) -> tuple[F8, F8, F8]:
    """Masses (k,), means (d, k) and covariances (k, d, d): label j is part of cluster ``place[j]``, −1 for none.

    ``reference`` (d, k) is a point in the middle of each cluster.
    """
    d, k = reference.shape
    mass, mean, cov = np.zeros(k), np.zeros((d, k)), np.zeros((k, d, d))
    cluster_moments(
        cloud.state, cloud.weight, cloud.start, labels.block, labels.own, place,
        reference.astype(cloud.state.dtype).astype(np.float64), cloud.scratch(), np.empty(cloud.most, np.int32),
        np.empty(d), np.empty((even(d), even(d))), mass, mean, cov,
    )  # fmt: skip
    return mass, mean, cov


def finish(mass: F8, mean: F8, cov: F8, z: F8, model: Model, region: float) -> Estimates:
    """States from clusters: a floor under their covariances, their boxes, and the detection that each rests on.

    A state rests on the nearest detection in whose 99 % region it lies; a detection serves one state, the closest first.
    """
    sensor = model.sensor
    d = len(mean)
    # Resampled particles can pile up on few points; a covariance of zero would claim certainty.
    floored = cov.copy()
    np.einsum("jrr->jr", floored)[...] += np.square(0.1 * sensor.noise(mean)).T.reshape(-1, d)
    z_of, state_of = Rectangles.of(mean[:2], mean[:2]).meeting(*sensor.gate(z))
    distance2 = sensor.distance2(z.take(z_of, axis=1), mean.take(state_of, axis=1))
    order = distance2.argsort(kind="stable")
    order = order[: np.searchsorted(distance2[order], region, side="right")]
    detection, served = np.full(len(mass), -1), set()
    for state, seen in zip(state_of[order].tolist(), z_of[order].tolist(), strict=True):
        if detection[state] < 0 and seen not in served:
            detection[state] = seen
            served.add(seen)
    return Estimates(mean, floored, mass, sensor.boxes(mean), detection)
