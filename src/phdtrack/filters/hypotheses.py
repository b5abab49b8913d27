"""Association hypotheses in clusters: the state of the MHT, how it branches with measurements, and
how it is pruned.

A track begins with a measurement and branches wherever it may have gone on in more than one way.
The nodes of all tracks' trees stand in layers, one for each of the last frames; the leaves are the
last layer. A hypothesis says of every track of a cluster which leaf is true, or that there is none.
Clusters are independent of each other, so that a hypothesis of everything is any choice of one from
each, and its probability the product. Most clusters are one track with one leaf: ``lone`` leaves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.arrays import sum_by
from phdtrack.kernels.appearance import NO_PASTS, Pasts
from phdtrack.kernels.association import competing, components
from phdtrack.kernels.branching import children, equal_rows
from phdtrack.types import F8, I8, Bool, GaussianMixture

# Steps that a cluster's assignments may take, about: a larger cluster keeps fewer hypotheses. With
# 300 of them it is reached where about 150 measurements compete.
WORK = 4e7
# A target that has existed with no greater probability in any frame has never been reported by
# anyone.
BELIEVED = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """One frame's states of all tracks in all forms.

    Attributes
    ----------
    mean : (L, d).      covariance : (L, d, d).
    r : (L,) probability that the target exists, if the measurements of its history are its own.
    detection : (L,) measurement of the frame that it took, −1 for none.
    parent : (L,) its node in the frame before; −1 if the track begins.
    label : (L,) the track's number, from 0, unique.
    missed : (L,) frames since it last took a measurement.
    survival : (L,) p_S of the interval before; 1 where the track begins.
    past : (L,) of leaves, which of `Hypotheses.pasts` each has, −1 for none.
    """

    mean: F8
    covariance: F8
    r: F8
    detection: I8
    parent: I8
    label: I8
    missed: I8
    survival: F8
    past: I8 = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self) -> None:
        if len(self.past) != len(self.r):
            object.__setattr__(self, "past", np.full(len(self.r), -1))

    def __len__(self) -> int:
        return len(self.r)

    def select(self, index: I8 | Bool) -> Nodes:
        """The nodes at ``index`` (integers or a mask), in that order."""
        return Nodes(
            self.mean[index],
            self.covariance[index],
            self.r[index],
            self.detection[index],
            self.parent[index],
            self.label[index],
            self.missed[index],
            self.survival[index],
            self.past[index],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Hypotheses about tracks that have competed for measurements.

    ``leaf`` (H, T): the leaf of each of T tracks in each of H hypotheses, −1: there is no such
    track in it. ``weight`` (H,): their probabilities, falling, of sum 1.
    """

    leaf: I8
    weight: F8


