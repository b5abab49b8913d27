"""What K-means and EM share: where clusters start, which particles are near them, and how they become states.

Distances are scaled by the noise of the measurement and of the velocity, component by component; without that, position
would drown in size. A particle is compared only with the centres near it: those within ``REACH`` deviations in position.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.arrays import chi2_quantile
from phdtrack.filters.extract.cloud import Cloud
from phdtrack.filters.extract.settling import REACH, Clusters, Start
from phdtrack.kernels import joining
from phdtrack.kernels.clustering import outside
from phdtrack.kernels.joining import claim, meeting, serve
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, I8, Bool, Estimates, Particles


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
    left, head, link, used = outside(
        cloud.state, cloud.start, cloud.known, cloud.most, cloud.grid.lower, cloud.grid.upper, *cloud.grid.grid,
        centres, scale, REACH,
    )  # fmt: skip
    return Start(centres, scale, head, link, used, centres.shape[1]), left


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


def heavy_enough(found: Clusters, sensor: Sensor, lightest: float, split: float) -> tuple[F8, F8, F8]:
    """Masses (m,), means (d, m) and covariances (m, d, d) of the clusters of at least that mass, light ones joined.

    Two light clusters near each other are one: clusters start on every detection, so one target beside a false alarm, or
    detected twice, may lie in two halves that are each too light.
    """
    out: tuple[F8, F8, F8] = joining.heavy_enough(
        found.mass, found.mean, found.covariance, sensor.noise(found.mean), REACH, lightest, split
    )
    return out


def finish(mass: F8, mean: F8, cov: F8, z: F8, model: Model) -> Estimates:
    """States from clusters: a floor under their covariances, their boxes, and the detection that each rests on.

    A state rests on the nearest detection in whose 99 % region it lies; a detection serves one state, the closest first.
    """
    sensor = model.sensor
    z_of, state_of = meeting(*sensor.gate(z), mean[:2], mean[:2])
    region = chi2_quantile(len(sensor.observed), 0.99)
    distance2 = sensor.distance2(z.take(z_of, axis=1), mean.take(state_of, axis=1))
    # Resampled particles can pile up on few points; a covariance of zero would claim certainty.
    detection, floored = serve(z_of, state_of, distance2, region, sensor.noise(mean), z.shape[1], cov)
    return Estimates(mean, floored, mass, sensor.boxes(mean), detection)
