"""Whether what a tracker follows is a false alarm or an object, by how often a person saw either there.

Light that trembles is no single false alarm: it is detected again and again as if somebody walked there, and no filter can
tell it from somebody by how it moves. But on the frames that were looked at, every detection is known to be one or the
other. With G(z) = r̄ α_g Σ_m π_m N(z; μ_m, Σ_m), the places of the false alarms, with the share λ of them that the tracker
takes for somebody although it knows κ, and with T(z), the density per frame of the detections that are none, the odds of a
false alarm that is followed are λ G(z)/T(z). Its uniform part tells of no place.

Of any false alarm, of those that are seen once as well, they are κ(z)/T(z): where these are small, whoever is seen for the
first time is somebody.

This is ours, not M09's, whose κ is that of alarms which come and go alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.context.scene_file import Followed, Learned
from phdtrack.kernels.context_density import mixture_density
from phdtrack.types import F8

_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class Odds:
    """λG/T and κ/T of a scene: false alarms, and what of them and of objects is followed."""

    clutter: Learned
    followed: Followed

    def log(self, z: F8) -> F8:
        """(2, N) logarithms of λG/T and of κ/T at boxes ``z`` (4, N)."""
        z, objects, flat = np.ascontiguousarray(z), self.followed.objects, self.clutter.density.flat
        places = _per_frame(self.clutter, z, 0.0)
        false = np.stack([self.followed.share * places, places + self.clutter.rate * flat])
        true = _per_frame(objects, z, objects.density.flat)
        out: F8 = np.log(np.maximum(false, _TINY)) - np.log(np.maximum(true, _TINY))
        return out


def _per_frame(learned: Learned, z: F8, flat: float) -> F8:
    """(N,) density per frame, with a uniform part of ``flat``, which there is beyond the volume too; 0: next to none."""
    p = learned.density
    out: F8 = mixture_density(z, float(learned.rate), p.low, p.high, np.full(2, max(flat, _TINY)), *p.table)
    return out
