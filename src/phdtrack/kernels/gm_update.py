"""The measurement update of a Gaussian-mixture PHD over the arrays that a model answers [V06 (32)–(38); V07].

Two steps, between which the cardinalised filter weighs the terms in its own way: `phd_terms` adds the births and finds what
all Gaussians say of the measurements, `phd_mixture` makes the updated Gaussians.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import (
    Births,
    Expected,
    Measurements,
    Pairs,
    gain,
    gated,
    innovation_root,
    posterior_covariance,
    posterior_mean,
    whitened,
    work_space,
)

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
# The reciprocal of a smaller number may overflow.
SMALLEST = float(np.finfo(np.float64).tiny)


class Rows(NamedTuple):
    """A Gaussian mixture, a Gaussian a row: ``weight`` (J,), ``mean`` (J, d), ``covariance`` (J, d, d), ``tag`` (J,)."""

    weight: F8
    mean: F8
    covariance: F8
    tag: I8


class Terms(NamedTuple):
    """The terms of an update, not weighed yet. Its Gaussians are the predicted ones and the births.

    Attributes
    ----------
    weight : (L,) of D⁺; births whose detection is explained weigh 0.
    kept : (K,) which of the L weigh more than 0.
    gaussian, measurement : (P,) pairs within the gate.
    share : (P,) p_D w q of each.
    evidence : (N,) C(z).
    explained : (N,) 1/(κ + C), 0 where κ + C is.
    vanished : how many of them are.
    predicted, born, missed : masses of D⁺, of the births within it and of (1 − p_D) D⁺.
    """

    weight: F8
    kept: I8
    gaussian: I8
    measurement: I8
    share: F8
    evidence: F8
    explained: F8
    vanished: int
    predicted: float
    born: float
    missed: float


@njit(**INNER)
def _births(before: F8, births: Births, pairs: Pairs, region: float, count: int) -> F8:
    """(L,) weights of predicted Gaussians and births, those 0 whose detection predicted ones explain.

    A detection is explained by a predicted mass of 1 or more within the squared distance ``region`` of it. Where births of
    several detections overlap they share γ: each is divided by Σ_i w_i q_i/γ at its own detection, so that together they
    have the density of γ there.
    """
    old, new = before.size, births.weight.size
    covered, shared, weight = np.zeros(count), np.zeros(count), np.empty(old + new)
    for i in range(old):
        weight[i] = before[i]
    for p in range(pairs.gaussian.size):
        if pairs.gaussian[p] < old and pairs.distance2[p] <= region:
            covered[pairs.measurement[p]] += before[pairs.gaussian[p]]
    for k in range(new):
        j = births.measurement[k]
        weight[old + k] = births.weight[k] if j < 0 or covered[j] < 1.0 else 0.0
    for p in range(pairs.gaussian.size):
        i = pairs.gaussian[p]
        if i >= old and births.measurement[i - old] >= 0 and pairs.distance2[p] <= region and weight[i] > 0.0:
            shared[pairs.measurement[p]] += weight[i] * np.exp(pairs.log_density[p])
    for k in range(new):
        j = births.measurement[k]
        if j >= 0 and weight[old + k] > 0.0:
            weight[old + k] *= births.density[k] / shared[j]
    return weight


@njit(**INNER)
def terms_of(before: F8, births: Births, e: Expected, m: Measurements, gate: float, region: float) -> Terms:
    """The terms of the update of predicted Gaussians and births.

    Parameters
    ----------
    before : (J,) weights of the predicted Gaussians.
    births : what is born in the interval.
    e : what the predicted Gaussians, and behind them the births, say of measurements.
    m : the measurements.
    gate : those further from a Gaussian, in deviations of the innovation, do not touch it.
    region : squared distance within which predicted mass explains a detection.
    """
    pairs, n, old = gated(e, m, gate), len(m.z), before.size
    weight = _births(before, births, pairs, region, n)
    evidence, explained, kept = np.zeros(n), np.zeros(n), np.empty(weight.size, np.int64)
    used, predicted, missed, born = 0, 0.0, 0.0, 0.0
    for i in range(weight.size):
        if weight[i] > 0.0:
            kept[used] = i
            used += 1
            predicted += weight[i]
            missed += weight[i] * (1.0 - e.p_detect[i])
            born += weight[i] if i >= old else 0.0
    count = pairs.gaussian.size
    gaussian, measurement, share = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count)
    found = 0
    for p in range(count):
        i, j = pairs.gaussian[p], pairs.measurement[p]
        if weight[i] > 0.0:
            gaussian[found], measurement[found] = i, j
            share[found] = e.p_detect[i] * weight[i] * np.exp(pairs.log_density[p])
            evidence[j] += share[found]
            found += 1
    vanished = 0
    for j in range(n):
        total = m.clutter[j] + evidence[j]
        if total >= SMALLEST:
            explained[j] = 1.0 / total
        else:
            vanished += 1
    return Terms(
        weight, kept[:used], gaussian[:found], measurement[:found], share[:found], evidence, explained, vanished,
        predicted, born, missed,
    )  # fmt: skip


@njit(**INNER)
def mixture_of(
    before: Rows, e: Expected, m: Measurements, terms: Terms, missed: float, detected: F8, fresh: int, threshold: float
) -> tuple[Rows, float, int]:
    """The updated Gaussians, their mass with what the threshold leaves out, and the next tag.

    Parameters
    ----------
    before : the Gaussians of D⁺, births last; only the predicted ones have tags.
    e, m, terms : what they say of the measurements.
    missed : weighs (1 − p_D) D⁺.
    detected : (N,) weigh the terms of each measurement.
    fresh : tag of the first new Gaussian.
    threshold : lighter Gaussians are left out.
    """
    used, d, old = terms.kept.size, before.mean.shape[1], before.tag.size
    tag, mass, room = np.empty(terms.weight.size, np.int64), 0.0, used
    for i in range(old):
        tag[i] = before.tag[i]
    for k in range(used):
        if terms.kept[k] >= old:
            tag[terms.kept[k]] = fresh
            fresh += 1
    for p in range(terms.share.size):
        room += terms.share[p] * detected[terms.measurement[p]] >= threshold
    out = Rows(np.empty(room), np.empty((room, d)), np.empty((room, d, d)), np.empty(room, np.int64))
    k = 0
    for row in range(used):
        i = terms.kept[row]
        value = missed * terms.weight[i] * (1.0 - e.p_detect[i])
        mass += value
        if value >= threshold:
            out.weight[k], out.tag[k] = value, tag[i]
            for r in range(d):
                out.mean[k, r] = before.mean[i, r]
                for s in range(d):
                    out.covariance[k, r, s] = before.covariance[i, r, s]
            k += 1
    work, last, fixed = work_space(d, m.period.size), -1, len(m.noise) == 0
    for p in range(terms.share.size):
        i, j = terms.gaussian[p], terms.measurement[p]
        value = terms.share[p] * detected[j]
        mass += value
        if value >= threshold:
            if not (fixed and last == i):
                innovation_root(e, m, i, j, work.root)
                gain(e, i, work)
                last = i
            whitened(e, m, i, j, work)
            out.weight[k], out.tag[k] = value, tag[i]
            posterior_mean(before.mean, i, work, out.mean, k)
            posterior_covariance(before.covariance, i, work, out.covariance, k)
            k += 1
    return Rows(out.weight[:k], out.mean[:k], out.covariance[:k], out.tag[:k]), mass, fresh


@njit(**ENTRY)
def phd_terms(before: F8, births: Births, e: Expected, m: Measurements, gate: float, region: float) -> Terms:
    """`terms_of`, to be called from Python."""
    out: Terms = terms_of(before, births, e, m, gate, region)
    return out


@njit(**ENTRY)
def phd_mixture(
    before: Rows, e: Expected, m: Measurements, terms: Terms, missed: float, detected: F8, fresh: int, threshold: float
) -> tuple[Rows, float, int]:
    """`mixture_of`, to be called from Python."""
    out: tuple[Rows, float, int] = mixture_of(before, e, m, terms, missed, detected, fresh, threshold)
    return out


@njit(**ENTRY)
def phd_update(
    before: Rows, births: Births, e: Expected, m: Measurements, gate: float, region: float, fresh: int, threshold: float
) -> tuple[F8, F8, F8, I8, F8, tuple[float, float, float], int, int]:
    """Both steps, weighed as in the PHD filter [V06 (32)]: by 1 and 1/(κ + C).

    Arguments as in `terms_of` and `mixture_of`. Returns the updated Gaussians as of `Rows`, C(z) (N,), the masses predicted,
    born and after the update, the number of measurements with κ + C = 0, and the next tag.
    """
    terms = terms_of(before.weight, births, e, m, gate, region)
    rows, mass, fresh = mixture_of(before, e, m, terms, 1.0, terms.explained, fresh, threshold)
    masses = (terms.predicted, terms.born, mass)
    return rows.weight, rows.mean, rows.covariance, rows.tag, terms.evidence, masses, terms.vanished, fresh
