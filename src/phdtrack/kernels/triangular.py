"""The inverse of a Cholesky factor."""

from __future__ import annotations

from phdtrack.kernels import F8
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import INNER


@njit(**INNER)
def invert_lower(root: F8, out: F8) -> None:
    """Write the inverse of a lower triangular matrix (d, d) into the lower triangle of ``out``."""
    for r in range(root.shape[0]):
        out[r, r] = 1.0 / root[r, r]
        for s in range(r):
            total = 0.0
            for q in range(s, r):
                total += root[r, q] * out[q, s]
            out[r, s] = -total / root[r, r]
