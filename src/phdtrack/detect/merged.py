"""Merged measurements: one detection for each of the targets that a background detector reports as one blob.

Small groups of blobs and expected targets that touch are explained together. An explanation gives each target one blob or
none; its log-likelihood is the sum over

    missed target     1 − r (p_D + (1 − p_D) c)      r: probability that it exists; c: share of it that a blob covers
    blob of one       r p_D N(z; h(x), R + H P Hᵀ)
    blob of k         ∏ r p_D · ρ^(k−1) · N(edges of the blob; the targets' outermost edges)
    blob of none      κ(z)

with ρ the probability that targets that touch are reported as one blob. In the best explanation every target of a merged
blob gets a detection of its expected size where the blob's edges put it. The blob's edge on each side is that of the target
that is expected to lie outermost there. In the sensor's noise, with the centre's deviation half the size's, the edges of
one box are independent.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np

from phdtrack.arrays import area, intersection, to_xyxy
from phdtrack.errors import Checked, NonNegative, Probability
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Bool, Detections, Estimates, Explanation

# Deviations beyond which a blob does not fit; blobs and targets that are explained together, at most.
GATE, GROUP = 5.0, 6
# Largest probability of existence; targets of a smaller one than the least are expected no more.
MAX_EXISTENCE, MIN_EXISTENCE = 0.99, 0.1
# Squared Mahalanobis distance in the plane within which an estimate can be an expected target: 99 % of two dimensions.
NEAR = 9.21
TINY = 1e-300
# (left, top, right, bottom) of (centre x, centre y, width, height), and the direction in which each edge lies outward.
EDGES: F8 = np.array([[1, 0, -0.5, 0], [0, 1, 0, -0.5], [1, 0, 0.5, 0], [0, 1, 0, 0.5]])
OUTWARD: F8 = np.array([-1.0, -1.0, 1.0, 1.0])
# The targets of each blob, by number.
Members = list[tuple[int, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedTargets:
    """Targets that the last frames showed, before or after a frame.

    Attributes
    ----------
    state : (d, n).      covariance : (n, d, d).
    existence : (n,) probability r that each is there.
    hidden : (n,) seconds for which neither its left nor its right edge was visible in a merged blob.
    separate : (n,) seconds for which each had a blob to itself.
    """

    state: F8
    covariance: F8
    existence: F8
    hidden: F8
    separate: F8

    def __len__(self) -> int:
        return len(self.existence)

    def take(self, index: I8 | Bool) -> ExpectedTargets:
        """The targets at ``index`` (integers or a mask)."""
        others = (self.covariance, self.existence, self.hidden, self.separate)
        return ExpectedTargets(np.ascontiguousarray(self.state[:, index]), *(part[index] for part in others))

    def joined(self, other: ExpectedTargets) -> ExpectedTargets:
        """The targets of both."""
        if not len(self) or not len(other):
            return self if len(self) else other
        pairs = [(getattr(self, field.name), getattr(other, field.name)) for field in fields(self)]
        return ExpectedTargets(np.hstack(pairs[0]), *(np.concatenate(pair) for pair in pairs[1:]))


@dataclass(frozen=True, slots=True)
class MergedMeasurements(Checked):
    """The merged-measurement model, for boxes in the image.

    Parameters
    ----------
    merge_probability : ρ, probability that targets that touch are reported as one blob; 0: blobs are never divided.
    min_separate_time : seconds for which a target must have had a blob to itself before it may share one.
    max_hidden_time : seconds for which a target may stay hidden in a merged blob, between the edges of others.
    """

    merge_probability: Probability = 0.5
    min_separate_time: NonNegative = 0.4
    max_hidden_time: NonNegative = 3.0

    def start(self) -> ExpectedTargets:
        """No targets are expected."""
        return ExpectedTargets(np.zeros((0, 0)), np.zeros((0, 0, 0)), np.zeros(0), np.zeros(0), np.zeros(0))

    def explain(
        self, state: ExpectedTargets, detections: Detections, model: Model, dt: float
    ) -> tuple[ExpectedTargets, Explanation]:
        """The targets expected in this frame, and the detections that the filter gets for them."""
        targets = _predicted(state, model, dt)
        if not (detections.observed and len(targets) and len(detections)):
            return targets, Explanation.unchanged(detections)
        boxes = to_xyxy(model.sensor.expected(targets.state)[:4])
        # In the order of their edges, so that nothing depends on the order in which they come.
        blobs, rows = (np.lexsort(edges.T[::-1]) for edges in (detections.xyxy, boxes))
        found = _Frame(self, model, targets.take(rows), boxes[rows], detections.take(blobs)).members()
        members: Members = [()] * len(blobs)
        for b, several in zip(blobs.tolist(), found, strict=True):
            members[b] = tuple(rows[list(several)].tolist())
        return _timed(targets, members, boxes, dt / model.rate), _divided(detections, members, boxes)

    def advance(
        self, state: ExpectedTargets, explanation: Explanation, estimates: Estimates, model: Model, dt: float
    ) -> ExpectedTargets:
        """The targets after the frame: the estimates, and expected targets that these do not show but that may be there.

        A target that was missed stays with probability r ← r (1 − p_D)/(1 − r p_D).
        """
        if not explanation.detections.observed:
            return state
        targets, target, seconds = state, explanation.target, dt / model.rate
        of = _continued(targets, target, estimates, model)
        # The last place stands for what is no target.
        seen, shown = np.zeros((2, len(targets) + 1), np.bool_)
        seen[target], shown[of] = True, True
        p = model.sensor.p_detect(targets.state) if len(targets) else np.zeros(0)
        r, hidden = targets.existence, targets.hidden + seconds
        there = np.where(seen[:-1], r, r * (1 - p) / np.maximum(1 - r * p, 1 - MAX_EXISTENCE))
        left = ~shown[:-1] & (there > MIN_EXISTENCE) & (hidden <= self.max_hidden_time)
        kept = replace(targets, existence=there, hidden=hidden).take(left)
        before = np.append(targets.hidden, 0.0)[of], np.append(targets.separate, 0.0)[of]
        weight = np.minimum(estimates.weight, MAX_EXISTENCE)
        return ExpectedTargets(estimates.state, estimates.covariance, weight, *before).joined(kept)


@dataclass(frozen=True, eq=False)
class _Frame:
    """The blobs (N) and the expected targets (n), with their boxes (n, 4), of one frame."""

    rule: MergedMeasurements
    model: Model
    targets: ExpectedTargets
    boxes: F8
    blobs: Detections

    def members(self) -> Members:
        """The targets of each blob in the best explanation."""
        sensor, z = self.model.sensor, self.model.sensor.measure(self.blobs)
        known: Bool = np.asarray(np.isfinite(z).all(axis=0))
        spread = EDGES @ self.targets.covariance[:, sensor.observed][:, :, sensor.observed] @ EDGES.T
        # The targets' edges are moved out by a deviation.
        reach = np.sqrt(np.maximum(np.einsum("nii->ni", spread), 0.0))
        edges, low, high = self.blobs.xyxy[:, None], self.boxes - reach, self.boxes + reach
        meet = (edges[..., :2] <= high[:, 2:]) & (low[:, :2] <= edges[..., 2:])
        touching = np.asarray(meet.all(axis=2) & known[:, None], np.bool_)
        out: Members = [tuple(np.flatnonzero(row).tolist()) for row in touching]
        if max(touching.sum(axis=0).max(), touching.sum(axis=1).max()) < 2:
            return out
        shared = intersection(self.blobs.xyxy, self.boxes)
        p, r = sensor.p_detect(self.targets.state), self.targets.existence
        covered = np.where(touching, shared, 0.0).max(axis=0) / np.maximum(area(self.boxes), TINY)
        missed = np.log(np.maximum(1 - r * (p + (1 - p) * np.minimum(covered, 1.0)), TINY)).tolist()
        seen = np.log(np.maximum(r * p, TINY))
        clutter = np.zeros(len(out))
        clutter[known] = np.log(np.maximum(self.model.clutter.intensity(np.ascontiguousarray(z[:, known])), TINY))
        smaller = np.minimum(area(self.blobs.xyxy)[:, None], area(self.boxes))
        # Of blobs and targets: the covariances of the edges, and the log-likelihoods that one is the other alone.
        pairs = np.nonzero(touching)
        covariance, fit = np.zeros((*touching.shape, 4, 4)), np.full(touching.shape, -math.inf)
        noise = sensor.covariance(z[:, pairs[0]], np.ascontiguousarray(self.targets.state[:, pairs[1]]))
        covariance[pairs] = spread[pairs[1]] + EDGES @ noise @ EDGES.T
        fit[pairs] = _log_density(self.blobs.xyxy[pairs[0]] - self.boxes[pairs[1]], covariance[pairs])
        out = [()] * len(out)

        @cache
        def likelihood(blob: int, targets: tuple[int, ...]) -> float:
            if not targets:
                return float(clutter[blob])
            value = fit[blob, targets[0]] if len(targets) == 1 else self._fit(blob, list(targets), covariance)
            return float(value + seen[list(targets)].sum())

        for blobs, targets, kept in _groups(touching, shared / np.maximum(smaller, TINY)):
            if len(blobs) == len(targets) == 1:
                out[blobs[0]] = (targets[0],)
                continue
            top = -math.inf
            # Of equally likely explanations the first.
            for choice in itertools.product(*([-1, *np.flatnonzero(kept[:, t]).tolist()] for t in targets)):
                of: dict[int, tuple[int, ...]] = dict.fromkeys(blobs, ())
                value = 0.0
                for t, b in zip(targets, choice, strict=True):
                    if b < 0:
                        value += missed[t]
                    else:
                        of[b] = (*of[b], t)
                value += sum(likelihood(b, several) for b, several in of.items())
                if value > top:
                    top, best = value, of
            for b, several in best.items():
                out[b] = several
        return out

    def _fit(self, blob: int, targets: list[int], covariance: F8) -> float:
        """Log-likelihood of the blob's edges where it is these targets, more than one, that were detected."""
        boxes, rule, lives = self.boxes[targets], self.rule, self.targets
        hidden = lives.hidden[targets][_hidden(boxes)]
        if not ((lives.separate[targets] >= rule.min_separate_time).all() and (hidden <= rule.max_hidden_time).all()):
            return -math.inf
        mean, spread = _outline(boxes, covariance[blob, targets])
        merged = (len(targets) - 1) * math.log(max(rule.merge_probability, TINY))
        return float(_log_density(self.blobs.xyxy[blob] - mean, spread)) + merged


