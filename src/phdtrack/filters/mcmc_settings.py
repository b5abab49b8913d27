"""What both forms of the MCMC filter share: the chain's length, the interaction, and how well a chain did."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.protocols import Sensor
from phdtrack.types import F8


@dataclass(frozen=True, slots=True)
class Interaction:
    """``strength`` of the pairwise potential, 0 for none; of ``boxes``, or of points with a ``reach`` [K05]."""

    strength: float
    boxes: bool
    reach: float

    def places(self, x: F8, sensor: Sensor) -> F8:
        """(L, 4) where states are, as `kernels.mcmc_apart` wants it; (0, 4) where nobody asks."""
        if self.strength == 0:
            return np.zeros((0, 4))
        if self.boxes:
            return np.ascontiguousarray(sensor.boxes(x))
        return np.ascontiguousarray(np.vstack([x[:2] / self.reach, np.zeros((2, x.shape[1]))]).T)


@dataclass(frozen=True, slots=True)
class Chain:
    """A chain of ``samples`` kept after ``burn`` steps, one of every ``thin``, with an interaction of targets."""

    samples: int
    burn: int
    thin: int
    interaction: Interaction

    @property
    def steps(self) -> int:
        """How many there are in all."""
        return self.burn + self.thin * self.samples


@dataclass(frozen=True, slots=True)
class Ancestry:
    """Of the form with given associations: see `mcmc.MCMC`."""

    joint: bool
    switch: float
    informed: bool
    greedy: bool


@dataclass(frozen=True, slots=True)
class Jumps:
    """Of the form without given associations: share of moves of two targets, and the least probability of one."""

    exchange: float
    faintest: float


def effective_samples(series: F8) -> float:
    """How many independent draws would tell the means of ``series`` (k, N) as well: least over its rows, by batch means.

    With b = √N batches the variance of a batch's mean, times its length, is that of the chain's asymptotic error; NaN for
    no rows or fewer than four samples, N where a row is constant.
    """
    count = series.shape[1]
    length = int(np.sqrt(count))
    if len(series) == 0 or length < 2:
        return float("nan")
    used = series[:, : count // length * length]
    means = used.reshape(len(series), -1, length).mean(axis=2)
    spread, batches = used.var(axis=1), length * means.var(axis=1, ddof=1)
    share = np.divide(spread, batches, out=np.ones(len(series)), where=batches > 0)
    return float(count * min(1.0, share.min()))
