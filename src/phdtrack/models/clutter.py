"""κ(z): false alarms, uniform over a volume [M07 §2]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import sum_by
from phdtrack.checks import NonNegative, Positive, check
from phdtrack.kernels.gating import gated_pairs
from phdtrack.models.volume import REACH, in_neighbourhood, local_volume
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
    """``rate`` expected clutter points per frame around each detection: ±1 box in position, 0.5 to 1.5 in size [M07 §2].

    Where neighbourhoods overlap their densities add up, as those of the births do: where a detector reports much, more of it
    is taken for clutter, and the ratio of the two densities stays what the rates say.
    """

    rate: NonNegative

    def __post_init__(self) -> None:
        check(self)

    def intensity(self, z: F8) -> F8:
        """κ(z) = Σ_j rate / V(z_j) over the detections z_j in whose neighbourhood z lies, its own included."""
        point, which = gated_pairs(z[0], z[1], z[:2] - REACH * z[2:4], z[:2] + REACH * z[2:4])
        near = in_neighbourhood(z[:, point], z[:, which])
        return sum_by(point[near], self.rate / local_volume(z)[which[near]], z.shape[1])
