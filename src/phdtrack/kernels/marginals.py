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
from phdtrack.kernels.fast32 import INNER
from phdtrack.kernels.gaussian import records
from phdtrack.kernels.linkage import root, unite

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Records = NDArray[np.void]

# Rounds at most, and the change of every message below which they are enough.
ROUNDS, SETTLED = 50, 1e-6


# A pair: its odds ψ and its messages, of which the first is at the end the probability that the target has the
# measurement; its two ends; and a number that all pairs share which are joined by targets and measurements.
EDGE = records("odds mu nu", "target measurement island")


@njit(**INNER)
def _start(edges: Records, live: I8, parent: I8, targets: int) -> None:
    """Write the first messages, the islands, and the numbers of the edges into ``live``."""
    for i in range(parent.size):
        parent[i] = i
    for e in range(edges.size):
        edge = edges[e]
        edge.nu, live[e] = 1.0, e
        unite(parent, edge.target, targets + edge.measurement)
    for e in range(edges.size):
        edges[e].island = root(parent, edges[e].target)


@njit(**INNER)
def beliefs(edges: Records, targets: int, measurements: int) -> tuple[F8, F8]:
    """Marginal association probabilities.

    Parameters
    ----------
    edges : (E,) of `EDGE`: odds ψ ≥ 0, target and measurement; no pair twice. The rest is written.
    targets, measurements : how many there are.

    Returns
    -------
    missed (T,) : probability that the target has no measurement; p_new (N,) : that the measurement is no earlier target's.
    """
    seen, claimed, moved = np.empty(targets), np.empty(measurements), np.empty(targets)
    live, count, turn = np.empty(edges.size, np.int64), edges.size, 0 * targets
    _start(edges, live, np.empty(targets + measurements, np.int64), targets)
    for j in range(measurements):
        claimed[j] = 0.0
    while True:
        for k in range(count):
            edge = edges[live[k]]
            seen[edge.target], claimed[edge.measurement], moved[edge.island] = 0.0, 0.0, 0.0
        for k in range(count):
            edge = edges[live[k]]
            seen[edge.target] += edge.odds * edge.nu
        for k in range(count):
            edge = edges[live[k]]
            others = seen[edge.target] - edge.odds * edge.nu
            edge.mu = edge.odds / (1.0 + others) if others > 0.0 else edge.odds
            claimed[edge.measurement] += edge.mu
        turn += 1
        change = 0.0
        for k in range(count):
            edge = edges[live[k]]
            others = claimed[edge.measurement] - edge.mu
            value = 1.0 / (1.0 + others) if others > 0.0 else 1.0
            step, edge.nu = abs(value - edge.nu), value
            moved[edge.island] = step if step > moved[edge.island] else moved[edge.island]
            change = step if step > change else change
        if change <= SETTLED or turn == ROUNDS:
            break
        # Where nothing has changed, nothing will: most islands are small, and one that is not would keep all others waiting.
        left = 0 * count
        for k in range(count):
            if moved[edges[live[k]].island] > 0.0:
                live[left] = live[k]
                left += 1
        count = left
    for t in range(targets):
        seen[t] = 0.0
    for e in range(edges.size):
        seen[edges[e].target] += edges[e].odds * edges[e].nu
    for e in range(edges.size):
        edges[e].mu = edges[e].odds * edges[e].nu / (1.0 + seen[edges[e].target])
    for t in range(targets):
        seen[t] = 1.0 / (1.0 + seen[t])
    for j in range(measurements):
        claimed[j] = 1.0 / (1.0 + claimed[j])
    return seen, claimed
