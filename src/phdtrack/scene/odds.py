"""Whether what a tracker follows is a false alarm or an object, by how often a person saw either there.

Light that trembles is no single false alarm: it is detected again and again as if somebody walked there, and no filter can
tell it from somebody by how it moves. But on the frames that were looked at, every detection is known to be one or the
other. With G(z) = r̄ α_g Σ_m π_m N(z; μ_m, Σ_m), the places of the false alarms, with the share λ of them that the tracker
takes for somebody although it knows κ, and with T(z), the density per frame of the detections that are none, the odds of a
false alarm that is followed are λ G(z)/T(z). Its uniform part tells of no place.

Of any false alarm, of those that are seen once as well, they are κ(z)/(T(z) + B(z)): where these are small, whoever is seen
for the first time is somebody. People come in where others did, which many more frames have shown: B are as many detections
as objects have, spread as the Gaussians of p(z|b). To what lasts, births tell nothing: the tracker's own tracks begin where
trees stand at an entrance, too.

This is ours, not M09's, whose κ is that of alarms which come and go alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from phdtrack.kernels.vetting import TINY, false_odds
from phdtrack.scene.density import SHOWN, ContextDensity, marginal
from phdtrack.scene.scene_file import Followed, Learned
from phdtrack.types import F8


@dataclass(frozen=True, eq=False)
class Odds:
    """λG/T and κ/(T + B) of a scene: false alarms, what of them and of objects is followed, births if they were learned."""

    clutter: Learned
    followed: Followed
    births: Learned | None = None

    def log(self, z: F8) -> F8:
        """(2, N) logarithms of λG/T and of κ/(T + B) at boxes ``z`` (4, N)."""
        out: F8 = false_odds(np.ascontiguousarray(z), *self._tables)
        return out

    @cached_property
    def _tables(self) -> tuple[F8, F8, F8, F8, F8, F8, float, float]:
        """What `false_odds` takes. The uniform part of objects is beyond the volume too."""
        clutter, objects = self.clutter, self.followed.objects
        alarms = _table(clutter.rate, clutter.density, TINY)
        people = _table(objects.rate, objects.density, objects.density.flat)
        # No place at all, where births were not learned.
        births = np.concatenate([[0.0, TINY, TINY], people[0][3:]]), np.zeros((len(people[1]), 0))
        if self.births is not None:
            births = _table(objects.rate, marginal(self.births.density, SHOWN), TINY)
        return *alarms, *people, *births, float(self.followed.share), float(clutter.rate * clutter.density.flat)


def _table(rate: float, p: ContextDensity, flat: float) -> tuple[F8, F8]:
    """Bounds and Gaussians of a density per frame, whose uniform part is ``flat`` everywhere."""
    return np.concatenate([[rate, flat, flat], p.low, p.high]), np.vstack(p.table)
