"""Models whose targets move and are seen linearly, with Gaussian noise: what one kernel draws and weighs by itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.models import PlaneMotion, PlaneSensor, PointMotion, PointSensor
from phdtrack.protocols import Model
from phdtrack.types import F8


@dataclass(frozen=True, slots=True, eq=False)
class LinearParts:
    """x = F ξ + L ν, z = (px, py) + noise of covariance R.

    Attributes
    ----------
    step, root : (d, d) F and L, with Q = L Lᵀ of whatever rank.
    z : (2, n) measured positions.        inverse : (n, 3) R⁻¹ of each, packed as xx, xy, yy.
    predictive : (n, 2, 2) (H L Lᵀ Hᵀ + R)⁻¹.
    """

    step: F8
    root: F8
    z: F8
    inverse: F8
    predictive: F8

    def fits(self, origin: F8) -> F8:
        """(n, M) log N(z; H F ξ, H Q Hᵀ + R) of each target's samples ``origin`` (d, n·M), up to a constant."""
        n = self.z.shape[1]
        apart = self.z[:, :, None] - (self.step[:2] @ origin).reshape(2, n, -1)
        (a, b), (_, c) = self.predictive.transpose(1, 2, 0)[:, :, :, None]
        out: F8 = -0.5 * (a * apart[0] ** 2 + 2 * b * apart[0] * apart[1] + c * apart[1] ** 2)
        return out


def linear_parts(model: Model, z: F8, dt: float) -> LinearParts | None:
    """The parts for measurements ``z`` (m, n) after ``dt``, or None where the model is none of those known to be linear."""
    if not isinstance(model.motion, PlaneMotion | PointMotion) or not isinstance(model.sensor, PlaneSensor | PointSensor):
        return None
    # Of both, F and Q are the same for all states and R for all states of one measurement.
    _, step, noise = model.motion.transition(np.zeros((model.motion.dim, 1)), dt)
    size, axes = np.linalg.eigh(noise[0])
    spread = model.sensor.covariance(z, np.zeros((model.motion.dim, z.shape[1])))
    inverse = np.linalg.inv(spread)
    total: F8 = spread + noise[0, :2, :2]
    predictive = np.asarray(np.linalg.inv(total), np.float64)
    packed = np.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], axis=1)
    root = axes * np.sqrt(np.maximum(size, 0.0))
    return LinearParts(
        np.ascontiguousarray(step[0]), np.ascontiguousarray(root), np.ascontiguousarray(z[:2]), packed, predictive
    )