def _log_density(step: F8, covariance: F8) -> F8:
    """(...) logarithm of the normal density of (..., 4) steps from the mean, −∞ beyond `GATE` deviations."""
    distance2 = (step * np.linalg.solve(covariance, step[..., None])[..., 0]).sum(axis=-1)
    return np.where(distance2 > GATE**2, -math.inf, -0.5 * (distance2 + np.linalg.slogdet(2 * np.pi * covariance)[1]))


def _groups(touching: Bool, strength: F8) -> Iterator[tuple[list[int], list[int], Bool]]:
    """Blobs, targets and pairs (N, n) of the groups that pairs ``touching`` (N, n) connect, of at most `GROUP` members.

    The strongest pairs are joined first; one that would make a group too large is left out.
    """
    n, m = touching.shape
    blob, target = np.nonzero(touching)
    group, kept = np.arange(n + m), np.zeros((n, m), np.bool_)
    for p in np.argsort(-strength[blob, target], kind="stable"):
        a, c = group[blob[p]], group[n + target[p]]
        if a == c or np.count_nonzero((group == a) | (group == c)) <= GROUP:
            group[group == c] = a
            kept[blob[p], target[p]] = True
    for key in np.unique(group[:n][kept.any(axis=1)]):
        blobs, targets = np.flatnonzero(group[:n] == key).tolist(), np.flatnonzero(group[n:] == key).tolist()
        yield blobs, targets, kept


