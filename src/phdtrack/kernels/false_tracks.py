"""Which rows of a frame belong to no false track, by the places that their tracks have been at."""

from __future__ import annotations

import numpy as np

from phdtrack.kernels import F8, I8, Bool
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY
from phdtrack.kernels.small_arrays import first_not_below


@njit(**ENTRY)
def genuine_so_far(
    known: I8, least: F8, identity: I8, confirmed: Bool, limit: float
) -> tuple[F8, Bool]:
    """(2, n) the least log-ratios so far of rows with an ``identity`` (n,), infinite for one that
    is not ``known``; and (n,) which rows belong to no false track.

    These are rows that are ``confirmed`` and whose first ratio is below 0, and those whose second
    one is below ``limit``. ``known`` (a,) ascending, ``least`` (2, a) its ratios.
    """
    n = identity.size
    found = np.full((2, n), np.inf)
    genuine = np.empty(n, np.bool_)
    for i in range(n):
        at = first_not_below(known, identity[i])
        if at < known.size and known[at] == identity[i]:
            found[0, i] = least[0, at]
            found[1, i] = least[1, at]
        genuine[i] = (confirmed[i] and found[0, i] < 0.0) or found[1, i] < limit
    return found, genuine
