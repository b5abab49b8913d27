"""What a density is worth, from samples that it was asked about before it learned them (prequentially).

The gain of a sample is log p(x) − log q(x), nats above another density: of false alarms the uniform one over the volume, of
births that of objects' detections. Its mean over the recent samples, with the standard error of that mean, decides between
the two: a difference of less than two standard errors decides nothing, so that what was chosen stays chosen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.types import F8

# Samples from which something is concluded, and standard errors that a mean must be away from 0.
FEWEST = 10.0
ERRORS = 2.0


@dataclass(frozen=True, slots=True)
class Evidence:
    """Gains of recent samples: how many (``count``, older ones count for less), their mean, their mean square."""

    count: float = 0.0
    mean: float = 0.0
    square: float = 0.0

    def seen(self, gain: F8, weight: F8, lasting: float) -> Evidence:
        """With the gains (k,) of new samples, worth ``weight`` (k,); older ones fade over ``lasting`` samples."""
        new = float(weight.sum())
        old = self.count * math.exp(-new / lasting)
        total = old + new
        if not new > 0:
            return self
        mean = (old * self.mean + float((weight * gain).sum())) / total
        square = (old * self.square + float((weight * np.square(gain)).sum())) / total
        return Evidence(total, mean, square)

    @property
    def error(self) -> float:
        """The standard error of the mean."""
        return math.sqrt(max(self.square - self.mean**2, 0.0) / max(self.count, 1.0))

    @property
    def for_it(self) -> bool:
        """Whether the density explains what comes better than the other one."""
        return self.count >= FEWEST and self.mean > ERRORS * self.error

    @property
    def against_it(self) -> bool:
        """Whether it explains it worse."""
        return self.count >= FEWEST and self.mean < -ERRORS * self.error

    def joined(self, other: Evidence) -> Evidence:
        """Of the samples of both."""
        total = self.count + other.count
        if not total > 0:
            return self
        share = other.count / total
        return Evidence(
            total, (1 - share) * self.mean + share * other.mean, (1 - share) * self.square + share * other.square
        )
