"""Pairs of truth and output, frame by frame, and the mappings between their boxes.

Both sides are checked, and distractors are removed as in MOTChallenge since MOT16: in each frame
all annotated boxes, distractors included, are matched with the output for the largest total overlap
among pairs at IoU ≥ 0.5; output boxes matched to a distractor are removed, then the distractors.
Unmatched output is removed if more than half of its area lies in an ignored region, or if it is
lower than a benchmark's least height, as in KITTI. Rows are ordered by frame, then box, so that no
score depends on the order of the input rows, even if two assignments tie.

Notation: n annotated and m output boxes in a frame; G annotated and O output identities in the
sequence, known by index.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.arrays import area, intersection, iou
from phdtrack.errors import InputError
from phdtrack.types import F8, I8, Bool, Tracks, Truth

# Overlaps are quotients of sums: one rounding error below the threshold still counts as reaching
# it, as in TrackEval.
ROUNDING = float(np.finfo(np.float64).eps)
_DISTRACTOR_IOU = 0.5
# Larger than any total overlap of a frame, so that a kept pair outweighs all new ones.
_KEEP = 1000.0


def ratio(numerator: float, denominator: float) -> float:
    """The quotient; NaN if the denominator is 0."""
    if denominator:
        return numerator / denominator
    return math.nan


def above(overlap: F8, threshold: float) -> F8:
    """The ``overlap`` (n, m), with 0 for values below ``threshold``."""
    return np.where(overlap >= threshold - ROUNDING, overlap, 0.0)


def check_threshold(threshold: float) -> None:
    """Raise `InputError` unless 0 < ``threshold`` ≤ 1."""
    if not 0 < threshold <= 1:
        raise InputError(
            f"expected an overlap (IoU) above 0 and at most 1, got {threshold:g}", where="iou"
        )


def assign(score: F8) -> tuple[I8, I8]:
    """Rows and columns (k,) of the one-to-one mapping with the largest total ``score`` (n, m),
    without pairs of score 0.
    """
    rows, columns = cheapest(-score)
    real = score[rows, columns] > 0
    return rows[real], columns[real]


def cheapest(cost: F8) -> tuple[I8, I8]:
    """Rows and columns (min(n, m),) of the one-to-one mapping of the smaller side into the larger
    with the least total ``cost`` (n, m).
    """
    # Imported on use: the import takes most of a second, and the command line starts without it.
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(cost)
    return rows.astype(np.int64), columns.astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class FramePair:
    """One frame: ``truth`` (n,) and ``output`` (m,) indices of identities, and the ``iou`` (n, m)
    between their boxes.

    ``truth_row`` (n,) and ``output_row`` (m,) are the indices of the input rows.
    """

    number: int
    truth: I8
    output: I8
    iou: F8
    truth_row: I8
    output_row: I8


@dataclass(frozen=True, slots=True, eq=False)
class SequencePair:
    """Truth and output of a sequence, ready to be scored.

    Attributes
    ----------
    pairs : the F frames with a box on at least one side, ascending.
    frames : the number of frames of the sequence, including empty ones.
    truth_identity, output_identity : (G,), (O,) the identities that the indices refer to, without
        distractors and the output matched to them.
    ignored : the number of output boxes that were removed.
    """

    pairs: tuple[FramePair, ...]
    frames: int
    truth_identity: I8
    output_identity: I8
    ignored: int

    @property
    def boxes(self) -> I8:
        """(2, F) annotated and output boxes in each frame."""
        return np.array([pair.iou.shape for pair in self.pairs], np.int64).reshape(-1, 2).T


def pair_frames(truth: Truth, tracks: Tracks, frames: int = 0, first: int = 1) -> SequencePair:
    """Pair ``truth`` and ``tracks`` frame by frame, without distractors. Raises `InputError` for
    wrong shapes, frame numbers below 1, boxes without finite extent, and an identity twice in a
    frame.

    Parameters
    ----------
    truth, tracks : annotated boxes, output boxes.
    frames : number of frames of the sequence, later rows are ignored; 0: up to the last row of
        either side.
    first : the first frame that is scored, earlier rows are ignored.
    """
    for name, value, minimum in (("frames", frames, 0), ("first", first, 1)):
        if value < minimum or value % 1:
            raise InputError(
                f"expected a whole number of at least {minimum}, got {value}", where=name
            )
    _check(truth, truth.distractor, "truth")
    _check(tracks, np.zeros(len(tracks.frame), np.bool_), "tracks")
    last = int(frames or max(truth.frame.max(initial=0), tracks.frame.max(initial=0)))
    if first > last + 1:
        raise InputError(f"expected one of the {last} frames, got {first}", where="first")
    truth_rows = _ordered(truth, first, last)
    output_rows = _ordered(tracks, first, last)
    numbers = np.union1d(truth.frame[truth_rows], tracks.frame[output_rows])
    truth_by_frame = np.split(truth_rows, np.searchsorted(truth.frame[truth_rows], numbers[1:]))
    output_by_frame = np.split(output_rows, np.searchsorted(tracks.frame[output_rows], numbers[1:]))
    pairs = [
        _frame(truth, tracks, rows, columns, number)
        for number, rows, columns in zip(
            numbers.tolist(), truth_by_frame, output_by_frame, strict=False
        )
    ]
    none = np.zeros(0, np.int64)
    objects = np.unique(np.concatenate([none, *(pair.truth for pair in pairs)]))
    outputs = np.unique(np.concatenate([none, *(pair.output for pair in pairs)]))
    indexed = [
        replace(
            pair,
            truth=np.searchsorted(objects, pair.truth),
            output=np.searchsorted(outputs, pair.output),
        )
        for pair in pairs
        if len(pair.truth) or len(pair.output)
    ]
    ignored = len(output_rows) - sum(len(pair.output) for pair in pairs)
    return SequencePair(tuple(indexed), last - first + 1, objects, outputs, ignored)


def _check(rows: Truth | Tracks, distractor: Bool, name: str) -> None:
    """Raise `InputError` for bad columns, frame numbers or boxes, or if an identity that is scored
    is twice in a frame.
    """
    frame = rows.frame
    identity = rows.identity
    xyxy = rows.xyxy
    if not (
        _kind(frame) in "iu"
        and _kind(identity) in "iu"
        and _kind(distractor) == "b"
        and distractor.shape == frame.shape
    ):
        raise InputError(
            "expected arrays of whole numbers for frame and identity, and of as many booleans for"
            " distractor",
            where=name,
        )
    if identity.shape != frame.shape or xyxy.shape != (len(frame), 4):
        shapes = f"{frame.shape}, {identity.shape}, {xyxy.shape}"
        raise InputError(
            f"expected frame (M,), identity (M,), xyxy (M, 4), got {shapes}", where=name
        )
    if len(frame) and frame.min() < 1:
        raise InputError(
            f"expected frame numbers from 1, got {frame.min()}",
            where=name,
            cure="Add 1 to frames that count from 0.",
        )
    bad = np.flatnonzero(
        ~(np.isfinite(xyxy).all(axis=1) & (xyxy[:, 2:] >= xyxy[:, :2]).all(axis=1))
    )
    if len(bad):
        problem = (
            f"expected finite boxes with left ≤ right and top ≤ bottom, got {xyxy[bad[0]].tolist()}"
        )
        where = f"{name}, frame {frame[bad[0]]}, identity {identity[bad[0]]}"
        raise InputError(
            problem,
            where=where,
            cure="Boxes are left, top, right, bottom, not left, top, width, height.",
        )
    order = np.lexsort((identity, frame))
    order = order[~distractor[order]]
    same = order[:-1][(np.diff(frame[order]) == 0) & (np.diff(identity[order]) == 0)]
    if len(same):
        raise InputError(
            f"expected one row per identity and frame, got identity {identity[same[0]]} twice",
            where=f"{name}, frame {frame[same[0]]}",
            cure="Drop the repeated row, or give it its own identity.",
        )


def _kind(column: object) -> str:
    """NumPy's character for the type of an array; the name of the type of anything else."""
    if isinstance(column, np.ndarray):
        return str(column.dtype.kind)
    return type(column).__name__


