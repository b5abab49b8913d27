"""Appearance of targets: colour histograms, and the distances of those of one target and of two in this very stream.

A box is described by two histograms of hue, saturation and value, of its upper and of its lower half without their margins,
as square roots, so that the Bhattacharyya distance of two is √(1 − ⟨a, b⟩). A piece of a track is described by the mean.

The distribution of the distance between pieces of one target is learned from pieces of one and the same track, that between
two targets from tracks that are there in one frame; both are taken for Gaussian. The logarithm of their ratio is added to
the log-odds of a pair. It falls with the distance: beyond either mean it stays what it is there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.smooth.paths import Paths
from phdtrack.types import F4, F8, I8, Image

# Bins of hue, saturation and value.
BINS = (8, 4, 4)
# Boxes in a piece, fewest pairs that a distribution is learned from, most tracks that pairs are made of, fewest pixels of
# half a box.
PIECE, FEWEST, TRACKS, PIXELS = 15, 5, 2000, 20
# Stretches of a box's height, and of its width, that are described.
HALVES, MIDDLE = ((0.1, 0.5), (0.5, 0.9)), (0.2, 0.8)


def histograms(image: Image, xyxy: F8) -> F4:
    """(N, 256) square roots of the histograms of the boxes (N, 4) in the image; NaN where there are too few pixels."""
    import cv2

    out = np.full((len(xyxy), 2, int(np.prod(BINS))), np.nan, np.float32)
    height, width = image.shape[:2]
    for box, halves in zip(xyxy, out, strict=True):
        left, right = (int(np.clip(box[0] + part * (box[2] - box[0]), 0, width)) for part in MIDDLE)
        for half, (begin, end) in zip(halves, HALVES, strict=True):
            top, bottom = (int(np.clip(box[1] + part * (box[3] - box[1]), 0, height)) for part in (begin, end))
            if (right - left) * (bottom - top) >= PIXELS:
                colours = cv2.cvtColor(np.ascontiguousarray(image[top:bottom, left:right]), cv2.COLOR_BGR2HSV)
                count = cv2.calcHist([colours], [0, 1, 2], None, list(BINS), [0, 180, 0, 256, 0, 256])
                half[:] = np.sqrt(count.ravel() / count.sum())
    return out.reshape(len(xyxy), 2 * int(np.prod(BINS)))


@dataclass(frozen=True, slots=True)
class Distances:
    """Mean and deviation of the distance of two pieces of the ``same`` target, and of ``other`` ones."""

    same: tuple[float, float]
    other: tuple[float, float]

    def log_ratio(self, distance: F8) -> F8:
        """(P,) log-ratio of both densities; 0 where it is unknown, or where those of one target are not closer."""
        if self.same[0] >= self.other[0]:
            return np.zeros(len(distance))
        between = np.clip(distance, self.same[0], self.other[0])
        same, other = (-0.5 * ((between - mean) / width) ** 2 - np.log(width) for mean, width in (self.same, self.other))
        out: F8 = np.nan_to_num(same - other)
        return out


def log_likelihood_ratio(paths: Paths, appearance: F4, before: I8, after: I8) -> F8:
    """(P,) log-likelihood ratios of pairs of paths being of one target, by the appearance of their measurements.

    Parameters
    ----------
    paths : K trajectories.
    appearance : (Z, B) description of each measurement, NaN where unknown.
    before, after : (P,) the pairs.

    Returns
    -------
    (P,) log-ratios; 0 where nothing is known.
    """
    rows = np.flatnonzero(paths.measurement >= 0)
    rows = rows[np.isfinite(appearance[paths.measurement[rows]]).all(axis=1)]
    owner, count = paths.path[rows], np.bincount(paths.path[rows], minlength=len(paths))
    rank = np.arange(len(rows)) - (np.cumsum(count) - count)[owner]
    if len(rows) == 0:
        return np.zeros(len(before))
    seen = appearance[paths.measurement[rows]]
    begins, ends = rank < PIECE, rank >= count[owner] - PIECE
    first, last = (_mean(seen[part], owner[part], len(paths)) for part in (begins, ends))
    known = _learned(paths, seen, owner, rank, first)
    return np.zeros(len(before)) if known is None else known.log_ratio(_distance(last[before], first[after]))


def _learned(paths: Paths, seen: F4, owner: I8, rank: I8, first: F8) -> Distances | None:
    """The distances; None where there are too few pairs. Pieces of one track are a piece's length apart, as after a gap."""
    pieces = paths.frame[paths.last].max() // PIECE + 2
    names, piece = np.unique(owner * pieces + rank // PIECE, return_inverse=True)
    means = _mean(seen, piece, len(names))
    at = np.minimum(np.searchsorted(names, names + 2), len(names) - 1)
    two = np.flatnonzero((names[at] == names + 2) & (names[at] // pieces == names // pieces))
    begin, end = paths.frame[paths.first[:TRACKS]], paths.frame[paths.last[:TRACKS]]
    a, b = np.nonzero(np.triu((begin[:, None] <= end) & (begin <= end[:, None]), 1))
    distances = (_distance(means[two], means[at[two]]), _distance(first[a], first[b]))
    same, other = (x[np.isfinite(x)] for x in distances)
    if min(len(same), len(other)) < FEWEST:
        return None
    return Distances(*((float(x.mean()), max(float(x.std()), 0.02)) for x in (same, other)))


def _mean(seen: F4, piece: I8, count: int) -> F8:
    """(count, 2, B/2) mean descriptions by ``piece``, each half of unit length; NaN where there is none."""
    total = np.zeros((count, seen.shape[1]))
    np.add.at(total, piece, seen)
    halves = total.reshape(count, 2, seen.shape[1] // 2)
    length = np.linalg.norm(halves, axis=2, keepdims=True)
    out: F8 = np.divide(halves, length, out=np.full_like(halves, np.nan), where=length > 0)
    return out


def _distance(a: F8, b: F8) -> F8:
    """(P,) Bhattacharyya distances, the mean of both halves."""
    out: F8 = np.sqrt(np.maximum(1 - (a * b).sum(axis=2), 0)).mean(axis=1)
    return out
