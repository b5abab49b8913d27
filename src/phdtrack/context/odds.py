"""Whether what a tracker follows is a false alarm or an object, by how often a person saw either there.

Light that trembles is no single false alarm: it is detected again and again as if somebody walked there, and no filter can
tell it from somebody by how it moves. But on the frames that were looked at, every detection is known to be one or the
other. With F(z) = λ r̄ α_g Σ_m π_m N(z; μ_m, Σ_m), the places of the false alarms and the share λ of them that the tracker
takes for somebody although it knows κ, and with T(z), the density per frame of the detections that are none, the odds of a
false alarm are F(z)/T(z). For who is followed for the first time births count too, as people are then where they come in: as
many detections as people bring, all in all, spread as p(z|b).

λ is of those that were followed for long. Of all false alarms, those that are seen once as well, the odds are F/(λ T): where
these are small, whoever is seen for the first time is somebody.

This is ours, not M09's, whose κ is that of alarms which come and go alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from phdtrack.context.density import ContextDensity, marginal
from phdtrack.context.scene_file import Followed, Learned
from phdtrack.kernels.context_density import mixture_density
from phdtrack.types import F8, Bool

# Of births what detections show: all but the two velocities.
_SHOWN = (0, 1, 4, 5)
_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, eq=False)
class Odds:
    """F/T of a scene: false alarms, what of them and of objects is followed, and births where they were learned."""

    clutter: Learned
    followed: Followed
    births: Learned | None = None

    def log(self, z: F8, first: Bool) -> F8:
        """(N,) log F/T at boxes ``z`` (4, N); ``first`` (N,): of who is followed for the first time."""
        z, objects = np.ascontiguousarray(z), self.followed.objects
        false = self.followed.share * _per_frame(self.clutter, z, 0.0)
        true = _per_frame(objects, z, objects.density.flat)
        if self._entered is not None and first.any():
            true[first] += objects.rate * self._entered(np.ascontiguousarray(z[:, first]))
        out: F8 = np.log(np.maximum(false, _TINY)) - np.log(np.maximum(true, _TINY))
        return out

    def of_all(self, odds: float) -> float:
        """log F/T where those of any false alarm, F/(λ T), are ``odds``; −∞ for 0."""
        share = self.followed.share
        return math.log(odds * share) if odds * share > 0 else -math.inf

    @cached_property
    def _entered(self) -> ContextDensity | None:
        """p(z|b)."""
        return None if self.births is None else marginal(self.births.density, _SHOWN)


def _per_frame(learned: Learned, z: F8, flat: float) -> F8:
    """(N,) density per frame, with a uniform part of ``flat``, which there is beyond the volume too; 0: next to none."""
    p = learned.density
    out: F8 = mixture_density(z, float(learned.rate), p.low, p.high, np.full(2, max(flat, _TINY)), *p.table)
    return out