def _owners(boxes: F8) -> I8:
    """(4,) which of the boxes (k, 4) has each edge of their union."""
    return np.asarray((boxes * OUTWARD).argmax(axis=0))


def _hidden(boxes: F8) -> Bool:
    """(k,) which of the boxes (k, 4) have neither the left nor the right edge of their union."""
    out = np.ones(len(boxes), np.bool_)
    out[_owners(boxes)[[0, 2]]] = False
    return out


def _outline(boxes: F8, covariance: F8) -> tuple[F8, F8]:
    """The union of boxes (k, 4) with edges of covariance (k, 4, 4) as a Gaussian: its mean (4,) and covariance (4, 4)."""
    owner, side = _owners(boxes), np.arange(4)
    same = owner[:, None] == owner[None, :]
    return boxes[owner, side], np.where(same, covariance[owner[:, None], side[:, None], side[None, :]], 0.0)


def _placed(blob: F8, boxes: F8) -> F8:
    """(k, 4) where a merged blob (4,) puts its targets' boxes (k, 4), their size unchanged.

    A target lies where the edges that it has put it, midway if it has both; one that has none along an axis stays where it
    is expected, inside the blob.
    """
    owner, k, out = _owners(boxes), np.arange(len(boxes)), boxes.copy()
    for axis in (0, 1):
        low, high = blob[axis], blob[axis + 2]
        size = boxes[:, axis + 2] - boxes[:, axis]
        at_low, at_high = owner[axis] == k, owner[axis + 2] == k
        start = np.where(at_low, low, boxes[:, axis])
        start = np.where(at_high, np.where(at_low, (low + high - size) / 2, high - size), start)
        room = high - low - size
        start = np.where(room > 0, np.clip(start, low, np.maximum(low, high - size)), low + room / 2)
        out[:, axis], out[:, axis + 2] = start, start + size
    return out


