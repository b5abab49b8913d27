"""The measurement update of a Gaussian-mixture PHD over the arrays that a model answers [V06
(32)–(38); V07].

Two steps, between which the cardinalised filter weighs the terms in its own way: `terms_of` adds
the births around measurements and finds what all Gaussians say of the measurements, `mixture_of`
makes the updated Gaussians.

In them γ is flat around a measurement, and a Gaussian stands for it. Two conditions choose its mass
m and its covariance aR in the rows of the state that the measurement shows: seen through the noise
R it has the density of the flat γ at the measurement, and its mass is that of γ in the 99 % region
{r² ≤ r₀²}, as of particles. In n dimensions, V_n the volume of the unit ball,

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
    + a. ``expected``: what these Gaussians say of measurements; where the sensor is linear
    ``p_detect`` and ``rows`` alone.
    """

    around: NewTargets
    rows: I8
    volume: float
    stretch: float
    expected: Expected


class Reach(NamedTuple):
    """How far Gaussians reach.

    ``gate``: measurements further from a Gaussian, in deviations of the innovation, do not touch
    it. ``region``: squared distance within which predicted mass explains a measurement.
    ``predicted``: how many Gaussians are predicted; those behind them are births that were given.
    """

    gate: float
    region: float
    predicted: int


class Terms(NamedTuple):
    """The terms of an update, not weighed yet.

    ``weight`` (N,), ``covariance`` (N, d, d), ``expected``: of the births around measurements, 0
    where there is none, and what they say of measurements. ``pairs``, ``born_pairs``, of `PAIR`
    weighed with p_D w q: those of the Gaussians, and of these births. ``evidence`` (N,): C(z).
    ``explained`` (N,): 1/(κ + C), 0 where κ + C is, of which there are ``vanished``. ``predicted``,
    ``born``, ``missed``: masses of D⁺, of the births within it and of (1 − p_D) D⁺.
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

    The weight is 0, and the others are arbitrary, where a predicted mass of 1 or more within the
    region about the measurement explains it. ``before`` (J,) are the weights of the Gaussians,
    ``extra`` is the measurements' part of R.
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
    """Weigh each pair with p_D w q, which is added to the ``evidence`` (N,) of its measurement."""
    for p in range(pairs.size):
        pair = pairs[p]
        pair.weight = p_detect[pair.gaussian] * weight[pair.gaussian] * np.exp(pair.log_density)
        evidence[pair.measurement] += pair.weight


@njit(**ENTRY)
def terms_of(before: Rows, e: Expected, m: Measurements, new: Newborn, reach: Reach) -> Terms:
    """The terms of the update; ``before`` are the predicted Gaussians, and behind them births that
    were given.
    """
    n = len(m.z)
    density = new.around.density
    z = m.z
    extra = m.noise
    period = m.period
    said = new.expected
    pairs = gated(
        e.rows, e.z, e.covariance, e.noise, z, extra, period, reach.gate, before.weight, GAUSSIAN
    )
    weight, covariance, noise = _newborn(before.weight, extra, new, pairs, reach)
    if len(said.covariance) == 0:
        said = Expected(said.rows, new.around.mean, covariance, covariance, noise, said.p_detect)
    born_pairs = gated(
        said.rows,
        said.z,
        said.covariance,
        said.noise,
        z,
        extra,
        period,
        reach.gate,
        weight,
        GAUSSIAN,
    )
    shared = np.zeros(n)
    for p in range(born_pairs.size):
        pair = born_pairs[p]
        if pair.distance2 <= reach.region:
            shared[pair.measurement] += weight[pair.gaussian] * np.exp(pair.log_density)
    predicted = 0.0
    missed = 0.0
    born = 0.0
    vanished = 0 * n
    for i in range(before.weight.size):
        predicted += before.weight[i]
        missed += before.weight[i] * (1.0 - e.p_detect[i])
        born += before.weight[i] if i >= reach.predicted else 0.0
    for j in range(n):
        if weight[j] > 0.0:
            weight[j] *= density[j] / shared[j]
            # A detection is of one target at most.
            weight[j] = weight[j] if weight[j] < 1.0 else 1.0
            predicted += weight[j]
            missed += weight[j] * (1.0 - said.p_detect[j])
            born += weight[j]
    evidence = np.zeros(n)
    explained = np.zeros(n)
    _weigh(before.weight, e.p_detect, pairs, evidence)
    _weigh(weight, said.p_detect, born_pairs, evidence)
    for j in range(n):
        total = m.clutter[j] + evidence[j]
        if total >= SMALLEST:
            explained[j] = 1.0 / total
        else:
            vanished += 1
    return Terms(
        weight,
        covariance,
        said,
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
    """Write Gaussians of weight (1 − p_D) ``factor`` behind the first k, but for those below the
    threshold; how many now.
    """
    old_weight, old_mean, old_covariance = before
    weight, mean, covariance = out
    d = mean.shape[1]
    for i in range(old_weight.size):
        value = factor * old_weight[i] * (1.0 - p_detect[i])
        if value >= threshold and old_weight[i] > 0.0:
            weight[k] = value
            for r in range(d):
                mean[k, r] = old_mean[i, r]
                for s in range(d):
                    covariance[k, r, s] = old_covariance[i, r, s]
            k += 1
    return k


@njit(**INNER)
def _heavy(pairs: Records, detected: F8, threshold: float) -> tuple[Records, float]:
    """The pairs, of their weight times ``detected``, that weigh no less than the threshold, and the
    mass of all.
    """
    heavy = np.empty(pairs.size, PAIR)
    mass = 0.0
    found = 0 * pairs.size
    for p in range(pairs.size):
        weight = pairs[p].weight * detected[pairs[p].measurement]
        mass += weight
        if weight >= threshold:
            heavy[found] = pairs[p]
            heavy[found].weight = weight
            found += 1
    return heavy[:found], mass


@njit(**ENTRY)
def mixture_of(
    before: Rows, e: Expected, m: Measurements, new: Newborn, terms: Terms, weighing: tuple[float, F8], threshold: float
) -> tuple[Rows, float]:  # fmt: skip
    """The updated Gaussians, and their mass with what the threshold leaves out. The first arguments
    are as of `terms_of`.

    ``weighing``: the factor of (1 − p_D) D⁺, and those (N,) of the terms of each measurement.
    Gaussians lighter than the ``threshold`` are left out.
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
    """An update, weighed as in the PHD filter [V06 (32)] by 1 and 1/(κ + C), and
    `gm_merge.merged_rows`.

    Gaussians that pruning would drop are not made. The first arguments are as of `terms_of`, the
    others as of `merged_rows`. Returns the Gaussians, means as (d, J), C(z) (N,), the masses
    predicted, born and after the update, and the number of measurements with κ + C = 0.
    """
    around, observed, volume, stretch, said = new
    new = Newborn(NewTargets(*around), observed, volume, stretch, Expected(*said))
    before = Rows(*before)
    e = Expected(*e)
    m = Measurements(*m)
    reach = Reach(*reach)
    merging = Merging(*merging)
    terms = terms_of(before, e, m, new, reach)
    rows, mass = mixture_of(
        before, e, m, new, terms, (1.0, terms.explained), merging.weight_threshold
    )
    weight, mean, covariance = merged_rows(rows, axes, merging, mass if merging.keep_mass else -1.0)
    return (
        weight,
        mean,
        covariance,
        terms.evidence,
        (terms.predicted, terms.born, mass),
        terms.vanished,
    )