@dataclass(frozen=True, slots=True, eq=False)
class Hypotheses:
    """The state of filters with global hypotheses, of the PMBM and of the MHT.

    Attributes
    ----------
    layers : nodes of the last frames, oldest first; those of the present are the leaves.
    lone : (n,) leaves of tracks that compete with no other and have one form.
    clusters : the other tracks.
    next_label : the label of the next new track.
    undetected : intensity of targets that have never been detected; always empty in an MHT.
    steps : of each layer the interval before it, in the model's time unit, and the camera's motion
        (3, 3) in it.
    pasts : what the leaves have seen of their targets.
    """

    layers: tuple[Nodes, ...]
    lone: I8
    clusters: tuple[Cluster, ...]
    next_label: int
    undetected: GaussianMixture
    steps: tuple[tuple[float, F8], ...]
    pasts: Pasts = NO_PASTS

    def __len__(self) -> int:
        """Number of leaves."""
        return len(self.leaves)

    @property
    def leaves(self) -> Nodes:
        """The nodes of the present."""
        return self.layers[-1]

    @property
    def probability(self) -> F8:
        """(L,) probability that each leaf's history is true."""
        held = np.concatenate([self.lone, *(c.leaf.ravel() for c in self.clusters)])
        weight = np.concatenate(
            [
                np.ones(len(self.lone)),
                *(np.repeat(c.weight, c.leaf.shape[1]) for c in self.clusters),
            ]
        )
        # The first place is for what a hypothesis does not hold.
        return sum_by(held + 1, weight, len(self) + 1)[1:]

    @property
    def mass(self) -> float:
        """The expected number of targets, over all hypotheses."""
        return float(self.probability @ self.leaves.r)

    def best(self) -> I8:
        """(n,) leaves of the most probable hypothesis, by label."""
        leaves = np.concatenate([self.lone, *(cluster.leaf[0] for cluster in self.clusters)])
        leaves = leaves[leaves >= 0]
        return np.asarray(leaves[np.argsort(self.leaves.label[leaves])])


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Terms of the log-weights of hypotheses.

    Attributes
    ----------
    leaf, measurement : (P,) pairs within the gate.
    gain : (P,) log r p_D q(z) − log(1 − r p_D): the leaf's detection by the measurement against its
        being missed.
    missed : (L,) log(1 − r p_D).
    unassigned : (N,) log(κ + λ̂): a false alarm or a new target.
    p_new : (N,) λ̂/(κ + λ̂).
    """

    leaf: I8
    measurement: I8
    gain: F8
    missed: F8
    unassigned: F8
    p_new: F8


@dataclass(frozen=True, slots=True)
class Limits:
    """Hypotheses per cluster, their least weight as a share of the best's, least probability that a
    target exists.
    """

    max_hypotheses: int
    hypothesis_threshold: float
    existence_threshold: float


@dataclass(frozen=True, slots=True, eq=False)
class Branches:
    """The hypotheses of the next frame, made of branches: a leaf and the measurement that it took.

    A branch has the number (leaf + 1)(N + 1) + measurement + 1, where −1 stands for a new track and
    for a miss. ``lone`` (n,), ``clusters``: as in `Hypotheses`, with branches for leaves.
    ``unassigned`` (N,): the probability that each measurement is no earlier track's.
    """

    lone: I8
    clusters: tuple[Cluster, ...]
    unassigned: F8


def before(nodes: Nodes, index: I8) -> I8:
    """(n,) where the parents of nodes at ``index`` (n,) are in the frame before; −1 if the track
    began or index is −1.
    """
    if len(nodes):
        return np.where(index >= 0, nodes.parent[index], -1)
    return np.full(len(index), -1)


def branched(state: Hypotheses, scores: Scores, limits: Limits) -> Branches:
    """The hypotheses that follow from the measurements; clusters that share one become one.

    Parameters
    ----------
    state : predicted.
    scores, limits : of the frame, and how much is kept.
    """
    lone = len(state.lone)
    count = len(scores.unassigned)
    many = lone + len(state.clusters)
    cluster_of = np.zeros(len(state), np.int64)
    cluster_of[state.lone] = np.arange(lone)
    for c, cluster in enumerate(state.clusters, start=lone):
        cluster_of[cluster.leaf[cluster.leaf >= 0]] = c
    part = components(many + count, cluster_of[scores.leaf], many + scores.measurement)
    joint = np.unique(part[cluster_of[scores.leaf]])
    apart = ~np.isin(part, joint)
    left = state.lone[apart[:lone]]
    free = np.flatnonzero(apart[many:] & (scores.p_new >= limits.existence_threshold))
    out = [_missed(state.clusters[c], scores, limits) for c in np.flatnonzero(apart[lone:many])]
    unassigned = np.ones(count)
    begins = scores.p_new >= limits.existence_threshold
    members = _lists(part[:many], joint)
    measured = _lists(part[many:], joint)
    for clusters, pairs, columns in zip(
        members, _lists(part[cluster_of[scores.leaf]], joint), measured, strict=True
    ):
        alone = state.lone[clusters[clusters < lone]]
        parts = [state.clusters[c - lone] for c in clusters if c >= lone]
        size = len(columns) * (len(pairs) + len(alone) + sum(one.leaf.shape[1] for one in parts))
        fewer = replace(limits, max_hypotheses=max(1, min(limits.max_hypotheses, int(WORK / size))))
        most = fewer.max_hypotheses, math.log(limits.hypothesis_threshold)
        whole = _product([Cluster(alone[None], np.ones(1)), *parts] if len(alone) else parts, fewer)
        leaf, weight, unassigned[columns] = children(
            whole.leaf,
            whole.weight,
            (scores.leaf[pairs], scores.measurement[pairs], scores.gain[pairs]),
            columns,
            scores.missed,
            scores.unassigned,
            begins,
            most,
        )
        out.append(Cluster(leaf, weight))
    return Branches(
        np.concatenate([_numbers(left, np.full(len(left), -1), count), free + 1]),
        tuple(out),
        unassigned,
    )


def _lists(part: I8, wanted: I8) -> list[I8]:
    """The places that are in each wanted part."""
    order = np.argsort(part, kind="stable")
    low = np.searchsorted(part[order], wanted)
    high = np.searchsorted(part[order], wanted, side="right")
    return [order[a:b] for a, b in zip(low, high, strict=True)]


def _numbers(leaf: I8, measurement: I8, count: int) -> I8:
    """The branches' numbers; −1 if there is no leaf."""
    return np.where(leaf >= 0, (leaf + 1) * (count + 1) + measurement + 1, -1)


