"""κ(z): false alarms, uniform over a volume [M07 §2]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.checks import NonNegative, Positive, check
from phdtrack.kernels.neighbourhoods import summed_densities
from phdtrack.models.region import local_density
from phdtrack.models.volume import REACH, SIZES, local_volume
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
        if z.shape[1] == 0:
            return np.zeros(0)
        out: F8 = summed_densities(np.ascontiguousarray(z[:4]), self.rate / local_volume(z), REACH, *SIZES)
        return out


@dataclass(frozen=True, slots=True)
class LocalPlaneClutter:
    """``rate`` expected clutter points per frame around each detection on the ground plane (see `models.region`)."""

    rate: NonNegative

    def __post_init__(self) -> None:
        check(self)

    def intensity(self, z: F8) -> F8:
        """κ(z), per m²: the sum of what all detections near z bring, its own included."""
        return local_density(z, z, self.rate)
