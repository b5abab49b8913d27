"""New targets for the filters that follow each: what a target would be whose first measurement this is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import sum_by
from phdtrack.filters.gated import gated_gaussians
from phdtrack.filters.transforms import Transform, posteriors
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, I8

_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class Newborn:
    """Targets that measurements are the first of: ``density`` (N,) γ̂(z) per unit of measurement volume, and their states
    ``mean`` (d, N), ``covariance`` (N, d, d)."""

    density: F8
    mean: F8
    covariance: F8


def newborn(z: F8, model: Model, dt: float, gate: float, transform: Transform) -> Newborn:
    """From the model's births: their Gaussians, updated with each measurement and joined by moment matching."""
    count = z.shape[1]
    births = model.birth.components(z, np.zeros(count), model.sensor, dt / model.rate)
    point, which, distance2, log_norm = gated_gaussians(births, z, model.sensor, gate, transform)
    weight = births.weight[point] * model.sensor.p_detect(births.mean)[point] * np.exp(log_norm - 0.5 * distance2)
    density = sum_by(which, weight, count)
    state, cov = model.sensor.states(z)
    if len(which) == 0:
        return Newborn(density, state, cov)
    each, spread = posteriors(births, z, point, which, model.sensor, transform)
    part = weight / np.maximum(density, _TINY)[which]
    born = density > 0
    mean = np.where(born, _sums(which, each * part, count), state)
    step = each - mean[:, which]
    spread = (spread + step.T[:, :, None] * step.T[:, None, :]) * part[:, None, None]
    joined = np.zeros_like(cov)
    np.add.at(joined, which, spread)
    return Newborn(density, mean, np.where(born[:, None, None], joined, cov))


def newborn_anywhere(z: F8, density: float, sensor: Sensor) -> Newborn:
    """As frequent everywhere, and known from their measurement alone."""
    mean, cov = sensor.states(z)
    return Newborn(np.full(z.shape[1], density), mean, cov)


def _sums(which: I8, columns: F8, count: int) -> F8:
    """(d, count) sums of the ``columns`` (d, P) of equal ``which``."""
    out = np.zeros((len(columns), count))
    np.add.at(out.T, which, columns.T)
    return out
