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
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.arrays import area, to_xyxy
from phdtrack.checks import NonNegative, Probability, check
from phdtrack.kernels.joining import meeting
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Bool, Detections, Estimates, Explanation

# Targets and blobs touch where they meet once the targets' edges are moved out by so many deviations.
REACH = 1.0
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

    @classmethod
    def empty(cls) -> ExpectedTargets:
        """No targets."""
        none = np.zeros(0)
        return cls(np.zeros((0, 0)), np.zeros((0, 0, 0)), none, none, none)

    def __len__(self) -> int:
        return len(self.existence)

    def take(self, index: I8 | Bool) -> ExpectedTargets:
        """The targets at ``index`` (integers or a mask)."""
        state = np.ascontiguousarray(self.state[:, index])
        return ExpectedTargets(
            state, self.covariance[index], self.existence[index], self.hidden[index], self.separate[index]
        )

    def joined(self, other: ExpectedTargets) -> ExpectedTargets:
        """The targets of both."""
        if not len(self) or not len(other):
            return self if len(self) else other
        return ExpectedTargets(
            np.concatenate([self.state, other.state], axis=1),
            np.concatenate([self.covariance, other.covariance]),
            np.concatenate([self.existence, other.existence]),
            np.concatenate([self.hidden, other.hidden]),
            np.concatenate([self.separate, other.separate]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Assignment:
    """The best explanation of a frame.

    ``target`` (N,): the target that each blob belongs to, −1 for none; of a merged blob the first. ``merged``: the targets
    of each merged blob.
    """

    target: I8
    merged: dict[int, tuple[int, ...]]


@dataclass(frozen=True, slots=True)
class MergedMeasurements:
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

    def __post_init__(self) -> None:
        check(self)

    def start(self) -> ExpectedTargets:
        """No targets are expected."""
        return ExpectedTargets.empty()

    def explain(
        self, state: ExpectedTargets, detections: Detections, model: Model, dt: float
    ) -> tuple[ExpectedTargets, Explanation]:
        """The targets expected in this frame, and the detections that the filter gets for them.

        Parameters
        ----------
        state : the targets after the last frame.
        detections : N boxes of this frame.
        model : the model of boxes.
        dt : interval since the last frame, time units.
        """
        targets = predicted(state, model, dt)
        if not (detections.observed and len(targets) and len(detections)):
            return targets, Explanation.unchanged(detections)
        boxes = to_xyxy(model.sensor.expected(targets.state)[:4])
        best = self._assigned(targets, boxes, detections, model)
        return _timed(targets, best, boxes, dt / model.rate), _divided(detections, best, boxes)

    def advance(
        self, targets: ExpectedTargets, explanation: Explanation, estimates: Estimates, model: Model, dt: float
    ) -> ExpectedTargets:
        """The targets after the frame.

        Parameters
        ----------
        targets : those expected in this frame.
        explanation : what `explain` made of the detections.
        estimates : the states that the filter shows.
        model : the model of boxes.
        dt : interval since the last frame, time units.
        """
        if not explanation.detections.observed:
            return targets
        return _updated(targets, explanation.target, estimates, model, dt / model.rate, self.max_hidden_time)

    def _assigned(self, targets: ExpectedTargets, boxes: F8, detections: Detections, model: Model) -> Assignment:
        """The best explanation; it does not depend on the order of blobs or targets."""
        sensor, rows = model.sensor, list(model.sensor.observed)
        z = sensor.measure(detections)
        usable: Bool = np.asarray(np.isfinite(z).all(axis=0), np.bool_)
        spread = EDGES @ targets.covariance[:, rows][:, :, rows] @ EDGES.T
        reach = REACH * np.sqrt(np.maximum(np.einsum("nii->ni", spread), 0.0))
        blob, target = contacts(detections.xyxy, boxes, reach)
        blob, target = blob[usable[blob]], target[usable[blob]]
        of = np.full(len(detections), -1)
        if max(np.bincount(blob, minlength=1).max(), np.bincount(target, minlength=1).max()) < 2:
            of[blob] = target
            return Assignment(of, {})
        kappa = np.zeros(len(detections))
        kappa[usable] = model.clutter.intensity(np.ascontiguousarray(z[:, usable]))
        p, shared = sensor.p_detect(targets.state), _shared_area(detections.xyxy[blob], boxes[target])
        covered = np.zeros(len(targets))
        np.maximum.at(covered, target, shared / np.maximum(area(boxes[target]), TINY))
        missed = targets.existence * (p + (1 - p) * np.minimum(covered, 1.0))
        may_merge, may_hide = targets.separate >= self.min_separate_time, targets.hidden <= self.max_hidden_time
        cells = _Cells(
            self.merge_probability, model, targets.state, detections.xyxy, boxes, z, spread,
            np.log(np.maximum(targets.existence * p, TINY)), np.log(np.maximum(1 - missed, TINY)),
            np.log(np.maximum(kappa, TINY)), may_merge, may_hide,
        )  # fmt: skip
        smaller = np.minimum(area(detections.xyxy[blob]), area(boxes[target]))
        first, last = _ranks(detections.xyxy), _ranks(boxes)
        order = np.lexsort((last[target], first[blob]))
        blob, target, strength = blob[order], target[order], (shared / np.maximum(smaller, TINY))[order]
        merged: dict[int, tuple[int, ...]] = {}
        for blobs, members, pairs in groups(blob, target, strength):
            blobs.sort(key=first.__getitem__)
            members.sort(key=last.__getitem__)
            for b, several in _best(blobs, members, pairs, cells).items():
                of[b] = several[0]
                if len(several) > 1:
                    merged[b] = several
        return Assignment(of, merged)


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Log-likelihoods of the parts of explanations, for the blobs (N) and targets (n) of one frame.

    ``spread`` (n, 4, 4): covariance of the targets' edges; ``seen``, ``missed`` (n,), ``clutter`` (N,): log-likelihoods.
    """

    merge_probability: float
    model: Model
    state: F8
    blobs: F8
    boxes: F8
    z: F8
    spread: F8
    seen: F8
    missed: F8
    clutter: F8
    may_merge: Bool
    may_hide: Bool

    def merged(self, blob: int, targets: tuple[int, ...]) -> float:
        """The blob is these targets, one or more."""
        index, k = np.array(targets), len(targets)
        boxes = self.boxes[index]
        if k > 1 and not (self.may_merge[index].all() and self.may_hide[index][hidden(boxes)].all()):
            return -math.inf
        z, state = self.z[:, [blob] * k], np.ascontiguousarray(self.state[:, index])
        noise = EDGES @ self.model.sensor.covariance(z, state) @ EDGES.T
        mean, covariance = outline(boxes, self.spread[index] + noise)
        step = self.blobs[blob] - mean
        distance2 = float(step @ np.linalg.solve(covariance, step))
        if distance2 > GATE**2:
            return -math.inf
        fit = -0.5 * (distance2 + float(np.linalg.slogdet(2 * np.pi * covariance)[1]))
        return fit + float(self.seen[index].sum()) + (k - 1) * math.log(max(self.merge_probability, TINY))


def contacts(blobs: F8, targets: F8, reach: F8) -> tuple[I8, I8]:
    """Pairs (blob, target) (P,) whose boxes (N, 4) and (n, 4) meet, the targets' edges moved out by ``reach`` (n, 4)."""
    sides = (blobs[:, :2], blobs[:, 2:], (targets - reach)[:, :2], (targets + reach)[:, 2:])
    first, second = meeting(*(np.ascontiguousarray(side.T) for side in sides))
    return first, second


def groups(blob: I8, target: I8, strength: F8) -> Iterator[tuple[list[int], list[int], set[tuple[int, int]]]]:
    """Blobs, targets and pairs (blob, target) of the groups that pairs (P,) connect, of at most `GROUP` members.

    The strongest pairs are joined first; one that would make a group too large is left out.
    """
    of: dict[tuple[bool, int], int] = {}
    members: dict[int, list[tuple[bool, int]]] = {}
    for key, node in enumerate(dict.fromkeys([*((True, b) for b in blob.tolist()), *((False, t) for t in target.tolist())])):
        of[node], members[key] = key, [node]
    pairs: dict[int, set[tuple[int, int]]] = {key: set() for key in members}
    for p in np.argsort(-strength, kind="stable").tolist():
        b, t = int(blob[p]), int(target[p])
        a, c = of[True, b], of[False, t]
        if a != c:
            if len(members[a]) + len(members[c]) > GROUP:
                continue
            for node in members[c]:
                of[node] = a
            members[a] += members.pop(c)
            pairs[a] |= pairs.pop(c)
        pairs[a].add((b, t))
    for key, found in members.items():
        if pairs[key]:
            yield [i for is_blob, i in found if is_blob], [i for is_blob, i in found if not is_blob], pairs[key]


def _best(blobs: list[int], targets: list[int], pairs: set[tuple[int, int]], cells: _Cells) -> dict[int, tuple[int, ...]]:
    """The targets of each blob in the likeliest explanation of a group; of equal ones the first, by enumeration."""
    if len(blobs) == len(targets) == 1:
        return {blobs[0]: (targets[0],)}
    known: dict[tuple[int, tuple[int, ...]], float] = {}
    top, best = -math.inf, dict[int, tuple[int, ...]]()
    for choice in itertools.product(*([-1, *(b for b in blobs if (b, t) in pairs)] for t in targets)):
        of: dict[int, tuple[int, ...]] = {}
        value = 0.0
        for t, b in zip(targets, choice, strict=True):
            if b < 0:
                value += float(cells.missed[t])
            else:
                of[b] = (*of.get(b, ()), t)
        for b in blobs:
            if b not in of:
                value += float(cells.clutter[b])
                continue
            if (b, of[b]) not in known:
                known[b, of[b]] = cells.merged(b, of[b])
            value += known[b, of[b]]
        if value > top:
            top, best = value, of
    return best


def owners(boxes: F8) -> I8:
    """(4,) which of the boxes (k, 4) has each edge of their union."""
    out: I8 = (boxes * OUTWARD).argmax(axis=0)
    return out


def hidden(boxes: F8) -> Bool:
    """(k,) which of the boxes (k, 4) have neither the left nor the right edge of their union."""
    out = np.ones(len(boxes), np.bool_)
    out[owners(boxes)[[0, 2]]] = False
    return out


def outline(boxes: F8, covariance: F8) -> tuple[F8, F8]:
    """The union of boxes (k, 4) with edges of covariance (k, 4, 4) as a Gaussian: its mean (4,) and covariance (4, 4)."""
    owner, side = owners(boxes), np.arange(4)
    same = owner[:, None] == owner[None, :]
    return boxes[owner, side], np.where(same, covariance[owner[:, None], side[:, None], side[None, :]], 0.0)


def placed(blob: F8, boxes: F8) -> tuple[F8, F8]:
    """Where a merged blob (4,) puts its targets' boxes (k, 4), of unchanged size, and how uncertain that is.

    A target lies where the edges that it has put it, midway if it has both; one that has none along an axis stays where it
    is expected, inside the blob. Returns boxes (k, 4), and (k, 2) the standard deviation along x and y of a uniform place
    in the blob for targets that have no edge there, 0 for the others.
    """
    owner, k = owners(boxes), np.arange(len(boxes))
    out, slack = boxes.copy(), np.zeros((len(boxes), 2))
    for axis in (0, 1):
        low, high = blob[axis], blob[axis + 2]
        size = boxes[:, axis + 2] - boxes[:, axis]
        at_low, at_high = owner[axis] == k, owner[axis + 2] == k
        start = np.where(at_low, low, boxes[:, axis])
        start = np.where(at_high, np.where(at_low, (low + high - size) / 2, high - size), start)
        room = high - low - size
        start = np.where(room > 0, np.clip(start, low, np.maximum(low, high - size)), low + room / 2)
        out[:, axis], out[:, axis + 2] = start, start + size
        slack[:, axis] = np.where(at_low | at_high, 0.0, np.maximum(room, 0.0) / np.sqrt(12))
    return out, slack


def predicted(targets: ExpectedTargets, model: Model, dt: float) -> ExpectedTargets:
    """The targets ``dt`` time units later."""
    if not len(targets):
        return targets
    state, before = model.warp_gaussians(np.ascontiguousarray(targets.state), targets.covariance)
    mean, jacobian, noise = model.motion.transition(np.ascontiguousarray(state), dt)
    covariance = jacobian @ before @ jacobian.transpose(0, 2, 1) + noise
    there = targets.existence * model.motion.p_survive(targets.state, dt / model.rate)
    return replace(targets, state=mean, covariance=covariance, existence=there)


def _timed(targets: ExpectedTargets, best: Assignment, boxes: F8, seconds: float) -> ExpectedTargets:
    """The targets with the seconds for which they have been hidden, and have had a blob to themselves."""
    out_of_sight, found = targets.hidden.copy(), best.target[best.target >= 0]
    separate = targets.separate + seconds * np.isin(np.arange(len(targets)), found)
    out_of_sight[found] = 0.0
    for members in best.merged.values():
        index = np.array(members)
        separate[index] = targets.separate[index]
        out_of_sight[index] = np.where(hidden(boxes[index]), targets.hidden[index] + seconds, 0.0)
    return replace(targets, hidden=out_of_sight, separate=separate)


def _divided(detections: Detections, best: Assignment, boxes: F8) -> Explanation:
    """The detections with one for each target of a merged blob, in the order of the blobs."""
    n = len(detections)
    if not best.merged:
        return Explanation(detections, np.arange(n), np.arange(n), best.target)
    source = np.repeat(np.arange(n), [len(best.merged.get(b, (b,))) for b in range(n)])
    part = np.searchsorted(source, np.arange(n))
    out, target = detections.take(source), best.target[source]
    xyxy, variance = out.xyxy.copy(), np.zeros((len(source), 4))
    for b, members in best.merged.items():
        rows = slice(part[b], part[b] + len(members))
        xyxy[rows], slack = placed(detections.xyxy[b], boxes[list(members)])
        variance[rows, :2], target[rows] = np.square(slack), members
    covariance = None if out.covariance is None else out.covariance + variance[:, :, None] * np.eye(4)
    return Explanation(replace(out, xyxy=xyxy, covariance=covariance), source, part, target, changed=True)


def _updated(
    targets: ExpectedTargets, target: I8, estimates: Estimates, model: Model, seconds: float, max_hidden: float
) -> ExpectedTargets:
    """The estimates after a frame, and those expected targets that it does not show but that may be there.

    A target that was missed stays with probability r ← r (1 − p_D)/(1 − r p_D). ``target`` (N,): the target of each
    detection, −1 for none.
    """
    of = _continued(targets, target, estimates, model)
    left, found = np.ones(len(targets), np.bool_), np.zeros(len(targets), np.bool_)
    left[of[of >= 0]] = False
    found[target[target >= 0]] = True
    p = model.sensor.p_detect(targets.state) if len(targets) else np.zeros(0)
    r = targets.existence
    there = np.where(found, r, r * (1 - p) / np.maximum(1 - r * p, 1 - MAX_EXISTENCE))
    left &= (there > MIN_EXISTENCE) & (targets.hidden + seconds <= max_hidden)
    kept = replace(targets, existence=there, hidden=targets.hidden + seconds).take(left)
    # The last place stands for estimates that continue no target.
    before = np.append(targets.hidden, 0.0)[of], np.append(targets.separate, 0.0)[of]
    weight = np.minimum(estimates.weight, MAX_EXISTENCE)
    return ExpectedTargets(estimates.state, estimates.covariance, weight, *before).joined(kept)


def _continued(targets: ExpectedTargets, target: I8, estimates: Estimates, model: Model) -> I8:
    """(k,) the expected target that each estimate continues, −1 for none.

    The target of its detection; where there is none, the nearest that is left, within the gate.
    """
    of: I8 = np.append(target, -1)[estimates.detection].astype(np.int64)
    first = np.zeros(len(of), np.bool_)
    first[np.unique(of, return_index=True)[1]] = True
    of = np.where(first, of, -1)
    free, lost = np.setdiff1d(np.arange(len(targets)), of), np.flatnonzero(of < 0)
    if not len(free) or not len(lost):
        return of
    step = estimates.state[:2, lost, None] - targets.state[:2, None, free]
    noise2 = np.square(model.sensor.noise(targets.state[:, free])[:2]).T
    spread = targets.covariance[free, :2, :2] + noise2[:, :, None] * np.eye(2)
    distance2 = np.einsum("aij,jab,bij->ij", step, np.linalg.inv(spread), step)
    for k in np.argsort(distance2, axis=None, kind="stable"):
        i, j = divmod(int(k), len(free))
        if distance2[i, j] > NEAR:
            break
        of[lost[i]] = free[j]
        distance2[i, :], distance2[:, j] = np.inf, np.inf
    return of


def _ranks(boxes: F8) -> I8:
    """(N,) the rank of each box by its edges, so that nothing depends on the order in which boxes come."""
    rank = np.empty(len(boxes), np.int64)
    rank[np.lexsort(boxes.T[::-1])] = np.arange(len(boxes))
    return rank


def _shared_area(a: F8, b: F8) -> F8:
    """(P,) area that boxes (P, 4) share, pair by pair."""
    side = np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
    out: F8 = side.clip(0.0).prod(axis=1)
    return out
