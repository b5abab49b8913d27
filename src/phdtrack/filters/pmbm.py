"""The Poisson multi-Bernoulli mixture filter [W15; G18]: the exact posterior of targets that are
born as a Poisson process.

Symbols: docs/methods.md, Poisson multi-Bernoulli. Targets that have been detected are a mixture of
multi-Bernoulli densities, one for each global hypothesis about which measurements were of which
target. The probability of a hypothesis, but for a constant, is the product over frames of

    r p_D N(z; ẑ, S)    of each target with a measurement,        1 − r p_D    of each without
    κ(z) + λ̂(z)         of each measurement that no earlier target has

with r the probability that the target exists, if the hypothesis is true: p_S r a frame later, 1
after a measurement, r (1 − p_D)/(1 − r p_D) after a miss, λ̂/(κ + λ̂) where it is first measured.
So whether such a measurement was a false alarm, and when a target left that has not been measured
since, is summed over: 50 false alarms are 50 targets of little weight and not 2⁵⁰ hypotheses.

Targets that compete for no measurement stand in different clusters, whose hypotheses are
independent. Where a measurement is near targets of several, they become one; where the targets of
one no longer share a measurement of the window, it falls apart. In each cluster the best
assignments over all hypotheses are found in order (`kernels.association`, Murty), up to
``max_hypotheses`` and down to ``hypothesis_threshold`` of the best. Targets whose existence has
become improbable are given back to λ.

*Trajectories* [T20]. A hypothesis keeps the nodes of each target in the last ``history`` frames:
Gaussian densities of its states, linked by the motion, which together are the density of its
trajectory. `BestHypothesis` reads it: with ``smoothed`` the states of the past given all
measurements since (the smoother of Rauch, Tung and Striebel is exact for a linear model), and the
probability that the target was there, which for a target that may have left in the meantime is

    e_j = e_{j+1} + (1 − e_{j+1}) r_j (1 − p_S) / (1 − p_S r_j),    e_k = r_k

as what is measured after it has left does not depend on when.
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
    branched,
    compact,
    decided,
    ended,
    parted,
)
from phdtrack.filters.pmb import without_overlaps
from phdtrack.filters.undetected import recycled, still_undetected, survived, with_births
from phdtrack.kernels import Records
from phdtrack.kernels.appearance import HOLDER, Looks, Pasts, plain, ratios_of_pairs, remembered
from phdtrack.kernels.gaussian import (
    GAUSSIAN,
    PAIR,
    Expected,
    Measurements,
    NewTargets,
    all_gated,
    all_posteriors,
)
from phdtrack.kernels.pmb import NEVER, TINY
from phdtrack.kernels.verdicts import DOUBTFUL, verdicts_of
from phdtrack.models.gaussian import (
    Transform,
    measurements,
    moved,
    new_targets,
    predicted_measurements,
)
from phdtrack.models.pasts import carried, with_looks
from phdtrack.models.rts import predict as ahead_of
from phdtrack.models.rts import smooth_back
from phdtrack.protocols import Filter, Model
from phdtrack.types import F8, I8, NO_PAIRS, STILL, Bool, Estimates, GaussianMixture, UpdateInfo


@dataclass(frozen=True, slots=True)
class PMBM(Checked, Filter[Hypotheses]):
    """Settings of the Poisson multi-Bernoulli mixture filter.

    Parameters
    ----------
    max_hypotheses : global hypotheses kept of a cluster, the most probable.
    hypothesis_threshold : hypotheses less probable than this share of their cluster's best are
        dropped.
    history : frames for which the states of the past are kept: so far back trajectories are
        revised.
    existence_threshold : targets that exist with less probability are given back to the undetected
        ones.
    gate_probability : part of the measurements of a target inside its gate; 1: no gate.
    transform : ``linear`` by Jacobians, or ``unscented`` by sigma points.
    initial : intensity of targets before the first frame, none of which has been detected.
    """

    max_hypotheses: PositiveCount = 300
    hypothesis_threshold: Share = 0.001
    history: PositiveCount = 10
    existence_threshold: Share = 1e-3
    gate_probability: Share = GATE
    transform: Transform = "linear"
    initial: GaussianMixture | None = None

    def start(self, model: Model, rng: np.random.Generator) -> Hypotheses:
        """No target has been detected; the initial intensity is that of all."""
        nothing = GaussianMixture.empty(model.motion.dim)
        return begun(nothing, self.initial or nothing)

    def predict(
        self, state: Hypotheses, model: Model, dt: float, rng: np.random.Generator
    ) -> Hypotheses:
        """A further layer: every leaf through f, with p_S of its probability to exist; and the
        undetected targets.
        """
        leaves = state.leaves
        n = len(state)
        _, _, after = moved(model, leaves.mean, leaves.covariance, dt, self.transform)
        missed = leaves.missed + 1
        none = np.full(n, -1)
        survival = self._survival(after.p_survive, missed)
        r = leaves.r * survival
        nodes = Nodes(
            after.mean,
            after.covariance,
            r,
            none,
            np.arange(n),
            leaves.label,
            missed,
            survival,
            leaves.past,
        )
        return replace(
            state,
            layers=(*state.layers[-self.history :], nodes),
            steps=(*state.steps[-self.history :], (dt, model.warp)),
            undetected=survived(state.undetected, model, dt, self.transform),
        )

    def _survival(self, p_survive: F8, missed: I8) -> F8:
        """(L,) probabilities that targets survive which have not been measured for so many frames,
        this one included.
        """
        return p_survive

    def update(
        self, state: Hypotheses, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Hypotheses, UpdateInfo]:
        """The best assignments of the measurements.

        `UpdateInfo.clutter_probability` is that of a false alarm over all hypotheses.
        """
        leaves = state.leaves
        seen = measurements(model.sensor, z, model.clutter.intensity(z))
        gate = math.sqrt(chi2_quantile(len(seen.period), self.gate_probability))
        # First detections of new targets λ̂(z), and predicted measurements of the others
        seen, new, undetected = self._unassigned(state.undetected, seen, z, model, dt, gate)
        e = predicted_measurements(model.sensor, leaves.mean, leaves.covariance, self.transform)
        p_detect = np.minimum(leaves.r * e.p_detect, 1 - NEVER)
        # Weigh every pair within the gates
        scores = _scores(e, seen, new, p_detect, gate)
        state, looks = _with_pasts(state, model.appearance)
        sure = _sure(state, scores, looks)
        scores = _with_ratios(scores, state, looks)
        limits = Limits(self.max_hypotheses, self.hypothesis_threshold, self.existence_threshold)
        # The best assignments under every global hypothesis, then their densities
        branches = branched(state, scores, limits)
        grown = replace(_grown(state, branches, p_detect, e, seen, new), undetected=undetected)
        info = _info(state, grown, branches, scores, seen.clutter, new)
        return _remembering(grown, looks), replace(info, sure=sure)

    def _unassigned(
        self,
        undetected: GaussianMixture,
        seen: Measurements,
        z: F8,
        model: Model,
        dt: float,
        gate: float,
    ) -> tuple[Measurements, NewTargets, GaussianMixture]:
        """Measurements with κ, the new targets that they may show, and the intensity that is left
        undetected.
        """
        births = with_births(undetected, model, z, dt)
        new = new_targets(model, births, seen, gate, self.transform)
        return seen, new, still_undetected(births, model)

    def reduce(self, state: Hypotheses, rng: np.random.Generator) -> Hypotheses:
        """Recycle improbable targets, split independent clusters, drop unreferenced nodes."""
        leaves = state.leaves
        probability = state.probability
        weak = np.flatnonzero(
            (leaves.r > 0) & (leaves.r < self.existence_threshold) & (probability > 0)
        )
        weight = probability[weak] * leaves.r[weak]
        undetected = recycled(state.undetected, weight, leaves.mean[weak], leaves.covariance[weak])
        state = replace(state, undetected=undetected)
        return compact(parted(ended(state, self.existence_threshold)))


@dataclass(frozen=True, slots=True)
class MHT(PMBM):
    """Settings of the multiple hypothesis tracker [R79; C96], those of `PMBM` among them: a PMBM
    with Reid's rules.

    A hypothesis assigns every measurement of every frame: to a track, as a new target's, or as a
    false alarm. Summed over what has no consequence, its probability is that of a global hypothesis
    of the mixture. What is Reid's and Cox and Hingorani's own: a target that is not detected when
    it is born is forgotten; new targets and false alarms may be stated as densities, and survival
    by the time since the last measurement; and what the best hypothesis says of the frame
    ``history`` frames back is decided, hypotheses that say something else are dropped (N-scan
    pruning). How many hypotheses, down to which share of the best, and how many frames are M09's
    [M09 §V].

    Parameters
    ----------
    new_target_density : density of new targets' first measurements per frame and unit of area
        (pixel², m²), with any size up to the frame's; 0: as the model's births have it.
    false_alarm_density : the same of false alarms; 0: as the model's clutter has it.
    termination_frames : λ_x, a target survives the k-th frame in a row in which it is not measured
        with probability e^(−k/λ_x), as Cox and Hingorani have it; 0: with the motion's p_S. Where
        p_S is 0 it does not survive.
    frame_size : the image's width and height in pixels, which both densities need where sizes are
        measured.
    """

    new_target_density: NonNegative = 0.0
    false_alarm_density: NonNegative = 0.0
    termination_frames: NonNegative = 0.0
    frame_size: tuple[float, float] = (0.0, 0.0)

    def start(self, model: Model, rng: np.random.Generator) -> Hypotheses:
        """The initial targets, each a track of its own; none without an initial mixture."""
        nothing = GaussianMixture.empty(model.motion.dim)
        return begun(self.initial or nothing, nothing)

    def _survival(self, p_survive: F8, missed: I8) -> F8:
        """By the motion, or by the frames without a measurement."""
        if self.termination_frames > 0:
            return np.where(p_survive > 0, np.exp(-missed / self.termination_frames), 0.0)
        return p_survive

    def _unassigned(
        self,
        undetected: GaussianMixture,
        seen: Measurements,
        z: F8,
        model: Model,
        dt: float,
        gate: float,
    ) -> tuple[Measurements, NewTargets, GaussianMixture]:
        """By the model or by the stated densities; nothing is remembered of targets that were not
        detected.
        """
        if self.false_alarm_density > 0:
            seen = seen._replace(
                clutter=np.full(z.shape[1], self.false_alarm_density / self._sizes(model))
            )
        if self.new_target_density > 0:
            mean, cov = model.sensor.states(z)
            density = np.full(z.shape[1], self.new_target_density / self._sizes(model))
            return seen, NewTargets(density, np.ascontiguousarray(mean.T), cov), undetected
        births = model.birth.gaussians(z, model.sensor, model.birth_seconds(dt))
        return seen, new_targets(model, births, seen, gate, self.transform), undetected

    def update(
        self, state: Hypotheses, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Hypotheses, UpdateInfo]:
        """Update like `PMBM.update`, and make the decision about the frame ``history`` frames
        back.
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
                "densities of new targets and false alarms need the frame's size, not"
                f" {width:g}x{height:g}",
                where="filter.new_target_density",
            )
        return width * height

    def reduce(self, state: Hypotheses, rng: np.random.Generator) -> Hypotheses:
        """Drop ended tracks, split independent clusters, drop unreferenced nodes."""
        return compact(parted(ended(state, self.existence_threshold)))


