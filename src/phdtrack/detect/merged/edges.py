"""Boxes by their edges (left, top, right, bottom): what of a target can be seen of a blob that several share.

The outline of a blob is the outermost of its targets' edges, side by side. Each side has an *owner*, the target whose edge
is expected to lie outermost; the blob's edge shows this target's and no other's. In the sensor's noise, σ_p = σ_size/2,
the edges of one box are independent.
"""

from __future__ import annotations

import numpy as np

from phdtrack.types import F8, I8

# (left, top, right, bottom) of (centre x, centre y, width, height).
EDGES: F8 = np.array([[1, 0, -0.5, 0], [0, 1, 0, -0.5], [1, 0, 0.5, 0], [0, 1, 0, 0.5]])
# Which way is outward.
_OUTWARD: F8 = np.array([-1.0, -1.0, 1.0, 1.0])


def edge_covariance(covariance: F8) -> F8:
    """(…, 4, 4) of the edges, of that (…, 4, 4) of centre and size."""
    out: F8 = EDGES @ covariance @ EDGES.T
    return out


def union(boxes: F8) -> F8:
    """(4,) the smallest box around the (k, 4) boxes."""
    return np.concatenate([boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)])


def owners(boxes: F8) -> I8:
    """(4,) which of the (k, 4) boxes owns each edge of their union."""
    out: I8 = (boxes * _OUTWARD).argmax(axis=0)
    return out


def outline(boxes: F8, covariance: F8) -> tuple[F8, F8]:
    """The union of boxes (k, 4) with edges of covariance (k, 4, 4), as a Gaussian: its mean (4,) and covariance (4, 4)."""
    own = owners(boxes)
    side = np.arange(4)
    same = own[:, None] == own[None, :]
    return boxes[own, side], np.where(same, covariance[own[:, None], side[:, None], side[None, :]], 0.0)


def log_normal(x: F8, mean: F8, covariance: F8, gate: float) -> float:
    """log N(x; mean, covariance) of vectors (4,); −∞ beyond ``gate`` deviations."""
    step = x - mean
    distance2 = float(step @ np.linalg.solve(covariance, step))
    if distance2 > gate**2:
        return -np.inf
    return -0.5 * (distance2 + float(np.linalg.slogdet(covariance)[1]) + len(x) * float(np.log(2 * np.pi)))


def fitted(blob: F8, boxes: F8) -> tuple[F8, F8]:
    """The boxes (k, 4) of the targets moved to where the ``blob`` (4,) shows them, keeping their sizes.

    Along each axis a target lies where the blob's edges that it owns put it (between them, if it owns both), and
    stays where it was expected if it owns none, but inside the blob, if it is no larger.

    Returns
    -------
    boxes : (k, 4).
    slack : (k, 2) standard deviation of what nobody sees, along x and y: that of a uniform place in the blob for a target
        that owns no edge, 0 for the others.
    """
    own, k = owners(boxes), np.arange(len(boxes))
    placed, slack = boxes.copy(), np.zeros((len(boxes), 2))
    for axis in (0, 1):
        low, high = blob[axis], blob[axis + 2]
        size = boxes[:, axis + 2] - boxes[:, axis]
        at_low, at_high = own[axis] == k, own[axis + 2] == k
        # Where the lower edge is by the one side, by the other, and as expected.
        start = np.where(at_low, low, boxes[:, axis])
        start = np.where(at_high, np.where(at_low, (low + high - size) / 2, high - size), start)
        room = high - low - size
        start = np.where(room > 0, np.clip(start, low, np.maximum(low, high - size)), low + room / 2)
        placed[:, axis], placed[:, axis + 2] = start, start + size
        slack[:, axis] = np.where(at_low | at_high, 0.0, np.maximum(room, 0.0) / np.sqrt(12))
    return placed, slack
