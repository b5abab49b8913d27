"""From which samples of the frame before the chain proposes to descend.

Of M samples few predict a precise measurement well, and of many targets hardly any does for all at once. A proposal that
knows the scan, q(r) ∝ Π_t p̂(z_t | x_t^r), finds them. It is a fixed law while a frame's chain runs, so any will do as long
as it leaves nobody out; the better it is, the more is accepted.

p̂ is the Gaussian view of ∫ g(z|x) f(x|x^r) dx: N(z; H F x^r, H Q Hᵀ + R), exact for linear models. Where the sensor is not
linear, it is the mean of g over a few draws of f. A small share of the proposals is uniform, for what either leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.filters.mcmc_linear import linear_parts
from phdtrack.kernels.gaussian import gaussian_parts
from phdtrack.protocols import Model
from phdtrack.types import F8, I8

# Share of uniform proposals among those that know the scan, and draws where there is no linear view.
UNIFORM, DRAWS = 0.05, 8


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A law q over M samples: ``log`` (M,) log q, ``running`` (M,) sums of q."""

    log: F8
    running: F8


def choose(proposal: Proposal, uniform: F8) -> I8:
    """Draws of q by uniform numbers (k,) in [0, 1)."""
    place: I8 = np.searchsorted(proposal.running, uniform * proposal.running[-1], side="right")
    return place


def proposals(
    informed: bool, joint: bool, origin: F8, dt: float, z: F8, model: Model, rng: np.random.Generator
) -> list[Proposal]:
    """One q for all targets together (``joint``), or one each, of samples ``origin`` (d, n·M) for measurements (m, n)."""
    n = z.shape[1]
    many = origin.shape[1] // n
    if not informed:
        flat = Proposal(np.full(many, -np.log(many)), np.arange(1.0, many + 1))
        return [flat] * (1 if joint else n)
    parts = linear_parts(model, z, dt) if dt else None
    if parts is None:
        fits = _fits(origin, dt, z[:, np.repeat(np.arange(n), many)], model, rng).reshape(n, many)
    else:
        fits = parts.fits(origin)
    if joint:
        fits = fits.sum(axis=0, keepdims=True)
    return [_law(fit) for fit in fits]


def _law(fit: F8) -> Proposal:
    weight = np.exp(fit - fit.max())
    share = (1 - UNIFORM) * weight / weight.sum() + UNIFORM / len(weight)
    return Proposal(np.log(share), np.cumsum(share))


def _fits(origin: F8, dt: float, z: F8, model: Model, rng: np.random.Generator) -> F8:
    """(L,) log p̂(z|ξ), up to what is the same for all, of pairs of columns of ``z`` (m, L) and ``origin`` (d, L)."""
    sensor = model.sensor
    if dt == 0:
        return sensor.log_likelihood(z, origin)
    if not sensor.linear:
        trials = [sensor.log_likelihood(z, model.motion.sample(origin, dt, rng)) for _ in range(DRAWS)]
        return np.asarray(np.logaddexp.reduce(trials, axis=0))
    mean, _, noise = model.motion.transition(origin, dt)
    rows = list(sensor.observed)
    spread = noise[:, rows][:, :, rows] + sensor.covariance(z, mean)
    apart = sensor.innovation(z, sensor.expected(mean))
    distance2, log_det = gaussian_parts(apart, spread)
    return np.asarray(-0.5 * (distance2 + log_det))
