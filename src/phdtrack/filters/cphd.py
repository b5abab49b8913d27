"""The Gaussian-mixture cardinalised PHD filter [V07].

The mixture goes the way of `phd_gaussian`, and with it the distribution of the number of targets (`cardinality`). What a
scan
says of the number bears on all weights at once: the count hardly jumps when a target is missed or a false alarm appears. The
price is that the weight of a missed target goes to the others for that scan, wherever they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from phdtrack.arrays import GATE
from phdtrack.errors import Count, NonNegative, Share, check
from phdtrack.filters.cardinality import no_targets, poisson, survived, weigh
from phdtrack.filters.intensities import Cardinalised
from phdtrack.filters.phd_gaussian import GMPHD, rows_of, tagged
from phdtrack.kernels.gm_update import phd_mixture, phd_terms
from phdtrack.models.gaussian import Transform
from phdtrack.protocols import Model
from phdtrack.types import F8, GaussianMixture, UpdateInfo

State = Cardinalised[GaussianMixture]


@dataclass(frozen=True, slots=True)
class GMCPHD:
    """Settings of the GM-CPHD filter; those of `GMPHD` and with its defaults.

    What pruning and capping drop is always given to the rest, because the number of targets does not change by it.

    Parameters
    ----------
    weight_threshold : Gaussians that weigh less are dropped.
    merge_distance : Mahalanobis distance (not squared) up to which a Gaussian is united with a stronger one, in its own
        covariance.
    max_components : J_max, Gaussians kept, the heaviest; 0 for all.
    split_weight : what shares its tag with a heavier Gaussian keeps it below this weight; 0: no two share one.
    gate_probability : part of the measurements of a Gaussian inside its gate; those beyond do not touch it; 1: no gate.
    transform : ``linear`` by Jacobians, or ``unscented`` by sigma points.
    initial : the intensity before the first frame; its number is Poisson distributed.
    """

    weight_threshold: NonNegative = 1e-5
    merge_distance: NonNegative = 2.0
    max_components: Count = 0
    split_weight: NonNegative = 0.5
    gate_probability: Share = GATE
    transform: Transform = "linear"
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
        """Add the births, then update the number and every Gaussian [V07]."""
        mixture = tagged(state.intensity)
        frame = _intensity(self).frame(rows_of(mixture), mixture.fresh, z, model, dt)
        t, kappa = phd_terms(*frame), frame.measurements.clutter
        births = model.birth.expected(z, dt / model.rate)
        unseen = max(births - t.born, 0.0)
        w = weigh(state.cardinality, t.predicted, t.missed, births, unseen, t.evidence, kappa)
        rows, mass, fresh = phd_mixture(*frame[:-1], t, (w.missed, w.detected), frame.reach.fresh)
        after = GaussianMixture(rows.weight, np.ascontiguousarray(rows.mean.T), rows.covariance, rows.tag, fresh)
        info = UpdateInfo(t.predicted, t.born, mass, t.evidence, kappa, cardinality=w.cardinality)
        return Cardinalised(after, w.cardinality), info

    def reduce(self, state: State, rng: np.random.Generator) -> State:
        """Prune, merge, cap; the number stays, unless nothing is left."""
        mixture = _intensity(self).reduce(state.intensity, rng)
        return Cardinalised(mixture, state.cardinality if len(mixture) else no_targets())

    def step(self, state: State, z: F8, model: Model, dt: float, rng: np.random.Generator) -> tuple[State, UpdateInfo]:
        """Predict, update and reduce."""
        updated, info = self.update(self.predict(state, model, dt, rng), z, model, dt, rng)
        return self.reduce(updated, rng), info


@lru_cache(maxsize=8)
def _intensity(settings: GMCPHD) -> GMPHD:
    """The recursion of the mixture."""
    s = settings
    return GMPHD(
        weight_threshold=s.weight_threshold,
        merge_distance=s.merge_distance,
        max_components=s.max_components,
        split_weight=s.split_weight,
        gate_probability=s.gate_probability,
        transform=s.transform,
        initial=s.initial,
    )
