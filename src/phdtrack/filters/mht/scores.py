"""What each measurement, track and pair of the two contributes to the log-weight of a hypothesis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.filters.gated import gated_gaussians
from phdtrack.filters.hypotheses import Nodes
from phdtrack.filters.newborn import Newborn
from phdtrack.filters.transforms import Transform
from phdtrack.protocols import Sensor
from phdtrack.types import F8, I8, GaussianMixture

# A detection that must be made (r p_D = 1) is missed with this probability: impossible, but comparable.
NEVER = 1e-15
_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Terms of the log-weights.

    Attributes
    ----------
    leaf, which : (P,) pairs (leaf, measurement) within the gate.
    gain : (P,) log r p_D q(z) − log(1 − r p_D): the leaf's detection by it against its being missed.
    share : (P,) r p_D q(z).
    missed : (L,) log(1 − r p_D).
    kept : (L,) probability that the target is there if it is missed, r (1 − p_D)/(1 − r p_D).
    alone : (N,) log(κ + γ̂): a false alarm or a new target.
    new : (N,) γ̂/(κ + γ̂).
    clutter : (N,) κ.
    born : what a new target at each measurement would be.
    """

    leaf: I8
    which: I8
    gain: F8
    share: F8
    missed: F8
    kept: F8
    alone: F8
    new: F8
    clutter: F8
    born: Newborn


def scores(nodes: Nodes, z: F8, born: Newborn, clutter: F8, sensor: Sensor, gate: float, transform: Transform) -> Scores:
    """Of the predicted leaves and the measurements ``z`` (m, N)."""
    there = np.flatnonzero(nodes.exist > 0)
    targets = GaussianMixture(nodes.exist[there], np.ascontiguousarray(nodes.mean[:, there]), nodes.covariance[there])
    seen = np.zeros(len(nodes))
    seen[there] = np.minimum(targets.weight * sensor.p_detect(targets.mean), 1 - NEVER)
    missed = np.log1p(-seen)
    point, which, distance2, log_norm = gated_gaussians(targets, z, sensor, gate, transform)
    leaf = there[point]
    possible = seen[leaf] > 0
    leaf, which = leaf[possible], which[possible]
    log_share = np.log(seen[leaf]) + (log_norm - 0.5 * distance2)[possible]
    total = np.maximum(clutter + born.density, _TINY)
    kept = np.clip((nodes.exist - seen) / (1 - seen), 0.0, 1.0)
    return Scores(
        leaf, which, log_share - missed[leaf], np.exp(log_share), missed, kept,
        np.log(total), born.density / total, clutter, born,
    )  # fmt: skip
