"""Appearance as a likelihood ratio, written naively: a past is the list of all that was seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import norm

from phdtrack.kernels.appearance import CHANCE, LEAST_FREE, LEAST_LENGTH, MOST, ODD_TIME, SOON, Law


def direction(look: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """(D,) a descriptor less the stream's mean, of length one; zeros if they are nearly equal."""
    rest = np.asarray(look, np.float64) - mean
    length = np.linalg.norm(rest)
    return rest / length if length > LEAST_LENGTH else np.zeros_like(rest)


def gain(s: float, same: float, deviation: float, other: float, other_deviation: float) -> float:
    """log p(s | same)/p(s | other) by two Gaussians: capped, and never falling with s."""
    if same < other:
        return 0.0

    def log_ratio(x: np.ndarray | float) -> np.ndarray | float:
        return norm.logpdf(x, same, deviation) - norm.logpdf(x, other, other_deviation)

    grid = np.array([-1.0, 0.0, 1.0])
    square, slope, _ = np.polyfit(grid, log_ratio(grid), 2)
    if deviation < other_deviation:
        s = min(s, -slope / (2 * square))
    if deviation > other_deviation:
        s = max(s, -slope / (2 * square))
    return min(float(log_ratio(s)), MOST)


def likelihoods(
    s_mean: float, s_last: float, seconds: float, count: float, odd: float, law: Law
) -> tuple[float, float]:
    """p(s | same)/p(s | other) of a target that looked odd with a probability when it was last
    seen, and the probability that it now does.
    """
    noise = (1 - law.signal) / law.signal
    same = (law.same + law.fading * max(math.log(max(seconds, 1e-300) / SOON), 0)) / math.sqrt(
        1 + noise / count
    )
    as_usual = math.exp(gain(s_mean, same, law.same_deviation, law.other, law.other_deviation))
    kept = math.exp(-seconds / law.independent)
    as_last = CHANCE + (1 - CHANCE) * math.exp(
        gain(
            s_last,
            law.signal * (1 - kept) + kept,
            law.same_deviation * (1 - kept) + law.near_deviation * kept,
            law.other,
            law.other_deviation,
        )
    )
    still_odd = odd * math.exp(-seconds / ODD_TIME)
    newly_odd = (1 - odd) * CHANCE
    usual = 1 - still_odd - newly_odd
    total = still_odd * as_last + newly_odd + usual * as_usual
    return total, (still_odd * as_last + newly_odd) / total


@dataclass(frozen=True)
class Past:
    """What one hypothesis has seen: times, free parts and descriptors of its detections, and the
    probability that the target looked odd at the last; and how many independent ones these are.
    """

    time: tuple[float, ...]
    free: tuple[float, ...]
    look: tuple[tuple[float, ...], ...]
    odd: float = 0.0
    number: float = 1.0

    def mean(self, memory: float) -> np.ndarray:
        """(D,) of the descriptors, each counting by its free part, old ones forgotten."""
        return np.average(np.array(self.look), axis=0, weights=self.weights(memory))

    def weights(self, memory: float) -> np.ndarray:
        """(n,) what each counts for now."""
        return np.array(self.free) * np.exp((np.array(self.time) - self.time[-1]) / memory)


def ratio(past: Past, j: int, looks) -> tuple[float, float]:
    """`likelihoods` of detection j of a frame."""
    return likelihoods(
        float(direction(past.mean(looks.memory), looks.mean) @ looks.seen[j]),
        float(direction(np.array(past.look[-1]), looks.mean) @ looks.seen[j]),
        looks.time - past.time[-1],
        past.number,
        past.odd,
        looks.law,
    )


def pair_ratio(past: Past | None, j: int, looks) -> float:
    """What the pair of a hypothesis with this past and detection j is multiplied with, as log."""
    if past is None or looks.free[j] <= 0:
        return 0.0
    return looks.law.weight * looks.free[j] * math.log(ratio(past, j, looks)[0])


