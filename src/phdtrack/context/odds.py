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
from functools import cached_property

import numpy as np

from phdtrack.context.scene_file import Followed, Learned
from phdtrack.kernels.vetting import TINY, false_odds
from phdtrack.types import F8


@dataclass(frozen=True, eq=False)
class Odds:
    """λG/T and κ/T of a scene: false alarms, and what of them and of objects is followed."""

    clutter: Learned
    followed: Followed

    def log(self, z: F8) -> F8:
        """(2, N) logarithms of λG/T and of κ/T at boxes ``z`` (4, N)."""
        out: F8 = false_odds(np.ascontiguousarray(z), *self._tables)
        return out

    @cached_property
    def _tables(self) -> tuple[F8, F8, F8, F8, float, float]:
        """What `false_odds` takes. The uniform part of objects is beyond the volume too."""
        clutter, objects = self.clutter, self.followed.objects
        alarms, people = _table(clutter, TINY), _table(objects, objects.density.flat)
        return *alarms, *people, float(self.followed.share), float(clutter.rate * clutter.density.flat)


def _table(learned: Learned, flat: float) -> tuple[F8, F8]:
    """Bounds and Gaussians of a density per frame, whose uniform part is ``flat`` everywhere."""
    p = learned.density
    return np.concatenate([[learned.rate, flat, flat], p.low, p.high]), np.vstack(p.table)
