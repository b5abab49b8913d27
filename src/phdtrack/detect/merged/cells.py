"""What the model says of the cells that explanations are made of, and the best explanation of a frame.

    missed      1 − r (p_D + (1 − p_D) c)         r: the target is there; c: part of it that blobs cover
    one blob    r p_D N(z; h(x), R + H P Hᵀ)
    merged      ∏ r p_D · ρ^(k−1) · N(edges of the blob; the targets' outermost edges)
    in pieces   r p_D · φ^(k−1) · N(union of the pieces; h(x), R + H P Hᵀ) · u^(k−1)
    nobody      κ(z)

ρ is the probability that targets that touch become one blob, φ that one falls into one more piece, u = 4/(wh)² the density
of a piece's own edges anywhere inside the target. Where something has changed nobody is overlooked: a target that a blob
covers is part of it, or has gone. Pieces make a target of the size that it had when it was whole; else two who part would
be one that grows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import area, to_xyxy
from phdtrack.detect.merged.contacts import Group, canonical, contacts, groups
from phdtrack.detect.merged.edges import edge_covariance, log_normal, outline, owners, union
from phdtrack.detect.merged.expected import Expected
from phdtrack.detect.merged.explanations import best
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Bool, Detections

# Targets and blobs touch where they meet once the targets' edges are moved out by so many deviations.
_REACH = 1.0
_LEAST = 1e-300


@dataclass(frozen=True, slots=True)
class Rules:
    """Probabilities ``merge`` ρ and ``split`` φ; the ``gate`` in deviations; sizes of groups and numbers of pieces."""

    merge: float
    split: float
    gate: float
    most: int
    pieces: int


@dataclass(frozen=True, slots=True, eq=False)
class May:
    """(n,) whether each target may ``share`` a blob, be hidden in one (``hide``), be in pieces (``tear``)."""

    share: Bool
    hide: Bool
    tear: Bool


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Blobs and targets of one frame.

    Attributes
    ----------
    blobs : (N, 4) xyxy.      boxes : (n, 4) of the targets.
    usual : (n, 4) the same of the size that each had when it was whole.
    z : (m, N) measurements of the blobs.      seen, lost : (n,) r p_D, and r p of those missed.      kappa : (N,).
    prior : (n, 4, 4) covariance of the targets' edges.
    """

    rules: Rules
    model: Model
    detections: Detections
    state: F8
    blobs: F8
    boxes: F8
    usual: F8
    z: F8
    seen: F8
    lost: F8
    kappa: F8
    prior: F8
    may: May

    def clutter(self, blob: int) -> float:
        """log κ(z)."""
        return math.log(max(float(self.kappa[blob]), _LEAST))

    def missed(self, target: int) -> float:
        """log(1 − r p), p the probability that the target shows where it is expected."""
        return math.log(max(1.0 - float(self.lost[target]), _LEAST))

    def merged(self, blob: int, targets: tuple[int, ...]) -> float:
        """The blob is these targets, one or more."""
        index = np.array(targets)
        boxes = self.boxes[index]
        if len(index) > 1 and not (self.may.share[index].all() and self.may.hide[index][hidden(boxes)].all()):
            return -math.inf
        noise = self._noise(self.z[:, [blob] * len(index)], index)
        mean, covariance = outline(boxes, self.prior[index] + noise)
        fit = log_normal(self.blobs[blob], mean, covariance, self.rules.gate)
        return fit + self._there(index) + (len(index) - 1) * math.log(max(self.rules.merge, _LEAST))

    def split(self, target: int, blobs: tuple[int, ...]) -> float:
        """These blobs, two or more, are the target's pieces."""
        if not self.may.tear[target] or not self.rules.split:
            return -math.inf
        index = np.array([target])
        around = union(self.blobs[list(blobs)])
        whole = one(self.detections, list(blobs), around)
        noise = self._noise(self.model.sensor.measure(whole), index)
        fit = log_normal(around, self.usual[target], self.prior[target] + noise[0], self.rules.gate)
        width, height = self.usual[target, 2:] - self.usual[target, :2]
        more = math.log(self.rules.split) + math.log(4.0) - 2 * math.log(max(width * height, _LEAST))
        return fit + self._there(index) + (len(blobs) - 1) * more

    def _there(self, index: I8) -> float:
        return float(np.log(np.maximum(self.seen[index], _LEAST)).sum())

    def _noise(self, z: F8, index: I8) -> F8:
        """(k, 4, 4) covariance of the edges that the sensor reports of the targets."""
        return edge_covariance(self.model.sensor.covariance(z, np.ascontiguousarray(self.state[:, index])))


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The best explanation.

    Attributes
    ----------
    who : (N,) the target that each blob belongs to, −1 for nobody; of a merged one the first.
    alone : (n,) which targets touch no second blob.
    merged : the targets of each merged blob.      torn : the pieces of each target that is in several.
    """

    who: I8
    alone: Bool
    merged: dict[int, tuple[int, ...]]
    torn: dict[int, tuple[int, ...]]


def hidden(boxes: F8) -> Bool:
    """(k,) which of the boxes (k, 4) own neither the left nor the right edge of their union."""
    own = owners(boxes)
    out = np.ones(len(boxes), np.bool_)
    out[own[[0, 2]]] = False
    return out


def one(detections: Detections, pieces: list[int], box: F8) -> Detections:
    """A detection of the ``box`` (4,) that these pieces make: as sure as the surest, of the largest's class and noise."""
    sizes = detections.xyxy[pieces, 2:] - detections.xyxy[pieces, :2]
    largest = detections.take(np.array([pieces[int(sizes.prod(axis=1).argmax())]]))
    confidence = detections.confidence[pieces].max(keepdims=True)
    return Detections(box[None], confidence, largest.class_id, largest.covariance, detections.observed)


