"""One-to-one assignment: the Hungarian algorithm behind every mapping and every distance between sets."""

from __future__ import annotations

import numpy as np

from phdtrack.types import F8, I8

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
