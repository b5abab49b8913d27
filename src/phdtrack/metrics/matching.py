"""Truth and output of one sequence laid side by side, frame by frame, and the mappings between their boxes.

Every metric keeps sums, and forms quotients last: pooling sequences is adding their sums (`total`).

Before anything is scored, three things happen here. Both sides are checked. Distractors are taken out the way MOTChallenge
does it since MOT16: in each frame all annotated boxes, distractors included, are matched with the output for the largest
total overlap among pairs at IoU ≥ 0.5; output boxes that fall to a distractor are removed, then the distractors. Rows are
put into an order of frame, then box, so that no score depends on the order of rows, even where two assignments tie.

Notation: n annotated and m output boxes in a frame; G annotated and O output identities in the sequence, known by index.

Scores differ in the mapping that they count on:

* `detection_mapping`: the largest total overlap among pairs at IoU ≥ threshold, each frame for itself. MODA, MODP.
* `tracking_mapping`: first as many pairs as possible of those that were mapped before, then the largest total overlap.
  N_MODA, MOTA, MOTP, switches, fragments, delays, false tracks.
* Those of `identity.py`: overlap weighted by how well the two identities agree over the sequence (HOTA), and one mapping of
  identities for the sequence (IDF1).

"Mapped before" means: in the last frame that held boxes on both sides. A frame with an empty side neither breaks nor makes a
mapping, in agreement with TrackEval's CLEAR [M09 (22)–(25)].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from phdtrack.arrays import iou
from phdtrack.errors import InputError
from phdtrack.types import F8, I8, Tracks, Truth

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")


def total(parts: Sequence[T]) -> T:
    """The sum, field by field, of frozen dataclasses of one type whose fields can be added, or are such dataclasses."""
    first = parts[0]
    sums = {}
    for field in fields(first):
        values = [getattr(part, field.name) for part in parts]
        sums[field.name] = total(values) if is_dataclass(values[0]) else sum(values[1:], values[0])
    return type(first)(**sums)


def ratio(numerator: float, denominator: float) -> float:
    """The quotient; NaN where nothing was counted in the denominator."""
    return numerator / denominator if denominator else math.nan


# Overlaps are quotients of sums; one rounding below the threshold still counts as on it, as in TrackEval.
ROUNDING = float(np.finfo(np.float64).eps)


def above(overlap: F8, threshold: float) -> F8:
    """``overlap`` (n, m) where it reaches ``threshold``, 0 elsewhere."""
    return np.where(overlap >= threshold - ROUNDING, overlap, 0.0)


def assign(score: F8) -> tuple[I8, I8]:
    """Rows and columns (k,) of the one-to-one mapping with the largest total ``score`` (n, m), less its pairs of score 0."""
    # Imported here: it takes most of a second, and the command line starts without it.
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(score, maximize=True)
    real = score[rows, columns] > 0
    return rows[real].astype(np.int64), columns[real].astype(np.int64)


def cheapest(cost: F8) -> tuple[I8, I8]:
    """Rows and columns (min(n, m),) of the mapping of the smaller side into the larger with the least ``cost`` (n, m)."""
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(cost)
    return rows.astype(np.int64), columns.astype(np.int64)


DISTRACTOR_IOU = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class FramePair:
    """One frame: ``truth`` (n,) and ``output`` (m,) indices of identities, ``iou`` (n, m) between their boxes."""

    number: int
    truth: I8
    output: I8
    iou: F8


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A sequence ready to be scored.

    Attributes
    ----------
    pairs : the frames that hold a box on at least one side, ascending.
    frames : the number of frames of the sequence, empty ones included.
    truth_identity, output_identity : (G,), (O,) the identities behind the indices; O counts what distractors left over.
    truth_boxes, output_boxes : (F,) number of boxes on each side of each of the F ``pairs``.
    """

    pairs: tuple[FramePair, ...]
    frames: int
    truth_identity: I8
    output_identity: I8
    truth_boxes: I8
    output_boxes: I8


