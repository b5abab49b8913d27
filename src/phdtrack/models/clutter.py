"""κ(z): false alarms, uniform over a volume [M07 §2]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.checks import NonNegative, Positive, check
from phdtrack.models.volume import local_volume
from phdtrack.types import F8


@dataclass(frozen=True, slots=True)
class UniformClutter:
    """``rate`` expected clutter points per frame, uniform over a volume of measurement space (pixel⁴ for boxes)."""

    rate: NonNegative
    volume: Positive

    def __post_init__(self) -> None:
        check(self)

    def intensity(self, z: F8) -> F8:
        """κ = rate / volume, the same everywhere."""
        return np.full(z.shape[1], self.rate / self.volume)


@dataclass(frozen=True, slots=True)
class LocalClutter:
    """``rate`` expected clutter points per frame around each detection: ±1 box in position, 0.5 to 1.5 in size [M07 §2]."""

    rate: NonNegative

    def __post_init__(self) -> None:
        check(self)

    def intensity(self, z: F8) -> F8:
        """κ(z) = rate / V(z), V the volume of the neighbourhood."""
        return self.rate / local_volume(z)
