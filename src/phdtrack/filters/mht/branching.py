"""From the hypotheses of one frame to those of the next: clusters meet, and measurements are assigned in the k best ways."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import sum_by
from phdtrack.filters.hypotheses import Cluster, Hypotheses
from phdtrack.filters.mht.scores import Scores
from phdtrack.kernels.linkage import components
from phdtrack.kernels.murty import best_assignments
from phdtrack.types import F8, I8


@dataclass(frozen=True, slots=True)
class Limits:
    """Hypotheses per cluster, their least weight as a share of the best's, least probability that a target is there."""

    most: int
    ratio: float
    least: float


@dataclass(frozen=True, slots=True, eq=False)
class Branches:
    """The hypotheses of the next frame, made of branches: a leaf and the measurement that it took.

    A branch has the number (leaf + 1)(N + 1) + measurement + 1, where −1 stands for a new track and for a miss. ``alone``
    (n,), ``clusters``: as in `Hypotheses`, with branches for leaves. ``own`` (N,): the probability that each measurement is
    no earlier track's.
    """

    alone: I8
    clusters: tuple[Cluster, ...]
    own: F8


def branched(state: Hypotheses, scores: Scores, limits: Limits) -> Branches:
    """The hypotheses that follow from ``state``, predicted, and the measurements."""
    lone, count = len(state.alone), len(scores.alone)
    many = lone + len(state.clusters)
    cluster_of = np.zeros(len(state), np.int64)
    cluster_of[state.alone] = np.arange(lone)
    for c, cluster in enumerate(state.clusters, start=lone):
        cluster_of[cluster.leaf[cluster.leaf >= 0]] = c
    part = components(many + count, cluster_of[scores.leaf], many + scores.which)
    meeting = np.unique(part[cluster_of[scores.leaf]])
    apart = ~np.isin(part, meeting)
    left = state.alone[apart[:lone]]
    free = np.flatnonzero(apart[many:] & (scores.new >= limits.least))
    alone = np.concatenate([_numbers(left, np.full(len(left), -1), count), free + 1])
    out = [_missed(state.clusters[c], scores, limits, count) for c in np.flatnonzero(apart[lone:many])]
    own = np.ones(count)
    members, measured = _lists(part[:many], meeting), _lists(part[many:], meeting)
    of_pair = _lists(part[cluster_of[scores.leaf]], meeting)
    for meet, pairs, columns in zip(members, of_pair, measured, strict=True):
        joint = _product([_single(state.alone[c]) if c < lone else state.clusters[c - lone] for c in meet], limits)
        child, own[columns] = _assigned(joint, pairs, columns, scores, limits)
        out.append(child)
    return Branches(alone, tuple(out), own)


def _single(leaf: np.int64) -> Cluster:
    """A track of which there is nothing else to believe."""
    return Cluster(np.array([[leaf]]), np.ones(1))


def _lists(part: I8, wanted: I8) -> list[I8]:
    """Of each wanted part the places that are in it."""
    order = np.argsort(part, kind="stable")
    low, high = np.searchsorted(part[order], wanted), np.searchsorted(part[order], wanted, side="right")
    return [order[a:b] for a, b in zip(low, high, strict=True)]


def _numbers(leaf: I8, measurement: I8, count: int) -> I8:
    """The branches' numbers; −1 where there is no leaf."""
    return np.where(leaf >= 0, (leaf + 1) * (count + 1) + measurement + 1, -1)


def _product(clusters: list[Cluster], limits: Limits) -> Cluster:
    """One cluster of all: every choice of a hypothesis from each, the most probable first."""
    whole = clusters[0]
    for other in clusters[1:]:
        a, b = len(whole.weight), len(other.weight)
        # Both fall: the product of the i-th and the j-th has i·j − 1 others before it.
        first, second = np.nonzero(np.arange(1, a + 1)[:, None] * np.arange(1, b + 1) <= limits.most)
        weight = whole.weight[first] * other.weight[second]
        kept = _best(weight, limits)
        leaf = np.hstack([whole.leaf[first[kept]], other.leaf[second[kept]]])
        whole = Cluster(leaf, weight[kept] / weight[kept].sum())
    return whole


def _best(weight: F8, limits: Limits) -> I8:
    """Which hypotheses are kept, the most probable first."""
    order = np.argsort(-weight, kind="stable")[: limits.most]
    out: I8 = order[weight[order] >= limits.ratio * weight[order[0]]]
    return out


def _weights(leaf: I8, missed: F8) -> F8:
    """(H,) log-weights of all tracks being missed."""
    out: F8 = np.where(leaf >= 0, missed[leaf], 0.0).sum(axis=1)
    return out


def _missed(cluster: Cluster, scores: Scores, limits: Limits, count: int) -> Cluster:
    """A cluster none of whose tracks a measurement is near."""
    log_weight = _weights(cluster.leaf, scores.missed)
    weight = cluster.weight * np.exp(log_weight - log_weight.max())
    kept = _best(weight, limits)
    return Cluster(_numbers(cluster.leaf[kept], np.full(1, -1), count), weight[kept] / weight[kept].sum())


def _assigned(cluster: Cluster, pairs: I8, columns: I8, scores: Scores, limits: Limits) -> tuple[Cluster, F8]:
    """The children of a cluster's hypotheses, given the measurements ``columns`` (M,) that meet it, and `Branches.own`."""
    m, count = len(columns), len(scores.alone)
    leaves, form = np.unique(scores.leaf[pairs], return_inverse=True)
    gain = np.full((m, len(leaves)), -np.inf)
    gain[np.searchsorted(columns, scores.which[pairs]), form] = scores.gain[pairs] - scores.alone[scores.which[pairs]]
    place = np.searchsorted(leaves, cluster.leaf)
    known = (place < len(leaves)) & (leaves[np.minimum(place, len(leaves) - 1)] == cluster.leaf)
    held = np.where(known, place, -1)
    base = np.log(cluster.weight) + _weights(cluster.leaf, scores.missed)
    reached = known.any(axis=0)
    parent, choice, log_weight = best_assignments(
        gain, scores.alone[columns], np.ascontiguousarray(held[:, reached]), base, limits.most, math.log(limits.ratio)
    )
    weight = np.exp(log_weight - log_weight[0])
    weight /= weight.sum()
    taken = np.full((len(parent), held.shape[1]), -1)
    track = np.empty(len(leaves), np.int64)
    track[held[known]] = np.nonzero(known)[1]
    rows, place = np.nonzero(choice >= 0)
    taken[rows, track[choice[rows, place]]] = columns[place]
    new = np.where((choice < 0) & (scores.new[columns] >= limits.least), columns + 1, -1)
    leaf = np.hstack([_numbers(cluster.leaf[parent], taken, count), new])
    own = sum_by(np.nonzero(choice < 0)[1], np.broadcast_to(weight[:, None], choice.shape)[choice < 0], m)
    return Cluster(leaf[:, (leaf >= 0).any(axis=0)], weight), own
