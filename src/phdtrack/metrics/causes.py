"""Why are there misses and false boxes: each of the CLEAR mapping gets exactly one cause, and the
worst tracks are named.

The mapping is that of MOTA (`matching.tracking_mapping`), so the sums equal its misses and false
positives. A box is *detected* where a detection overlaps it at the threshold of the mapping.

A miss has a cause and a place in the life of its object.

* undetected: no detection overlaps the true box; unused: one does, and no track is mapped there.
* never: the object is mapped in no frame; head: before its first mapped frame; tail: after its
  last; gap: between.

A false box is the first of

* loose: the true box that it overlaps most, by .1 or more, is mapped to no track. The threshold was
  not reached;
* ghost: its track is mapped in another frame, and nothing is detected here: shown where its object
  had been, or bridged;
* duplicate: it overlaps a true box by half of the threshold or more, which then is mapped to
  another track;
* clutter: all others. The track follows false alarms, or an object that nobody annotated.

Without detections the first cause of misses holds all of them, and a ghost must overlap no true box
by .1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from phdtrack.arrays import iou as overlaps
from phdtrack.metrics.matching import (
    ROUNDING,
    Scene,
    above,
    build,
    check_threshold,
    tracking_mapping,
)
from phdtrack.types import F8, I8, Bool, DetectionTable, Tracks, Truth

CAUSES = ("undetected", "unused")
PLACES = ("never", "head", "gap", "tail")
FALSE = ("loose", "ghost", "duplicate", "clutter")
# The names of the sums in `Errors.sums`.
SUMS = (*(f"miss_{name}" for name in (*CAUSES, *PLACES)), *(f"false_{name}" for name in FALSE))
# Boxes that overlap less have nothing to do with each other.
_NEAR = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """The errors of a sequence by object and by track.

    Attributes
    ----------
    misses : (G, 2, 4) number of misses of each object by `CAUSES` and `PLACES`.
    false : (O, 4) number of false boxes of each track by `FALSE`.
    objects, tracks : (G,), (O,) identities.
    boxes, shown : (G,), (O,) number of boxes of each.
    last, last_shown : (G,), (O,) the last frame in which each is mapped, 0 where none is.
    ignored : number of output boxes that fell to distractors and ignored regions, and count as
        nothing.
    detected : whether detections were given; else all misses stand under the first cause.
    """

    misses: I8
    false: I8
    objects: I8
    tracks: I8
    boxes: I8
    shown: I8
    last: I8
    last_shown: I8
    ignored: int
    detected: bool

    @property
    def causes(self) -> tuple[str, ...]:
        """The names of the causes of misses that can be told apart."""
        if self.detected:
            return CAUSES
        return ("not tracked",)

    def sums(self) -> dict[str, int]:
        """The numbers of misses by cause and by place, and of false boxes, by `SUMS`."""
        misses = self.misses.sum(axis=0)
        numbers = np.concatenate([misses.sum(axis=1), misses.sum(axis=0), self.false.sum(axis=0)])
        return dict(zip(SUMS, numbers.tolist(), strict=True))

    def worst_objects(self, number: int) -> I8:
        """Indices of the objects with most misses, of ``number`` at most."""
        return _most(self.misses.sum(axis=(1, 2)), number)

    def worst_tracks(self, number: int) -> I8:
        """Indices of the tracks with most false boxes, of ``number`` at most."""
        return _most(self.false.sum(axis=1), number)

    def as_dict(self, worst: int) -> dict[str, object]:
        """The sums, and the ``worst`` objects and tracks, by name for JSON."""
        misses = self.misses.sum(axis=0).tolist()
        false = self.false.sum(axis=0).tolist()
        objects = [
            {"identity": int(self.objects[i]), "boxes": int(self.boxes[i]), "misses": self._cells(self.misses[i].tolist()),
             "last": int(self.last[i])}
            for i in self.worst_objects(worst)
        ]  # fmt: skip
        tracks = [
            {"identity": int(self.tracks[i]), "boxes": int(self.shown[i]), "last": int(self.last_shown[i]),
             "false_positives": dict(zip(FALSE, self.false[i].tolist(), strict=True))}
            for i in self.worst_tracks(worst)
        ]  # fmt: skip
        by_cause = {
            "misses": self._cells(misses),
            "false_positives": dict(zip(FALSE, false, strict=True)),
        }
        return {
            **by_cause,
            "ignored": self.ignored,
            "worst_objects": objects,
            "worst_tracks": tracks,
        }

    def _cells(self, table: list[list[int]]) -> dict[str, dict[str, int]]:
        """A table of misses (2, 4) by the names of causes and places."""
        rows = zip(self.causes, table, strict=False)
        return {cause: dict(zip(PLACES, row, strict=True)) for cause, row in rows}


def _most(number: I8, most: int) -> I8:
    """Indices of the largest numbers above 0, the largest first."""
    order = np.argsort(-number, kind="stable")[:most]
    return order[number[order] > 0]


class _Rows(NamedTuple):
    """The (M,) boxes of one side, frames ascending.

    Their frame, index of identity, whether it is mapped, whether it is detected, the largest
    overlap with a box of the other side, and whether that one is mapped.
    """

    frame: I8
    who: I8
    mapped: Bool
    detected: Bool
    best: F8
    rival: Bool

    def lives(self, size: int) -> tuple[I8, I8]:
        """(size,) of each identity: the first and last frame in which it is mapped, 0 for none."""
        first, last = np.zeros((2, size), np.int64)
        frame = self.frame[self.mapped]
        who = self.who[self.mapped]
        # Where an index comes more than once the last value is kept.
        first[who[::-1]] = frame[::-1]
        last[who] = frame
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
    """The misses and false boxes of ``tracks`` against ``truth`` by cause, as the module says.
    Raises `InputError` for what `evaluate` would refuse.

    Parameters
    ----------
    truth, tracks : annotated boxes, output boxes; what is ignored in `evaluate` is ignored here.
    detections : what the tracker was given; None: not known.
    frames : number of frames of the sequence, later rows are left out; 0: up to the last row of
        either side.
    iou : the overlap from which a pair of boxes may match, in (0, 1].
    """
    check_threshold(iou)
    scene = build(truth, tracks, frames)
    given = detections is not None
    true, shown = _sides(scene, (truth.xyxy, tracks.xyxy), detections, iou)
    objects = len(scene.truth_identity)
    outputs = len(scene.output_identity)
    first, last = true.lives(objects)
    _, last_shown = shown.lives(outputs)

    missed = ~true.mapped
    frame = true.frame[missed]
    who = true.who[missed]
    place = np.select([last[who] == 0, frame < first[who], frame < last[who]], [0, 1, 2], 3)
    misses = np.zeros((objects, len(CAUSES), len(PLACES)), np.int64)
    np.add.at(misses, (who, true.detected[missed].astype(np.int64), place), 1)

    wrong = ~shown.mapped
    who = shown.who[wrong]
    near = shown.best[wrong] >= _NEAR
    ghost = (last_shown[who] > 0) & ~(shown.detected[wrong] if given else near)
    twice = shown.best[wrong] >= iou / 2 - ROUNDING
    cause = np.select([near & ~shown.rival[wrong], ghost, twice], [0, 1, 2], 3)
    false = np.zeros((outputs, len(FALSE)), np.int64)
    np.add.at(false, (who, cause), 1)

    return Errors(
        misses=misses,
        false=false,
        objects=scene.truth_identity,
        tracks=scene.output_identity,
        boxes=np.bincount(true.who, minlength=objects),
        shown=np.bincount(shown.who, minlength=outputs),
        last=last,
        last_shown=last_shown,
        ignored=scene.ignored,
        detected=given,
    )


def _sides(
    scene: Scene, xyxy: tuple[F8, F8], detections: DetectionTable | None, iou: float
) -> tuple[_Rows, _Rows]:
    """The true and the output boxes, which are rows of ``xyxy``."""
    mapping = tracking_mapping(scene, iou)
    edges = np.searchsorted(mapping.position, np.arange(len(scene.pairs) + 1))
    parts = [_NO_ROWS], [_NO_ROWS]
    for k, pair in enumerate(scene.pairs):
        now = slice(edges[k], edges[k + 1])
        if detections is None:
            seen = np.zeros((0, 4))
        else:
            seen = detections.at(pair.number).xyxy
        mapped = np.isin(pair.truth, mapping.truth[now]), np.isin(pair.output, mapping.output[now])
        sides = (pair.truth, pair.truth_row, pair.iou), (pair.output, pair.output_row, pair.iou.T)
        for side, (who, row, overlap) in enumerate(sides):
            detected: Bool = (
                above(overlaps(xyxy[side][row], seen), iou).max(axis=1, initial=0.0) > 0
            )
            if overlap.size:
                rival = mapped[1 - side][overlap.argmax(axis=1)]
            else:
                rival = np.zeros(len(who), np.bool_)
            best = overlap.max(axis=1, initial=0.0)
            parts[side].append(
                _Rows(np.full(len(who), pair.number), who, mapped[side], detected, best, rival)
            )
    true, shown = (_Rows(*map(np.concatenate, zip(*part, strict=True))) for part in parts)
    return true, shown
