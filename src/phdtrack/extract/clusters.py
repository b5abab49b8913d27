"""What K-means and EM share: where clusters start, which particles are near them, and how they become states.

Distances are scaled by the noise of the measurement and of the velocity, component by component; without that, position
would drown in size. A particle is compared only with the centres near it: those within ``REACH`` deviations in position.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phdtrack.extract.cloud import Cloud, even
from phdtrack.kernels import joining
from phdtrack.kernels.clustering import cluster_moments, outside
from phdtrack.kernels.joining import claim, meeting, serve
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


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where clusters start.

    Attributes
    ----------
    centre : (d, k), ``scale`` (d, k) deviations by which distances from them are measured.
    head, link : which of the first ``filed`` centres are near each block, as `kernels.clustering.outside` gives it.
    """

    centre: F8
    scale: F8
    head: I8
    link: I8
    filed: int


def seeds(cloud: Cloud, z: F8, sensor: Sensor, lightest: float) -> Start:
    """First centres: the detections, at rest [M07 §3], and what no detection is near.

    A target that was missed has no detection to start from, and its particles would be drawn into a far cluster or lost.
    While more than ``lightest`` mass is out of every centre's reach, some of these particles become centres.
    """
    start, left = starting(cloud, sensor.states(z)[0], sensor)
    centres = start.centre
    # Once finds every target whose particles lie together, as blocks do; again, to be sure.
    for _ in range(2):
        if cloud.mass_of(left) < lightest:
            break
        found, claimed = _lonely_centres(cloud.take(left), sensor, lightest)
        centres = np.concatenate((centres, found), axis=1)
        left = left[~claimed]
    if centres is start.centre:
        return start
    return replace(start, centre=centres, scale=sensor.noise(centres))


def starting(cloud: Cloud, centres: F8, sensor: Sensor) -> tuple[Start, I8]:
    """A start from these centres (d, k), and the particles that none of them reaches."""
    scale = sensor.noise(centres)
    left, head, link = outside(
        cloud.state, cloud.start, cloud.known, cloud.most, cloud.grid.lower, cloud.grid.upper, *cloud.grid.grid,
        centres, scale, REACH,
    )  # fmt: skip
    return Start(centres, scale, head, link, centres.shape[1]), left


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
    which, point = meeting(centre[:2] - reach, centre[:2] + reach, rest.state[:2], rest.state[:2])
    claimed = np.zeros(len(rest), np.bool_)
    found = claim(rest.state, rest.weight, asked, which, point, claimed, centre)
    return centre[:, :found], claimed


def cluster(cloud: Cloud, start: Start, split: float, iterations: int) -> Labels:
    """K-means from a start with k centres: clusters heavier than ``split`` are divided, and it settles in ``iterations``.

    Distances are measured in the noise at the first centres; that changes little as the centres move, and asking the
    sensor in every iteration would cost as much as the iteration.
    """
    (d, k), blocks = start.centre.shape, len(cloud.known)
    # Each division adds a cluster, and a mass M holds at most M/split too heavy ones: the bound only guards rounding.
    rounds = math.ceil(2 * float(cloud.known[:, 0].sum()) / split) if split < math.inf else 0
    # As many as there could be if every division parted as little as does not count as a stray (`kernels.kmeans.STRAY`).
    room = k + 10 * rounds
    table, flags = np.empty((room, CENTRE + 4 * d)), np.empty((room, 6), np.int64)
    block, own = np.empty(blocks, np.int32), np.empty(cloud.state.shape[1], np.int32)
    k = kmeans(
        cloud.state, cloud.weight, cloud.start, cloud.known, cloud.grid.lower, cloud.grid.upper, *cloud.grid.grid,
        start.centre, start.scale, REACH, split, iterations, rounds, start.head, start.link, start.filed,
        table, flags, block, own, cloud.scratch(), np.empty(cloud.most, np.int32),
    )  # fmt: skip
    return Labels(block, own, table[:k, MASS].copy(), table[:k, CENTRE + 2 * d : CENTRE + 3 * d].T.copy())


def heavy_enough(labels: Labels, sensor: Sensor, lightest: float, split: float) -> tuple[I8, F8]:
    """Of which cluster each is part (k,), −1: none; and the (d, m) centres of those.

    Two light clusters near each other are one: clusters start on every detection, so one target beside a false alarm, or
    detected twice, may lie in two halves that are each too light.
    """
    scale, centre, at = sensor.noise(labels.mean), np.empty_like(labels.mean), labels.mean[:2]
    side = REACH * scale[:2]
    pairs = meeting(at - side, at + side, at, at)
    place, kept = joining.heavy_enough(*pairs, labels.mass, labels.mean, scale, REACH, lightest, split, centre)
    return place, np.ascontiguousarray(centre[:, :kept])


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
    z_of, state_of = meeting(*sensor.gate(z), mean[:2], mean[:2])
    distance2 = sensor.distance2(z.take(z_of, axis=1), mean.take(state_of, axis=1))
    # Resampled particles can pile up on few points; a covariance of zero would claim certainty.
    floored, detection = cov.copy(), np.full(len(mass), -1)
    serve(z_of, state_of, distance2, region, sensor.noise(mean), np.full(z.shape[1], -1), detection, floored)
    return Estimates(mean, floored, mass, sensor.boxes(mean), detection)