def begun(detected: GaussianMixture, undetected: GaussianMixture) -> Hypotheses:
    """Before the first frame: Bernoulli targets, whose weights are the probabilities that they
    exist, and the intensity.
    """
    n = len(detected)
    none = np.full(n, -1)
    mean = np.ascontiguousarray(detected.mean.T)
    cov = np.ascontiguousarray(detected.covariance)
    r = np.minimum(detected.weight, 1.0)
    nodes = Nodes(mean, cov, r, none, none, np.arange(n), np.zeros(n, np.int64), np.ones(n))
    return Hypotheses((nodes,), np.arange(n), (), n, undetected, ((0.0, STILL),))


def _scores(e: Expected, m: Measurements, new: NewTargets, p_detect: F8, gate: float) -> Scores:
    """The terms of measurements, leaves and pairs in log-weights; ``p_detect`` (L,) is r
    p_D.
    """
    pairs = all_gated(
        e.rows, e.z, e.covariance, e.noise, m.z, m.noise, m.period, gate, p_detect, GAUSSIAN
    )
    leaf = np.ascontiguousarray(pairs["gaussian"])
    measurement = np.ascontiguousarray(pairs["measurement"])
    missed = np.log1p(-p_detect)
    gain = np.log(p_detect[leaf]) + pairs["log_density"] - missed[leaf]
    total = np.maximum(m.clutter + new.density, TINY)
    return Scores(leaf, measurement, gain, missed, np.log(total), new.density / total)


