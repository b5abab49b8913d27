"""What objects look like: colour histograms, and how much alike two of the same object are in this very stream.

A box is seen as two histograms of hue, saturation and value, of its upper and of its lower half without their margins, as
square roots, so that the Bhattacharyya distance of two is √(1 − ⟨a, b⟩). A piece of a track looks like its boxes' mean.

How far two pieces of one object are apart is learned from pieces of one and the same track, and how far those of two
objects, from tracks that are there in one frame; both distances are taken for Gaussian. The logarithm of their ratio is
added to the log-odds of a pair. It falls with the distance: beyond either mean it stays what it is there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.smooth.paths import Paths
from phdtrack.types import F4, F8, I8, Image

# Bins of hue, saturation and value.
BINS = (8, 4, 4)
# Boxes that make a piece, fewest pairs of which something is learned, most tracks that others are told by, fewest pixels of
# half a box.
PIECE, FEWEST, TRACKS, PIXELS = 15, 5, 2000, 20
# Stretches of a box's height, and of its width, that are looked at.
HALVES, MIDDLE = ((0.1, 0.5), (0.5, 0.9)), (0.2, 0.8)


def histograms(image: Image, xyxy: F8) -> F4:
    """(N, 256) square roots of the histograms of the boxes (N, 4) in the picture; NaN where there is too little to see."""
    import cv2

    out = np.full((len(xyxy), 2, int(np.prod(BINS))), np.nan, np.float32)
    height, width = image.shape[:2]
    for box, looks in zip(xyxy, out, strict=True):
        left, right = (int(np.clip(box[0] + part * (box[2] - box[0]), 0, width)) for part in MIDDLE)
        for half, (begin, end) in zip(looks, HALVES, strict=True):
            top, bottom = (int(np.clip(box[1] + part * (box[3] - box[1]), 0, height)) for part in (begin, end))
            if (right - left) * (bottom - top) >= PIXELS:
                colours = cv2.cvtColor(np.ascontiguousarray(image[top:bottom, left:right]), cv2.COLOR_BGR2HSV)
                count = cv2.calcHist([colours], [0, 1, 2], None, list(BINS), [0, 180, 0, 256, 0, 256])
                half[:] = np.sqrt(count.ravel() / count.sum())
    return out.reshape(len(xyxy), 2 * int(np.prod(BINS)))


@dataclass(frozen=True, slots=True)
class Alike:
    """Mean and deviation of the distance of two pieces of the ``same`` object, and of ``other`` ones."""

    same: tuple[float, float]
    other: tuple[float, float]

    def log_ratio(self, distance: F8) -> F8:
        """(P,) log-ratio of both densities; 0 where nothing was seen, or where the same are no more alike than others."""
        if self.same[0] >= self.other[0]:
            return np.zeros(len(distance))
        between = np.clip(distance, self.same[0], self.other[0])
        same, other = (-0.5 * ((between - mean) / width) ** 2 - np.log(width) for mean, width in (self.same, self.other))
        out: F8 = np.nan_to_num(same - other)
        return out


def likeness(paths: Paths, look: F4, before: I8, after: I8) -> F8:
    """(P,) what the looks (Z, B) of their measurements say for the paths ``after`` being ``before`` gone on, in log-odds."""
    rows = np.flatnonzero(paths.measurement >= 0)
    rows = rows[np.isfinite(look[paths.measurement[rows]]).all(axis=1)]
    owner, count = paths.owner[rows], np.bincount(paths.owner[rows], minlength=len(paths))
    rank = np.arange(len(rows)) - (np.cumsum(count) - count)[owner]
    if len(rows) == 0:
        return np.zeros(len(before))
    seen = look[paths.measurement[rows]]
    begins, ends = rank < PIECE, rank >= count[owner] - PIECE
    first, last = (_mean(seen[part], owner[part], len(paths)) for part in (begins, ends))
    known = _learned(paths, seen, owner, rank, first)
    return np.zeros(len(before)) if known is None else known.log_ratio(_distance(last[before], first[after]))


def _learned(paths: Paths, seen: F4, owner: I8, rank: I8, first: F8) -> Alike | None:
    """How alike pieces are; None where too few were seen. Those of one track are a piece's length apart, as after a gap."""
    pieces = paths.frame[paths.last].max() // PIECE + 2
    names, whose = np.unique(owner * pieces + rank // PIECE, return_inverse=True)
    means = _mean(seen, whose, len(names))
    at = np.minimum(np.searchsorted(names, names + 2), len(names) - 1)
    two = np.flatnonzero((names[at] == names + 2) & (names[at] // pieces == names // pieces))
    begin, end = paths.frame[paths.first[:TRACKS]], paths.frame[paths.last[:TRACKS]]
    a, b = np.nonzero(np.triu((begin[:, None] <= end) & (begin <= end[:, None]), 1))
    distances = (_distance(means[two], means[at[two]]), _distance(first[a], first[b]))
    same, other = (x[np.isfinite(x)] for x in distances)
    if min(len(same), len(other)) < FEWEST:
        return None
    return Alike(*((float(x.mean()), max(float(x.std()), 0.02)) for x in (same, other)))


def _mean(seen: F4, whose: I8, count: int) -> F8:
    """(count, 2, B/2) mean looks, each half of unit length; NaN of whoever was not seen."""
    total = np.zeros((count, seen.shape[1]))
    np.add.at(total, whose, seen)
    halves = total.reshape(count, 2, seen.shape[1] // 2)
    length = np.linalg.norm(halves, axis=2, keepdims=True)
    out: F8 = np.divide(halves, length, out=np.full_like(halves, np.nan), where=length > 0)
    return out


def _distance(a: F8, b: F8) -> F8:
    """(P,) Bhattacharyya distances, the mean of both halves."""
    out: F8 = np.sqrt(np.maximum(1 - (a * b).sum(axis=2), 0)).mean(axis=1)
    return out
