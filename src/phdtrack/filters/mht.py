"""Multiple hypothesis tracking [R79; C96]: hypotheses about the origin of measurements, a Kalman filter for each track.

A hypothesis assigns every measurement of every frame: to a track, as a new target's, or as a false alarm. Its probability,
but for a constant, is the product over frames of

    r p_D N(z; ẑ, S)    of each track with a measurement,        1 − r p_D    of each without
    κ(z) + γ̂(z)         of each measurement that no earlier track has

with r the probability that the target exists: p_S r a frame later, 1 after a measurement, r (1 − p_D)/(1 − r p_D) after a
miss, γ̂/(κ + γ̂) where a track begins. So hypotheses are summed that differ only in whether a measurement that nothing has
followed yet was a false alarm or a new target's, or in when a target left that has not been measured since. Reid's
probabilities are the same, but 50 false alarms make 50 short tracks of little weight and not 2⁵⁰ hypotheses.
γ̂(z) = ∫ p_D g(z|x) γ(x) dx, κ and p_D are the model's, or stated as densities as Cox and Hingorani have them.

Tracks that compete for no measurement stand in different clusters, whose hypotheses are independent. Where a measurement is
near tracks of several, they become one; where the tracks of one no longer share a measurement of the window, it falls apart.
In each cluster the best assignments over all hypotheses are found in order (`kernels.association`), up to ``max_hypotheses``
and down to ``hypothesis_threshold`` of the best. What the best hypothesis says of the frame ``history`` frames back is then
decided: others are dropped.

The model answers with the arrays of `models.gaussian`, as for all Gaussian filters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.arrays import GATE, chi2_quantile, sum_by
from phdtrack.errors import Checked, InputError, NonNegative, PositiveCount, Share
from phdtrack.filters.hypotheses import (
    Branches,
    Cluster,
    Hypotheses,
    Limits,
    Nodes,
    Scores,
    before,
    branched,
    compact,
    decided,
    ended,
    parted,
)
from phdtrack.filters.pmb import without_overlaps
from phdtrack.kernels.gaussian import GAUSSIAN, PAIR, Expected, Measurements, NewTargets, all_gated, all_posteriors
from phdtrack.kernels.pmb import NEVER, TINY
from phdtrack.models.gaussian import Transform, expected, measurements, moved, new_targets
from phdtrack.protocols import Filter, Model
from phdtrack.types import F8, I8, Estimates, GaussianMixture, UpdateInfo


@dataclass(frozen=True, slots=True)
class MHT(Checked, Filter[Hypotheses]):
    """Settings of the multiple hypothesis tracker; history, threshold and number of hypotheses are M09's.

    Parameters
    ----------
    max_hypotheses : hypotheses kept of a cluster, the most probable [M09 §V].
    hypothesis_threshold : hypotheses less probable than this share of their cluster's best are dropped [M09 §V].
    history : N, frames after which what the best hypothesis says is decided [M09 §V].
    existence_threshold : targets that exist with less probability are deleted.
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

    def start(self, model: Model, rng: np.random.Generator) -> Hypotheses:
        """The initial targets, each a track of its own; none where none were given."""
        given = self.initial or GaussianMixture.empty(model.motion.dim)
        n = len(given)
        none, mean, cov = np.full(n, -1), np.ascontiguousarray(given.mean.T), np.ascontiguousarray(given.covariance)
        nodes = Nodes(mean, cov, np.minimum(given.weight, 1.0), none, none, np.arange(n), np.zeros(n, np.int64))
        return Hypotheses((nodes,), np.arange(n), (), n)

    def predict(self, state: Hypotheses, model: Model, dt: float, rng: np.random.Generator) -> Hypotheses:
        """A further layer: every leaf through f, with p_S of its probability to exist."""
        leaves, n = state.leaves, len(state)
        _, _, after = moved(model, leaves.mean, leaves.covariance, dt, self.transform)
        survive, missed = after.p_survive, leaves.missed + 1
        if self.termination_frames > 0:
            survive = np.where(survive > 0, np.exp(-missed / self.termination_frames), 0.0)
        r, none = leaves.r * survive, np.full(n, -1)
        nodes = Nodes(after.mean, after.covariance, r, none, np.arange(n), leaves.label, missed)
        return replace(state, layers=(*state.layers[-self.history :], nodes))

    def update(
        self, state: Hypotheses, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Hypotheses, UpdateInfo]:
        """The best assignments of the measurements, and the decision about the frame ``history`` frames back.

        `UpdateInfo.clutter_probability` is that of a false alarm over all hypotheses.
        """
        leaves, sensor = state.leaves, model.sensor
        seen = measurements(model, z)
        gate = math.sqrt(chi2_quantile(len(seen.period), self.gate_probability))
        if self.false_alarm_density > 0:
            seen = seen._replace(clutter=np.full(z.shape[1], self.false_alarm_density / self._sizes(model)))
        if self.new_target_density > 0:
            mean, cov = sensor.states(z)
            density = np.full(z.shape[1], self.new_target_density / self._sizes(model))
            new = NewTargets(density, np.ascontiguousarray(mean.T), cov)
        else:
            new = new_targets(model, z, seen, dt, gate, self.transform)
        e = expected(sensor, leaves.mean, leaves.covariance, self.transform)
        p_detect = np.minimum(leaves.r * e.p_detect, 1 - NEVER)
        scores = _scores(e, seen, new, p_detect, gate)
        limits = Limits(self.max_hypotheses, self.hypothesis_threshold, self.existence_threshold)
        branches = branched(state, scores, limits)
        grown = _grown(state, branches, p_detect, e, seen, new)
        if len(grown.layers) > self.history:
            grown = decided(grown)
        return grown, _info(state, grown, branches, scores, seen.clutter, new)

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