def _with_pasts(state: Hypotheses, looks: Looks | None) -> tuple[Hypotheses, Looks]:
    """The leaves with their pasts, and what a frame looks like, as of `carried`."""
    leaves = state.leaves
    past, pasts, seen = carried(leaves.past, state.pasts, looks)
    if past is leaves.past:
        return state, seen
    layers = (*state.layers[:-1], replace(leaves, past=past))
    return replace(state, layers=layers, pasts=pasts), seen


def _sure(state: Hypotheses, scores: Scores, looks: Looks) -> I8:
    """`UpdateInfo.sure`, by the marginal probabilities of pairs without appearance; none where it
    is not known what measurements look like.
    """
    if not len(looks.mean):
        return NO_PAIRS
    label, target = np.unique(state.leaves.label, return_inverse=True)
    probability = state.probability
    n = len(label)
    missed = 1 + sum_by(target, probability * np.expm1(scores.missed), n)
    missed = np.maximum(missed, NEVER)
    presence = sum_by(target, probability * state.leaves.r, n)
    leaf = scores.leaf
    # log r p_D q(z) − log (κ + λ̂)
    log_odds = scores.gain + scores.missed[leaf] - scores.unassigned[scores.measurement]
    odds = probability[leaf] * np.exp(log_odds) / missed[target[leaf]]
    verdicts = verdicts_of(target[leaf], scores.measurement, odds, n, len(scores.unassigned))
    known = (verdicts != DOUBTFUL) & (presence >= 0.5)
    return np.stack([label[known], verdicts[known]], axis=1)


