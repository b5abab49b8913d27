"""Groups as clusters of the intensity's components [E13 §5].

Components of the mixture above a weight are the nodes of a graph. Two are connected if they are
closer than T_p and their relative speed is below T_v. A group is a connected component of the
graph, and its head count is the sum of the weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import Checked, NonNegative, Positive
from phdtrack.kernels.association import components
from phdtrack.kernels.grid import points_in_rectangles
from phdtrack.types import F8, I8, GaussianMixture


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """The groups of one frame, in the order of their first component.

    Attributes
    ----------
    label : (J,) the group of each component, −1 for components that are too light.
    count : (G,) expected number of people, Σ w.
    deviation : (G,) standard deviation of that number.
    mean : (4, G) weighted mean of the positions in metres and velocities in metres per second.
    covariance : (G, 4, 4) of a member about that mean: of the components and between them.
    """

    label: I8
    count: F8
    deviation: F8
    mean: F8
    covariance: F8


@dataclass(frozen=True, slots=True)
class Grouping(Checked):
    """The thresholds that make components a group.

    Parameters
    ----------
    max_distance : T_p, metres: connected components are closer.
    max_speed_difference : T_v, metres per second: their relative speed is lower.
    min_weight : lighter components are ignored. No paper states it. It must be below
        p_M·p_S = 0.297 (E13's values), the weight of a person after one missed detection;
        otherwise one miss removes a person from the group.
    """

    max_distance: Positive = 2.0
    max_speed_difference: Positive = 1.0
    min_weight: NonNegative = 0.25

    def groups(self, mixture: GaussianMixture) -> Groups:
        """The groups of a mixture over (px, py, vx, vy): connected components of the graph [E13
        §5].
        """
        heavy = np.flatnonzero(mixture.weight >= self.min_weight)
        a, b = self.connected(mixture.mean[:, heavy])
        label = np.full(len(mixture), -1, np.int64)
        label[heavy] = components(len(heavy), a, b)
        return group_moments(mixture, label)

    def connected(self, mean: F8) -> tuple[I8, I8]:
        """Pairs (i, j), i < j, of columns of (4, n) states that are connected. A grid makes the
        search linear in n.
        """
        position = np.ascontiguousarray(mean[:2])
        a, b = points_in_rectangles(
            position, position - self.max_distance, position + self.max_distance
        )
        once = a < b
        a = a[once]
        b = b[once]
        squared = ((mean[:, a] - mean[:, b]) ** 2).reshape(2, 2, -1).sum(1)
        joined = (squared[0] < self.max_distance**2) & (squared[1] < self.max_speed_difference**2)
        return a[joined], b[joined]


def group_moments(mixture: GaussianMixture, label: I8) -> Groups:
    """The groups of the components of a mixture over (px, py, vx, vy) with the labels (J,), from 0,
    −1 for none.

    A component of weight w counts as a person with existence probability w, independent of the
    others; one above 1 as its integer part of people and one more with the fractional part r. So
    the variance of the number is Σ r(1 − r). (A Poisson point process, which the filter assumes for
    the posterior, would have Σ w.)
    """
    used = label >= 0
    number = int(label.max(initial=-1)) + 1
    group = label[used]
    weight = mixture.weight[used]
    mean = mixture.mean[:4, used]
    cov = mixture.covariance[used][:, :4, :4]
    count: F8 = np.bincount(group, weight, number).astype(np.float64)
    fraction = weight - np.floor(weight)
    deviation = np.sqrt(np.bincount(group, fraction * (1 - fraction), number))
    share = weight / count[group]
    centre = np.zeros((4, number))
    spread = np.zeros((number, 4, 4))
    np.add.at(centre.T, group, (share * mean).T)
    offset = (mean - centre[:, group]).T
    outer = offset[:, :, None] * offset[:, None, :]
    np.add.at(spread, group, share[:, None, None] * (cov + outer))
    return Groups(label, count, deviation, centre, spread)
