"""Marginals of associations and what the Poisson multi-Bernoulli filter makes of them, written naively."""

from __future__ import annotations

import itertools

import numpy as np


def propagated(psi: np.ndarray, rounds: int, settled: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Belief propagation on the whole table of odds (T, N): probabilities of pairs (T, N), misses (T,), of nobody's (N,)."""
    mu, nu = np.zeros_like(psi), np.ones_like(psi)
    for _ in range(rounds):
        for t, j in np.ndindex(*psi.shape):
            mu[t, j] = psi[t, j] / (1 + sum(psi[t, i] * nu[t, i] for i in range(psi.shape[1]) if i != j))
        before = nu.copy()
        for t, j in np.ndindex(*psi.shape):
            nu[t, j] = 1 / (1 + sum(mu[s, j] for s in range(len(psi)) if s != t))
        # Where no pair is, no message goes.
        if np.abs(nu - before)[psi > 0].max(initial=0) <= settled:
            break
    total = 1 + (psi * nu).sum(1)
    return psi * nu / total[:, None], 1 / total, 1 / (1 + mu.sum(0))


def enumerated(psi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same exactly, over every assignment of one measurement at most to each target, and one target to each."""
    targets, n = psi.shape
    pair, missed, own, total = np.zeros_like(psi), np.zeros(targets), np.zeros(n), 0.0
    for choice in itertools.product(range(-1, n), repeat=targets):
        taken = [j for j in choice if j >= 0]
        if len(taken) != len(set(taken)):
            continue
        weight = float(np.prod([psi[t, j] for t, j in enumerate(choice) if j >= 0]))
        total += weight
        for t, j in enumerate(choice):
            if j < 0:
                missed[t] += weight
            else:
                pair[t, j] += weight
        for j in set(range(n)) - set(taken):
            own[j] += weight
    return pair / total, missed / total, own / total


def weighed(targets, pairs, alone, least, share, most, rounds, settled):
    """Targets and hypotheses after a measurement.

    ``targets`` is a list of (r, [(weight, probability to be detected), …]), ``pairs`` a dictionary of densities by (target,
    hypothesis in it, measurement). Gives the survivors as a list of (target, r, [(hypothesis in it, measurement, weight),
    …]), the probabilities that measurements are nobody's, and those of the pairs as a dictionary.
    """
    gain, psi = {}, np.zeros((len(targets), len(alone)))
    for (t, c, j), density in pairs.items():
        exist, hypotheses = targets[t]
        weight, seen = hypotheses[c]
        missed = 1 - exist * sum(w * p for w, p in hypotheses)
        gain[t, c, j] = exist * weight * seen * density / max(missed, 1e-15) / alone[j]
        psi[t, j] += gain[t, c, j]
    belief, nothing, own = propagated(psi, rounds, settled)
    told = {(t, c, j): belief[t, j] * g / psi[t, j] if psi[t, j] > 0 else 0.0 for (t, c, j), g in gain.items()}
    kept = []
    for t, (exist, hypotheses) in enumerate(targets):
        unseen = sum(w * (1 - p) for w, p in hypotheses)
        there = min(exist * unseen / max(1 - exist * sum(w * p for w, p in hypotheses), 1e-15), 1.0)
        options = [(c, j, p) for (s, c, j), p in told.items() if s == t]
        if unseen > 0:
            options += [(c, -1, nothing[t] * there * w * (1 - p) / unseen) for c, (w, p) in enumerate(hypotheses)]
        r = sum(p for *_, p in options)
        options = [o for o in options if o[2] > 0 and o[2] >= share * r]
        options = sorted(options, key=lambda o: -o[2])[:most]
        if (r < least and not r > exist) or not options:
            continue
        whole = sum(p for *_, p in options)
        kept.append((t, min(r, 1.0), [(c, j, p / whole) for c, j, p in options]))
    return kept, own, told


def united(hypotheses, limit):
    """Of one target's hypotheses (weight, mean, variances, static), heaviest first: which are kept, and their weights."""
    kept: list[int] = []
    weight = [w for w, *_ in hypotheses]
    for c, (w, mean, _, static) in enumerate(hypotheses):
        for i in kept:
            _, other, variance, kind = hypotheses[i]
            if kind == static and ((mean - other) ** 2 / np.maximum(variance, 1e-12)).sum() < limit:
                weight[i] += w
                break
        else:
            kept.append(c)
    return kept, [weight[i] for i in kept]