def _ordered(rows: Truth | Tracks, first: int, last: int) -> I8:
    """Indices of the rows of frames ``first`` to ``last``, ordered by frame, box, identity."""
    order = np.lexsort((rows.identity, *rows.xyxy.T[::-1], rows.frame))
    return order[(rows.frame[order] >= first) & (rows.frame[order] <= last)]


def _frame(truth: Truth, tracks: Tracks, truth_rows: I8, output_rows: I8, number: int) -> FramePair:
    """A frame without its distractors and the output that is ignored, with identities in place of
    their indices.
    """
    overlap = iou(truth.xyxy[truth_rows], tracks.xyxy[output_rows])
    scored = ~truth.distractor[truth_rows]
    kept = np.ones(len(output_rows), np.bool_)
    regions = truth.regions[np.isin(truth.regions[:, 0], (0, number)), 1:]
    if not scored.all() or len(regions) or truth.least_height:
        rows, columns = assign(above(overlap, _DISTRACTOR_IOU))
        kept[columns[~scored[rows]]] = False
        boxes = tracks.xyxy[output_rows]
        unmatched = np.ones(len(output_rows), np.bool_)
        unmatched[columns] = False
        low = boxes[:, 3] - boxes[:, 1] <= truth.least_height + ROUNDING
        covered = intersection(boxes, regions).max(axis=1, initial=0.0)
        inside = covered > (0.5 + ROUNDING) * area(boxes)
        kept &= ~(unmatched & (inside | (low & (truth.least_height > 0))))
    truth_rows = truth_rows[scored]
    output_rows = output_rows[kept]
    return FramePair(
        number,
        truth.identity[truth_rows],
        tracks.identity[output_rows],
        overlap[np.ix_(scored, kept)],
        truth_rows,
        output_rows,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """The K mapped pairs of a sequence, frames ascending.

    Attributes
    ----------
    position : (K,) index of the frame in `SequencePair.pairs`.
    truth, output : (K,) indices of the two identities.
    iou : (K,) overlap of the two boxes.
    """

    position: I8
    truth: I8
    output: I8
    iou: F8

    def histories(self) -> tuple[I8, Bool]:
        """The order (K,) by object, then frame; and (K−1,) True if the next pair in this order has
        the same object.
        """
        order = np.argsort(self.truth, kind="stable")
        return order, np.diff(self.truth[order]) == 0

    def switches(self) -> Bool:
        """(K,) True if the object was last mapped to another output."""
        order, again = self.histories()
        switched = np.zeros(len(order), np.bool_)
        switched[order[1:]] = again & (np.diff(self.output[order]) != 0)
        return switched

    def first_frames(self, sequence: SequencePair) -> I8:
        """(G,) the number of the first frame in which each object is mapped, 0 for never."""
        first = np.zeros(len(sequence.truth_identity), np.int64)
        index, earliest = np.unique(self.truth, return_index=True)
        numbers = np.array([pair.number for pair in sequence.pairs], np.int64)
        first[index] = numbers[self.position[earliest]]
        return first


def match(sequence: SequencePair, score: Callable[[FramePair, I8], F8]) -> Matches:
    """The mapping with the largest total score (n, m) in every frame; pairs of score 0 stay
    unmapped.

    ``score`` gets the frame, and for each of the G objects the output that it was mapped to in the
    last frame with boxes on both sides, −1 for none.
    """
    none = np.zeros(0, np.int64)
    columns = [(none, none, none, np.zeros(0))]
    before = np.full(len(sequence.truth_identity), -1)
    for i, pair in enumerate(sequence.pairs):
        if pair.iou.size:
            rows, outputs = assign(score(pair, before))
            truth = pair.truth[rows]
            output = pair.output[outputs]
            columns.append((np.full(len(rows), i), truth, output, pair.iou[rows, outputs]))
            before = np.full_like(before, -1)
            before[truth] = output
    return Matches(*(np.concatenate(parts) for parts in zip(*columns, strict=True)))


def tracking_mapping(sequence: SequencePair, threshold: float) -> Matches:
    """The mapping that keeps as many of the previous pairs as possible, then has the largest total
    overlap, at IoU ≥ ``threshold`` [M09 (22)–(25)].

    The previous frame is the last one with boxes on both sides: a frame with an empty side neither
    breaks nor makes a mapping, in agreement with TrackEval's CLEAR.
    """

    def score(pair: FramePair, before: I8) -> F8:
        overlap = above(pair.iou, threshold)
        kept = before[pair.truth][:, None] == pair.output
        return np.where(kept & (overlap > 0), overlap + _KEEP, overlap)

    return match(sequence, score)