def build(truth: Truth, tracks: Tracks, frames: int = 0) -> Scene:
    """Lay ``truth`` beside ``tracks`` over the frames 1…``frames``, leaving later rows out; 0: all frames of either.

    Parameters
    ----------
    truth : annotated boxes.
    tracks : output boxes.
    frames : number of frames of the sequence, later rows are left out; 0: up to the last row of either side.

    Raises
    ------
    InputError : for wrong shapes, frame numbers below 1, boxes without finite extent, or an identity twice in a frame.
    """
    if frames < 0:
        raise InputError(f"expected a number of frames ≥ 0, got {frames}", where="frames")
    _check(truth, "truth")
    _check(tracks, "tracks")
    _check_unique(truth.frame[~truth.distractor], truth.identity[~truth.distractor], "truth")
    _check_unique(tracks.frame, tracks.identity, "tracks")
    last = frames or max(truth.frame.max(initial=0), tracks.frame.max(initial=0))
    rows_t, rows_o = _ordered(truth, last), _ordered(tracks, last)
    numbers = np.union1d(truth.frame[rows_t], tracks.frame[rows_o])
    each_t = np.split(rows_t, np.searchsorted(truth.frame[rows_t], numbers[1:]))
    each_o = np.split(rows_o, np.searchsorted(tracks.frame[rows_o], numbers[1:]))
    raw = [_frame(truth, tracks, t, o, k) for k, t, o in zip(numbers.tolist(), each_t, each_o, strict=False)]
    return _relabelled([pair for pair in raw if len(pair.truth) or len(pair.output)], int(last))


def _check(rows: Truth | Tracks, name: str) -> None:
    """Raise `InputError` where shapes, frame numbers or boxes of ``rows`` are not what they should be."""
    count = len(rows.frame)
    if rows.frame.shape != (count,) or rows.identity.shape != (count,) or rows.xyxy.shape != (count, 4):
        shapes = f"{rows.frame.shape}, {rows.identity.shape}, {rows.xyxy.shape}"
        raise InputError(f"expected frame (M,), identity (M,), xyxy (M, 4), got {shapes}", where=name)
    if count and rows.frame.min() < 1:
        raise InputError(
            f"expected frame numbers from 1, got {rows.frame.min()}", where=name, cure="Add 1 to frames that count from 0."
        )
    extent = (rows.xyxy[:, 2] >= rows.xyxy[:, 0]) & (rows.xyxy[:, 3] >= rows.xyxy[:, 1])
    bad = np.flatnonzero(~(np.isfinite(rows.xyxy).all(axis=1) & extent))
    if len(bad):
        box = [float(v) for v in rows.xyxy[bad[0]]]
        raise InputError(
            f"expected finite boxes with left ≤ right and top ≤ bottom, got {box}",
            where=f"{name}, frame {rows.frame[bad[0]]}, identity {rows.identity[bad[0]]}",
            cure="Boxes are left, top, right, bottom, not left, top, width, height.",
        )


def _check_unique(frame: I8, identity: I8, name: str) -> None:
    order = np.lexsort((identity, frame))
    same = (np.diff(frame[order]) == 0) & (np.diff(identity[order]) == 0)
    if same.any():
        row = order[int(np.argmax(same))]
        raise InputError(
            f"expected one row per identity and frame, got identity {identity[row]} twice",
            where=f"{name}, frame {frame[row]}",
            cure="Drop the repeated row, or give it an identity of its own.",
        )


def _ordered(rows: Truth | Tracks, last: int) -> I8:
    order = np.lexsort((rows.identity, *rows.xyxy.T[::-1], rows.frame))
    return order[rows.frame[order] <= last]