def _with_ratios(scores: Scores, state: Hypotheses, looks: Looks) -> Scores:
    """The scores with the log-likelihood ratios of what leaves and measurements look like
    [APP (2)].
    """
    if looks.law.weight <= 0 or not len(looks.mean):
        return scores
    pairs = np.zeros(len(scores.leaf), PAIR)
    pairs["gaussian"] = scores.leaf
    pairs["measurement"] = scores.measurement
    ratio = ratios_of_pairs(pairs, _holders(state), tuple(state.pasts), plain(looks))
    return replace(scores, gain=scores.gain + ratio) if len(ratio) else scores


def _holders(state: Hypotheses) -> Records:
    """The leaves as holders of pasts. Those of one track follow each other."""
    holders = np.empty(len(state), HOLDER)
    holders["target"] = state.leaves.label
    holders["detection"] = state.leaves.detection
    holders["past"] = state.leaves.past
    return holders


def _remembering(state: Hypotheses, looks: Looks) -> Hypotheses:
    """The hypotheses with what their leaves have seen in this frame, too."""
    if not len(looks.mean):
        return state
    holders = _holders(state)
    pasts = Pasts(*remembered(holders, tuple(state.pasts), plain(looks)))
    leaves = replace(state.leaves, past=np.ascontiguousarray(holders["past"]))
    return replace(state, layers=(*state.layers[:-1], leaves), pasts=pasts)


def _grown(
    state: Hypotheses,
    branches: Branches,
    p_detect: F8,
    e: Expected,
    m: Measurements,
    new: NewTargets,
) -> Hypotheses:
    """The hypotheses with the branches as leaves; ``p_detect`` (L,) is r p_D."""
    leaves = state.leaves
    count = len(m.z)
    number = np.unique(
        np.concatenate([branches.lone, *(c.leaf[c.leaf >= 0] for c in branches.clusters)])
    )
    source = number // (count + 1) - 1
    which = number % (count + 1) - 1
    begins = source < 0
    missed = which < 0
    n = len(number)
    d = leaves.mean.shape[1]
    mean = np.empty((n, d))
    cov = np.empty((n, d, d))
    r = np.ones(n)
    since = np.zeros(n, np.int64)
    mean[begins] = new.mean[which[begins]]
    cov[begins] = new.covariance[which[begins]]
    density = new.density[which[begins]]
    r[begins] = density / np.maximum(m.clutter[which[begins]] + density, TINY)
    at = source[missed]
    mean[missed] = leaves.mean[at]
    cov[missed] = leaves.covariance[at]
    since[missed] = leaves.missed[at]
    r[missed] = np.clip((leaves.r[at] - p_detect[at]) / (1 - p_detect[at]), 0.0, 1.0)
    # Of branches without a measurement of an earlier track nothing is written.
    pairs = np.empty(n, PAIR)
    pairs["gaussian"] = source
    pairs["measurement"] = np.where(begins, -1, which)
    all_posteriors(leaves.mean, leaves.covariance, e, m, pairs, mean, cov)
    # The last place stands for new tracks.
    label = np.where(
        begins, state.next_label + np.cumsum(begins) - 1, np.append(leaves.label, -1)[source]
    )
    parent = np.append(leaves.parent, -1)[source]
    survival = np.append(leaves.survival, 1.0)[source]
    past = np.append(leaves.past, -1)[source]
    nodes = Nodes(mean, cov, r, which, parent, label, since, survival, past)
    clusters = tuple(
        Cluster(np.where(c.leaf >= 0, np.searchsorted(number, c.leaf), -1), c.weight)
        for c in branches.clusters
    )
    lone = np.searchsorted(number, branches.lone)
    label_after = state.next_label + int(begins.sum())
    return replace(
        state,
        layers=(*state.layers[:-1], nodes),
        lone=lone,
        clusters=clusters,
        next_label=label_after,
    )


