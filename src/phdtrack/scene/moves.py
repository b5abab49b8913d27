"""Components that a mixture lacks or can do without, looked for after recursive learning.

The recursive rule ends in a local optimum: a place of few samples has been swallowed by a wide component, two places share
one, or one stands where the uniform part explains as much, which the rule, whose Gaussians do not depend on that part,
cannot know. So moves are tried in turn. A component goes; or it is parted along its longest axis; or a new one begins where
samples crowd in one position. After each comes EM for the whole model, and the move that makes

    −log p(x_1 … x_n) + Σ_m τ [log n_m + (d + 2)/(n_m − d − 2)] + M/2 log n

smallest stays, if it makes it smaller: the N = 2τ parameters of a component are known from the n_m samples in d dimensions
that it explains, and its share from all [S78]. The recursive rule has the same prior [Z04]. The fraction is half of the
correction for few samples [B94]; half, because with all of it eight marks are no place, and with none eight samples that lie
together by chance are one.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from phdtrack.scene.batch_em import SETTLED, Samples, fitted, likelihood, log_parts, moments, parameters, taken
from phdtrack.scene.density import ContextDensity, marginal
from phdtrack.types import I8

# Steps of EM after which moves are compared, and for a new component alone; how many of the best are then fitted wholly.
_BRIEF, _ALONE, _WHOLLY = 5, 10, 2
# Samples among which crowds are looked for at most: it takes their number squared.
_LOOKED_AT = 1000


def improved(p: ContextDensity, samples: Samples, most: int) -> ContextDensity:
    """``p`` fitted to the samples, after at most ``most`` moves."""
    p = fitted(p, samples)
    length = criterion(p, samples)
    for _ in range(most):
        better = _better(p, length, samples)
        if better is None:
            break
        p, length = better
    return p


def criterion(p: ContextDensity, samples: Samples) -> float:
    """What moves make smaller, nats [S78; B94]."""
    tau = parameters(p.dim) / 2
    n = np.maximum(samples.total * (1 - p.uniform) * p.weight, tau)
    price = tau * (np.log(n) + (p.dim + 2) / (n - p.dim - 2)) + 0.5 * math.log(samples.total)
    return float(price.sum()) - likelihood(p, samples)


def _better(p: ContextDensity, length: float, samples: Samples) -> tuple[ContextDensity, float] | None:
    """The best of what a move makes of ``p``, with its criterion; None where that is not below ``length``."""
    trials = [fitted(trial, samples, _BRIEF) for trial in (*_without(p), *_parted(p), *_with_crowds(p, samples))]
    lengths = np.array([criterion(trial, samples) for trial in trials])
    found = None
    for i in np.argsort(lengths)[:_WHOLLY]:
        trial = fitted(trials[i], samples)
        now = criterion(trial, samples)
        if now < length - SETTLED:
            found, length = (trial, now), now
    return found


def _without(p: ContextDensity) -> list[ContextDensity]:
    """Without each of the components."""
    return [taken(p, np.delete(np.arange(len(p)), m)) for m in range(len(p))] if len(p) > 1 else []


def _parted(p: ContextDensity) -> list[ContextDensity]:
    """With each of the components in two halves: what lies on either side of its middle, along the longest axis of its
    correlation matrix."""
    found = []
    for m in range(len(p)):
        deviation = np.sqrt(np.diag(p.covariance[m]))
        values, vectors = np.linalg.eigh(p.covariance[m] / np.outer(deviation, deviation))
        # The mean of half a normal distribution is √(2/π) deviations from its middle.
        step = math.sqrt(2 / math.pi * values[-1]) * vectors[:, -1] * deviation
        half = p.covariance[m] - np.outer(step, step)
        others = np.delete(np.arange(len(p)), m)
        weight = np.concatenate([p.weight[others], np.full(2, p.weight[m] / 2)])
        mean = np.column_stack([p.mean[:, others], p.mean[:, m] - step, p.mean[:, m] + step])
        found.append(replace(p, weight=weight, mean=mean, covariance=np.concatenate([p.covariance[others], [half, half]])))
    return found


def _with_crowds(p: ContextDensity, samples: Samples) -> list[ContextDensity]:
    """With one component more, fitted alone beside ``p``: each begins in another crowd."""
    parts, found = log_parts(p, samples), []
    density = np.logaddexp.reduce(parts, axis=0)
    for near in _crowds(p, np.argmax(parts, axis=0), samples):
        x, share = samples.x[:, near], len(near) / len(samples.worth)
        spread = np.cov(x, bias=True) + np.diag(samples.floor)
        one = ContextDensity(p.low, p.high, samples.least, np.ones(1), x.mean(axis=1)[:, None], spread[None])
        for _ in range(_ALONE):
            alone = log_parts(one, samples)[1] - math.log(1 - one.uniform)
            odds = np.exp(np.clip(alone - density, -700, 700)) * share / (1 - share)
            belongs = samples.worth * odds / (1 + odds)
            mean, cov = moments(one, belongs[None], samples)
            one, share = replace(one, mean=mean, covariance=cov), min(float(belongs.sum()) / samples.total, 0.5)
        if share * samples.total > parameters(p.dim) / 2:
            found.append(_beside(p, one, share))
    return found


def _beside(p: ContextDensity, one: ContextDensity, share: float) -> ContextDensity:
    """``p`` with the component ``one``, which has a ``share`` of everything."""
    uniform = (1 - share) * p.uniform
    weight = np.append((1 - share) * (1 - p.uniform) * p.weight, share) / (1 - uniform)
    mean = np.hstack([p.mean, one.mean])
    return replace(p, uniform=uniform, weight=weight, mean=mean, covariance=np.concatenate([p.covariance, one.covariance]))


def _crowds(p: ContextDensity, owner: I8, samples: Samples) -> list[I8]:
    """Of the samples of each part, ``owner`` (n,), those about the one where more than anywhere are beside what is expected.

    They crowd in position, rows 0 and 1: a crowd are the nearest samples, as many as a component must explain.
    """
    k = math.ceil(parameters(p.dim) / 2) + 1
    known = np.flatnonzero(np.isfinite(samples.x).all(axis=0) & (samples.worth > 0))[:_LOOKED_AT]
    if len(known) <= k:
        return []
    place = np.ascontiguousarray(samples.x[:2, known])
    scaled = place / np.sqrt(place.var(axis=1) + samples.floor[:2])[:, None]
    distance2 = np.square(scaled[:, :, None] - scaled[:, None]).sum(axis=0)
    near = np.argpartition(distance2, k - 1, axis=1)[:, :k]
    radius2 = np.maximum(np.take_along_axis(distance2, near, axis=1).max(axis=1), 1e-12)
    score = -np.log(radius2) - marginal(p, (0, 1)).log(place)
    found = []
    for part in np.unique(owner[known]):
        own = np.flatnonzero(owner[known] == part)
        found.append(known[near[own[np.argmax(score[own])]]])
    return found
