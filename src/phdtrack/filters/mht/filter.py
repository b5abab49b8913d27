"""Multiple hypothesis tracking [R79; C96]: hypotheses about which measurements are whose, a Kalman filter for each track.

A hypothesis assigns every measurement of every frame: to a track, as a new target's, or as a false alarm. Its probability,
but for a constant, is the product over frames of

    r p_D N(z; ẑ, S)    of each track with a measurement,        1 − r p_D    of each without
    κ(z) + γ̂(z)         of each measurement that no earlier track has

with r the probability that the target is there: p_S r a frame later, 1 after a measurement, r (1 − p_D)/(1 − r p_D) after a
miss, γ̂/(κ + γ̂) where a track begins. So hypotheses are summed that differ only in whether a measurement that nothing has
followed yet was a false alarm or a new target's, or in when a target left that has not been measured since. Reid's
probabilities are the same, but 50 false alarms make 50 short tracks of little weight and not 2⁵⁰ hypotheses.
γ̂(z) = ∫ p_D g(z|x) γ(x) dx, κ and p_D are the model's, or stated as densities as Cox and Hingorani have them.

Tracks that compete for no measurement stand in different clusters, whose hypotheses are independent. Where a measurement is
near tracks of several, they become one; where the tracks of one no longer share a measurement of the window, it falls apart.
In each cluster the best assignments over all its hypotheses are found in order (`kernels.murty`), up to ``max_hypotheses``
and down to ``hypothesis_threshold`` of the best. What the best hypothesis says of the frame ``history`` frames back is then
decided: others are dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.arrays import GATE, chi2_quantile, sum_by
from phdtrack.checks import NonNegative, PositiveCount, Share, check
from phdtrack.errors import InputError
from phdtrack.filters.composed import composed_step
from phdtrack.filters.hypotheses import Cluster, Hypotheses, Nodes
from phdtrack.filters.mht.branching import Branches, Limits, branched
from phdtrack.filters.mht.pruning import compact, decided, ended, parted
from phdtrack.filters.mht.scores import Scores, scores
from phdtrack.filters.newborn import Newborn, newborn, newborn_anywhere
from phdtrack.filters.transforms import Transform, moved, posteriors
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, GaussianMixture, Particles, UpdateInfo


@dataclass(frozen=True, slots=True)
class MHT:
    """Settings of the multiple hypothesis tracker; depth, ratio and number of hypotheses are M09's.

    Parameters
    ----------
    max_hypotheses : hypotheses kept of a cluster, the most probable [M09 §V].
    hypothesis_threshold : hypotheses less probable than this share of their cluster's best are dropped [M09 §V].
    history : N, frames after which what the best hypothesis says is decided [M09 §V].
    existence_threshold : targets that are there with less probability are given up.
    gate_probability : part of the measurements of a track inside its gate; 1: no gate.
    transform : ``linear`` by Jacobians, or ``unscented`` by sigma points.
    new_target_density : density of new targets' first measurements per frame and unit of area (pixel², m²), with any size
        up to the frame's; 0: as the model's births have it.
    false_alarm_density : the same of false alarms; 0: as the model's clutter has it.
    termination_frames : λ_x, a target survives the k-th frame in a row in which it is not measured with probability
        e^(−k/λ_x), as Cox and Hingorani have it; 0: with the motion's p_S. Where p_S is 0 it does not survive.
    frame_size : the image's width and height in pixels, which both densities need where sizes are measured.
    initial : targets before the first frame; a weight is the probability that there is one.
    """

    max_hypotheses: PositiveCount = 300
    hypothesis_threshold: Share = 0.001
    history: PositiveCount = 10
    existence_threshold: Share = 1e-4
    gate_probability: Share = GATE
    transform: Transform = "linear"
    new_target_density: NonNegative = 0.0
    false_alarm_density: NonNegative = 0.0
    termination_frames: NonNegative = 0.0
    frame_size: tuple[float, float] = (0.0, 0.0)
    initial: GaussianMixture | None = None

    def __post_init__(self) -> None:
        check(self)

    def start(self, model: Model, rng: np.random.Generator) -> Hypotheses:
        """The initial targets, each a track of its own; none where none were given."""
        given, d = self.initial, model.motion.dim
        if given is None:
            given = GaussianMixture(np.zeros(0), np.zeros((d, 0)), np.zeros((0, d, d)))
        n = len(given)
        none, zeros = np.full(n, -1), np.zeros(n, np.int64)
        mean, cov = np.array(given.mean, order="C"), np.array(given.covariance)
        nodes = Nodes(mean, cov, np.minimum(given.weight, 1.0), none, none, np.arange(n), zeros)
        return Hypotheses((nodes,), np.arange(n), (), n)

    def predict(self, state: Hypotheses, model: Model, dt: float, rng: np.random.Generator) -> Hypotheses:
        """A further layer: every leaf through f, there with p_S of its probability.

        Raises `InputError` where the motion spawns: spawned targets have no Gaussian form.
        """
        leaves = state.leaves
        n, there = len(leaves), np.flatnonzero(leaves.exist > 0)
        mean, cov, exist = leaves.mean.copy(), leaves.covariance.copy(), np.zeros(n)
        if len(there):
            x, spread = model.carried_gaussians(np.ascontiguousarray(leaves.mean[:, there]), leaves.covariance[there])
            if len(model.motion.spawn(Particles(x, leaves.exist[there]), dt, rng)):
                raise InputError(
                    "the MHT has no spawning", where="motion.births", cure="Use NoSpawn, or the particle filter"
                )
            exist[there] = leaves.exist[there] * self._survive(x, leaves.since[there] + 1, model, dt)
            mean[:, there], cov[there] = moved(x, spread, model.motion, dt, self.transform)
        nodes = Nodes(mean, cov, exist, np.full(n, -1), np.arange(n), leaves.label, leaves.since + 1)
        return replace(state, layers=(*state.layers[-self.history :], nodes))

    def _survive(self, x: F8, missed: I8, model: Model, dt: float) -> F8:
        """(L,) probability to survive, of targets that have not been measured for so many frames, this one included."""
        survive = model.motion.p_survive(x, dt / model.rate)
        if self.termination_frames == 0:
            return survive
        lasting: F8 = np.where(survive > 0, np.exp(-missed / self.termination_frames), 0.0)
        return lasting

    def update(
        self, state: Hypotheses, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Hypotheses, UpdateInfo]:
        """The best assignments of the measurements, and the decision about the frame ``history`` frames back.

        In the information returned the newborn are the new targets among the measurements, and ``evidence`` and ``clutter``
        are scaled so that `UpdateInfo.clutter_probability` is the probability of a false alarm over all hypotheses.
        """
        limits = Limits(self.max_hypotheses, self.hypothesis_threshold, self.existence_threshold)
        born, clutter = self._born(z, model, dt), self._clutter(z, model)
        terms = scores(state.leaves, z, born, clutter, model.sensor, self._gate(model), self.transform)
        branches = branched(state, terms, limits)
        grown = self._grown(state, branches, terms, z, model)
        if len(grown.layers) > self.history:
            grown = decided(grown)
        return grown, _info(state, grown, branches, terms)

    def _born(self, z: F8, model: Model, dt: float) -> Newborn:
        if self.new_target_density == 0:
            return newborn(z, model, dt, self._gate(model), self.transform)
        return newborn_anywhere(z, self.new_target_density / self._sizes(model), model.sensor)

    def _clutter(self, z: F8, model: Model) -> F8:
        return (
            model.clutter.intensity(z)
            if self.false_alarm_density == 0
            else np.full(z.shape[1], self.false_alarm_density / self._sizes(model))
        )

    def _gate(self, model: Model) -> float:
        """The gate in deviations of the innovation."""
        return math.sqrt(chi2_quantile(len(model.sensor.observed), self.gate_probability))

    def _sizes(self, model: Model) -> float:
        """The volume of what a measurement shows beside a position."""
        if len(model.sensor.observed) == 2:
            return 1.0
        width, height = self.frame_size
        if width <= 0 or height <= 0:
            raise InputError(
                f"densities of new targets and false alarms need the frame's size, not {width:g}x{height:g}",
                where="filter.new_target_density",
                cure="Give --frame-size WxH, or 0 for the rates of the model",
            )
        return width * height

    def _grown(self, state: Hypotheses, branches: Branches, terms: Scores, z: F8, model: Model) -> Hypotheses:
        """The hypotheses with the branches as leaves."""
        before, count = state.leaves, z.shape[1]
        held = [branches.alone, *(c.leaf[c.leaf >= 0] for c in branches.clusters)]
        number = np.unique(np.concatenate(held))
        source, which = number // (count + 1) - 1, number % (count + 1) - 1
        new, seen, n = source < 0, (source >= 0) & (which >= 0), len(number)
        mean, cov = np.empty((len(before.mean), n)), np.empty((n, *before.covariance.shape[1:]))
        exist, since = np.ones(n), np.zeros(n, np.int64)
        mean[:, new], cov[new] = terms.born.mean[:, which[new]], terms.born.covariance[which[new]]
        exist[new] = terms.new[which[new]]
        missed = which < 0
        mean[:, missed], cov[missed] = before.mean[:, source[missed]], before.covariance[source[missed]]
        exist[missed], since[missed] = terms.kept[source[missed]], before.since[source[missed]]
        if seen.any():
            mixture = GaussianMixture(before.exist, before.mean, before.covariance)
            mean[:, seen], cov[seen] = posteriors(mixture, z, source[seen], which[seen], model.sensor, self.transform)
        label = np.where(new, state.fresh + np.cumsum(new) - 1, before.label[source] if len(before) else 0)
        parent = np.where(new, -1, before.parent[source] if len(before) else -1)
        nodes = Nodes(mean, cov, exist, which, parent, label, since)
        clusters = tuple(
            Cluster(np.where(c.leaf >= 0, np.searchsorted(number, c.leaf), -1), c.weight) for c in branches.clusters
        )
        alone = np.searchsorted(number, branches.alone)
        return Hypotheses((*state.layers[:-1], nodes), alone, clusters, state.fresh + int(new.sum()))

    def reduce(self, state: Hypotheses, rng: np.random.Generator) -> Hypotheses:
        """Ended tracks are forgotten, clusters that have become independent part, nodes that nothing rests on go."""
        return compact(parted(ended(state, self.existence_threshold)))

    def step(
        self, state: Hypotheses, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Hypotheses, UpdateInfo]:
        """Predict, update and reduce in turn."""
        return composed_step(self, state, z, model, dt, rng)


def _info(state: Hypotheses, grown: Hypotheses, branches: Branches, terms: Scores) -> UpdateInfo:
    """What the update of ``state`` to ``grown`` learned."""
    probability, count = state.probability, len(terms.alone)
    total = terms.clutter + terms.born.density + sum_by(terms.which, probability[terms.leaf] * terms.share, count)
    born = float(branches.own @ terms.new)
    false = branches.own * (1 - terms.new)
    vanished = int(np.count_nonzero(total == 0))
    return UpdateInfo(
        float(probability @ state.leaves.exist) + born, born, grown.mass, (1 - false) * total, false * total, vanished
    )
