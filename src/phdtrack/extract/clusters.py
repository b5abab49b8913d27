"""What K-means and EM share: where clusters start, which particles are near them, and how they become states.

Distances are scaled by the noise of the measurement and of the velocity, component by component; without that, position
would drown in size. A particle is compared only with the centres near it: those within ``REACH`` deviations in position.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phdtrack.extract.cloud import Cloud
from phdtrack.kernels.clustering import cluster_moments, outside
from phdtrack.kernels.gating import gated_pairs
from phdtrack.kernels.joining import claim, serve
from phdtrack.kernels.kmeans import kmeans
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
    left = outside(cloud.state, cloud.start, cloud.low, cloud.high, centres, sensor.noise(centres), REACH)
    # Once finds every target whose particles lie together, as blocks do; again, to be sure.
    for _ in range(2):
        rest = cloud.take(left)
        if rest.mass < lightest:
            break
        found, claimed = _lonely_centres(rest, sensor, lightest)
        centres = np.concatenate((centres, found), axis=1)
        left = left[~claimed]
    return centres


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
    point, which = gated_pairs(rest.state[0], rest.state[1], centre[:2] - reach, centre[:2] + reach)
    found: tuple[F8, Bool] = claim(rest.state, rest.weight, asked, point, which)
    return found


def cluster(cloud: Cloud, centres: F8, sensor: Sensor, split: float, iterations: int) -> Labels:
    """K-means from the centres (d, k): clusters heavier than ``split`` are divided, and it settles in ``iterations``.

    Distances are measured in the noise at the first centres; that changes little as the centres move, and asking the
    sensor in every iteration would cost as much as the iteration.
    """
    # Each division adds a cluster, and a mass M holds at most M/split too heavy ones: the bound only guards rounding.
    rounds = math.ceil(2 * float(cloud.mass.sum()) / split) if split < math.inf else 0
    k, mass, mean, block, own = kmeans(
        cloud.state, cloud.weight, cloud.start, cloud.low, cloud.high, cloud.origin, cloud.mass, cloud.first, *cloud.grid,
        centres, sensor.noise(centres), REACH, split, iterations, rounds,
    )  # fmt: skip
    return Labels(block, own, mass[:k], np.ascontiguousarray(mean[:, :k]))


def moments(cloud: Cloud, labels: Labels, place: I8, reference: F8) -> tuple[F8, F8, F8]:
    """Masses (k,), means (d, k) and covariances (k, d, d): label j is part of cluster ``place[j]``, −1 for none.

    ``reference`` (d, k) is a point in the middle of each cluster.
    """
    result: tuple[F8, F8, F8] = cluster_moments(
        cloud.state, cloud.weight, cloud.start, cloud.origin, cloud.mass, cloud.first, cloud.second,
        labels.block, labels.own, place, reference,
    )  # fmt: skip
    return result


def finish(mass: F8, mean: F8, cov: F8, z: F8, model: Model, region: float) -> Estimates:
    """States from clusters: a floor under their covariances, their boxes, and the detection that each rests on.

    A state rests on the nearest detection in whose 99 % region it lies; a detection serves one state, the closest first.
    """
    sensor = model.sensor
    d = len(mean)
    # Resampled particles can pile up on few points; a covariance of zero would claim certainty.
    floored = cov.copy()
    np.einsum("jrr->jr", floored)[...] += np.square(0.1 * sensor.noise(mean)).T.reshape(-1, d)
    state_of, z_of = gated_pairs(mean[0], mean[1], *sensor.gate(z))
    distance2 = sensor.distance2(z.take(z_of, axis=1), mean.take(state_of, axis=1))
    order = distance2.argsort(kind="stable")
    order = order[: np.searchsorted(distance2[order], region, side="right")]
    return Estimates(mean, floored, mass, sensor.boxes(mean), serve(order, state_of, z_of, len(mass), z.shape[1]))
