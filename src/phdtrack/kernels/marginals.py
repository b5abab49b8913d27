"""Marginal probabilities of which target has which measurement, by loopy belief propagation [W14; W15].

Each target has one measurement at most and each measurement one target at most. With ψ_e the odds of a pair e = (target,
measurement) against the target being missed and the measurement being no earlier target's, the messages are

    μ_e = ψ_e / (1 + Σ_{other pairs of the target} ψ ν)      ν_e = 1 / (1 + Σ_{other pairs of the measurement} μ)

They converge, whatever ψ [W14], and are exact where pairs form a tree; a round costs as much as there are pairs
where messages still change.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.linkage import root, unite

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# Rounds at most, and the change of every message below which they are enough.
ROUNDS, SETTLED = 50, 1e-6


@njit(**INNER)
def _islands(target: I8, which: I8, pairs: int, targets: int, measurements: int) -> I8:
    """(E,) of each pair a number that all share which are joined by targets and measurements."""
    parent, island = np.empty(targets + measurements, np.int64), np.empty(pairs, np.int64)
    for i in range(parent.size):
        parent[i] = i
    for e in range(pairs):
        unite(parent, target[e], targets + which[e])
    for e in range(pairs):
        island[e] = root(parent, target[e])
    return island


@njit(**INNER)
def beliefs(odds: F8, target: I8, which: I8, pairs: int, targets: int, measurements: int) -> tuple[F8, F8, F8]:
    """As `marginals`, of the first ``pairs`` rows."""
    mu, nu = np.empty(pairs), np.empty(pairs)
    seen, claimed, moved = np.empty(targets), np.empty(measurements), np.empty(targets)
    island, live = _islands(target, which, pairs, targets, measurements), np.empty(pairs, np.int64)
    for e in range(pairs):
        nu[e], live[e] = 1.0, e
    for j in range(measurements):
        claimed[j] = 0.0
    # A literal zero is a type of its own.
    turn, count = 0 * pairs, pairs
    while True:
        for k in range(count):
            e = live[k]
            seen[target[e]], claimed[which[e]], moved[island[e]] = 0.0, 0.0, 0.0
        for k in range(count):
            e = live[k]
            seen[target[e]] += odds[e] * nu[e]
        for k in range(count):
            e = live[k]
            mu[e] = odds[e] / (1.0 + max(seen[target[e]] - odds[e] * nu[e], 0.0))
            claimed[which[e]] += mu[e]
        turn += 1
        change = 0.0
        for k in range(count):
            e = live[k]
            value = 1.0 / (1.0 + max(claimed[which[e]] - mu[e], 0.0))
            moved[island[e]] = max(moved[island[e]], abs(value - nu[e]))
            change = max(change, abs(value - nu[e]))
            nu[e] = value
        if change <= SETTLED or turn == ROUNDS:
            break
        # Where nothing has changed, nothing will: most islands are small, and one that is not would keep all others waiting.
        left = 0 * pairs
        for k in range(count):
            if moved[island[live[k]]] > 0.0:
                live[left] = live[k]
                left += 1
        count = left
    for t in range(targets):
        seen[t] = 0.0
    for e in range(pairs):
        seen[target[e]] += odds[e] * nu[e]
    for e in range(pairs):
        mu[e] = odds[e] * nu[e] / (1.0 + seen[target[e]])
    for t in range(targets):
        seen[t] = 1.0 / (1.0 + seen[t])
    for j in range(measurements):
        claimed[j] = 1.0 / (1.0 + claimed[j])
    return mu, seen, claimed


@njit(**ENTRY)
def marginals(odds: F8, target: I8, which: I8, targets: int, measurements: int) -> tuple[F8, F8, F8]:
    """Marginal association probabilities.

    Parameters
    ----------
    odds, target, which : (E,) ψ ≥ 0, target and measurement of each pair; no pair twice.
    targets, measurements : how many there are.

    Returns
    -------
    pair (E,) : probability that the target has the measurement; missed (T,) : that it has none; p_new (N,) : that the
    measurement is no earlier target's.
    """
    out: tuple[F8, F8, F8] = beliefs(odds, target, which, len(odds), targets, measurements)
    return out
