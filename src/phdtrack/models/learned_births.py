"""γ learned from where tracks began: a Gaussian mixture over first states, fitted by MAP expectation and maximisation.

EM with two priors: of each covariance an inverse Wishart about a small part of the states' own spread, worth as many
observations as a state has components plus two, which keeps every covariance positive definite however few tracks there are
[Fraley and Raftery 2007]; of the weights none. The number of components is the one of the smallest

    BIC(k) = −2 log L + m(k) log n,     m(k) = k − 1 + k d + k d (d + 1)/2

The mixture's weights, in births per time unit, add up to the number of tracks over the time in which they began. A file
holds it as JSON: ``weight`` (k), ``mean`` (k rows of d), ``covariance`` (k of d rows).
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.types import F8, GaussianMixture

# Relative gain of the log-likelihood below which EM has arrived.
_SETTLED = 1e-7
_ITERATIONS = 300
_STARTS = 4


def fit(states: F8, duration: float, rng: np.random.Generator, most: int = 8) -> GaussianMixture:
    """The births behind first states (d, n) of tracks that began within ``duration`` time units; at most ``most`` places.

    Raises `InputError` where there are fewer than two tracks, or no time.
    """
    d, n = states.shape
    if n < 2 or not duration > 0 or not np.isfinite(states).all():
        raise InputError(
            f"expected finite first states of two or more tracks and a time above 0, got {n} in {duration:g}",
            where="learned births",
            cure="Learn from a longer sequence",
        )
    best, least = _fitted(states, 1, rng), math.inf
    for k in range(1, min(most, n // 2) + 1):
        found = max((_fitted(states, k, rng) for _ in range(_STARTS if k > 1 else 1)), key=lambda pair: pair[1])
        parameters = k - 1 + k * d + k * d * (d + 1) / 2
        criterion = -2 * found[1] + parameters * math.log(n)
        if criterion < least:
            best, least = found, criterion
    mixture = best[0]
    return GaussianMixture(mixture.weight * n / duration, mixture.mean, mixture.covariance)


def _fitted(states: F8, k: int, rng: np.random.Generator) -> tuple[GaussianMixture, float]:
    """MAP estimate of ``k`` components of total weight 1, and the log-likelihood of the states under it."""
    d, n = states.shape
    spread = np.atleast_2d(np.cov(states, bias=True)) + 1e-9 * np.eye(d)
    # A volume k times smaller, the same shape.
    prior, worth = spread / k ** (2 / d), d + 2.0
    mixture = GaussianMixture(np.full(k, 1 / k), _apart(states, spread, k, rng), np.tile(prior, (k, 1, 1)))
    before = -math.inf
    for _ in range(_ITERATIONS):
        log_density = _log_density(states, mixture)
        total = np.logaddexp.reduce(log_density, axis=0)
        now = float(total.sum())
        if now - before < _SETTLED * abs(now):
            break
        before = now
        share = np.exp(log_density - total)
        mass = share.sum(axis=1)
        alive = mass > 1e-3
        share, mass = share[alive], mass[alive]
        mean = states @ share.T / mass
        step = states[:, None, :] - mean[:, :, None]
        scatter = np.einsum("rjn,jn,sjn->jrs", step, share, step)
        cov = (prior + scatter) / (worth + mass + d + 2)[:, None, None]
        mixture = GaussianMixture(mass / n, mean, cov)
    return mixture, now


def _apart(states: F8, spread: F8, k: int, rng: np.random.Generator) -> F8:
    """(d, k) of the states, each drawn with the squared distance from those before (k-means++)."""
    white = np.linalg.solve(np.linalg.cholesky(spread), states)
    chosen = [int(rng.integers(states.shape[1]))]
    for _ in range(k - 1):
        distance2 = np.square(white[:, :, None] - white[:, None, chosen]).sum(axis=0).min(axis=1)
        total = distance2.sum()
        chosen.append(int(rng.choice(len(distance2), p=distance2 / total if total > 0 else None)))
    return states[:, chosen]


def _log_density(states: F8, mixture: GaussianMixture) -> F8:
    """(k, n) log w_j N(x; m_j, P_j)."""
    root = np.linalg.cholesky(mixture.covariance)
    step = states[None, :, :] - mixture.mean.T[:, :, None]
    white = np.linalg.solve(root, step)
    log_det = np.log(np.einsum("jrr->jr", root)).sum(axis=1)
    norm = np.log(mixture.weight) - log_det - 0.5 * len(states) * math.log(2 * math.pi)
    out: F8 = norm[:, None] - 0.5 * np.square(white).sum(axis=1)
    return out


def write_births(path: Path, mixture: GaussianMixture) -> None:
    """Write a mixture of births as JSON."""
    document = {
        "weight": mixture.weight.tolist(),
        "mean": mixture.mean.T.tolist(),
        "covariance": mixture.covariance.tolist(),
    }
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def read_births(path: Path) -> GaussianMixture:
    """The mixture in a JSON file. Raises `InputError` where there is none, or it is no mixture."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=path) from None
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"expected births as JSON ({error})", where=path) from None
    try:
        weight, mean, cov = (np.array(document[name], np.float64) for name in ("weight", "mean", "covariance"))
        k, d = mean.shape
        fits = weight.shape == (k,) and cov.shape == (k, d, d) and k > 0
        fits = fits and all(np.isfinite(part).all() for part in (weight, mean, cov)) and bool((weight >= 0).all())
        fits = fits and bool((np.linalg.eigvalsh(cov) > 0).all()) and np.allclose(cov, cov.transpose(0, 2, 1))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"expected weight, mean and covariance of a Gaussian mixture ({error})", where=path) from None
    if not fits:
        raise InputError(
            "expected weights (k) from 0, means (k rows of d) and positive definite covariances (k of d by d)",
            where=path,
            cure="Write it with phdtrack.models.learned_births.write_births",
        )
    return GaussianMixture(weight, np.ascontiguousarray(mean.T), cov)
