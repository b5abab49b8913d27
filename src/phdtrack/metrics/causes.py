"""Causes of errors: every miss and every false positive of the CLEAR mapping gets exactly one.

The mapping is that of MOTA (`matching.tracking_mapping`), so the sums equal its misses and false
positives. A box is *detected* if a detection overlaps it at the threshold of the mapping.

A miss has a cause and a position in the life of its object.

* undetected: no detection overlaps the true box; unused: one does, but no track is mapped to it.
* never: the object is never mapped; head: before its first mapped frame; tail: after its last; gap:
  between the two.

A false positive is the first of

* loose: the true box that it overlaps most, by .1 or more, is mapped to no track: the overlap is
  below the threshold;
* ghost: its track is mapped in another frame, and there is no detection here: the track coasts or
  bridges a gap at the wrong place;
* duplicate: it overlaps by half of the threshold or more a true box that is mapped to another
  track;
* clutter: all others. The track follows false alarms, or an object without annotation.

Without detections all misses have the first cause, and a ghost must overlap no true box by .1.
Errors of identity are defined in `identity_errors`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from phdtrack.arrays import iou as overlaps
from phdtrack.metrics.identity_errors import KINDS, IdentityError, identity_errors
from phdtrack.metrics.matching import (
    ROUNDING,
    Matches,
    SequencePair,
    above,
    check_threshold,
    pair_frames,
    tracking_mapping,
)
from phdtrack.types import F8, I8, Bool, DetectionTable, Tracks, Truth

CAUSES = ("undetected", "unused")
PLACES = ("never", "head", "gap", "tail")
FALSE = ("loose", "ghost", "duplicate", "clutter")
# The names of the sums in `Errors.sums`.
SUMS = (*(f"miss_{name}" for name in (*CAUSES, *PLACES)), *(f"false_{name}" for name in FALSE))
# Boxes with less overlap are unrelated.
_NEAR = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """The errors of a sequence by object and by track.

    Attributes
    ----------
    misses : (G, 2, 4) number of misses of each object by `CAUSES` and `PLACES`.
    false : (O, 4) number of false positives of each track by `FALSE`.
    objects, tracks : (G,), (O,) identities.
    boxes, track_boxes : (G,), (O,) number of boxes of each.
    last, track_last : (G,), (O,) the last frame in which each is mapped, 0 for never.
    ignored : number of output boxes that were matched to distractors or lie in ignored regions.
    detected : True if detections were given; otherwise all misses have the first cause.
    identity : errors of identity, frames ascending.
    """

    misses: I8
    false: I8
    objects: I8
    tracks: I8
    boxes: I8
    track_boxes: I8
    last: I8
    track_last: I8
    ignored: int
    detected: bool
    identity: tuple[IdentityError, ...] = ()

    @property
    def causes(self) -> tuple[str, ...]:
        """The names of the causes of misses that can be distinguished."""
        if self.detected:
            return CAUSES
        return ("not tracked",)

    def sums(self) -> dict[str, int]:
        """The numbers of misses by cause and place and of false positives, named as in `SUMS`."""
        misses = self.misses.sum(axis=0)
        numbers = np.concatenate([misses.sum(axis=1), misses.sum(axis=0), self.false.sum(axis=0)])
        return dict(zip(SUMS, numbers.tolist(), strict=True))

    def worst_objects(self, number: int) -> I8:
        """Indices of at most ``number`` objects with misses, most misses first."""
        return _most(self.misses.sum(axis=(1, 2)), number)

    def worst_tracks(self, number: int) -> I8:
        """Indices of at most ``number`` tracks with false positives, most first."""
        return _most(self.false.sum(axis=1), number)

    def identity_sums(self) -> dict[str, int]:
        """The number of errors of identity of each kind: ``swaps``, ``transfers``, ``breaks``."""
        return {f"{kind}s": sum(each.kind == kind for each in self.identity) for kind in KINDS}

    def worst_identity(self, number: int) -> list[IdentityError]:
        """At most ``number`` errors of identity, those with most boxes first."""
        return sorted(self.identity, key=lambda each: -each.boxes)[:number]

    def in_frames(self, numbers: I8) -> Errors:
        """The errors of frames that were numbered from 1, with their own ``numbers``.

        Parameters
        ----------
        numbers : (F,) the number of each frame.
        """
        known = np.append(0, numbers)
        return replace(
            self,
            last=known[self.last],
            track_last=known[self.track_last],
            identity=tuple(each._replace(frame=int(known[each.frame])) for each in self.identity),
        )

    def as_dict(self, worst: int) -> dict[str, object]:
        """The sums, and at most ``worst`` objects and tracks with most errors and errors of
        identity, for JSON.
        """
        misses = self.misses.sum(axis=0).tolist()
        false = self.false.sum(axis=0).tolist()
        objects = [
            {
                "identity": int(self.objects[i]),
                "boxes": int(self.boxes[i]),
                "misses": self._by_cause(self.misses[i].tolist()),
                "last": int(self.last[i]),
            }
            for i in self.worst_objects(worst)
        ]
        tracks = [
            {
                "identity": int(self.tracks[i]),
                "boxes": int(self.track_boxes[i]),
                "last": int(self.track_last[i]),
                "false_positives": dict(zip(FALSE, self.false[i].tolist(), strict=True)),
            }
            for i in self.worst_tracks(worst)
        ]
        return {
            "misses": self._by_cause(misses),
            "false_positives": dict(zip(FALSE, false, strict=True)),
            "ignored": self.ignored,
            "worst_objects": objects,
            "worst_tracks": tracks,
            "identity": self.identity_sums(),
            "worst_identity": [each._asdict() for each in self.worst_identity(worst)],
        }

    def _by_cause(self, table: list[list[int]]) -> dict[str, dict[str, int]]:
        """A table of misses (2, 4) with the names of causes and places."""
        rows = zip(self.causes, table, strict=False)
        return {cause: dict(zip(PLACES, row, strict=True)) for cause, row in rows}


def _most(number: I8, limit: int) -> I8:
    """Indices of at most ``limit`` numbers above 0, the largest first."""
    order = np.argsort(-number, kind="stable")[:limit]
    return order[number[order] > 0]


class _Rows(NamedTuple):
    """The M boxes of one side, frames ascending.

    Their frame, the index of their identity, and whether they are mapped and detected; the largest
    overlap with a box of the other side, and whether that box is mapped. (M,) each.
    """

    frame: I8
    identity: I8
    mapped: Bool
    detected: Bool
    best_iou: F8
    best_mapped: Bool

    def mapped_span(self, size: int) -> tuple[I8, I8]:
        """(size,) for each identity the first and the last frame in which it is mapped, 0 for
        never.
        """
        first, last = np.zeros((2, size), np.int64)
        frame = self.frame[self.mapped]
        identity = self.identity[self.mapped]
        # Of repeated indices the last value is kept.
        first[identity[::-1]] = frame[::-1]
        last[identity] = frame
        return first, last


_NONE = np.zeros(0, np.int64)
_NO_ROWS = _Rows(_NONE, _NONE, _NONE > 0, _NONE > 0, np.zeros(0), _NONE > 0)


def explain(
    truth: Truth,
    tracks: Tracks,
    detections: DetectionTable | None = None,
    *,
    frames: int = 0,
    iou: float = 0.5,
) -> Errors:
    """The misses and false positives of ``tracks`` against ``truth`` by cause. Raises `InputError`
    for arguments that `evaluate` refuses.

    Parameters
    ----------
    truth, tracks : annotated boxes, output boxes; rows that `evaluate` ignores are ignored here.
    detections : the input of the tracker; None: unknown.
    frames : number of frames of the sequence, later rows are ignored; 0: up to the last row of
        either side.
    iou : the overlap from which a pair of boxes may match, in (0, 1].

    Returns
    -------
    Each error with its cause.
    """
    check_threshold(iou)
    sequence = pair_frames(truth, tracks, frames)
    mapping = tracking_mapping(sequence, iou)
    true, output = _sides(sequence, mapping, (truth.xyxy, tracks.xyxy), detections, iou)
    objects = len(sequence.truth_identity)
    outputs = len(sequence.output_identity)
    first, last = true.mapped_span(objects)
    _, track_last = output.mapped_span(outputs)

    missed = ~true.mapped
    frame = true.frame[missed]
    missed_object = true.identity[missed]
    place = np.select(
        [
            last[missed_object] == 0,
            frame < first[missed_object],
            frame < last[missed_object],
        ],
        [0, 1, 2],
        3,
    )
    misses = np.zeros((objects, len(CAUSES), len(PLACES)), np.int64)
    np.add.at(misses, (missed_object, true.detected[missed].astype(np.int64), place), 1)

    wrong = ~output.mapped
    wrong_track = output.identity[wrong]
    overlap = output.best_iou[wrong]
    near = overlap >= _NEAR
    unsupported = ~near if detections is None else ~output.detected[wrong]
    ghost = (track_last[wrong_track] > 0) & unsupported
    duplicate = overlap >= iou / 2 - ROUNDING
    cause = np.select([near & ~output.best_mapped[wrong], ghost, duplicate], [0, 1, 2], 3)
    false = np.zeros((outputs, len(FALSE)), np.int64)
    np.add.at(false, (wrong_track, cause), 1)

    return Errors(
        misses=misses,
        false=false,
        objects=sequence.truth_identity,
        tracks=sequence.output_identity,
        boxes=np.bincount(true.identity, minlength=objects),
        track_boxes=np.bincount(output.identity, minlength=outputs),
        last=last,
        track_last=track_last,
        ignored=sequence.ignored,
        detected=detections is not None,
        identity=identity_errors(sequence, mapping),
    )


def _sides(
    sequence: SequencePair,
    mapping: Matches,
    xyxy: tuple[F8, F8],
    detections: DetectionTable | None,
    iou: float,
) -> tuple[_Rows, _Rows]:
    """The true and the output boxes; the pairs refer to the rows of ``xyxy``."""
    edges = np.searchsorted(mapping.position, np.arange(len(sequence.pairs) + 1))
    true = [_NO_ROWS]
    output = [_NO_ROWS]
    for k, pair in enumerate(sequence.pairs):
        detected = np.zeros((0, 4))
        if detections is not None:
            detected = detections.at(pair.number).xyxy
        now = slice(edges[k], edges[k + 1])
        truth_mapped = np.isin(pair.truth, mapping.truth[now])
        output_mapped = np.isin(pair.output, mapping.output[now])
        true.append(
            _Rows(
                np.full(len(pair.truth), pair.number),
                pair.truth,
                truth_mapped,
                _overlaps_any(xyxy[0][pair.truth_row], detected, iou),
                *_best(pair.iou, output_mapped),
            )
        )
        output.append(
            _Rows(
                np.full(len(pair.output), pair.number),
                pair.output,
                output_mapped,
                _overlaps_any(xyxy[1][pair.output_row], detected, iou),
                *_best(pair.iou.T, truth_mapped),
            )
        )
    return (
        _Rows(*map(np.concatenate, zip(*true, strict=True))),
        _Rows(*map(np.concatenate, zip(*output, strict=True))),
    )


def _overlaps_any(boxes: F8, others: F8, iou: float) -> Bool:
    """(n,) True for boxes (n, 4) that overlap one of the others (m, 4) by at least ``iou``."""
    overlapping: Bool = above(overlaps(boxes, others), iou).max(axis=1, initial=0.0) > 0
    return overlapping


def _best(overlap: F8, other_mapped: Bool) -> tuple[F8, Bool]:
    """(n,) the largest ``overlap`` (n, m) of each box with the other side, and whether that box is
    mapped.
    """
    if not overlap.size:
        return np.zeros(len(overlap)), np.zeros(len(overlap), np.bool_)
    return overlap.max(axis=1), other_mapped[overlap.argmax(axis=1)]
