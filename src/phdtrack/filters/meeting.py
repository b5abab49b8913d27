"""Where an intensity meets the measurements: what the PHD update and its cardinalised form have in common.

Both updates weigh the same terms and differ in the factors only:

    D(x) = a (1 − p_D(x)) D⁺(x) + Σ_z b_z p_D(x) g(z|x) D⁺(x)

For the PHD filter a = 1 and b_z = 1/(κ(z) + C(z)); for the cardinalised one see `cardinality`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic

import numpy as np

from phdtrack.filters.intensities import Points
from phdtrack.types import F8, I8, UpdateInfo


@dataclass(frozen=True, slots=True, eq=False)
class Meeting(Generic[Points]):
    """The terms of an update, not weighed yet.

    Attributes
    ----------
    intensity : D⁺, of L particles or Gaussians, newborn included.
    born : mass of the newborn within it.
    missed : (L,) (1 − p_D) w.
    point, which : (P,) pairs (particle or Gaussian, measurement) within the gate.
    share : (P,) p_D w g of each pair.
    evidence, clutter : (N,) C(z) and κ(z), per unit of measurement volume.
    """

    intensity: Points
    born: float
    missed: F8
    point: I8
    which: I8
    share: F8
    evidence: F8
    clutter: F8

    def info(self, mass: float, vanished: int = 0) -> UpdateInfo:
        """What the update learned, ``mass`` being that after it."""
        return UpdateInfo(self.intensity.mass, self.born, mass, self.evidence, self.clutter, vanished)


def explained(evidence: F8, clutter: F8) -> tuple[F8, int]:
    """(N,) 1/(κ + C) [V06 (32); M07 (6)], and how many are 0 because κ + C is.

    A likelihood far out in its tail is a denormal number, whose reciprocal overflows: below the smallest normal number is 0.
    """
    total = clutter + evidence
    known = total >= np.finfo(np.float64).tiny
    return np.divide(1.0, total, out=np.zeros_like(total), where=known), int(np.count_nonzero(~known))
