"""Verdicts on which measurement a target has: those that motion alone leaves no doubt of, from
which appearance is learned.
"""

from __future__ import annotations

import numpy as np

from phdtrack.kernels import F8, I8, Records
from phdtrack.kernels.association import EDGE
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.small_arrays import floats

# Verdicts on a target's measurement: it has none, or there is doubt. The odds of a pair that leave
# none.
MISSED = -1
DOUBTFUL = -2
SURE = 99.0


@njit(**INNER)
def write_verdicts(edges: Records, odds: F8, measurements: int, verdicts: I8) -> None:
    """Write the measurement of each target (T,) that motion alone leaves no doubt of; `MISSED`
    where it has none without doubt, else `DOUBTFUL`.

    ``odds`` (E,): those of the ``edges``, without appearance. The probability of a pair is at least
    odds/((1 + odds of the others of the target)(1 + those of the others of the measurement)) as
    odds of having it.
    """
    if verdicts.size == 0:
        return
    total = floats(verdicts.size, 0.0)
    claimed = floats(measurements, 0.0)
    for k in range(edges.size):
        total[edges[k].target] += odds[k]
        claimed[edges[k].measurement] += odds[k]
    for t in range(verdicts.size):
        verdicts[t] = MISSED if total[t] < 1.0 / SURE else DOUBTFUL
    for k in range(edges.size):
        t = edges[k].target
        others = 1.0 + max(total[t] - odds[k], 0.0)
        rivals = 1.0 + max(claimed[edges[k].measurement] - odds[k], 0.0)
        if odds[k] >= SURE * others * rivals:
            verdicts[t] = edges[k].measurement


@njit(**ENTRY)
def verdicts_of(target: I8, measurement: I8, odds: F8, targets: int, measurements: int) -> I8:
    """(T,) `write_verdicts` on pairs (P,) of a target and a measurement; those of the same two, by
    several hypotheses, may occur more than once.

    ``odds`` (P,): of each pair, against the target being missed and the measurement being another
    one's or false, without appearance.
    """
    place = np.full((targets, measurements), -1)
    edges = np.empty(len(odds), EDGE)
    total = np.zeros(len(odds))
    count = 0
    for q in range(len(odds)):
        k = place[target[q], measurement[q]]
        if k < 0:
            k = count
            place[target[q], measurement[q]] = k
            edges[k].target = target[q]
            edges[k].measurement = measurement[q]
            count += 1
        total[k] += odds[q]
    verdicts = np.empty(targets, np.int64)
    write_verdicts(edges[:count], total, measurements, verdicts)
    return verdicts
