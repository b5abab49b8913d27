"""What a mode knows as it is used: no surer than its samples make it (`prior`), and births against detections of objects."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from phdtrack.scene.density import SHOWN, ContextDensity, marginal
from phdtrack.scene.part import Part
from phdtrack.scene.prior import Sizes, detected_sizes, humbled, of_the_next
from phdtrack.scene.scene_file import Learned
from phdtrack.types import F8


@dataclass(frozen=True, slots=True, eq=False)
class Humble:
    """Births, false alarms, and detections of objects; None where nothing is known of them."""

    births: Learned | None
    clutter: Learned | None
    objects: Learned | None

    @property
    def entering(self) -> Callable[[F8], F8] | None:
        """log p(z|b)/p(z|o) of states (6, k), None where one of the two is not known.

        Births that are laid over others are p(z|b)/p(z|o) times those: as many as there are, all in all, so that this is by
        how many nats such births are likelier than the others.
        """
        if self.births is None or self.objects is None:
            return None
        enter, are = marginal(self.births.density, SHOWN), self.objects.density

        def ratio(x: F8) -> F8:
            z = np.ascontiguousarray(x[list(SHOWN)])
            out: F8 = _log(enter, z) - _log(are, z)
            return out

        return ratio


def humble(births: Part, clutter: Part, objects: Part) -> Humble:
    """What is known, of the sizes that were detected."""
    size = np.hstack([clutter.recent.samples[2:], objects.recent.samples[2:]])
    if not size.shape[1]:
        return Humble(None, None, None)
    sizes = detected_sizes(size)
    return Humble(*(_humble(part, sizes) for part in (births, clutter, objects)))


def _humble(part: Part, sizes: Sizes) -> Learned | None:
    """None where no sample has taught anything."""
    if not len(part.density):
        return None
    many = part.recent.many
    return humbled(Learned(part.rate, of_the_next(part.density, many), math.ceil(many)), sizes)


def _log(p: ContextDensity, z: F8) -> F8:
    """(k,) log p at boxes (4, k), nowhere below its uniform part."""
    out: F8 = np.where(p.contains(z), np.logaddexp.reduce(p.parts(z), axis=0), math.log(p.flat))
    return out
