"""Means over seeds, with the interval that Student's t gives them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

LEVEL = 0.95


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean over ``count`` values, and half the width of its 95 % confidence interval; NaN where there is none."""

    mean: float
    half: float
    count: int

    @property
    def clear(self) -> bool:
        """Whether 0 lies outside."""
        return math.isfinite(self.half) and abs(self.mean) > self.half

    @property
    def low(self) -> float:
        """The lower end; the mean itself where there is no interval."""
        return self.mean - self.half if math.isfinite(self.half) else self.mean

    @property
    def high(self) -> float:
        """The upper end; the mean itself where there is no interval."""
        return self.mean + self.half if math.isfinite(self.half) else self.mean


def interval(values: Sequence[float]) -> Interval:
    """Mean and interval of independent values, t with n − 1 degrees of freedom; undefined (NaN) values make it undefined."""
    each = np.array(values, np.float64)
    count = len(each)
    if count < 2:
        return Interval(float(each.mean()) if count else math.nan, math.nan, count)
    error = float(each.std(ddof=1)) / math.sqrt(count)
    return Interval(float(each.mean()), float(stdtrit(count - 1, (1 + LEVEL) / 2)) * error, count)
