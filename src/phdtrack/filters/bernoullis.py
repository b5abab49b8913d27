"""Targets that are there or not, each with a label, an existence probability and hypotheses about its state and past.

The state of a Poisson multi-Bernoulli filter. Hypotheses are columns; those of target t are ``first[t]`` …
``first[t + 1] − 1``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.types import F8, I8, Bool, GaussianMixture


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """The targets of one frame.

    Attributes
    ----------
    exist : (T,) probability r that the target is there, as itself or as a source of false alarms.
    label : (T,) its number, rising, from 0, none given twice.
    first : (T + 1,) where its hypotheses begin.
    weight : (C,) their probabilities, which sum to one for each target, falling.
    mean : (d, C).      covariance : (C, d, d).
    static : (C,) whether the hypothesis is that of a source that stays where it is and no target.
    hidden : (C,) probability that the target cannot be detected at present.
    detection : (C,) measurement of the frame that it took, −1: none.
    parent : (C,) its hypothesis in the frame before; −1 where the target begins.
    best : (T,) the heaviest hypothesis that is no source's, −1: there is none.
    presence : (T,) probability that the target is there and no source.
    believed : (T,) the greatest presence that it ever had.
    """

    exist: F8
    label: I8
    first: I8
    weight: F8
    mean: F8
    covariance: F8
    static: Bool
    hidden: F8
    detection: I8
    parent: I8
    best: I8
    presence: F8
    believed: F8

    def __len__(self) -> int:
        """Number of hypotheses."""
        return len(self.weight)

    @property
    def target(self) -> I8:
        """(C,) the target of each hypothesis."""
        return np.repeat(np.arange(len(self.exist)), np.diff(self.first))

    @property
    def probability(self) -> F8:
        """(C,) probability that there is a target and that it is as the hypothesis has it; 0 of sources."""
        return np.where(self.static, 0.0, self.exist[self.target] * self.weight)


@dataclass(frozen=True, slots=True, eq=False)
class Bernoullis:
    """The state of a Poisson multi-Bernoulli filter.

    Attributes
    ----------
    layers : the last frames, oldest first.
    ended : (2, E) layer, from the end, and hypothesis there, of targets that were believed in and have been given up since.
    fresh : the label that the next new target is given.
    """

    layers: tuple[Layer, ...]
    ended: I8
    fresh: int

    def __len__(self) -> int:
        """Number of hypotheses."""
        return len(self.present)

    @property
    def present(self) -> Layer:
        """The last frame's targets."""
        return self.layers[-1]

    @property
    def mass(self) -> float:
        """The expected number of targets."""
        return float(self.present.presence.sum())

    def mixture(self) -> GaussianMixture:
        """The intensity of the targets: hypotheses weighed with the probability that they are true."""
        now = self.present
        weight = now.probability
        there = np.flatnonzero(weight > 0)
        mean = np.ascontiguousarray(now.mean[:, there])
        return GaussianMixture(weight[there], mean, now.covariance[there], now.label[now.target[there]], self.fresh)


def nobody(dim: int) -> Layer:
    """No target."""
    none, zeros = np.zeros(0, np.int64), np.zeros(0)
    start, no = np.zeros(1, np.int64), np.zeros(0, np.bool_)
    return Layer(
        zeros, none, start, zeros, np.zeros((dim, 0)), np.zeros((0, dim, dim)), no, zeros, none, none, none, zeros, zeros
    )