def followed_by(past: Past | None, j: int, looks) -> Past | None:
    """The past after a frame in which the hypothesis had detection j, −1 for none."""
    if j < 0 or looks.free[j] <= 0:
        return past
    here = (looks.time,), (float(looks.free[j]),), (tuple(looks.raw[j].tolist()),)
    if past is None:
        return Past(*here)
    seconds = looks.time - past.time[-1]
    rho = math.exp(-seconds / looks.law.independent)
    number = past.number * math.exp(-seconds / looks.memory)
    number += looks.free[j] * (1 - rho) / (1 + rho)
    odd = past.odd + looks.free[j] * (ratio(past, j, looks)[1] - past.odd)
    return Past(
        past.time + here[0], past.free + here[1], past.look + here[2], odd, max(number, 1.0)
    )


def likeness(
    mean: np.ndarray,
    count: float,
    other: np.ndarray,
    other_count: float,
    looks,
    seconds: float = 0.0,
) -> float:
    """The log-likelihood ratio that two means of so many independent descriptors are of one object:
    of one whose looks may have changed by `CHANCE`, for so many seconds if a second is usual.
    """
    law = looks.law
    noise = (1 - law.signal) / law.signal
    expected = law.means_same / math.sqrt((1 + noise / count) * (1 + noise / other_count))
    s = float(direction(mean, looks.mean) @ direction(other, looks.mean))
    found = gain(s, expected, law.means_deviation, law.means_other, law.means_other_deviation)
    odd = CHANCE * math.exp(-seconds / ODD_TIME)
    return law.means_weight * math.log(odd + (1 - odd) * math.exp(found))


def free_parts(boxes: np.ndarray) -> list[float]:
    """How much of each box (N, 4) the one that covers most of it leaves, from `LEAST_FREE` to 1."""
    out = []
    for i, (left, top, right, bottom) in enumerate(boxes):
        covered = [0.0]
        for k, other in enumerate(boxes):
            width = min(right, other[2]) - max(left, other[0])
            height = min(bottom, other[3]) - max(top, other[1])
            if k != i and width > 0 and height > 0:
                covered.append(width * height / ((right - left) * (bottom - top)))
        out.append(max((1 - max(covered) - LEAST_FREE) / (1 - LEAST_FREE), 0.0))
    return out


@dataclass
class Person:
    """A target that lessons are taken from: all its detections, the seconds of the last lesson, how
    many detections there were when each early mean was kept, and two single ones.
    """

    seen: list[tuple[float, float, np.ndarray]] = field(default_factory=list)
    taught: float = -math.inf
    early: dict[int, int] = field(default_factory=dict)
    single: dict[int, tuple[float, np.ndarray]] = field(default_factory=dict)

    def mean(self, memory: float, begin: int = 0, end: int | None = None) -> np.ndarray:
        """(D,) of some of the detections, old ones forgotten."""
        some = self.seen[begin:end]
        weight = [free * math.exp((t - self.seen[-1][0]) / memory) for t, free, _ in some]
        return np.average([look for *_, look in some], axis=0, weights=weight)

    def since(self, begin: int, memory: float) -> np.ndarray | None:
        """The mean of the detections from one on, if these count for more than half of one."""
        some = self.seen[begin:]
        weight = sum(free * math.exp((t - self.seen[-1][0]) / memory) for t, free, _ in some)
        return self.mean(memory, begin) if weight > 0.5 else None


