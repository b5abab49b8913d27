"""The measurement update of a Poisson multi-Bernoulli, for any model: what `kernels.pmb_step` does for boxes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.arrays import sum_by
from phdtrack.filters.bernoullis import Layer
from phdtrack.filters.gated import gated_gaussians
from phdtrack.filters.newborn import Newborn, newborn
from phdtrack.filters.transforms import Transform, posteriors
from phdtrack.kernels.pmb_update import foremost, united, weighed
from phdtrack.models import MeasurementBirth
from phdtrack.models.learned_scene import ContextBirth
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, GaussianMixture, UpdateInfo

TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True)
class Terms:
    """The settings of `filters.pmb.PMB` that an update needs."""

    least: float
    share: float
    most: int
    gate: float
    transform: Transform
    sources: float
    firing: float


def measured(before: Layer, z: F8, model: Model, dt: float, terms: Terms, fresh: int) -> tuple[Layer, UpdateInfo, int]:
    """The targets ``before``, predicted, after the measurements ``z`` (m, N); the label that is free next."""
    sensor, n = model.sensor, z.shape[1]
    mixture = GaussianMixture(before.weight, np.ascontiguousarray(before.mean), before.covariance)
    seen = np.where(before.static, terms.firing, (1 - before.hidden) * sensor.p_detect(mixture.mean))
    point, which, distance2, log_norm = gated_gaussians(mixture, z, sensor, terms.gate, terms.transform)
    order = np.lexsort((which, point))
    point, which, density = point[order], which[order], np.exp((log_norm - 0.5 * distance2)[order])
    born, kappa = first_states(z, model, dt, terms), model.clutter.intensity(z)
    alone = np.maximum(kappa + born.density, TINY)
    target, exist, first, source, taken, weight, own, told = weighed(
        before.exist, before.first, before.weight, seen, point, which, density, alone, terms.least, terms.share, terms.most
    )
    mean, cov = mixture.mean[:, source], before.covariance[source]
    hit = taken >= 0
    if hit.any():
        mean[:, hit], cov[hit] = posteriors(mixture, z, source[hit], taken[hit], sensor, terms.transform)
    unseen = before.hidden[source] / np.maximum(1 - seen[source], TINY)
    hidden = np.where(hit | before.static[source], 0.0, np.minimum(unseen, 1.0))
    kept = Layer(
        exist, before.label[target], first, weight, mean, cov, before.static[source], hidden, taken, before.parent[source],
        before.best[:0], before.presence[:0], before.believed[target],
    )  # fmt: skip
    grown = _joined(kept, _new(own, born, kappa, terms, fresh))
    share = (before.exist[before.target] * before.weight * seen)[point] * density
    false = own * kappa / alone + own * born.density / alone * terms.sources
    false += sum_by(which, np.where(before.static[point], told, 0.0), n)
    total = kappa + born.density + sum_by(which, share, n)
    appeared = float((own * born.density / alone).sum()) * (1 - terms.sources)
    info = UpdateInfo(
        float(before.presence.sum()) + appeared, appeared, float(grown.presence.sum()), (1 - false) * total, false * total,
        int(np.count_nonzero(total == 0)),
    )  # fmt: skip
    return grown, info, fresh + len(grown.exist) - len(exist)


def first_states(z: F8, model: Model, dt: float, terms: Terms) -> Newborn:
    """What new targets are whose first measurements these are.

    Births that are flat about every measurement have γ̂ = p_D γ(z) and the state that z alone tells, with the velocity that
    was learned there; others are updated.
    """
    birth = model.birth
    if isinstance(birth, ContextBirth) and birth.around_detections > 0:
        return first_about(z, birth, model.sensor, dt / model.rate)
    if not isinstance(birth, MeasurementBirth):
        return newborn(z, model, dt, terms.gate, terms.transform)
    mean, cov = model.sensor.states(z)
    return Newborn(model.sensor.p_detect(mean) * birth.density(z) * dt / model.rate, mean, cov)


def first_about(z: F8, birth: ContextBirth, sensor: Sensor, seconds: float) -> Newborn:
    """What new targets are where births are spread around the measurements by place, γ̂ = p_D γ(z)."""
    at = birth.around(sensor.states(z), seconds)
    return Newborn(sensor.p_detect(at.mean) * at.density, at.mean, at.covariance)


def _new(own: F8, born: Newborn, kappa: F8, terms: Terms, fresh: int) -> Layer:
    """A target for every measurement that may be the first of one: itself, or a source."""
    alone = np.divide(born.density, kappa + born.density, out=np.zeros_like(own), where=born.density > 0)
    exist = own * alone
    new = np.flatnonzero((exist >= np.minimum(terms.least, 0.5 * alone)) & (exist > 0))
    n, kinds = len(new), np.array([False, True]) if terms.sources > 0 else np.zeros(1, np.bool_)
    k = len(kinds)
    of = np.repeat(new, k)
    weight = np.tile([1 - terms.sources, terms.sources][:k], n)
    return Layer(
        exist[new], fresh + np.arange(n), k * np.arange(n + 1), weight, born.mean[:, of], born.covariance[of],
        np.tile(kinds, n), np.zeros(len(of)), of, np.full(len(of), -1), new[:0], exist[:0], np.zeros(n),
    )  # fmt: skip


def _joined(a: Layer, b: Layer) -> Layer:
    """The targets of both, with what is read from them."""
    layer = Layer(
        np.concatenate([a.exist, b.exist]),
        np.concatenate([a.label, b.label]),
        np.concatenate([a.first, a.first[-1] + b.first[1:]]),
        np.concatenate([a.weight, b.weight]),
        np.hstack([a.mean, b.mean]),
        np.concatenate([a.covariance, b.covariance]),
        np.concatenate([a.static, b.static]),
        np.concatenate([a.hidden, b.hidden]),
        np.concatenate([a.detection, b.detection]),
        np.concatenate([a.parent, b.parent]),
        a.best,
        a.presence,
        np.concatenate([a.believed, b.believed]),
    )
    return _read(layer)


def _read(layer: Layer) -> Layer:
    """With its best hypotheses and presences."""
    best, presence = foremost(layer.exist, layer.first, layer.weight, layer.static)
    return replace(layer, best=best, presence=presence, believed=np.maximum(layer.believed, presence))


def merged(layer: Layer, merge: float) -> Layer:
    """With the hypotheses of each target that are within ``merge`` deviations of a heavier one given to it."""
    variance = np.diagonal(layer.covariance, axis1=1, axis2=2)
    rows = np.ascontiguousarray(np.hstack([layer.mean.T, variance]))
    first, kept, weight = united(layer.first, layer.weight, rows, layer.static, merge * merge)
    if len(kept) == len(layer):
        return layer
    return _read(
        replace(
            layer, first=first, weight=weight, mean=layer.mean[:, kept], covariance=layer.covariance[kept],
            static=layer.static[kept], hidden=layer.hidden[kept], detection=layer.detection[kept],
            parent=layer.parent[kept],
        )
    )  # fmt: skip
