"""What keeps the trees small: decisions N frames back, tracks that have ended, clusters that fall apart, unused nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.arrays import sum_by
from phdtrack.filters.hypotheses import Cluster, Hypotheses, Nodes, before
from phdtrack.kernels.linkage import competing
from phdtrack.types import F8, I8, Bool


def decided(state: Hypotheses) -> Hypotheses:
    """Of each cluster the hypotheses that agree with the best about the oldest layer (N-scan pruning).

    Of every track they hold the node that it holds there, or none any more: a hypothesis without a track says nothing of
    where it was. A node of a track that the best has not is one that the best denies, and its hypotheses go.
    """
    root = np.arange(len(state))
    for nodes in state.layers[:0:-1]:
        root = before(nodes, root)
    clusters = []
    for cluster in state.clusters:
        held = np.where(cluster.leaf >= 0, root[cluster.leaf], -1)
        agree = ((held < 0) | (held == held[0])).all(axis=1)
        clusters.append(cluster if agree.all() else _cluster(cluster.leaf[agree], cluster.weight[agree]))
    return replace(state, clusters=tuple(clusters))


def ended(state: Hypotheses, least: float) -> Hypotheses:
    """Targets that are there with less probability than ``least`` are not; when their last detection is too old, forgotten.

    Until then they remain as leaves: what they took, others have not taken, and the past that is told shows them.
    """
    leaves = state.leaves
    nodes = replace(leaves, exist=np.where(leaves.exist >= least, leaves.exist, 0.0))
    gone = (nodes.exist == 0) & (nodes.since >= len(state.layers))
    clusters = tuple(_without(cluster, gone) for cluster in state.clusters)
    return Hypotheses((*state.layers[:-1], nodes), state.alone[~gone[state.alone]], clusters, state.fresh)


def _without(cluster: Cluster, gone: Bool) -> Cluster:
    lost = (cluster.leaf >= 0) & gone[cluster.leaf]
    return _summed(np.where(lost, -1, cluster.leaf), cluster.weight) if lost.any() else cluster


def _cluster(leaf: I8, weight: F8) -> Cluster:
    """A cluster without tracks that no hypothesis has."""
    return Cluster(np.ascontiguousarray(leaf[:, (leaf >= 0).any(axis=0)]), weight / weight.sum())


def _summed(leaf: I8, weight: F8) -> Cluster:
    """A cluster in which equal hypotheses are one, the most probable first."""
    if leaf.shape[1] == 0:
        return Cluster(leaf[:1], np.ones(1))
    # A few short rows: a dictionary is faster than a sort.
    number: dict[tuple[int, ...], int] = {}
    which = np.array([number.setdefault(tuple(row), len(number)) for row in leaf.tolist()])
    total = sum_by(which, weight, len(number))
    order = np.argsort(-total, kind="stable")
    return _cluster(np.array(list(number))[order], total[order])


def parted(state: Hypotheses) -> Hypotheses:
    """Clusters divided where tracks have not competed for any measurement of the window: what is left is independent.

    The probability of a part of a hypothesis is the sum over all that have it.
    """
    alone, clusters = [state.alone], []
    trace = _trace(state) if any(c.leaf.shape[1] > 1 and len(c.weight) > 1 for c in state.clusters) else None
    for cluster in state.clusters:
        hypotheses, tracks = cluster.leaf.shape
        if hypotheses == 1:
            alone.append(cluster.leaf[0])
        elif tracks == 1 or trace is None:
            clusters.append(cluster)
        else:
            part = competing(cluster.leaf, *trace)
            for number in range(int(part.max()) + 1):
                one = cluster if part.max() == 0 else _summed(cluster.leaf[:, part == number], cluster.weight)
                if one.leaf.shape[0] == 1:
                    alone.append(one.leaf[0])
                else:
                    clusters.append(one)
    return replace(state, alone=np.concatenate(alone), clusters=tuple(clusters))


def _trace(state: Hypotheses) -> tuple[I8, int]:
    """(L, W) the measurement that each leaf's history rests on in each frame, −1: none; and a number above all of them."""
    out = np.full((len(state), len(state.layers)), -1)
    at = np.arange(len(state))
    for k, nodes in enumerate(reversed(state.layers)):
        known = at >= 0
        out[known, k] = nodes.detection[at[known]]
        at = before(nodes, at)
    return out, int(out.max(initial=-1)) + 1


def compact(state: Hypotheses) -> Hypotheses:
    """Without leaves that no hypothesis has, and earlier nodes without descendants where they are the greater part."""
    used = np.zeros(len(state), np.bool_)
    used[state.alone] = True
    for cluster in state.clusters:
        used[cluster.leaf[cluster.leaf >= 0]] = True
    number = np.where(used, np.cumsum(used) - 1, -1)
    nodes, layers = state.leaves.take(used), []
    for earlier in state.layers[-2::-1]:
        reached = np.zeros(len(earlier), np.bool_)
        reached[nodes.parent[nodes.parent >= 0]] = True
        if 2 * np.count_nonzero(reached) < len(earlier):
            place = np.append(np.cumsum(reached) - 1, -1)
            nodes = replace(nodes, parent=place[nodes.parent])
            earlier = earlier.take(reached)
        layers.append(nodes)
        nodes = earlier
    layers.append(_rootless(nodes))
    clusters = tuple(Cluster(np.append(number, -1)[c.leaf], c.weight) for c in state.clusters)
    return Hypotheses(tuple(layers[::-1]), number[state.alone], clusters, state.fresh)


def _rootless(nodes: Nodes) -> Nodes:
    """The oldest layer, whose parents nobody remembers."""
    return replace(nodes, parent=np.full(len(nodes), -1)) if (nodes.parent >= 0).any() else nodes
