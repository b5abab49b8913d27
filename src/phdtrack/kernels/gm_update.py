"""The measurement update of a Gaussian-mixture PHD over the arrays of a model [V06 (32)–(38); V07].

It has two steps, between which the cardinalised filter weighs the terms in its own way: `terms_of`
adds the births around measurements and computes the likelihoods of all Gaussians, `mixture_of`
makes the updated Gaussians.

γ is flat around a measurement, and a Gaussian represents it. Two conditions define its mass m and
its covariance aR in the rows of the state that the measurement shows: with the noise R it has the
density of the flat γ at the measurement, and its mass is that of γ in the 99 % region {r² ≤ r₀²},
as for particles. In n dimensions, V_n the volume of the unit ball,

    m = γ V_n r₀ⁿ √|R|,     m N(0; 0, (1 + a) R) = γ     ⇒     1 + a = (V_n r₀ⁿ)^(2/n) / 2π

(a = 3.70 for boxes, 3.61 for points). Where such Gaussians overlap they share γ: each is divided by
Σ_i w_i q_i/γ at its own measurement, so that together they have the density of γ there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I8, Records
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.gaussian import (
    GAUSSIAN,
    PAIR,
    Expected,
    Measurements,
    NewTargets,
    copy_gaussian,
    factor,
    gated,
    write_posteriors,
)
from phdtrack.kernels.gm_merge import Axes, Merging, Rows, merged_rows

# The reciprocal of a smaller number may overflow.
SMALLEST = float(np.finfo(np.float64).tiny)


class Newborn(NamedTuple):
    """Births ``around`` the measurements, a Gaussian each.

    ``rows`` (n,) of the state that a measurement shows, int64. ``volume``: V_n r₀ⁿ. ``stretch``: 1
    + a. ``expected``: their predicted measurements; only ``p_detect`` and ``rows`` if the sensor is
    linear.
    """

    around: NewTargets
    rows: I8
    volume: float
    stretch: float
    expected: Expected


class Reach(NamedTuple):
    """Limits of an update.

    ``gate``: measurements farther from a Gaussian, in deviations of the innovation, do not update
    it. ``region``: squared distance within which predicted mass explains a measurement.
    ``predicted``: number of predicted Gaussians; those behind them are fixed births.
    """

    gate: float
    region: float
    predicted: int


class Terms(NamedTuple):
    """The terms of an update, before they are weighed.

    ``weight`` (N,), ``covariance`` (N, d, d), ``expected``: weights of the births around
    measurements, 0 for none, their covariances and predicted measurements. ``pairs``,
    ``born_pairs``, of `PAIR` with weights p_D w q: those of the Gaussians, and of these births.
    ``evidence`` (N,): C(z). ``explained`` (N,): 1/(κ + C), or 0 where κ + C is 0, which happens
    ``vanished`` times. ``predicted``, ``born``, ``missed``: masses of D⁺, of the births in it and
    of (1 − p_D) D⁺.
    """

    weight: F8
    covariance: F8
    expected: Expected
    pairs: Records
    born_pairs: Records
    evidence: F8
    explained: F8
    vanished: int
    predicted: float
    born: float
    missed: float


@njit(**INNER)
def _newborn(
    before: F8, extra: F8, new: Newborn, pairs: Records, reach: Reach
) -> tuple[F8, F8, F8]:
    """Weights (N,), covariances (N, d, d) and the targets' part of R (N, r, r) of births around
    measurements.

    If a predicted mass of 1 or more within the region about a measurement explains it, its weight
    is 0 and the others are arbitrary. ``before`` (J,): weights of the Gaussians; ``extra``: the
    measurements' part of R.
    """
    density = new.around.density
    first = new.around.covariance
    rows = new.rows
    n = len(first)
    d = first.shape[1]
    r = rows.size
    covered = np.zeros(n)
    weight = np.zeros(n)
    covariance = np.empty((n, d, d))
    noise = np.empty((n, r, r))
    for p in range(pairs.size):
        pair = pairs[p]
        if pair.gaussian < reach.predicted and pair.distance2 <= reach.region:
            covered[pair.measurement] += before[pair.gaussian]
    root = np.empty((r, r))
    for j in range(n):
        if covered[j] < 1.0 and density[j] > 0.0:
            for c in range(d):
                for b in range(d):
                    covariance[j, c, b] = first[j, c, b]
            for a in range(r):
                for b in range(r):
                    noise[j, a, b] = first[j, rows[a], rows[b]]
                    covariance[j, rows[a], rows[b]] = (new.stretch - 1.0) * noise[j, a, b]
            weight[j] = density[j] * new.volume * np.exp(0.5 * factor(noise[j], root))
            if len(extra) > 0:
                for a in range(r):
                    for b in range(r):
                        noise[j, a, b] -= extra[j, a, b]
    return weight, covariance, noise


@njit(**INNER)
def _weigh(weight: F8, p_detect: F8, pairs: Records, evidence: F8) -> None:
    """Write the weight p_D w q of each pair, and add it to the ``evidence`` (N,) of its
    measurement.
    """
    for p in range(pairs.size):
        pair = pairs[p]
        pair.weight = p_detect[pair.gaussian] * weight[pair.gaussian] * np.exp(pair.log_density)
        evidence[pair.measurement] += pair.weight


@njit(**INNER)
def _pairs(weight: F8, e: Expected, m: Measurements, gate: float) -> Records:
    """The pairs of Gaussians of a weight above 0 and measurements within the gate."""
    pairs: Records = gated(
        e.rows, e.z, e.covariance, e.noise, m.z, m.noise, m.period, gate, weight, GAUSSIAN
    )
    return pairs


@njit(**INNER)
def _share_density(weight: F8, density: F8, pairs: Records, region: float) -> None:
    """Scale the weights of births whose Gaussians overlap, so that together they have the density
    of γ at each measurement.
    """
    shared = np.zeros(weight.size)
    for p in range(pairs.size):
        pair = pairs[p]
        if pair.distance2 <= region:
            shared[pair.measurement] += weight[pair.gaussian] * np.exp(pair.log_density)
    for j in range(weight.size):
        if weight[j] > 0.0:
            weight[j] *= density[j] / shared[j]
            # A detection is of one target at most.
            weight[j] = min(1.0, weight[j])


@njit(**ENTRY)
def terms_of(before: Rows, e: Expected, m: Measurements, new: Newborn, reach: Reach) -> Terms:
    """The terms of the update; ``before`` are the predicted Gaussians, and behind them fixed
    births.
    """
    n = len(m.z)
    density = new.around.density
    born_e = new.expected
    pairs = _pairs(before.weight, e, m, reach.gate)
    weight, covariance, noise = _newborn(before.weight, m.noise, new, pairs, reach)
    if len(born_e.covariance) == 0:
        born_e = Expected(
            born_e.rows, new.around.mean, covariance, covariance, noise, born_e.p_detect
        )
    born_pairs = _pairs(weight, born_e, m, reach.gate)
    _share_density(weight, density, born_pairs, reach.region)
    # Masses of D⁺, of the births in it, and of (1 − p_D) D⁺.
    predicted = 0.0
    missed = 0.0
    born = 0.0
    for i in range(before.weight.size):
        predicted += before.weight[i]
        missed += before.weight[i] * (1.0 - e.p_detect[i])
        if i >= reach.predicted:
            born += before.weight[i]
    for j in range(n):
        if weight[j] > 0.0:
            predicted += weight[j]
            missed += weight[j] * (1.0 - born_e.p_detect[j])
            born += weight[j]
    # C(z) of each measurement.
    evidence = np.zeros(n)
    _weigh(before.weight, e.p_detect, pairs, evidence)
    _weigh(weight, born_e.p_detect, born_pairs, evidence)
    explained = np.zeros(n)
    vanished = 0 * n
    for j in range(n):
        total = m.clutter[j] + evidence[j]
        if total >= SMALLEST:
            explained[j] = 1.0 / total
        else:
            vanished += 1
    return Terms(
        weight,
        covariance,
        born_e,
        pairs,
        born_pairs,
        evidence,
        explained,
        vanished,
        predicted,
        born,
        missed,
    )


@njit(**INNER)
def _missed(before: Rows, p_detect: F8, factor: float, threshold: float, out: Rows, k: int) -> int:
    """Write the missed Gaussians, of weight (1 − p_D) ``factor``, from row k on, except those below
    the threshold; returns the row behind them.
    """
    old_weight, old_mean, old_covariance = before
    weight, mean, covariance = out
    for i in range(old_weight.size):
        value = factor * old_weight[i] * (1.0 - p_detect[i])
        if value >= threshold and old_weight[i] > 0.0:
            weight[k] = value
            copy_gaussian(old_mean, old_covariance, i, mean, covariance, k)
            k += 1
    return k


@njit(**INNER)
def _heavy(pairs: Records, detected: F8, threshold: float) -> tuple[Records, float]:
    """The pairs whose weights, multiplied by ``detected`` of their measurements, reach the
    threshold, and the mass of all pairs.
    """
    heavy = np.empty(pairs.size, PAIR)
    mass = 0.0
    count = 0 * pairs.size
    for p in range(pairs.size):
        weight = pairs[p].weight * detected[pairs[p].measurement]
        mass += weight
        if weight >= threshold:
            heavy[count] = pairs[p]
            heavy[count].weight = weight
            count += 1
    return heavy[:count], mass


@njit(**ENTRY)
def mixture_of(
    before: Rows,
    e: Expected,
    m: Measurements,
    new: Newborn,
    terms: Terms,
    weighing: tuple[float, F8],
    threshold: float,
) -> tuple[Rows, float]:
    """The updated Gaussians, and their mass before lighter ones than the ``threshold`` are dropped.

    The first arguments are those of `terms_of`. ``weighing``: the factor of (1 − p_D) D⁺, and those
    (N,) of the terms of each measurement.
    """
    missed, detected = weighing
    d = before.mean.shape[1]
    n = terms.weight.size
    born = Rows(terms.weight, new.around.mean, terms.covariance)
    pairs, mass = _heavy(terms.pairs, detected, threshold)
    born_pairs, born_mass = _heavy(terms.born_pairs, detected, threshold)
    room = before.weight.size + n + pairs.size + born_pairs.size
    out = Rows(np.empty(room), np.empty((room, d)), np.empty((room, d, d)))
    k = _missed(before, e.p_detect, missed, threshold, out, 0 * n)
    k = _missed(born, terms.expected.p_detect, missed, threshold, out, k)
    out_weight = out.weight
    behind = k + pairs.size
    write_posteriors(before.mean, before.covariance, e, m, pairs, out.mean[k:], out.covariance[k:])
    write_posteriors(
        born.mean,
        born.covariance,
        terms.expected,
        m,
        born_pairs,
        out.mean[behind:],
        out.covariance[behind:],
    )
    for p in range(pairs.size):
        out_weight[k + p] = pairs[p].weight
    for p in range(born_pairs.size):
        out_weight[behind + p] = born_pairs[p].weight
    k = behind + born_pairs.size
    return (
        Rows(out_weight[:k], out.mean[:k], out.covariance[:k]),
        missed * terms.missed + mass + born_mass,
    )


@njit(**ENTRY)
def phd_step(
    before: Rows,
    e: Expected,
    m: Measurements,
    new: Newborn,
    reach: Reach,
    merging: Merging,
    axes: Axes,
) -> tuple[F8, F8, F8, F8, tuple[float, float, float], int]:
    """A PHD update [V06 (32)], terms weighed by 1 and 1/(κ + C), and `gm_merge.merged_rows`.

    Gaussians that pruning would drop are not made. The first arguments are those of `terms_of`, the
    others those of `merged_rows`. Returns the Gaussians, means as (d, J), C(z) (N,), the masses
    predicted, born and after the update, and the number of measurements with κ + C = 0.
    """
    around, observed, volume, stretch, expected = new
    new = Newborn(NewTargets(*around), observed, volume, stretch, Expected(*expected))
    before = Rows(*before)
    e = Expected(*e)
    m = Measurements(*m)
    reach = Reach(*reach)
    merging = Merging(*merging)
    terms = terms_of(before, e, m, new, reach)
    rows, mass = mixture_of(
        before, e, m, new, terms, (1.0, terms.explained), merging.weight_threshold
    )
    wanted = -1.0
    if merging.keep_mass:
        wanted = mass
    weight, mean, covariance = merged_rows(rows, axes, merging, wanted)
    return (
        weight,
        mean,
        covariance,
        terms.evidence,
        (terms.predicted, terms.born, mass),
        terms.vanished,
    )
