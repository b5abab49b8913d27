"""States one frame on: the camera's motion, then the targets'."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.protocols import Motion
from phdtrack.types import F8, STILL, MeasurementHistory


@dataclass(frozen=True, slots=True, eq=False)
class Ahead:
    """Predictions ``mean`` (n, d), ``covariance`` (n, d, d), and the Jacobians ``jacobian`` (n, d, d) by which they came."""

    mean: F8
    covariance: F8
    jacobian: F8


def ahead(mean: F8, covariance: F8, place: int, measured: MeasurementHistory, motion: Motion) -> Ahead:
    """States (n, d) with covariances (n, d, d) of the frame before ``place``, predicted for that frame."""
    x, slope = np.ascontiguousarray(mean.T), None
    warp = measured.warp[place] if len(measured.warp) else STILL
    if len(warp):
        x, slope = motion.carried(x, warp), motion.carried_slope(x, warp)
    moved, jacobian, noise = motion.transition(x, float(measured.time[place] - measured.time[place - 1]))
    f = jacobian if slope is None else jacobian @ slope
    return Ahead(moved.T, f @ covariance @ f.transpose(0, 2, 1) + noise, f)