def _product(clusters: list[Cluster], limits: Limits) -> Cluster:
    """One cluster of all: every choice of a hypothesis from each, the most probable first."""
    whole = clusters[0]
    for other in clusters[1:]:
        a = len(whole.weight)
        b = len(other.weight)
        # Both fall: the product of the i-th and the j-th has i·j − 1 others before it.
        first, second = np.nonzero(
            np.arange(1, a + 1)[:, None] * np.arange(1, b + 1) <= limits.max_hypotheses
        )
        weight = whole.weight[first] * other.weight[second]
        kept = _best(weight, limits)
        leaf = np.hstack([whole.leaf[first[kept]], other.leaf[second[kept]]])
        whole = Cluster(leaf, weight[kept] / weight[kept].sum())
    return whole


def _best(weight: F8, limits: Limits) -> I8:
    """Which hypotheses are kept, the most probable first."""
    order = np.argsort(-weight, kind="stable")[: limits.max_hypotheses]
    return np.asarray(order[weight[order] >= limits.hypothesis_threshold * weight[order[0]]])


def _missed(cluster: Cluster, scores: Scores, limits: Limits) -> Cluster:
    """A cluster with no measurement inside the gates of its tracks."""
    log_weight = np.where(cluster.leaf >= 0, scores.missed[cluster.leaf], 0.0).sum(axis=1)
    weight = cluster.weight * np.exp(log_weight - log_weight.max())
    kept = _best(weight, limits)
    leaf = _numbers(cluster.leaf[kept], np.full(1, -1), len(scores.unassigned))
    return Cluster(leaf, weight[kept] / weight[kept].sum())


def decided(state: Hypotheses) -> Hypotheses:
    """Keep the hypotheses of each cluster that agree with the best about the oldest layer (N-scan
    pruning).

    Of every track they hold the node that it holds there, or none any more: a hypothesis without a
    track says nothing of where it was. A node of a track that the best has not is one that the best
    denies, and its hypotheses go.
    """
    root = np.arange(len(state))
    for nodes in state.layers[:0:-1]:
        root = before(nodes, root)
    clusters = []
    for cluster in state.clusters:
        held = np.where(cluster.leaf >= 0, root[cluster.leaf], -1)
        agree = ((held < 0) | (held == held[0])).all(axis=1)
        clusters.append(
            cluster if agree.all() else _cluster(cluster.leaf[agree], cluster.weight[agree])
        )
    return replace(state, clusters=tuple(clusters))


def ended(state: Hypotheses, existence_threshold: float) -> Hypotheses:
    """Targets below the threshold do not exist; when their last detection is too old, they are
    forgotten.

    Until then they remain as leaves: they keep their measurements, and the past that is reported
    shows them, except those that were never probable.
    """
    leaves = state.leaves
    nodes = replace(leaves, r=np.where(leaves.r >= existence_threshold, leaves.r, 0.0))
    over = np.flatnonzero(nodes.r == 0)
    believed = np.zeros(len(over))
    at = over
    for then in reversed(state.layers):
        known = at >= 0
        believed[known] = np.maximum(believed[known], then.r[at[known]])
        at = before(then, at)
    gone = np.zeros(len(nodes), np.bool_)
    gone[over] = (nodes.missed[over] >= len(state.layers)) | (believed < BELIEVED)
    clusters = []
    for cluster in state.clusters:
        lost = (cluster.leaf >= 0) & gone[cluster.leaf]
        clusters.append(
            _summed(np.where(lost, -1, cluster.leaf), cluster.weight) if lost.any() else cluster
        )
    return replace(
        state,
        layers=(*state.layers[:-1], nodes),
        lone=state.lone[~gone[state.lone]],
        clusters=tuple(clusters),
    )


