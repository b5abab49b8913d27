"""The terms of a PHD update before they are weighed: the PHD filter [V06, M07] and the cardinalised one [V07] share them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from phdtrack.types import F8, UpdateInfo

TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class UpdateTerms:
    """D = a (1 − p_D) D⁺ + Σ_z b_z p_D g(z|·) D⁺: for the PHD filter a = 1, b_z = 1/(κ(z) + C(z)); else see `cardinality`.

    Attributes
    ----------
    mass, born, missed : of D⁺, newborn included; of the newborn; ∫ (1 − p_D) D⁺.
    evidence, clutter : (N,) C(z) and κ(z), per unit of measurement volume.
    weighed : D for a and b (N,).
    least : what κ + C is at least where it is not taken for 0.
    """

    mass: float
    born: float
    missed: float
    evidence: F8
    clutter: F8
    weighed: Callable[[float, F8], Any]
    least: float = TINY

    def info(self, mass: float, vanished: int = 0) -> UpdateInfo:
        """What the update learned, ``mass`` being that after it."""
        detected = self.mass - self.missed
        return UpdateInfo(self.mass, self.born, mass, self.evidence, self.clutter, vanished, detected=detected)

    def phd(self) -> tuple[Any, UpdateInfo]:
        """The intensity after the update of a PHD filter, and what it learned."""
        factor, vanished = self.factors()
        after = self.weighed(1.0, factor)
        return after, self.info(after.mass, vanished)

    def factors(self) -> tuple[F8, int]:
        """(N,) 1/(κ + C) [V06 (32); M07 (5)], and how many are 0 because κ + C is."""
        total = self.clutter + self.evidence
        known = total >= self.least
        return np.divide(1.0, total, out=np.zeros_like(total), where=known), int(np.count_nonzero(~known))
