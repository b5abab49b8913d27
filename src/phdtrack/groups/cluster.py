"""From the intensity to groups: connected components in position and velocity [E13 §4.3].

Components of the mixture above a weight are the nodes of a graph. Two are connected when they are closer than T_p and move
relative to each other slower than T_v; a group is a connected component, and its head count the sum of its weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.checks import NonNegative, Positive, check
from phdtrack.kernels.gating import gated_pairs
from phdtrack.types import F8, I8, GaussianMixture

# Rows of a state on the ground.
POSITION, VELOCITY = slice(0, 2), slice(2, 4)


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """The groups of one frame, in the order of their first component.

    Attributes
    ----------
    label : (J,) the group of each component, −1 where the component is too light to count.
    count : (G,) expected number of people, Σ w.
    deviation : (G,) standard deviation of that number.
    mean : (4, G) centre in metres and velocity in metres per second, averaged by weight.
    covariance : (G, 4, 4) of a member about the centre: the components' own and that of their means.
    """

    label: I8
    count: F8
    deviation: F8
    mean: F8
    covariance: F8

    def __len__(self) -> int:
        return len(self.count)


@dataclass(frozen=True, slots=True)
class Grouping:
    """What makes components a group.

    Parameters
    ----------
    near : T_p, metres: connected components are closer.
    slow : T_v, metres per second: and slower apart.
    lightest : components of less weight do not count. No paper gives it. It must lie below p_M·p_S = 0.297 (E13's values),
        the weight of a person missed once, or one miss drops a person.
    """

    near: Positive = 2.0
    slow: Positive = 1.0
    lightest: NonNegative = 0.25

    def __post_init__(self) -> None:
        check(self)

    def groups(self, mixture: GaussianMixture) -> Groups:
        """The groups of a mixture over (px, py, vx, vy): connected components of the graph [E13 §4.3]."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        heavy = np.flatnonzero(mixture.weight >= self.lightest)
        a, b = self.connected(mixture.mean[:, heavy])
        n = len(heavy)
        graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(n, n))
        number, of_heavy = connected_components(graph, directed=False) if n else (0, np.zeros(0, np.int64))
        label = np.full(len(mixture), -1, np.int64)
        label[heavy] = of_heavy
        return summarised(mixture, label, int(number))

    def connected(self, mean: F8) -> tuple[I8, I8]:
        """Pairs (i, j), i < j, of columns of (4, n) states that are near and slow apart. Linear in n through a grid."""
        position = np.ascontiguousarray(mean[POSITION])
        a, b = gated_pairs(position[0], position[1], position - self.near, position + self.near)
        a, b = a[a < b], b[a < b]
        apart2 = ((mean[:, a] - mean[:, b]) ** 2).reshape(2, 2, -1).sum(1)
        joined = (apart2[0] < self.near**2) & (apart2[1] < self.slow**2)
        return a[joined], b[joined]


def summarised(mixture: GaussianMixture, label: I8, number: int) -> Groups:
    """The ``number`` groups that ``label`` (J,) makes of the mixture's components.

    A component of weight w is taken for a person who is there with probability w, independent of the others, and one above 1
    for its whole part of people and one more with the rest: the variance of the number is Σ r(1 − r), r the part behind the
    point. (A Poisson point process, as which the filter treats the posterior, would have Σ w.)
    """
    used = label >= 0
    of, weight = label[used], mixture.weight[used]
    mean, cov = mixture.mean[:4, used], mixture.covariance[used][:, :4, :4]
    count: F8 = np.bincount(of, weight, number).astype(np.float64)
    part = weight - np.floor(weight)
    deviation = np.sqrt(np.bincount(of, part * (1 - part), number))
    share = weight / count[of]
    centre = np.zeros((4, number))
    np.add.at(centre.T, of, (share * mean).T)
    off = (mean - centre[:, of]).T
    spread = np.zeros((number, 4, 4))
    np.add.at(spread, of, share[:, None, None] * (cov + off[:, :, None] * off[:, None, :]))
    return Groups(label, count, deviation, centre, spread)