def _predicted(targets: ExpectedTargets, model: Model, dt: float) -> ExpectedTargets:
    """The targets ``dt`` time units later."""
    if not len(targets):
        return targets
    state, before = model.warp_gaussians(np.ascontiguousarray(targets.state), targets.covariance)
    mean, jacobian, noise = model.motion.transition(np.ascontiguousarray(state), dt)
    covariance = jacobian @ before @ jacobian.transpose(0, 2, 1) + noise
    there = targets.existence * model.motion.p_survive(targets.state, dt / model.rate)
    return replace(targets, state=mean, covariance=covariance, existence=there)


def _timed(targets: ExpectedTargets, members: Members, boxes: F8, seconds: float) -> ExpectedTargets:
    """The targets with the seconds for which they have been hidden, and have had a blob to themselves."""
    out_of_sight, separate = targets.hidden.copy(), targets.separate.copy()
    alone = [several[0] for several in members if len(several) == 1]
    separate[alone] += seconds
    out_of_sight[alone] = 0.0
    for index in [list(several) for several in members if len(several) > 1]:
        out_of_sight[index] = np.where(_hidden(boxes[index]), out_of_sight[index] + seconds, 0.0)
    return replace(targets, hidden=out_of_sight, separate=separate)


def _divided(detections: Detections, members: Members, boxes: F8) -> Explanation:
    """The detections with one for each target of a merged blob, in the order of the blobs."""
    n = len(detections)
    source = np.repeat(np.arange(n), [max(1, len(several)) for several in members])
    part = np.searchsorted(source, np.arange(n))
    target = np.array([t for several in members for t in several or (-1,)], np.int64)
    if len(source) == n:
        return Explanation(detections, source, part, target)
    xyxy = detections.xyxy[source]
    for b, several in enumerate(members):
        if len(several) > 1:
            xyxy[part[b] : part[b] + len(several)] = _placed(detections.xyxy[b], boxes[list(several)])
    return Explanation(replace(detections.take(source), xyxy=xyxy), source, part, target, changed=True)


def _continued(targets: ExpectedTargets, target: I8, estimates: Estimates, model: Model) -> I8:
    """(k,) the expected target that each estimate continues, −1 for none.

    The target of its detection; where there is none, the nearest that is left, within the gate.
    """
    of: I8 = np.append(target, -1)[estimates.detection].astype(np.int64)
    later = np.ones(len(of), np.bool_)
    later[np.unique(of, return_index=True)[1]] = False
    of[later] = -1
    free, lost = np.setdiff1d(np.arange(len(targets)), of), np.flatnonzero(of < 0)
    if not len(free) or not len(lost):
        return of
    step = estimates.state[:2, lost, None] - targets.state[:2, None, free]
    noise2 = np.square(model.sensor.noise(targets.state[:, free])[:2]).T
    spread = targets.covariance[free, :2, :2] + noise2[:, :, None] * np.eye(2)
    distance2 = np.einsum("aij,jab,bij->ij", step, np.linalg.inv(spread), step)
    while (nearest := distance2.min()) <= NEAR:
        i, j = np.argwhere(distance2 == nearest)[0]
        of[lost[i]] = free[j]
        distance2[i, :], distance2[:, j] = np.inf, np.inf
    return of