def _frame(truth: Truth, tracks: Tracks, t: I8, o: I8, number: int) -> FramePair:
    overlap = iou(truth.xyxy[t], tracks.xyxy[o])
    counts = ~truth.distractor[t]
    left = np.ones(len(o), np.bool_)
    if not counts.all():
        rows, columns = assign(above(overlap, DISTRACTOR_IOU))
        left[columns[~counts[rows]]] = False
    return FramePair(number, truth.identity[t[counts]], tracks.identity[o[left]], overlap[np.ix_(counts, left)])


def _relabelled(raw: list[FramePair], frames: int) -> Scene:
    none = np.zeros(0, np.int64)
    truth_identity = np.unique(np.concatenate([none, *(p.truth for p in raw)]))
    output_identity = np.unique(np.concatenate([none, *(p.output for p in raw)]))
    pairs = tuple(
        FramePair(p.number, np.searchsorted(truth_identity, p.truth), np.searchsorted(output_identity, p.output), p.iou)
        for p in raw
    )
    truth_boxes = np.array([len(p.truth) for p in pairs], np.int64)
    output_boxes = np.array([len(p.output) for p in pairs], np.int64)
    return Scene(pairs, frames, truth_identity, output_identity, truth_boxes, output_boxes)


# Larger than any total overlap that a frame can hold, so that a kept pair outweighs all new ones.
KEEP = 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """The K mapped pairs of a sequence, frames ascending.

    Attributes
    ----------
    position : (K,) index of the frame in `Scene.pairs`.
    truth, output : (K,) indices of the two identities.
    iou : (K,) overlap of the two boxes.
    """

    position: I8
    truth: I8
    output: I8
    iou: F8

    def per_frame(self, scene: Scene) -> I8:
        """(F,) number of mapped pairs in each of the scene's frames."""
        return np.bincount(self.position, minlength=len(scene.pairs)).astype(np.int64)

    def iou_per_frame(self, scene: Scene) -> F8:
        """(F,) sum of the overlaps in each of the scene's frames."""
        return np.bincount(self.position, self.iou, minlength=len(scene.pairs)).astype(np.float64)


Part = tuple[int, I8, I8, F8]


def match(scene: Scene, score: Callable[[FramePair], F8]) -> Matches:
    """The mapping with the largest total ``score(pair)`` (n, m) in every frame; pairs of score 0 stay unmapped."""
    return gather([_part(position, pair, score(pair)) for position, pair in enumerate(scene.pairs) if pair.iou.size])


def detection_mapping(scene: Scene, threshold: float) -> Matches:
    """The largest total overlap among pairs at IoU ≥ ``threshold``, each frame for itself."""
    return match(scene, lambda pair: above(pair.iou, threshold))


def tracking_mapping(scene: Scene, threshold: float) -> Matches:
    """As `detection_mapping`, but pairs mapped in the frame before stay mapped while their IoU is ≥ ``threshold``."""
    parts: list[Part] = []
    before = np.full(len(scene.truth_identity), -1)
    for position, pair in enumerate(scene.pairs):
        if not pair.iou.size:
            continue
        kept = before[pair.truth][:, None] == pair.output[None, :]
        overlap = above(pair.iou, threshold)
        part = _part(position, pair, overlap + KEEP * (kept & (overlap > 0)))
        before = np.full_like(before, -1)
        before[part[1]] = part[2]
        parts.append(part)
    return gather(parts)


def gather(parts: list[Part]) -> Matches:
    """The parts of single frames in one record."""
    none = np.zeros(0, np.int64)
    return Matches(
        np.repeat(np.array([p[0] for p in parts], np.int64), [len(p[1]) for p in parts]),
        np.concatenate([none, *(p[1] for p in parts)]),
        np.concatenate([none, *(p[2] for p in parts)]),
        np.concatenate([np.zeros(0), *(p[3] for p in parts)]),
    )


def _part(position: int, pair: FramePair, score: F8) -> Part:
    rows, columns = assign(score)
    return position, pair.truth[rows], pair.output[columns], pair.iou[rows, columns]
