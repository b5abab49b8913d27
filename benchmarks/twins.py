"""The same filter in NumPy, float64, as one would write it: dense, and gated through a grid;
K-means in NumPy.

They do what `ParticlePHD` does with M09's model and Jmax newborn for every detection: move with
noises that follow the size, draw newborn inside the 99 % region of each detection, weigh them by γ
over the whole proposal, weigh everything with every detection, resample, and find clusters that
start on the detections and on what no detection is near. The dense twin compares every particle
with every detection; the gated one only those within 5 σ, through a grid of the detections.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from benchmarks.timing import Took, clock, took
from benchmarks.workload import Crowd
from phdtrack.arrays import to_cxcywh
from phdtrack.types import F8, Detections

I8 = NDArray[np.int64]
PER_TARGET = 1500
NEWBORN = 1000
ACCELERATION = 0.03
RESIZE = 0.1
SPREAD = 0.15
SURVIVAL = 0.99
SPEED = 0.06
REGION = float(chdtri(4, 0.01))
GATE = 5.0
REACH = 8.0
LIGHTEST = 0.6
HEAVIEST = 1.5
ROUNDS = 3
# State rows: x, y, vx, vy, w, h.
OBSERVED = [0, 1, 4, 5]


@dataclass(frozen=True, slots=True)
class World:
    """Numbers of the model: p_D, and γ and κ per unit of (position, size) volume."""

    detection: float
    gamma: float
    kappa: float

    @classmethod
    def of(cls, crowd: Crowd, sizes: float) -> World:
        """That of the crowd; ``sizes`` is the volume of possible sizes that the intensities are
        spread over.
        """
        area = crowd.info.width * crowd.info.height
        return cls(
            crowd.p_detect,
            0.001 * crowd.targets / (area * sizes),
            crowd.false_alarms / (area * sizes),
        )


class Twin:
    """One of the two: ``gated`` or dense."""

    def __init__(self, world: World, seed: int, *, gated: bool) -> None:
        self.world = world
        self.gated = gated
        self.rng = np.random.default_rng(seed)
        self.state: F8 = np.zeros((6, 0))
        self.unit = 0.0

    def frame(self, number: int, detections: Detections) -> tuple[tuple[Took, ...], F8]:
        """Seconds of filter and extraction, and the centres found."""
        began = clock()
        z = to_cxcywh(detections.xyxy)
        moved, weight = self._predict()
        born, born_weight = self._births(z)
        old = len(weight)
        x = np.hstack([moved, born])
        weight = np.concatenate([weight, born_weight])
        weight = (
            self._update_gated(x, weight, z, old)
            if self.gated
            else self._update_dense(x, weight, z)
        )
        self._resample(x, weight)
        filtered = clock()
        centres = extract(self.state, self.unit, z, gated=self.gated)
        return (took(began, filtered), took(filtered, clock())), centres[:2]

    def _predict(self) -> tuple[F8, F8]:
        x = self.state
        noise = self.rng.standard_normal((4, x.shape[1]))
        size = x[4:6]
        kick = ACCELERATION * size * noise[:2]
        moved = np.concatenate(
            [x[:2] + x[2:4] + kick / 2, x[2:4] + kick, np.abs(size + RESIZE * size * noise[2:])]
        )
        return moved, np.full(x.shape[1], self.unit * SURVIVAL)

    def _births(self, z: F8) -> tuple[F8, F8]:
        """Jmax particles for each detection, uniform γ over the proposal mixture."""
        n = z.shape[1]
        parent = np.repeat(np.arange(n), NEWBORN)
        sigma = sigmas(z[2:4])
        step = self._inside(len(parent))
        drawn = z[:, parent] + sigma[:, parent] * step
        amplitude = SPEED * np.sqrt(z[2] * z[3])[parent] * self.rng.standard_normal(len(parent))
        angle = self.rng.uniform(0, 2 * math.pi, len(parent))
        born = np.concatenate(
            [drawn[:2], [amplitude * np.cos(angle), amplitude * np.sin(angle)], drawn[2:]]
        )
        norm = 1 / (0.99 * (2 * math.pi) ** 2 * sigma.prod(0))
        if self.gated:
            half = math.sqrt(REGION) * sigma[:2]
            proposal = norm[parent] * np.exp(-0.5 * (step**2).sum(0))
            point, which = self._of_newborn(z, half, half, itself=False)
            d2 = (((drawn[:, point] - z[:, which]) / sigma[:, which]) ** 2).sum(0)
            share = np.where(d2 <= REGION, norm[which] * np.exp(-0.5 * d2), 0.0)
            proposal += np.bincount(point, share, len(parent))
        else:
            d2 = (((drawn[:, None, :] - z[:, :, None]) / sigma[:, :, None]) ** 2).sum(0)
            proposal = np.where(
                d2 <= REGION * (1 + 1e-9), norm[:, None] * np.exp(-0.5 * d2), 0.0
            ).sum(0)
        return born, self.world.gamma / (NEWBORN * proposal)

    def _inside(self, count: int) -> F8:
        """(4, count) standard normals inside the 99 % region: what is outside is drawn again."""
        out = self.rng.standard_normal((4, count))
        outside = np.flatnonzero((out**2).sum(0) > REGION)
        while len(outside):
            out[:, outside] = self.rng.standard_normal((4, len(outside)))
            outside = outside[(out[:, outside] ** 2).sum(0) > REGION]
        return out

    def _of_newborn(self, z: F8, around: F8, reach: F8, *, itself: bool) -> tuple[I8, I8]:
        """Pairs (newborn, detection) that may matter, from the pairs of detections alone.

        Newborn lie within ``around`` (2, N) of theirs and matter to what is within ``reach`` (2,
        N); with their own detection only where ``itself``.
        """
        half = reach + around.max(1, initial=0.0)[:, None]
        born, which = in_rectangles(z[0], z[1], z[:2] - half, z[:2] + half)
        if not itself:
            other = born != which
            born = born[other]
            which = which[other]
        point = born[:, None] * NEWBORN + np.arange(NEWBORN)
        return point.ravel(), np.repeat(which, NEWBORN)

    def _update_dense(self, x: F8, weight: F8, z: F8) -> F8:
        sigma = sigmas(x[4:6])
        d2 = np.zeros((z.shape[1], x.shape[1]))
        for row, s, value in zip(OBSERVED, sigma, z, strict=True):
            d2 += ((value[:, None] - x[row]) / s) ** 2
        share = (
            self.world.detection * weight / ((2 * math.pi) ** 2 * sigma.prod(0)) * np.exp(-0.5 * d2)
        )
        total = self.world.kappa + share.sum(1)
        out: F8 = (1 - self.world.detection) * weight + (share / total[:, None]).sum(0)
        return out

    def _update_gated(self, x: F8, weight: F8, z: F8, old: int) -> F8:
        g = GATE * SPREAD
        half = g / 2 / math.sqrt(1 - g**2) * z[2:4]
        near, of_old = in_rectangles(x[0, :old], x[1, :old], z[:2] - half, z[:2] + half)
        born, of_born = self._of_newborn(
            z, math.sqrt(REGION) * sigmas(z[2:4])[:2], half, itself=True
        )
        point = np.concatenate([near, old + born])
        which = np.concatenate([of_old, of_born])
        sigma = sigmas(x[4:6])
        d2 = np.zeros(len(point))
        for row, s, value in zip(OBSERVED, sigma, z, strict=True):
            d2 += ((value[which] - x[row][point]) / s[point]) ** 2
        seen = self.world.detection * weight / ((2 * math.pi) ** 2 * sigma.prod(0))
        share = seen[point] * np.exp(-0.5 * d2)
        total = self.world.kappa + np.bincount(which, share, z.shape[1])
        out: F8 = (1 - self.world.detection) * weight + np.bincount(
            point, share / total[which], len(weight)
        )
        return out

    def _resample(self, x: F8, weight: F8) -> None:
        mass = weight.sum()
        count = round(PER_TARGET * mass)
        comb = (np.arange(count) + self.rng.random()) * (mass / max(count, 1))
        chosen = np.minimum(np.searchsorted(np.cumsum(weight), comb), len(weight) - 1)
        self.state = x[:, chosen]
        self.unit = mass / max(count, 1)


def sigmas(size: F8) -> F8:
    """(4, n) deviations of x, y, w, h for sizes (2, n)."""
    return np.concatenate([SPREAD / 2 * size, SPREAD * size])


def in_rectangles(px: F8, py: F8, lower: F8, upper: F8) -> tuple[I8, I8]:
    """Pairs (point, rectangle): rectangles are entered in all cells that they touch, a point asks
    its own cell.
    """
    none = np.zeros(0, np.int64)
    if not px.size or not lower.shape[1]:
        return none, none
    origin = lower.min(1)
    cell = np.maximum((upper - lower).mean(1), 1e-9)
    first = ((lower - origin[:, None]) / cell[:, None]).astype(np.int64)
    last = ((upper - origin[:, None]) / cell[:, None]).astype(np.int64)
    columns, grid_rows = last.max(1) + 1
    wide, high = last - first + 1
    rectangle = np.repeat(np.arange(lower.shape[1]), wide * high)
    nth = np.arange(len(rectangle)) - np.repeat(np.cumsum(wide * high) - wide * high, wide * high)
    entered = (
        (first[1][rectangle] + nth // wide[rectangle]) * columns
        + first[0][rectangle]
        + nth % wide[rectangle]
    )
    rectangle = rectangle[np.argsort(entered, kind="stable")]
    held = np.bincount(entered, minlength=columns * grid_rows)
    start = np.cumsum(held) - held
    at = np.stack([(px - origin[0]) / cell[0], (py - origin[1]) / cell[1]])
    inside = np.flatnonzero((at >= 0).all(0) & (at[0] < columns) & (at[1] < grid_rows))
    mine = at[1, inside].astype(np.int64) * columns + at[0, inside].astype(np.int64)
    counts = held[mine]
    point = np.repeat(inside, counts)
    offset = np.arange(len(point)) - np.repeat(np.cumsum(counts) - counts, counts)
    which = rectangle[np.repeat(start[mine], counts) + offset]
    x = px[point]
    y = py[point]
    kept = (
        (x >= lower[0, which])
        & (x <= upper[0, which])
        & (y >= lower[1, which])
        & (y <= upper[1, which])
    )
    return point[kept], which[kept]


def extract(x: F8, unit: float, z: F8, *, gated: bool) -> F8:
    """(6, k) cluster centres: K-means from the detections at rest and from what none of them is
    near.
    """
    if not x.size:
        return np.zeros((6, 0))
    centres = np.concatenate([z[:2], np.zeros_like(z[:2]), z[2:]])
    choice: Dense | Gated = Gated(x, centres) if gated else Dense(x)
    labels = choice.labels(centres)
    lonely = np.flatnonzero(labels < 0)
    if len(lonely) * unit >= LIGHTEST:
        centres = np.hstack([centres, _lonely(x[:, lonely])])
        choice = Gated(x, centres) if gated else choice
        labels = choice.labels(centres)
    centres, labels = _settle(x, centres, labels, choice)
    mass: F8 = (unit * np.bincount(labels[labels >= 0], minlength=centres.shape[1])).astype(
        np.float64
    )
    heavy = np.flatnonzero(mass > HEAVIEST)
    if len(heavy):
        inside = np.flatnonzero(np.isin(labels, heavy))
        distance2 = (
            ((x[:, inside] - centres[:, labels[inside]]) / _scale(centres)[:, labels[inside]]) ** 2
        ).sum(0)
        order = np.lexsort((distance2, labels[inside]))
        farthest = inside[order[np.searchsorted(labels[inside][order], heavy, side="right") - 1]]
        # Only the particles of the heavy clusters choose again.
        halves = np.hstack([centres[:, heavy], x[:, farthest]])
        mine = np.ascontiguousarray(x[:, inside])
        choice = Gated(mine, halves) if gated else Dense(mine)
        halves, labels = _settle(mine, halves, choice.labels(halves), choice)
        mass[heavy] = 0.0
        mass = np.append(mass, unit * np.bincount(labels[labels >= 0], minlength=halves.shape[1]))
        centres = np.hstack([centres, halves])
    return _join_light(centres, mass)


def _lonely(x: F8) -> F8:
    """Means of the particles in cells about as large as an object."""
    size = np.median(x[4:6], axis=1)
    cell = np.round(x[:2] / (2 * size[:, None])).astype(np.int64)
    _, group = np.unique(cell, axis=1, return_inverse=True)
    count = np.bincount(group)
    return np.stack([np.bincount(group, row) for row in x]) / count


def _settle(x: F8, centres: F8, labels: I8, choice: Dense | Gated) -> tuple[F8, I8]:
    """K-means until no label changes; a centre of nothing stays where it is."""
    for _ in range(ROUNDS):
        inside = labels >= 0
        points, mine = (x, labels) if inside.all() else (x[:, inside], labels[inside])
        count = np.bincount(mine, minlength=centres.shape[1])
        sums = np.stack([np.bincount(mine, row, len(count)) for row in points])
        centres = np.where(count > 0, sums / np.maximum(count, 1), centres)
        before = labels
        labels = choice.labels(centres)
        if np.array_equal(labels, before):
            break
    return centres, labels


def _scale(centres: F8) -> F8:
    """(6, k) deviations that distances are measured in."""
    size = centres[4:6]
    speed = np.broadcast_to(
        np.maximum(SPEED * np.sqrt(size[0] * size[1]) / math.sqrt(2), 1e-6), size.shape
    )
    return np.concatenate([SPREAD / 2 * size, speed, SPREAD * size])


class Dense:
    """Every particle may choose any centre."""

    def __init__(self, x: F8) -> None:
        self.x = x

    def labels(self, centres: F8) -> I8:
        """The nearest centre of each particle within reach, −1 for none."""
        x = self.x
        scale = _scale(centres)
        if not centres.shape[1]:
            return np.full(x.shape[1], -1)
        d2 = np.zeros((centres.shape[1], x.shape[1]))
        for value, centre, s in zip(x, centres, scale, strict=True):
            d2 += ((value - centre[:, None]) / s[:, None]) ** 2
        d2[(np.abs(x[:2, None] - centres[:2, :, None]) > REACH * scale[:2, :, None]).any(0)] = (
            np.inf
        )
        nearest = d2.argmin(0)
        return np.where(np.isfinite(d2[nearest, np.arange(x.shape[1])]), nearest, -1)


class Gated:
    """Every particle may choose among the centres within whose reach it was at the start: they move
    little afterwards.
    """

    def __init__(self, x: F8, centres: F8) -> None:
        half = REACH * _scale(centres)[:2]
        point, which = in_rectangles(x[0], x[1], centres[:2] - half, centres[:2] + half)
        # Where there is no choice, no distance is needed.
        self.alone = np.full(x.shape[1], -1)
        self.alone[point] = which
        several = np.bincount(point, minlength=x.shape[1])[point] > 1
        self.point = point[several]
        self.which = which[several]
        self.x = x[:, self.point]
        # The pairs come in the order of their particles.
        self.first = np.flatnonzero(np.diff(self.point, prepend=-1))
        self.counts = np.diff(np.append(self.first, len(self.point)))

    def labels(self, centres: F8) -> I8:
        """The nearest of the centres that a particle may choose, −1 where there is none."""
        labels = self.alone.copy()
        if len(self.point):
            d2 = (((self.x - centres[:, self.which]) / _scale(centres)[:, self.which]) ** 2).sum(0)
            won = d2 == np.repeat(np.minimum.reduceat(d2, self.first), self.counts)
            labels[self.point[won]] = self.which[won]
        return labels


def _join_light(centres: F8, mass: F8) -> F8:
    """Centres heavy enough; light neighbours are joined first, nearest first, while they are not
    too heavy together.
    """
    light = np.flatnonzero((mass > 0) & (mass < LIGHTEST))
    lower = centres[:2, light] - centres[4:6, light] / 2
    upper = centres[:2, light] + centres[4:6, light] / 2
    a, b = in_rectangles(centres[0, light], centres[1, light], lower, upper)
    a, b = light[a[a < b]], light[b[a < b]]
    mass = mass.copy()
    centres = centres.copy()
    for i, j in zip(a, b, strict=True):
        if (
            mass[i]
            and mass[j]
            and min(mass[i], mass[j]) < LIGHTEST
            and mass[i] + mass[j] <= HEAVIEST
        ):
            centres[:, i] = (mass[i] * centres[:, i] + mass[j] * centres[:, j]) / (
                mass[i] + mass[j]
            )
            mass[i] = mass[i] + mass[j]
            mass[j] = 0.0
    return centres[:, mass >= LIGHTEST]