def _scores(e: Expected, m: Measurements, new: NewTargets, p_detect: F8, gate: float) -> Scores:
    """What measurements, leaves, and pairs contribute to log-weights; ``p_detect`` (L,) is r p_D."""
    pairs = all_gated(e.rows, e.z, e.covariance, e.noise, m.z, m.noise, m.period, gate, p_detect, GAUSSIAN)
    leaf, measurement = np.ascontiguousarray(pairs["gaussian"]), np.ascontiguousarray(pairs["measurement"])
    missed = np.log1p(-p_detect)
    gain = np.log(p_detect[leaf]) + pairs["log_density"] - missed[leaf]
    total = np.maximum(m.clutter + new.density, TINY)
    return Scores(leaf, measurement, gain, missed, np.log(total), new.density / total)


def _grown(state: Hypotheses, branches: Branches, p_detect: F8, e: Expected, m: Measurements, new: NewTargets) -> Hypotheses:
    """The hypotheses with the branches as leaves; ``p_detect`` (L,) is r p_D."""
    leaves, count = state.leaves, len(m.z)
    number = np.unique(np.concatenate([branches.lone, *(c.leaf[c.leaf >= 0] for c in branches.clusters)]))
    source, which = number // (count + 1) - 1, number % (count + 1) - 1
    begins, missed, n = source < 0, which < 0, len(number)
    d = leaves.mean.shape[1]
    mean, cov, r, since = np.empty((n, d)), np.empty((n, d, d)), np.ones(n), np.zeros(n, np.int64)
    mean[begins], cov[begins] = new.mean[which[begins]], new.covariance[which[begins]]
    density = new.density[which[begins]]
    r[begins] = density / np.maximum(m.clutter[which[begins]] + density, TINY)
    at = source[missed]
    mean[missed], cov[missed], since[missed] = leaves.mean[at], leaves.covariance[at], leaves.missed[at]
    r[missed] = np.clip((leaves.r[at] - p_detect[at]) / (1 - p_detect[at]), 0.0, 1.0)
    # Of branches without a measurement of an earlier track nothing is written.
    pairs = np.empty(n, PAIR)
    pairs["gaussian"], pairs["measurement"] = source, np.where(begins, -1, which)
    all_posteriors(leaves.mean, leaves.covariance, e, m, pairs, mean, cov)
    # The last place stands for new tracks.
    label = np.where(begins, state.next_label + np.cumsum(begins) - 1, np.append(leaves.label, -1)[source])
    nodes = Nodes(mean, cov, r, which, np.append(leaves.parent, -1)[source], label, since)
    clusters = tuple(
        Cluster(np.where(c.leaf >= 0, np.searchsorted(number, c.leaf), -1), c.weight) for c in branches.clusters
    )
    lone = np.searchsorted(number, branches.lone)
    return Hypotheses((*state.layers[:-1], nodes), lone, clusters, state.next_label + int(begins.sum()))


def _info(
    state: Hypotheses, grown: Hypotheses, branches: Branches, scores: Scores, clutter: F8, new: NewTargets
) -> UpdateInfo:
    """What the update of ``state`` to ``grown`` learned."""
    probability, count = state.probability, len(clutter)
    share = probability[scores.leaf] * np.exp(scores.gain + scores.missed[scores.leaf])
    total = clutter + new.density + sum_by(scores.measurement, share, count)
    born = float(branches.unassigned @ scores.p_new)
    false = branches.unassigned * (1 - scores.p_new)
    # log(1 − r p_D) is what a leaf contributes that is missed.
    detected = float(probability @ -np.expm1(scores.missed))
    mass = float(probability @ state.leaves.r) + born
    return UpdateInfo(
        mass, born, grown.mass, (1 - false) * total, false * total, int(np.count_nonzero(total == 0)), detected=detected
    )


@dataclass(frozen=True, slots=True)
class BestHypothesis(Checked):
    """Settings of the extraction from hypotheses.

    Parameters
    ----------
    min_weight : targets that exist with less probability, if the hypothesis is true, are not reported. A target that was
        detected again later existed.
    merge_iou : of targets whose boxes overlap by more (IoU) the one that has been followed for longer is reported; 1: all.
    """

    min_weight: Share = 0.5
    merge_iou: Share = 0.4

    def extract(self, state: Hypotheses, z: F8, model: Model) -> Estimates:
        """The targets of each cluster's best hypothesis, by label; their weight is the probability that they exist.

        `Estimates.past` are the same targets, and those that have ended since, in the frames before.
        """
        at: I8 = state.best()
        weight, frames = np.zeros(len(at)), []
        for nodes in reversed(state.layers):
            known = np.flatnonzero(at >= 0)
            weight[known] = np.maximum(weight[known], nodes.r[at[known]])
            reported = known[weight[known] >= self.min_weight]
            here = nodes.take(at[reported])
            mean = np.ascontiguousarray(here.mean.T)
            found = Estimates(mean, here.covariance, weight[reported], model.sensor.boxes(mean), here.detection, here.label)
            # Labels rise with the frame in which a track began.
            frames.append(found.take(without_overlaps(found.xyxy, self.merge_iou)))
            at = before(nodes, at)
        return replace(frames[0], past=tuple(frames[:0:-1]))