def _info(
    state: Hypotheses,
    grown: Hypotheses,
    branches: Branches,
    scores: Scores,
    clutter: F8,
    new: NewTargets,
) -> UpdateInfo:
    """The record of the update of ``state`` to ``grown``."""
    probability = state.probability
    count = len(clutter)
    share = probability[scores.leaf] * np.exp(scores.gain + scores.missed[scores.leaf])
    evidence = new.density + sum_by(scores.measurement, share, count)
    explained = clutter + evidence > 0
    born = float(branches.unassigned @ scores.p_new)
    false_alarm = np.where(explained, branches.unassigned * (1 - scores.p_new), 1.0)
    # log(1 − r p_D) is what a leaf contributes that is missed.
    detected = float(probability @ -np.expm1(scores.missed))
    mass = float(probability @ state.leaves.r) + born
    return UpdateInfo(
        mass,
        born,
        grown.mass,
        evidence,
        clutter,
        false_alarm,
        int(np.count_nonzero(~explained)),
        detected=detected,
    )


@dataclass(frozen=True, slots=True)
class BestHypothesis(Checked):
    """Settings of the extraction from hypotheses.

    Parameters
    ----------
    min_weight : targets that exist with less probability, if the hypothesis is true, are not
        reported. In the frames before the probability is given all that has been measured since: a
        target that was detected again later existed.
    merge_iou : of targets whose boxes overlap by more (IoU) the one that has been followed for
        longer is reported; 1: all.
    smoothed : states of the frames before are given all that has been measured since, too; False:
        as they were then.
    """

    min_weight: Share = 0.5
    merge_iou: Share = 0.4
    smoothed: bool = False

    def extract(self, state: Hypotheses, z: F8, model: Model) -> Estimates:
        """The targets of each cluster's best hypothesis, by label; their weight is the probability
        that they exist.

        `Estimates.past` are the same targets, and those that have ended since, in the frames
        before.
        """
        at: I8 = state.best()
        exists = state.leaves.r[at]
        gaussians = (state.leaves.mean[at], state.leaves.covariance[at])
        frames = [self._estimates(state.leaves, at, exists, gaussians, model)]
        for k in range(len(state.layers) - 2, -1, -1):
            later = state.layers[k + 1].select(at)
            nodes = state.layers[k]
            at = later.parent
            known = at >= 0
            at = at[known]
            later = later.select(known)
            exists = exists[known]
            then = nodes.select(at)
            there = nodes.r[at]
            left = there * (1 - later.survival) / np.maximum(1 - later.survival * there, TINY)
            exists = np.minimum(exists + (1 - exists) * left, 1.0)
            gaussians = gaussians[0][known], gaussians[1][known]
            if self.smoothed:
                ahead = ahead_of(model.motion, then.mean, then.covariance, *state.steps[k + 1])
                gaussians = smooth_back(then.mean, then.covariance, ahead, *gaussians)
            else:
                gaussians = then.mean, then.covariance
            frames.append(self._estimates(nodes, at, exists, gaussians, model))
        estimates = replace(frames[0], past=tuple(frames[:0:-1]))
        if model.appearance is None or not len(state.pasts.rows):
            return estimates
        leaves = state.leaves
        best = state.best()
        own = best[leaves.label[best].searchsorted(estimates.tag)]
        followed = np.unique(leaves.label[leaves.r > 0])
        return with_looks(estimates, leaves.past[own], state.pasts, followed)

    def _estimates(
        self, nodes: Nodes, at: I8, exists: F8, gaussians: tuple[F8, F8], model: Model
    ) -> Estimates:
        """The nodes ``at`` (n,), that exist with these probabilities in these states,
        which are reported.
        """
        reported: Bool = exists >= self.min_weight
        mean = np.ascontiguousarray(gaussians[0][reported].T)
        at = at[reported]
        boxes = model.sensor.boxes(mean)
        label = nodes.label[at]
        found = Estimates(
            mean, gaussians[1][reported], exists[reported], boxes, nodes.detection[at], label
        )
        # Labels rise with the frame in which a track began.
        return found.select(without_overlaps(found.xyxy, self.merge_iou))