def explained(rules: Rules, targets: Expected, detections: Detections, model: Model, may: May) -> Found:
    """The best explanation of a frame's blobs. The order in which blobs or targets come does not matter."""
    sensor, rows = model.sensor, list(model.sensor.observed)
    z = sensor.measure(detections)
    usable: Bool = np.asarray(np.isfinite(z).all(axis=0), np.bool_)
    boxes = to_xyxy(sensor.expected(targets.state)[:4])
    prior = edge_covariance(targets.covariance[:, rows][:, :, rows])
    reach = _REACH * np.sqrt(np.maximum(np.einsum("nii->ni", prior), 0.0))
    blob, target = contacts(detections.xyxy, boxes, reach)
    blob, target = blob[usable[blob]], target[usable[blob]]
    who = np.full(len(detections), -1)
    alone: Bool = np.less(np.bincount(target, minlength=len(targets)), 2)
    if alone.all() and np.bincount(blob, minlength=1).max() < 2:
        who[blob] = target
        return Found(who, alone, {}, {})
    kappa = np.zeros(len(detections))
    kappa[usable] = model.clutter.intensity(np.ascontiguousarray(z[:, usable]))
    p = sensor.p_detect(targets.state)
    cover = _covered(detections.xyxy[blob], boxes, target)
    seen, lost = targets.existence * p, targets.existence * (p + (1 - p) * cover)
    usual = to_xyxy(np.concatenate([sensor.expected(targets.state)[:2], targets.size.T]))
    cells = Cells(rules, model, detections, targets.state, detections.xyxy, boxes, usual, z, seen, lost, kappa, prior, may)
    place, rank = canonical(detections.xyxy), canonical(boxes)
    order = np.lexsort((rank[target], place[blob]))
    blob, target = blob[order], target[order]
    merged: dict[int, tuple[int, ...]] = {}
    torn: dict[int, tuple[int, ...]] = {}
    for group, inside in groups(blob, target, _overlap(cells.blobs[blob], boxes[target]), rules.most):
        _settle(group, inside, cells, place, rank, (who, merged, torn))
    return Found(who, alone, merged, torn)


def _settle(
    group: Group,
    inside: set[tuple[int, int]],
    cells: Cells,
    place: I8,
    rank: I8,
    out: tuple[I8, dict[int, tuple[int, ...]], dict[int, tuple[int, ...]]],
) -> None:
    """Put the group's best explanation into ``out``, which the caller owns."""
    who, merged, torn = out
    blobs, targets = sorted(group[0], key=place.__getitem__), sorted(group[1], key=rank.__getitem__)
    if len(blobs) == len(targets) == 1:
        who[blobs[0]] = targets[0]
        return
    shared: dict[int, tuple[int, ...]] = {}
    for t, given in zip(targets, best(blobs, targets, inside, cells, cells.rules.pieces), strict=True):
        for b in given:
            who[b] = t if who[b] < 0 else who[b]
        if len(given) > 1:
            torn[t] = given
        elif given:
            shared[given[0]] = (*shared.get(given[0], ()), t)
    merged.update({b: several for b, several in shared.items() if len(several) > 1})


def _covered(blobs: F8, boxes: F8, target: I8) -> F8:
    """(n,) the part of each of the ``boxes`` (n, 4) that the blob which covers most of it covers; pairs (P,)."""
    out = np.zeros(len(boxes))
    np.maximum.at(out, target, _shared(blobs, boxes[target]) / np.maximum(area(boxes[target]), _LEAST))
    return np.minimum(out, 1.0)


def _shared(a: F8, b: F8) -> F8:
    """(P,) area that boxes (P, 4) share, pair by pair."""
    side = np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
    out: F8 = side.clip(0.0).prod(axis=1)
    return out


def _overlap(a: F8, b: F8) -> F8:
    """(P,) shared area of boxes (P, 4), pair by pair, as a part of the smaller one's."""
    out: F8 = _shared(a, b) / np.maximum(np.minimum(area(a), area(b)), _LEAST)
    return out
