"""Marginal probabilities of which target has which measurement, by loopy belief propagation [W14 §IV; W15 (35)–(37)].

Each target has one measurement at most and each measurement one target at most. With ψ_e the odds of a pair e = (target,
measurement) against the target being missed and the measurement being nobody's, messages go to and fro:

    μ_e = ψ_e / (1 + Σ_{other pairs of the target} ψ ν)      ν_e = 1 / (1 + Σ_{other pairs of the measurement} μ)

They converge, whatever ψ [W14 Th. 1], and are exact where pairs form a tree; each round costs as much as there are pairs.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# Rounds at most, and the change of every message below which they are enough.
ROUNDS, SETTLED = 50, 1e-6


@njit(**INNER)
def beliefs(odds: F8, target: I8, which: I8, pairs: int, targets: int, measurements: int) -> tuple[F8, F8, F8]:
    """As `marginals`, of the first ``pairs`` rows."""
    mu, nu = np.empty(pairs), np.empty(pairs)
    seen, claimed = np.empty(targets), np.empty(measurements)
    for e in range(pairs):
        nu[e] = 1.0
    # A literal zero is a type of its own.
    turn = 0 * pairs
    while True:
        for t in range(targets):
            seen[t] = 0.0
        for e in range(pairs):
            seen[target[e]] += odds[e] * nu[e]
        for j in range(measurements):
            claimed[j] = 0.0
        for e in range(pairs):
            mu[e] = odds[e] / (1.0 + max(seen[target[e]] - odds[e] * nu[e], 0.0))
            claimed[which[e]] += mu[e]
        turn += 1
        change = 0.0
        for e in range(pairs):
            value = 1.0 / (1.0 + max(claimed[which[e]] - mu[e], 0.0))
            change = max(change, abs(value - nu[e]))
            nu[e] = value
        if change <= SETTLED or turn == ROUNDS:
            break
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
    pair (E,) : probability that the target has the measurement; missed (T,) : that it has none; own (N,) : that the
    measurement is nobody's.
    """
    return beliefs(odds, target, which, len(odds), targets, measurements)
