"""The number of targets in the cardinalised PHD recursion [V07]: beside the intensity D goes its
distribution p(n).

Equations: docs/methods.md, CPHD, with M, p⁺ and D⁺ those with the newborn, and with φ = ∫ (1 − p_D)
D⁺ / M

    Υᵘ[Z](n) = Σ_j n!/(n − j − u)! φⁿ⁻ʲ⁻ᵘ E_j(Z),  E_j(Z) = [tʲ] Π_z (κ(z) + t C(z)/M)

for clutter whose number is Poisson distributed: everything except κ(z) drops out of it. E_j(Z) is
e_j of C/(Mκ), multiplied with Πκ, so that κ = 0 needs no rule of its own. The mean of p is the mass
of D after every update.

Births that are driven by measurements are drawn around the detections only: D⁺ lacks the part of γT
that is born where nothing was detected. In p⁺ and in M it counts, as seen by no detection and
missed like the others: a number without births would take newborn targets for those that existed.
The mean of p is then larger than the mass of D by what was born unseen.

Everything is summed in logarithms of positive terms (`kernels.esf`). Detections that nothing in the
intensity explains (C = 0: outside of every gate) change no ratio and are left out: the cost is O(m²
+ m n), m the number of the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from phdtrack.filters.particle_blocks import Intensity
from phdtrack.kernels.esf import log_products, log_sums_without
from phdtrack.types import F8, GaussianMixture, UpdateInfo, false_alarm_share

# Of the distribution's upper end, as much is cut as it adds to the mean.
CUT = 1e-14
TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class UpdateTerms:
    """The terms of an update before they are weighed, which the PHD filter [V06, M07] and the
    cardinalised one share.

    D = a (1 − p_D) D⁺ + Σ_z b_z p_D g(z|·) D⁺; for the PHD filter a = 1, b_z = 1/(κ(z) + C(z)).

    Attributes
    ----------
    mass, born, missed : of D⁺, newborn included; of the newborn; ∫ (1 − p_D) D⁺.
    evidence, clutter : (N,) C(z) and κ(z), per unit of measurement volume.
    weighed : D for a and b (N,).
    least : what κ + C is at least where it is not taken for 0.
    """

    mass: float
    born: float
    missed: float
    evidence: F8
    clutter: F8
    weighed: Callable[[float, F8], Any]
    least: float = TINY

    def info(self, mass: float, vanished: int = 0) -> UpdateInfo:
        """The record of the update; ``mass`` is that after it."""
        detected = self.mass - self.missed
        return UpdateInfo(
            self.mass,
            self.born,
            mass,
            self.evidence,
            self.clutter,
            false_alarm_share(self.clutter, self.evidence),
            vanished,
            detected=detected,
        )

    def phd(self) -> tuple[Any, UpdateInfo]:
        """The intensity after the update of a PHD filter, and what it learned."""
        factor, vanished = self.factors()
        after = self.weighed(1.0, factor)
        return after, self.info(after.mass, vanished)

    def factors(self) -> tuple[F8, int]:
        """(N,) 1/(κ + C) [V06 (32); M07 (5)], and how many are 0 because κ + C is."""
        total = self.clutter + self.evidence
        known = total >= self.least
        return np.divide(1.0, total, out=np.zeros_like(total), where=known), int(
            np.count_nonzero(~known)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Cardinalised:
    """An intensity with the distribution of the number of targets: what the cardinalised PHD
    filters carry.

    ``cardinality`` (n,) holds the probabilities of 0, 1, 2, … targets; its mean is the mass of
    ``intensity`` and of what may have been born where nothing was detected.
    """

    intensity: Intensity | GaussianMixture
    cardinality: F8

    def __len__(self) -> int:
        return len(self.intensity)

    @property
    def mass(self) -> float:
        """The integral of the intensity: the expected number of targets."""
        return self.intensity.mass


@dataclass(frozen=True, slots=True, eq=False)
class Weighing:
    """Factors of the update of the intensity, and the distribution of the number of targets after
    it.

    ``missed`` is the factor of (1 − p_D) D⁺, ``detected`` (N,) that of p_D g(z|·) D⁺ of each
    detection, and ``cardinality`` (n,) the probabilities of 0, 1, 2, … targets.
    """

    missed: float
    detected: F8
    cardinality: F8


def poisson(mean: float, more: int = 0) -> F8:
    """Poisson probabilities of 0, 1, 2, … as far as they count, and of ``more``."""
    number = np.arange(math.ceil(mean + 10 * math.sqrt(mean) + 20) + more)
    if mean > 0:
        return np.exp(number * math.log(mean) - mean - log_factorials(len(number)))
    return np.ones(1)


def weigh(cardinality: F8, terms: UpdateTerms, births: float) -> Weighing:
    """The number with births and after the scan.

    Parameters
    ----------
    cardinality : (n,) probabilities of 0, 1, 2, … targets before births and scan.
    terms : of the intensity, births that it holds included.
    births : expected number of births; those that the intensity does not hold are missed like the
        others.
    """
    known = terms.mass
    evidence = terms.evidence
    # Births reach beyond what is likely: what a scan shows may be very unlikely before it is seen.
    grown = np.convolve(cardinality, poisson(births, len(evidence)))
    whole = known + max(births - terms.born, 0.0)
    return factors(
        grown, whole, terms.missed * whole / known if known > 0 else whole, evidence, terms.clutter
    )


def factors(cardinality: F8, mass: float, missed: float, evidence: F8, clutter: F8) -> Weighing:
    """The update of the number, and the factors of the intensity's [V07].

    Parameters
    ----------
    cardinality : (n,) p⁺.
    mass, missed : M = ∫D⁺ and ∫(1 − p_D) D⁺.
    evidence, clutter : (N,) C(z) and κ(z), per unit of measurement volume.

    Where p⁺ makes the scan impossible (more detections than targets can be, no births and no
    clutter), it is taken for Poisson: the factors are those of the PHD filter then.
    """
    if mass < TINY:
        return Weighing(1.0, np.zeros(len(evidence)), np.ones(1))
    with np.errstate(divide="ignore"):
        prior = np.log(cardinality)
        phi = float(np.log(min(max(missed / mass, 0.0), 1.0)))
    # The reciprocal of a denormal number overflows.
    live = evidence >= TINY
    log_clutter, log_evidence = _shares(evidence[live] / mass, clutter[live])
    products = log_products(log_clutter, log_evidence, len(prior) - 1)
    scan = products[-1]
    likelihood = _log_sum(scan[:, None] + _terms(len(scan), len(prior), 0, phi), axis=0)
    total = float(_log_sum(prior + likelihood, axis=0))
    if total == -math.inf:
        return factors(poisson(mass, len(scan)), mass, missed, evidence, clutter)
    after = _log_sum(prior + _terms(len(scan), len(prior), 1, phi), axis=1)
    factor = math.exp(float(_log_sum(after + scan, axis=0)) - total) / mass
    without = log_sums_without(log_clutter, log_evidence, products, after)
    detected = np.zeros(len(evidence))
    detected[live] = np.exp(without - total) / (clutter[live] * mass + evidence[live])
    return Weighing(factor, detected, trimmed(np.exp(prior + likelihood - total)))


def trimmed(cardinality: F8) -> F8:
    """Without the upper end that adds nothing to the mean; the sum is 1."""
    tail = np.cumsum((np.arange(len(cardinality)) * cardinality)[::-1])[::-1]
    kept = cardinality[: max(1, int(np.count_nonzero(tail > CUT * tail[0])))]
    return np.asarray(kept / kept.sum())


def log_factorials(count: int) -> F8:
    """(count,) log 0! … log (count − 1)!"""
    return np.cumsum(np.log(np.maximum(np.arange(count), 1)))


def _shares(evidence: F8, clutter: F8) -> tuple[F8, F8]:
    """(m,) each: log of κ/(κ + c) and of c/(κ + c), exact however much smaller one is."""
    with np.errstate(divide="ignore"):
        low = np.log(clutter)
        high = np.log(evidence)
    both = np.logaddexp(low, high)
    return low - both, high - both


def _terms(rows: int, columns: int, more: int, phi: float) -> F8:
    """(j, n) log of n!/(n − j − u)! φⁿ⁻ʲ⁻ᵘ; ``more`` is u, ``phi`` log φ. −∞ where n < j + u."""
    factorials = log_factorials(columns)
    left = np.arange(columns) - np.arange(more, rows + more)[:, None]
    some = np.maximum(left, 0)
    # φ⁰ = 1, also where φ = 0.
    powers = np.multiply(some, phi, out=np.zeros(left.shape), where=some > 0)
    return np.where(left >= 0, factorials - factorials[some] + powers, -np.inf)


def _log_sum(values: F8, axis: int) -> F8:
    """log Σ exp along ``axis``; −∞ where all are."""
    largest = values.max(axis=axis, keepdims=True)
    base = np.where(np.isfinite(largest), largest, 0.0)
    with np.errstate(divide="ignore"):
        out: F8 = np.log(np.exp(values - base).sum(axis=axis)) + base.squeeze(axis)
    return out
