"""The Gaussian-mixture cardinalised PHD filter [V07].

The mixture goes the way of `gm_phd`, and the distribution of the number of targets beside it (`cardinality`). What a scan
says of the number bears on all weights at once: the count hardly jumps when a target is missed or a false alarm appears.
The price is that the weight of a missed target goes to the others for that scan, wherever they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from phdtrack.checks import Count, NonNegative, Positive, check
from phdtrack.filters.cardinality import nobody, poisson, survived, weigh
from phdtrack.filters.composed import composed_step
from phdtrack.filters.gm_phd import GMPHD
from phdtrack.filters.intensities import Cardinalised
from phdtrack.filters.transforms import Transform
from phdtrack.protocols import Model
from phdtrack.types import F8, GaussianMixture, UpdateInfo

State = Cardinalised[GaussianMixture]


@dataclass(frozen=True, slots=True)
class GMCPHD:
    """Settings of the GM-CPHD filter; those of `GMPHD` and with its defaults.

    What pruning and capping drop is always given to the rest, because the number of targets does not change by it.

    Parameters
    ----------
    prune : Gaussians that weigh less are dropped.
    merge : Mahalanobis distance (not squared) up to which a Gaussian is united with a stronger one, in its own covariance.
    most : J_max, Gaussians kept, the heaviest; 0 for all.
    split : what shares its tag with a heavier Gaussian keeps it below this weight; 0: no two share one.
    gate : G, measurements further than this many deviations of the innovation from a Gaussian do not touch it.
    transform : ``linear`` by Jacobians, or ``unscented`` by sigma points.
    region : squared Mahalanobis distance within which a Gaussian's mass counts as explaining a detection, M(z).
    initial : the intensity before the first frame; its number is Poisson distributed.
    """

    prune: NonNegative = 1e-5
    merge: NonNegative = 2.0
    most: Count = 0
    split: NonNegative = 0.5
    gate: Positive = 5.0
    transform: Transform = "linear"
    region: Positive = 13.28
    initial: GaussianMixture | None = None

    def __post_init__(self) -> None:
        check(self)

    def start(self, model: Model, rng: np.random.Generator) -> State:
        """The initial intensity and a Poisson distributed number; nothing where none was given."""
        mixture = _intensity(self).start(model, rng)
        return Cardinalised(mixture, poisson(mixture.mass))

    def predict(self, state: State, model: Model, dt: float, rng: np.random.Generator) -> State:
        """Every Gaussian through f, weighed with p_S; the number thinned by the mean of p_S [V07].

        Raises `InputError` where the motion spawns.
        """
        if len(state) == 0:
            return state
        mixture = _intensity(self).predict(state.intensity, model, dt, rng)
        return Cardinalised(mixture, survived(state.cardinality, mixture.mass / state.mass))

    def update(self, state: State, z: F8, model: Model, dt: float, rng: np.random.Generator) -> tuple[State, UpdateInfo]:
        """Add the newborn, then update the number and every Gaussian [V07]."""
        recursion = _intensity(self)
        meeting = recursion.meet(state.intensity, z, model, dt)
        weighing = weigh(state.cardinality, meeting, model.birth.expected(z, dt))
        mixture = recursion.weighed(meeting, weighing.missed, weighing.detected, z, model)
        info = replace(meeting.info(mixture.mass), cardinality=weighing.cardinality)
        return Cardinalised(mixture, weighing.cardinality), info

    def reduce(self, state: State, rng: np.random.Generator) -> State:
        """Prune, merge, cap; the number stays, unless nothing is left."""
        mixture = _intensity(self).reduce(state.intensity, rng)
        return Cardinalised(mixture, state.cardinality if len(mixture) else nobody())

    def step(self, state: State, z: F8, model: Model, dt: float, rng: np.random.Generator) -> tuple[State, UpdateInfo]:
        """Predict, update and reduce."""
        return composed_step(self, state, z, model, dt, rng)


@lru_cache(maxsize=8)
def _intensity(settings: GMCPHD) -> GMPHD:
    """The recursion of the mixture."""
    s = settings
    return GMPHD(
        prune=s.prune,
        merge=s.merge,
        most=s.most,
        split=s.split,
        gate=s.gate,
        region=s.region,
        transform=s.transform,
        initial=s.initial,
    )
