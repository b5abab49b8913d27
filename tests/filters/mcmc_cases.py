"""Small worlds in which everything that the MCMC filter samples can be enumerated."""

from __future__ import annotations

import itertools
from collections import defaultdict
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from phdtrack.kernels.particle_models import (
    Number,
    Real,
    SensorNumbers,
    X,
    distance,
    implements,
    seen,
)
from phdtrack.models import UniformClutter
from phdtrack.protocols import Model
from phdtrack.types import Particles

CELLS = 4


class RingTable(NamedTuple):
    """`RingSensor` for the kernels: its likelihoods."""

    table: tuple[float, ...]


@implements(seen, RingTable)
def _seen_ring(model: Number, table: Real, j: int) -> Number:
    return (table[0, j],)


@implements(distance, RingTable)
def _distance_ring(model: Number, z: Number, s: Real, i: int) -> Number:
    step = z[0] - s[X + i]
    return step * step, model.table[int(abs(step)) % CELLS] * np.exp(0.5 * step * step)


@dataclass(frozen=True)
class RingSensor:
    """A measurement is a position, wrong by so many cells with these likelihoods; a target at 0 is
    seen less often.
    """

    table: tuple[float, ...] = (0.6, 0.25, 0.15, 0.25)
    linear: bool = False
    observed: tuple[int, ...] = (0, 1)

    def likelihood(self, z, x):
        return np.array(self.table)[np.abs(z[0] - x[0]).astype(int) % CELLS]

    def particle_model(self, z):
        return SensorNumbers(RingTable(self.table), z, np.zeros(0))

    def p_detect(self, x):
        return np.where(x[0] == 0, 0.5, 0.8)

    def gate(self, z):
        return z[:2] - CELLS, z[:2] + CELLS

    def boxes(self, x):
        return np.vstack([x[:2] - 1, x[:2] + 1]).T

    def states(self, z):
        return z[:2].copy(), np.tile(np.eye(2), (z.shape[1], 1, 1))


@dataclass(frozen=True)
class RingBirth:
    """Everywhere alike."""

    rate: float = 0.4

    def sample(self, z, covered, sensor, dt, rng):
        x = np.vstack([np.arange(CELLS, dtype=float), np.zeros(CELLS)])
        return Particles(x, np.full(CELLS, self.rate / CELLS))


def ring() -> Model:
    return Model(None, RingSensor(), RingBirth(), UniformClutter(0.5, CELLS))


def joint_law(candidates, log_psi) -> dict[tuple, float]:
    """The law over all that candidates may be together, from lists of (measurement or −1, state or
    −1, weight).

    ``log_psi`` gives the interaction's logarithm for a tuple of states, −1: the target does not
    exist.
    """
    law: dict[tuple, float] = {}
    for choice in itertools.product(*candidates):
        held = [j for j, _, _ in choice if j >= 0]
        if len(set(held)) == len(held):
            weight = np.prod([w for _, _, w in choice]) * np.exp(log_psi([i for _, i, _ in choice]))
            if weight > 0:
                law[tuple((j, i) for j, i, _ in choice)] = weight
    total = sum(law.values())
    return {key: weight / total for key, weight in law.items()}


def apart(box: np.ndarray, strength: float):
    """``log_psi`` of states whose boxes (L, 4) are known: −strength times the overlaps of all
    pairs.
    """

    def overlap(a: np.ndarray, b: np.ndarray) -> float:
        shared = np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0).prod()
        return float(shared / ((a[2:] - a[:2]).prod() + (b[2:] - b[:2]).prod() - shared))

    def log_psi(states):
        return -strength * sum(
            overlap(box[i], box[k])
            for i, k in itertools.combinations([i for i in states if i >= 0], 2)
        )

    return log_psi


def variation(law: dict, samples) -> float:
    """Total variation between a law and the frequencies of samples."""
    share: dict = defaultdict(float)
    for key, count in zip(*np.unique(np.array(samples), axis=0, return_counts=True), strict=True):
        share[tuple(map(tuple, key)) if key.ndim > 1 else tuple(key)] = count / len(samples)
    assert set(share) <= set(law), "the chain is where it cannot be"
    return 0.5 * sum(abs(law[key] - share[key]) for key in law)
