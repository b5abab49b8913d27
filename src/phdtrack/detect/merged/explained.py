"""One detection for each target, of blobs that several targets share and of pieces of one.

Small groups of blobs and expected targets that touch are explained by what the model says of them (`blobs.cells`). Where
a blob is several targets, each of them gets a detection of the size that is expected of it, where the blob's edges put
it; where a target is in pieces it gets their union. Everything else stays as it was detected, and where no blob touches
two targets and no target two blobs, nothing happens at all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge

from phdtrack.arrays import to_xyxy
from phdtrack.checks import NonNegative, Positive, Probability, check
from phdtrack.detect.merged.cells import Found, May, Rules, explained, hidden, one
from phdtrack.detect.merged.edges import fitted, union
from phdtrack.detect.merged.expected import Expected, predicted, seen
from phdtrack.protocols import Model
from phdtrack.types import F8, Detections, Estimates, Explanation


@dataclass(frozen=True, slots=True)
class Explained:
    """Merged blobs parted and pieces joined, for boxes in the image.

    Parameters
    ----------
    merge : probability ρ that targets that touch are reported as one blob; 0: blobs are never parted.
    split : probability φ that a target falls into one more piece; 0: pieces are never joined. Background detectors join
        theirs themselves, and those of another are joined wrongly now and then.
    known : seconds for which a target must have had a blob of its own before it may share one.
    patience : seconds for which a target may be hidden in a blob, between the edges of others.
    torn : seconds for which the pieces of a target may follow it; what is in pieces for longer is several.
    gate_sigmas : deviations beyond which a blob does not fit.
    most : blobs and targets that are explained together.
    pieces : the most pieces that a target falls into.
    """

    merge: Probability = 0.5
    split: Probability = 0.0
    known: NonNegative = 0.4
    patience: NonNegative = 3.0
    torn: NonNegative = 1.0
    gate_sigmas: Positive = 5.0
    most: Annotated[int, Ge(3)] = 6
    pieces: Annotated[int, Ge(1)] = 3

    def __post_init__(self) -> None:
        check(self)

    def start(self) -> Expected:
        """Nobody is expected."""
        return Expected.nobody()

    def explain(self, state: Expected, detections: Detections, model: Model, dt: float) -> tuple[Expected, Explanation]:
        """The targets expected in this frame, and the detections that the filter is to be given for them."""
        targets, n = predicted(state, model, dt), len(detections)
        found = None
        if detections.observed and len(targets) and n:
            rules = Rules(self.merge, self.split, self.gate_sigmas, self.most, self.pieces)
            may = May(targets.alone >= self.known, targets.hidden <= self.patience, targets.pieces <= self.torn)
            found = explained(rules, targets, detections, model, may)
        if found is None:
            return targets, Explanation.unchanged(detections)
        boxes = to_xyxy(model.sensor.expected(targets.state)[:4])
        return _timed(targets, found, boxes, dt / model.rate), _told(detections, found, boxes)

    def advance(
        self, targets: Expected, explanation: Explanation, estimates: Estimates, model: Model, dt: float
    ) -> Expected:
        """The targets after the frame, of which the filter showed ``estimates``."""
        if not explanation.detections.observed:
            return targets
        return seen(targets, explanation.target, estimates, model, dt / model.rate, self.patience)


def _timed(targets: Expected, found: Found, boxes: F8, span: float) -> Expected:
    """The targets with the seconds for which they have been hidden, or in pieces."""
    out_of_sight, pieces = targets.hidden.copy(), np.where(found.alone, 0.0, targets.pieces)
    alone = targets.alone + span * np.isin(np.arange(len(targets)), found.target)
    out_of_sight[found.target[found.target >= 0]] = 0.0
    for members in found.merged.values():
        those = np.array(members)
        alone[those] = targets.alone[those]
        out_of_sight[those] = np.where(hidden(boxes[those]), targets.hidden[those] + span, 0.0)
    torn = list(found.torn)
    pieces[torn] = targets.pieces[torn] + span
    return replace(targets, hidden=out_of_sight, pieces=pieces, alone=alone)


def _told(detections: Detections, found: Found, boxes: F8) -> Explanation:
    """What the filter is given, in the order of the blobs that it rests on."""
    n = len(detections)
    if not found.merged and not found.torn:
        return Explanation(detections, np.arange(n), np.arange(n), found.target, changed=False)
    parts: list[tuple[int, Detections, int]] = []
    part, used = np.full(n, -1), set(found.merged)
    for b, members in found.merged.items():
        placed, slack = fitted(detections.xyxy[b], boxes[list(members)])
        shared = detections.take(np.full(len(members), b))
        parts += [(b, _at(shared, k, placed, slack), t) for k, t in enumerate(members)]
    for t, pieces in found.torn.items():
        whole = one(detections, list(pieces), union(detections.xyxy[list(pieces)]))
        first = min(pieces)
        parts.append((first, whole, t))
        part[list(pieces)] = first
        used.update(pieces)
    parts += [(b, detections.take(np.array([b])), int(found.target[b])) for b in range(n) if b not in used]
    parts.sort(key=lambda told: told[0])
    source = np.array([b for b, _, _ in parts])
    start = np.searchsorted(source, np.where(part < 0, np.arange(n), part))
    who = np.array([t for _, _, t in parts])
    return Explanation(_together([d for _, d, _ in parts]), source, start, who, changed=True)


def _at(shared: Detections, k: int, placed: F8, slack: F8) -> Detections:
    """The k-th of the detections of a shared blob, at its place and as uncertain as that is."""
    own = shared.take(np.array([k]))
    covariance = own.covariance
    if covariance is not None:
        covariance = covariance + np.diag(np.append(np.square(slack[k]), [0.0, 0.0]))
    return replace(own, xyxy=placed[[k]], covariance=covariance)


def _together(parts: list[Detections]) -> Detections:
    """The detections end to end."""
    covariances = [d.covariance for d in parts if d.covariance is not None]
    return Detections(
        np.concatenate([d.xyxy for d in parts]),
        np.concatenate([d.confidence for d in parts]),
        np.concatenate([d.class_id for d in parts]),
        np.concatenate(covariances) if covariances else None,
    )
