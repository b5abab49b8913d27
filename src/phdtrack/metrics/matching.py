"""Truth and output of one sequence side by side, frame by frame, and the mapping between their
boxes.

First both sides are checked, and distractors are taken out as MOTChallenge does it since MOT16: in
each frame all annotated boxes, distractors included, are matched with the output for the largest
total overlap among pairs at IoU ≥ 0.5; output boxes that fall to a distractor are removed, then the
distractors. Of output that fell to nothing is removed what lies in ignored regions by more than
half of its area, and what is lower than a benchmark looks at, as in KITTI. Rows are ordered by
frame, then box, so that no score depends on the order of rows, even where two assignments tie.

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

# Overlaps are quotients of sums; one rounding below the threshold still counts as on it, as in
# TrackEval.
ROUNDING = float(np.finfo(np.float64).eps)
_DISTRACTOR_IOU = 0.5
# Larger than any total overlap that a frame can hold, so that a kept pair outweighs all new ones.
_KEEP = 1000.0


def ratio(numerator: float, denominator: float) -> float:
    """The quotient; NaN where nothing was counted in the denominator."""
    if denominator:
        return numerator / denominator
    return math.nan


def above(overlap: F8, threshold: float) -> F8:
    """``overlap`` (n, m) where it reaches ``threshold``, 0 elsewhere."""
    return np.where(overlap >= threshold - ROUNDING, overlap, 0.0)


def check_threshold(threshold: float) -> None:
    """Raise `InputError` unless 0 < ``threshold`` ≤ 1."""
    if not 0 < threshold <= 1:
        raise InputError(
            f"expected an overlap (IoU) above 0 and at most 1, got {threshold:g}", where="iou"
        )


def assign(score: F8) -> tuple[I8, I8]:
    """Rows and columns (k,) of the one-to-one mapping with the largest total ``score`` (n, m), less
    its pairs of score 0.
    """
    rows, columns = cheapest(-score)
    real = score[rows, columns] > 0
    return rows[real], columns[real]


def cheapest(cost: F8) -> tuple[I8, I8]:
    """Rows and columns (min(n, m),) of the mapping of the smaller side into the larger with the
    least ``cost`` (n, m).
    """
    # Imported here: it takes most of a second, and the command line starts without it.
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(cost)
    return rows.astype(np.int64), columns.astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class FramePair:
    """One frame: ``truth`` (n,) and ``output`` (m,) indices of identities, ``iou`` (n, m) between
    their boxes.

    ``truth_row`` (n,) and ``output_row`` (m,) are the rows that were given.
    """

    number: int
    truth: I8
    output: I8
    iou: F8
    truth_row: I8
    output_row: I8


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A sequence ready to be scored.

    Attributes
    ----------
    pairs : the F frames that hold a box on at least one side, ascending.
    frames : the number of frames of the sequence, empty ones included.
    truth_identity, output_identity : (G,), (O,) the identities behind the indices; O counts what
        distractors left over.
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


def build(truth: Truth, tracks: Tracks, frames: int = 0, first: int = 1) -> Scene:
    """``truth`` and ``tracks`` side by side, frame by frame, without distractors. Raises
    `InputError` for wrong shapes, frame numbers below 1, boxes without finite extent, and an
    identity twice in a frame.

    Parameters
    ----------
    truth, tracks : annotated boxes, output boxes.
    frames : number of frames of the sequence, later rows are left out; 0: up to the last row of
        either side.
    first : the first of these that counts, earlier rows are left out.
    """
    for name, value, least in (("frames", frames, 0), ("first", first, 1)):
        if value < least or value % 1:
            raise InputError(
                f"expected a whole number of at least {least}, got {value}", where=name
            )
    _check(truth, truth.distractor, "truth")
    _check(tracks, np.zeros(len(tracks.frame), np.bool_), "tracks")
    last = int(frames or max(truth.frame.max(initial=0), tracks.frame.max(initial=0)))
    if first > last + 1:
        raise InputError(f"expected one of the {last} frames, got {first}", where="first")
    rows_t = _ordered(truth, first, last)
    rows_o = _ordered(tracks, first, last)
    numbers = np.union1d(truth.frame[rows_t], tracks.frame[rows_o])
    each_t = np.split(rows_t, np.searchsorted(truth.frame[rows_t], numbers[1:]))
    each_o = np.split(rows_o, np.searchsorted(tracks.frame[rows_o], numbers[1:]))
    raw = [
        _frame(truth, tracks, t, o, k)
        for k, t, o in zip(numbers.tolist(), each_t, each_o, strict=False)
    ]
    none = np.zeros(0, np.int64)
    names_t, names_o = (
        np.unique(np.concatenate([none, *ids]))
        for ids in ([p.truth for p in raw], [p.output for p in raw])
    )
    pairs = (
        replace(
            p, truth=np.searchsorted(names_t, p.truth), output=np.searchsorted(names_o, p.output)
        )
        for p in raw
        if len(p.truth) or len(p.output)
    )
    return Scene(
        tuple(pairs),
        last - first + 1,
        names_t,
        names_o,
        len(rows_o) - sum(len(p.output) for p in raw),
    )


def _check(rows: Truth | Tracks, distractor: Bool, name: str) -> None:
    """Raise `InputError` for bad columns, frame numbers or boxes, or where an identity that counts
    is twice in a frame.
    """
    frame = rows.frame
    identity = rows.identity
    xyxy = rows.xyxy
    kinds = [
        getattr(getattr(one, "dtype", None), "kind", type(one).__name__)
        for one in (frame, identity, distractor)
    ]
    if not (
        kinds[0] in "iu"
        and kinds[1] in "iu"
        and kinds[2] == "b"
        and distractor.shape == frame.shape
    ):
        expected = (
            "arrays of whole numbers for frame and identity, of True and False, as many, for"
            " distractor"
        )
        raise InputError(f"expected {expected}", where=name)
    if identity.shape != frame.shape or xyxy.shape != (len(frame), 4):
        shapes = f"{frame.shape}, {identity.shape}, {xyxy.shape}"
        raise InputError(
            f"expected frame (M,), identity (M,), xyxy (M, 4), got {shapes}", where=name
        )
    if len(frame) and frame.min() < 1:
        cure = "Add 1 to frames that count from 0."
        raise InputError(f"expected frame numbers from 1, got {frame.min()}", where=name, cure=cure)
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
        problem = f"expected one row per identity and frame, got identity {identity[same[0]]} twice"
        cure = "Drop the repeated row, or give it an identity of its own."
        raise InputError(problem, where=f"{name}, frame {frame[same[0]]}", cure=cure)


def _ordered(rows: Truth | Tracks, first: int, last: int) -> I8:
    order = np.lexsort((rows.identity, *rows.xyxy.T[::-1], rows.frame))
    return order[(rows.frame[order] >= first) & (rows.frame[order] <= last)]


def _frame(truth: Truth, tracks: Tracks, t: I8, o: I8, number: int) -> FramePair:
    """A frame without its distractors and the output that does not count; with identities in place
    of their indices.
    """
    overlap = iou(truth.xyxy[t], tracks.xyxy[o])
    counts = ~truth.distractor[t]
    left = np.ones(len(o), np.bool_)
    here = truth.regions[np.isin(truth.regions[:, 0], (0, number)), 1:]
    if not counts.all() or len(here) or truth.least_height:
        rows, columns = assign(above(overlap, _DISTRACTOR_IOU))
        left[columns[~counts[rows]]] = False
        boxes = tracks.xyxy[o]
        free = np.ones(len(o), np.bool_)
        free[columns] = False
        low = boxes[:, 3] - boxes[:, 1] <= truth.least_height + ROUNDING
        inside = intersection(boxes, here).max(axis=1, initial=0.0) > (0.5 + ROUNDING) * area(boxes)
        left &= ~(free & (inside | (low & (truth.least_height > 0))))
    t = t[counts]
    o = o[left]
    overlap = overlap[np.ix_(counts, left)]
    return FramePair(number, truth.identity[t], tracks.identity[o], overlap, t, o)


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

    def histories(self) -> tuple[I8, Bool]:
        """The order (K,) by object, then frame; (K−1,) whether the next pair in it is of the same
        object.
        """
        order = np.argsort(self.truth, kind="stable")
        return order, np.diff(self.truth[order]) == 0

    def switches(self) -> Bool:
        """(K,) True where the object was mapped before, and to another output."""
        order, again = self.histories()
        switched = np.zeros(len(order), np.bool_)
        switched[order[1:]] = again & (np.diff(self.output[order]) != 0)
        return switched

    def first_frames(self, scene: Scene) -> I8:
        """(G,) the number of the first frame in which each object is mapped, 0 where it never
        is.
        """
        first = np.zeros(len(scene.truth_identity), np.int64)
        # Backwards, so that the earliest frame is written last.
        for position, index in zip(
            self.position[::-1].tolist(), self.truth[::-1].tolist(), strict=True
        ):
            first[index] = scene.pairs[position].number
        return first


def match(scene: Scene, score: Callable[[FramePair, I8], F8]) -> Matches:
    """The mapping with the largest total score (n, m) in every frame; pairs of score 0 stay
    unmapped.

    ``score`` is given the frame, and for each of the G objects the output that it was mapped to in
    the last frame with boxes on both sides, −1 for none.
    """
    position, truth, output = ([np.zeros(0, np.int64)] for _ in range(3))
    overlap = [np.zeros(0)]
    before = np.full(len(scene.truth_identity), -1)
    for i, pair in enumerate(scene.pairs):
        if pair.iou.size:
            rows, columns = assign(score(pair, before))
            position.append(np.full(len(rows), i))
            truth.append(pair.truth[rows])
            output.append(pair.output[columns])
            overlap.append(pair.iou[rows, columns])
            before = np.full_like(before, -1)
            before[truth[-1]] = output[-1]
    return Matches(
        np.concatenate(position),
        np.concatenate(truth),
        np.concatenate(output),
        np.concatenate(overlap),
    )


def tracking_mapping(scene: Scene, threshold: float) -> Matches:
    """As many pairs as possible of those mapped before, then the largest total overlap at IoU ≥
    ``threshold``.

    "Before" is the last frame that held boxes on both sides: a frame with an empty side neither
    breaks nor makes a mapping, in agreement with TrackEval's CLEAR [M09 (22)–(25)].
    """

    def score(pair: FramePair, before: I8) -> F8:
        overlap = above(pair.iou, threshold)
        kept = before[pair.truth][:, None] == pair.output
        return np.where(kept & (overlap > 0), overlap + _KEEP, overlap)

    return match(scene, score)
