"""Multiple hypothesis tracking [R79; C96]: a PMBM with Reid's rules.

A hypothesis assigns every measurement of every frame: to a track, as a new target's, or as a false alarm. Summed over what
has no consequence, its probability is that of a global hypothesis of the Poisson multi-Bernoulli mixture [W15], and the
recursion is the one of `filters.pmbm`. What is Reid's and Cox and Hingorani's own: a target that is not detected when it is
born is forgotten; new targets and false alarms may be stated as densities, and survival by the time since the last
measurement; and what the best hypothesis says of the frame ``history`` frames back is decided, hypotheses that say something
else are dropped (N-scan pruning).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import InputError, NonNegative
from phdtrack.filters.hypotheses import Hypotheses, compact, decided, ended, parted
from phdtrack.filters.pmbm import PMBM, begun
from phdtrack.kernels.gaussian import Measurements, NewTargets
from phdtrack.models.gaussian import new_targets
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, GaussianMixture, UpdateInfo


@dataclass(frozen=True, slots=True)
class MHT(PMBM):
    """Settings of the multiple hypothesis tracker; history, threshold and number of hypotheses are M09's.

    Parameters
    ----------
    max_hypotheses : hypotheses kept of a cluster, the most probable [M09 §V].
    hypothesis_threshold : hypotheses less probable than this share of their cluster's best are dropped [M09 §V].
    history : N, frames after which what the best hypothesis says is decided [M09 §V].
    existence_threshold : targets that exist with less probability are deleted.
    gate_probability : part of the measurements of a track inside its gate; 1: no gate.
    transform : ``linear`` by Jacobians, or ``unscented`` by sigma points.
    initial : targets before the first frame; a weight is the probability that there is one.
    new_target_density : density of new targets' first measurements per frame and unit of area (pixel², m²), with any size
        up to the frame's; 0: as the model's births have it.
    false_alarm_density : the same of false alarms; 0: as the model's clutter has it.
    termination_frames : λ_x, a target survives the k-th frame in a row in which it is not measured with probability
        e^(−k/λ_x), as Cox and Hingorani have it; 0: with the motion's p_S. Where p_S is 0 it does not survive.
    frame_size : the image's width and height in pixels, which both densities need where sizes are measured.
    """

    new_target_density: NonNegative = 0.0
    false_alarm_density: NonNegative = 0.0
    termination_frames: NonNegative = 0.0
    frame_size: tuple[float, float] = (0.0, 0.0)

    def start(self, model: Model, rng: np.random.Generator) -> Hypotheses:
        """The initial targets, each a track of its own; none where none were given."""
        nothing = GaussianMixture.empty(model.motion.dim)
        return begun(self.initial or nothing, nothing)

    def _survival(self, p_survive: F8, missed: I8) -> F8:
        """By the motion, or by the frames without a measurement."""
        if self.termination_frames > 0:
            return np.where(p_survive > 0, np.exp(-missed / self.termination_frames), 0.0)
        return p_survive

    def _unassigned(
        self, undetected: GaussianMixture, seen: Measurements, z: F8, model: Model, dt: float, gate: float
    ) -> tuple[Measurements, NewTargets, GaussianMixture]:
        """By the model or by the stated densities; nothing is remembered of targets that were not detected."""
        if self.false_alarm_density > 0:
            seen = seen._replace(clutter=np.full(z.shape[1], self.false_alarm_density / self._sizes(model)))
        if self.new_target_density > 0:
            mean, cov = model.sensor.states(z)
            density = np.full(z.shape[1], self.new_target_density / self._sizes(model))
            return seen, NewTargets(density, np.ascontiguousarray(mean.T), cov), undetected
        births = model.birth.gaussians(z, model.sensor, model.birth_seconds(dt))
        return seen, new_targets(model, births, seen, gate, self.transform), undetected

    def update(
        self, state: Hypotheses, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Hypotheses, UpdateInfo]:
        """The best assignments of the measurements, and the decision about the frame ``history`` frames back.

        `UpdateInfo.clutter_probability` is that of a false alarm over all hypotheses.
        """
        grown, info = PMBM.update(self, state, z, model, dt, rng)
        return decided(grown) if len(grown.layers) > self.history else grown, info

    def _sizes(self, model: Model) -> float:
        """The volume of what a measurement shows besides a position."""
        if len(model.sensor.observed) == 2:
            return 1.0
        width, height = self.frame_size
        if width <= 0 or height <= 0:
            raise InputError(
                f"densities of new targets and false alarms need the frame's size, not {width:g}x{height:g}",
                where="filter.new_target_density",
            )
        return width * height

    def reduce(self, state: Hypotheses, rng: np.random.Generator) -> Hypotheses:
        """Ended tracks are forgotten, clusters that have become independent part, nodes that nothing rests on go."""
        return compact(parted(ended(state, self.existence_threshold)))