@dataclass
class School:
    """Targets without doubt, and the sums of what they have taught."""

    spans: Sequence[float]
    pause: float
    least_free: float
    most: float
    people: dict[int, Person] = field(default_factory=dict)
    same: np.ndarray = field(default_factory=lambda: np.zeros(6))
    other: np.ndarray = field(default_factory=lambda: np.zeros(3))
    single: np.ndarray = field(default_factory=lambda: np.zeros(6))
    means: np.ndarray = field(default_factory=lambda: np.zeros(6))
    beside: np.ndarray = field(default_factory=lambda: np.zeros(2))

    def frame(self, sure: np.ndarray, looks) -> None:
        """Learn from a frame; those that are not ``sure`` (K, 2) are forgotten."""
        self.people = {label: self.people.get(label, Person()) for label in sure[:, 0].tolist()}
        good = [
            (label, j) for label, j in sure.tolist() if j >= 0 and looks.free[j] >= self.least_free
        ]
        learners = {
            label for label, _ in good if looks.time >= self.people[label].taught + self.pause
        }
        for label, j in good:
            if label in learners:
                self._lessons(label, j, looks)
                self._meeting(label, j, sure, looks)
        for label, j in good:
            self._singles(self.people[label], j, looks, label in learners)
            self._seen(self.people[label], j, looks)
        if max(self.means[0], self.means[3]) > self.most:
            self.means *= 1 - 1 / self.most

    def _lessons(self, label: int, j: int, looks) -> None:
        one = self.people[label]
        one.taught = looks.time
        mean = looks.mean
        now = looks.seen[j]
        own = one.seen and direction(one.mean(looks.memory), mean)
        rivals = [p for name, p in self.people.items() if name != label and p.seen]
        if rivals:
            self.other *= 1 - 1 / self.most
        for rival in rivals:
            theirs = direction(rival.mean(looks.memory), mean)
            self.other += powers(float(theirs @ now)) / len(rivals)
            if one.seen:
                self.means[3:] += powers(float(theirs @ own)) / len(rivals)
        if not one.seen:
            return
        last = one.seen[-1][0]
        lessons = [(float(own @ now), looks.time - last)]
        self.same *= 1 - 1 / self.most
        parts = 1 + len(one.early)
        for end in one.early.values():
            early = direction(one.mean(looks.memory, 0, end), mean)
            lessons.append((float(early @ now), looks.time - one.seen[end - 1][0]))
            since = one.since(end, looks.memory)
            if since is not None and last - one.seen[end - 1][0] >= self.spans[0]:
                self.means[:3] += powers(float(early @ direction(since, mean))) / parts
        for s, seconds in lessons:
            x = max(math.log(seconds / SOON), 0.0)
            self.same += np.array([1, x, x * x, s, x * s, s * s]) / parts

    def _meeting(self, label: int, j: int, sure: np.ndarray, looks) -> None:
        """Learn if detection j looks like the target beside it, by Bayes' rule."""
        for other in sure[sure[:, 1] == looks.beside[j], 0].tolist():
            if looks.beside[j] < 0 or not (self.people[label].seen and self.people[other].seen):
                continue
            law = looks.law
            ratios = []
            for name in (label, other):
                mean = direction(self.people[name].mean(looks.memory), looks.mean)
                s = float(mean @ looks.seen[j])
                ratios.append(gain(s, law.same, law.same_deviation, law.other, law.other_deviation))
            share = (self.beside[1] + 0.4) / (self.beside[0] + 40)
            log_odds = math.log(share / (1 - share)) + ratios[1] - ratios[0]
            self.beside *= 1 - 1 / self.most
            self.beside += [1, 1 / (1 + math.exp(-max(log_odds, -100)))]

    def _singles(self, one: Person, j: int, looks, learns: bool) -> None:
        for k, span in enumerate(self.spans):
            known = one.early.get(k)
            if one.seen and (known is None or looks.time - one.seen[known - 1][0] >= 2 * span):
                one.early[k] = len(one.seen)
        kept = 1 - 1 / self.most
        time, look = one.single.get(1, (-math.inf, looks.mean))
        apart = looks.time - time
        if apart >= self.spans[1]:
            if apart < 2 * self.spans[1]:
                s = float(direction(look, looks.mean) @ looks.seen[j])
                self.single[3:5] = kept * self.single[3:5] + [1, s]
            one.single[1] = (looks.time, looks.raw[j])
        time, look = one.single.get(0, (-math.inf, looks.mean))
        apart = looks.time - time
        if learns and apart < self.spans[0]:
            s = float(direction(look, looks.mean) @ looks.seen[j])
            self.single[[0, 1, 2, 5]] = kept * self.single[[0, 1, 2, 5]] + [1, apart, s, s * s]
        one.single[0] = (looks.time, looks.raw[j])

    def _seen(self, one: Person, j: int, looks) -> None:
        one.seen.append((looks.time, float(looks.free[j]), looks.raw[j].astype(np.float64)))


def powers(s: float) -> np.ndarray:
    """(3,) 1, s and s²."""
    return np.array([1.0, s, s * s])