def _cluster(leaf: I8, weight: F8) -> Cluster:
    """A cluster without tracks that no hypothesis has."""
    return Cluster(np.ascontiguousarray(leaf[:, (leaf >= 0).any(axis=0)]), weight / weight.sum())


def _summed(leaf: I8, weight: F8) -> Cluster:
    """A cluster in which equal hypotheses are one, the most probable first."""
    if leaf.shape[1] == 0:
        return Cluster(leaf[:1], np.ones(1))
    first = equal_rows(np.ascontiguousarray(leaf))
    total = sum_by(first, weight, len(leaf))
    kept = np.flatnonzero(first == np.arange(len(leaf)))
    kept = kept[np.argsort(-total[kept], kind="stable")]
    return _cluster(leaf[kept], total[kept])


def parted(state: Hypotheses) -> Hypotheses:
    """Clusters divided where tracks have not competed for any measurement of the window: what is
    left is independent.

    The probability of a part of a hypothesis is the sum over all that have it.
    """
    lone = [state.lone]
    clusters = []
    if any(c.leaf.shape[1] > 1 and len(c.weight) > 1 for c in state.clusters):
        trace = _trace(state)
    else:
        trace = None
    for cluster in state.clusters:
        parts = [cluster]
        if trace is not None and cluster.leaf.shape[1] > 1 and len(cluster.weight) > 1:
            part = competing(cluster.leaf, *trace)
            if part.max() > 0:
                parts = [
                    _summed(cluster.leaf[:, part == k], cluster.weight)
                    for k in range(int(part.max()) + 1)
                ]
        for one in parts:
            if len(one.weight) > 1:
                clusters.append(one)
            else:
                lone.append(one.leaf[0][one.leaf[0] >= 0])
    return replace(state, lone=np.concatenate(lone), clusters=tuple(clusters))


def _trace(state: Hypotheses) -> tuple[I8, int]:
    """(L, W) the measurement that each leaf's history rests on in each frame, −1: none; and a
    number above all of them.
    """
    out = np.full((len(state), len(state.layers)), -1)
    at = np.arange(len(state))
    for k, nodes in enumerate(reversed(state.layers)):
        known = at >= 0
        out[known, k] = nodes.detection[at[known]]
        at = before(nodes, at)
    return out, int(out.max(initial=-1)) + 1


def compact(state: Hypotheses) -> Hypotheses:
    """Without leaves that no hypothesis has, and earlier nodes without descendants where they are
    the greater part.
    """
    used = np.zeros(len(state), np.bool_)
    used[state.lone] = True
    for cluster in state.clusters:
        used[cluster.leaf[cluster.leaf >= 0]] = True
    number = np.append(np.where(used, np.cumsum(used) - 1, -1), -1)
    nodes = state.leaves.select(used)
    layers = []
    for earlier in state.layers[-2::-1]:
        reached = np.zeros(len(earlier), np.bool_)
        reached[nodes.parent[nodes.parent >= 0]] = True
        if 2 * np.count_nonzero(reached) < len(earlier):
            place = np.append(np.cumsum(reached) - 1, -1)
            nodes = replace(nodes, parent=place[nodes.parent])
            earlier = earlier.select(reached)
        layers.append(nodes)
        nodes = earlier
    # Parents of the oldest layer are forgotten.
    layers.append(replace(nodes, parent=np.full(len(nodes), -1)))
    clusters = tuple(Cluster(number[c.leaf], c.weight) for c in state.clusters)
    return replace(state, layers=tuple(layers[::-1]), lone=number[state.lone], clusters=clusters)
