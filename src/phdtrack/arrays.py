"""Small array operations that several stages share."""

from __future__ import annotations

import numpy as np

from phdtrack.types import F8, I8


def sum_by(index: I8, value: F8, count: int) -> F8:
    """(count,) sums of ``value`` over equal ``index``, in float64."""
    return np.asarray(np.bincount(index, value, count), dtype=np.float64)
