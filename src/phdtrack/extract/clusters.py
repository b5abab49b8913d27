"""What K-means and EM share: where clusters start, which particles are near them, and how they become states.

Distances are scaled by the noise of the measurement and of the velocity, component by component; without that, position
would drown in size. A particle is compared only with the centres near it: those within ``REACH`` deviations in position.
"""

from __future__ import annotations

import numpy as np

from phdtrack.kernels.gating import gated_pairs
from phdtrack.kernels.pairs import nearest, scaled_distance2
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, I8, Bool, Estimates, Particles

# A cluster reaches this many deviations of the measurement noise. Wide, because a target that was missed spreads.
REACH = 8.0


def near(particles: Particles, centres: F8, sensor: Sensor) -> tuple[I8, I8, F8]:
    """Pairs (particle, centre) within reach, and the scaled distance² of each."""
    scale = sensor.noise(centres)
    reach = REACH * scale[:2]
    point, which = gated_pairs(particles.state[0], particles.state[1], centres[:2] - reach, centres[:2] + reach)
    return point, which, scaled_distance2(particles.state, centres, scale, point, which)


def seeds(particles: Particles, z: F8, sensor: Sensor, lightest: float) -> F8:
    """(d, k) first centres: the detections, at rest [M07 §3], and what no detection is near.

    A target that was missed has no detection to start from, and its particles would be drawn into a far cluster or lost.
    While more than ``lightest`` mass is out of every centre's reach, some of these particles become centres.
    """
    centres, _ = sensor.states(z)
    lonely = np.ones(len(particles), np.bool_)
    point, _, _ = near(particles, centres, sensor)
    lonely[point] = False
    # Once finds every target whose particles lie together in memory, as resampling leaves them; again, to be sure.
    for _ in range(2):
        left = np.flatnonzero(lonely)
        if particles.weight[left].sum() < lightest:
            break
        rest = Particles(np.ascontiguousarray(particles.state[:, left]), particles.weight[left])
        found, claimed = _lonely_centres(rest, sensor, lightest)
        centres = np.hstack([centres, found])
        lonely[left[claimed]] = False
    return centres


def _lonely_centres(rest: Particles, sensor: Sensor, lightest: float) -> tuple[F8, Bool]:
    """Centres (d, k) among particles that no detection is near, and which particles (L,) they have claimed.

    Every half of ``lightest`` along the cumulative weight one particle is asked: it claims what is in its reach and not
    claimed yet, and the mean of that is a centre.
    """
    mass = np.cumsum(rest.weight)
    teeth = np.arange(0.25 * lightest, mass[-1], 0.5 * lightest)
    asked = np.unique(np.minimum(np.searchsorted(mass, teeth), len(mass) - 1))
    point, which, _ = near(rest, np.ascontiguousarray(rest.state[:, asked]), sensor)
    claimed = np.zeros(len(rest), np.bool_)
    centres = []
    for i, members in zip(asked, np.split(point, np.searchsorted(which, np.arange(1, len(asked)))), strict=True):
        if claimed[i]:
            continue
        mine = members[~claimed[members]]
        centres.append(np.average(rest.state[:, mine], axis=1, weights=rest.weight[mine]))
        claimed[mine] = True
    return np.stack(centres, axis=1), claimed


def label(particles: Particles, centres: F8, sensor: Sensor) -> tuple[I8, F8]:
    """The nearest centre in reach of each particle (−1: none), and its scaled distance²."""
    point, which, distance2 = near(particles, centres, sensor)
    labels, best = nearest(distance2, point, which, len(particles))
    return labels, best


def finish(mass: F8, mean: F8, cov: F8, z: F8, model: Model, region: float) -> Estimates:
    """States from clusters: a floor under their covariances, their boxes, and the detection that each rests on.

    A state rests on the nearest detection in whose 99 % region it lies; a detection serves one state, the closest first.
    """
    sensor = model.sensor
    # Resampled particles can pile up on few points; a covariance of zero would claim certainty.
    floor = (0.1 * sensor.noise(mean)) ** 2
    d = len(mean)
    cov = cov.copy()
    cov[:, range(d), range(d)] += floor.T
    detection = np.full(len(mass), -1, np.int64)
    state_of, z_of = gated_pairs(mean[0], mean[1], *sensor.gate(z))
    distance2 = sensor.distance2(z[:, z_of], mean[:, state_of])
    taken = np.zeros(z.shape[1], np.bool_)
    for p in np.argsort(distance2, kind="stable"):
        i, j = state_of[p], z_of[p]
        if distance2[p] <= region and detection[i] < 0 and not taken[j]:
            detection[i], taken[j] = j, True
    return Estimates(mean, cov, mass, sensor.boxes(mean), detection)
