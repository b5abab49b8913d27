"""κ(z): false alarms, uniform over a volume [M07 §2], and what scores make of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import InputError, NonNegative, Positive, check
from phdtrack.models.volumes import local_box_density, local_density
from phdtrack.protocols import Clutter
from phdtrack.types import F8


@dataclass(frozen=True, slots=True)
class UniformClutter:
    """``clutter_per_frame`` expected clutter points per frame, uniform over a volume of measurement space (pixel⁴ for
    boxes)."""

    clutter_per_frame: NonNegative
    volume: Positive

    def __post_init__(self) -> None:
        check(self)

    def intensity(self, z: F8) -> F8:
        """κ = rate / volume, the same everywhere."""
        return np.full(z.shape[1], self.clutter_per_frame / self.volume)


@dataclass(frozen=True, slots=True)
class LocalClutter:
    """``clutter_per_detection`` expected clutter points around each detection: ±1 box in position, 0.5 to 1.5 in size
    [M07 §2].

    Where neighbourhoods overlap their densities add up, as those of the births do: where a detector reports much, more of it
    is taken for clutter, and the ratio of the two densities stays what the rates say.
    """

    clutter_per_detection: NonNegative

    def __post_init__(self) -> None:
        check(self)

    def intensity(self, z: F8) -> F8:
        """κ(z) = Σ_j rate / V(z_j) over the detections z_j in whose neighbourhood z lies, its own included."""
        return local_box_density(z, self.clutter_per_detection)


@dataclass(frozen=True, slots=True)
class LocalPlaneClutter:
    """``clutter_per_detection`` expected clutter points around each detection on the ground (see `models.volumes`)."""

    clutter_per_detection: NonNegative

    def __post_init__(self) -> None:
        check(self)

    def intensity(self, z: F8) -> F8:
        """κ(z), per m²: the sum of what all detections near z bring, its own included."""
        return local_density(z, z, self.clutter_per_detection)


@dataclass(frozen=True, eq=False)
class ScoredClutter:
    """κ(z, s) of the detections of one frame, each with a score s, for a g(z|x) that leaves scores out.

    With p(s|object) taken out of numerator and denominator of every ratio of the update, what is left of the scores is
    κ(z)/odds, odds = p(s|object)/p(s|false alarm): a detection of low odds can only be explained by a target that
    exists already, and starts none.

    Parameters
    ----------
    base : κ(z) without scores.
    odds : (N,) of the detections, in the order in which ``intensity`` is asked for them.
    """

    base: Clutter
    odds: F8

    def intensity(self, z: F8) -> F8:
        """κ(z)/odds. Raises `InputError` for other detections than those with the odds."""
        if z.shape[1] != len(self.odds):
            raise InputError(f"expected the {len(self.odds)} detections that the odds are of, got {z.shape[1]}")
        return self.base.intensity(z) / self.odds
