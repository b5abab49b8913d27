"""What a filter of multiple hypotheses carries from frame to frame, and the extraction reads: trees of targets' states.

A track begins with a measurement and branches wherever it may have gone on in more than one way. The nodes of all tracks'
trees stand in layers, one for each of the last frames; the leaves are the last layer. A hypothesis says of every track of a
cluster which leaf is true, or that there is none. Clusters are independent of each other, so that a hypothesis of everything
is any choice of one from each, and its probability the product. Most clusters are one track with one leaf: those are
``alone``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import sum_by
from phdtrack.types import F8, I8, Bool, GaussianMixture


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """One frame's states of all tracks in all forms.

    Attributes
    ----------
    mean : (d, L).      covariance : (L, d, d).
    exist : (L,) probability that the target is there, if the measurements of its history are its own.
    detection : (L,) measurement of the frame that it took, −1: none.
    parent : (L,) its node in the frame before; −1 where the track begins.
    label : (L,) the track's number, from 0, none given twice.
    since : (L,) frames since it last took a measurement.
    """

    mean: F8
    covariance: F8
    exist: F8
    detection: I8
    parent: I8
    label: I8
    since: I8

    def __len__(self) -> int:
        return len(self.exist)

    def take(self, index: I8 | Bool) -> Nodes:
        """The nodes at ``index`` (integers or a mask), in that order."""
        return Nodes(
            np.ascontiguousarray(self.mean[:, index]),
            self.covariance[index],
            self.exist[index],
            self.detection[index],
            self.parent[index],
            self.label[index],
            self.since[index],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Hypotheses about tracks that have competed for measurements.

    ``leaf`` (H, T): the leaf of each of T tracks in each of H hypotheses, −1: there is no such track in it. ``weight`` (H,):
    their probabilities, falling, of sum 1.
    """

    leaf: I8
    weight: F8


@dataclass(frozen=True, slots=True, eq=False)
class Hypotheses:
    """The state of a filter of multiple hypotheses.

    Attributes
    ----------
    layers : nodes of the last frames, oldest first; those of the present are the leaves.
    alone : (n,) leaves of tracks of which there is nothing else to believe.
    clusters : the other tracks.
    fresh : the label that the next new track is given.
    """

    layers: tuple[Nodes, ...]
    alone: I8
    clusters: tuple[Cluster, ...]
    fresh: int

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
        held = np.concatenate([self.alone, *(c.leaf.ravel() for c in self.clusters)])
        weight = np.concatenate([np.ones(len(self.alone)), *(np.repeat(c.weight, c.leaf.shape[1]) for c in self.clusters)])
        # The first place is for what a hypothesis does not hold.
        return sum_by(held + 1, weight, len(self) + 1)[1:]

    @property
    def mass(self) -> float:
        """The expected number of targets, over all hypotheses."""
        return float(self.probability @ self.leaves.exist)

    def best(self) -> I8:
        """(n,) leaves of the most probable hypothesis, by label."""
        held = [self.alone, *(cluster.leaf[0] for cluster in self.clusters)]
        leaves = np.concatenate(held)
        leaves = leaves[leaves >= 0]
        out: I8 = leaves[np.argsort(self.leaves.label[leaves])]
        return out

    def mixture(self) -> GaussianMixture:
        """The intensity: every leaf weighed with the probability that it is true and its target there."""
        weight = self.probability * self.leaves.exist
        there = np.flatnonzero(weight > 0)
        leaves = self.leaves.take(there)
        return GaussianMixture(weight[there], leaves.mean, leaves.covariance, leaves.label, self.fresh)


def before(nodes: Nodes, index: I8) -> I8:
    """(n,) where the parents of nodes at ``index`` (n,) are in the frame before; −1 where the track began or index is −1."""
    return np.where(index >= 0, nodes.parent[index], -1) if len(nodes) else np.full(len(index), -1)
