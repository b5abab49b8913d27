"""From the intensity to groups and their shapes [E13 §5].

Components of the mixture above a weight are the nodes of a graph. Two are connected when they are
closer than T_p and move relative to each other slower than T_v; a group is a connected component,
and its head count the sum of its weights. Its shape is the level curve of its position intensity,
velocity integrated out:

    v(p) = Σ_i w_i N(p; m_i, P_i)  over position alone,   contour = {p : v(p) = level}

At E13's level of 0.1 people per square metre one person has a contour while w/(2π√|P|) exceeds it,
and none where the position is less certain than that; a loose group may have several.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.errors import Checked, NonNegative, Positive
from phdtrack.kernels.association import components
from phdtrack.kernels.grid import points_in_rectangles
from phdtrack.types import F8, I8, Bool, GaussianMixture

# T_v, metres per second: people of a group are slower apart [E13 §5].
MAX_SPEED_DIFFERENCE = 1.0
# Points of the contours' grid along each side at most: a group that is wider than it is sharp gets
# a coarser grid.
MAX_GRID = 160


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """The groups of one frame, in the order of their first component.

    Attributes
    ----------
    label : (J,) the group of each component, −1 where the component is too light to count.
    count : (G,) expected number of people, Σ w.
    deviation : (G,) standard deviation of that number.
    mean : (4, G) centre in metres and velocity in metres per second, averaged by weight.
    covariance : (G, 4, 4) of a member about the centre: the components' own and that of their
        means.
    """

    label: I8
    count: F8
    deviation: F8
    mean: F8
    covariance: F8


@dataclass(frozen=True, slots=True)
class Grouping(Checked):
    """What makes components a group.

    Parameters
    ----------
    max_distance : T_p, metres: connected components are closer.
    min_weight : components of less weight do not count. No paper gives it. It must lie below
        p_M·p_S = 0.297 (E13's values), the weight of a person missed once, or one miss drops a
        person.
    """

    max_distance: Positive = 2.0
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
        """Pairs (i, j), i < j, of columns of (4, n) states that are near and slow apart. Linear in
        n through a grid.
        """
        position = np.ascontiguousarray(mean[:2])
        a, b = points_in_rectangles(
            position, position - self.max_distance, position + self.max_distance
        )
        a, b = a[a < b], b[a < b]
        apart2 = ((mean[:, a] - mean[:, b]) ** 2).reshape(2, 2, -1).sum(1)
        joined = (apart2[0] < self.max_distance**2) & (apart2[1] < MAX_SPEED_DIFFERENCE**2)
        return a[joined], b[joined]


def group_moments(mixture: GaussianMixture, label: I8) -> Groups:
    """The groups that ``label`` (J,), from 0, −1 for none, makes of the components of a mixture
    over (px, py, vx, vy).

    A component of weight w is taken for a person who is there with probability w, independent of
    the others, and one above 1 for its whole part of people and one more with the rest: the
    variance of the number is Σ r(1 − r), r the part behind the point. (A Poisson point process, as
    which the filter treats the posterior, would have Σ w.)
    """
    used = label >= 0
    number = int(label.max(initial=-1)) + 1
    of = label[used]
    weight = mixture.weight[used]
    mean = mixture.mean[:4, used]
    cov = mixture.covariance[used][:, :4, :4]
    count: F8 = np.bincount(of, weight, number).astype(np.float64)
    part = weight - np.floor(weight)
    deviation = np.sqrt(np.bincount(of, part * (1 - part), number))
    share = weight / count[of]
    centre = np.zeros((4, number))
    spread = np.zeros((number, 4, 4))
    np.add.at(centre.T, of, (share * mean).T)
    off = (mean - centre[:, of]).T
    np.add.at(spread, of, share[:, None, None] * (cov + off[:, :, None] * off[:, None, :]))
    return Groups(label, count, deviation, centre, spread)


@dataclass(frozen=True, slots=True)
class Contours(Checked):
    """How the level curves are drawn.

    Parameters
    ----------
    level : people per square metre on the curve.
    grid_density : grid points per standard deviation of the narrowest component of a group.
    tolerance : metres by which a polygon may stray from the curve on the grid, to have fewer
        corners (Douglas and Peucker).
    """

    level: Positive = 0.1
    grid_density: Positive = 4.0
    tolerance: NonNegative = 0.02

    def of(self, mixture: GaussianMixture, members: Bool) -> tuple[F8, ...]:
        """Closed polygons (2, K), metres, first point = last, of the group of the components
        ``members`` (J,).

        They run counter-clockwise around what is inside (x to the right, y up) and clockwise around
        holes. There are none where the intensity stays below the level.
        """
        weight = mixture.weight[members]
        mean = mixture.mean[:2, members]
        cov = mixture.covariance[members][:, :2, :2]
        peak = weight / (2 * math.pi * np.sqrt(np.linalg.det(cov)))
        if peak.sum() <= self.level:
            return ()
        import cv2
        from contourpy import contour_generator

        x, y = self._grid(peak, mean, cov)
        off = np.stack(np.meshgrid(x, y))[:, None] - mean[:, :, None, None]
        distance2 = np.einsum("ijyx,jik,kjyx->jyx", off, np.linalg.inv(cov), off)
        intensity = (peak[:, None, None] * np.exp(-0.5 * distance2)).sum(axis=0)
        found = []
        lines = contour_generator(x, y, intensity).lines(self.level)
        for line in map(np.asarray, lines):
            # Single precision about the line's own place keeps micrometres.
            corners = (line[:-1] - line[0]).astype(np.float32)[:, None]
            kept = cv2.approxPolyDP(corners, self.tolerance, True)[:, 0] + np.asarray(
                line[0], np.float64
            )
            found.append(np.ascontiguousarray(np.vstack([kept, kept[:1]]).T))
        return tuple(found)

    def _grid(self, peak: F8, mean: F8, cov: F8) -> list[F8]:
        """Coordinates x and y of a grid on whose rim the intensity is below the level."""
        # Outside of radius r of every component each is below its share of the level.
        radius = np.sqrt(2 * np.log(np.maximum(peak * len(peak) / self.level, 1.0)))
        half = (radius + 0.5) * np.sqrt(np.stack([cov[:, 0, 0], cov[:, 1, 1]]))
        narrowest = math.sqrt(float(np.linalg.eigvalsh(cov)[:, 0].min()))
        axes = []
        for low, high in zip((mean - half).min(1), (mean + half).max(1), strict=True):
            points = int(
                np.clip(math.ceil((high - low) * self.grid_density / narrowest) + 1, 8, MAX_GRID)
            )
            axes.append(np.linspace(low, high, points))
        return axes


def polygon_area(polygon: F8) -> float:
    """Square metres inside a closed polygon (2, K); negative where it runs clockwise."""
    x, y = polygon
    return 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
