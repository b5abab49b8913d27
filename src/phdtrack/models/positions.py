"""Targets without a size: constant velocity with white noise, and a measured position with Gaussian
noise.

`models.plane` and `models.point` build on these.

**Motion.** State x = (px, py, vx, vy, …). Along each axis noise disturbs position and velocity over
an interval by variances (of position, of position and velocity, of velocity). Those of a
white-noise acceleration of deviation a have two forms over an interval T [E13 §4]:

    piecewise     a² (T⁴/4, T³/2, T²): constant over the interval, as the papers print it
    continuous    a² (T³/3, T²/2, T): white; a gap of two frames is the same as two steps of one

**Sensor.** g(z|x) = N(z; h(x), R) of two components. R belongs to each measurement, or is the same
for all targets.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import numpy as np

from phdtrack.arrays import chi2_quantile
from phdtrack.errors import Checked, InputError, check
from phdtrack.kernels.particle_models import SensorNumbers, position_numbers, walk
from phdtrack.models.volumes import Region, check_region, inside
from phdtrack.types import F8

Form = Literal["piecewise", "continuous"]
Variances = tuple[float, float, float]
"""Of position, of position and velocity, of velocity of an axis."""


class PositionMotion:
    """f and p_S of constant velocity. A motion has these fields, or defines its own variances."""

    __slots__ = ()
    dim: ClassVar[int] = 4
    acceleration: float
    form: Form
    survival_probability: float
    borders: Region

    def __post_init__(self) -> None:
        check(self)
        check_region(self.borders, f"{type(self).__name__}.borders")

    def _variances(self, dt: float) -> Variances:
        """Variances of the noise over the interval ``dt`` [E13 §4]."""
        a2 = self.acceleration**2
        if self.form == "piecewise":
            return a2 * dt**4 / 4, a2 * dt**3 / 2, a2 * dt**2
        return a2 * dt**3 / 3, a2 * dt**2 / 2, a2 * dt

    def _noise_covariance(self, dt: float, n: int) -> F8:
        """(d, d, n) covariances of the noise over the interval ``dt``."""
        q = np.zeros((self.dim, self.dim, n))
        for axis in range(2):
            q[axis, axis], q[axis, axis + 2], q[axis + 2, axis + 2] = self._variances(dt)
            q[axis + 2, axis] = q[axis, axis + 2]
        return q

    def p_survive(self, x: F8, seconds: float) -> F8:
        """p_S^seconds inside the borders, 0 outside."""
        return np.where(inside(x, self.borders), self.survival_probability**seconds, 0.0)

    def particle_model(self, dt: float, seconds: float) -> Any:
        """The numbers of f over ``dt`` and p_S over ``seconds`` for the particle filters [E13 §4,
        D14].
        """
        return walk(dt, self._variances(dt), self.survival_probability**seconds, self.borders)

    def transition(self, x: F8, dt: float) -> tuple[F8, F8, F8]:
        """Mean, Jacobian and noise covariance of f(·|x) over the interval ``dt`` [E13 §4, D14]."""
        n = x.shape[1]
        f = np.eye(4)
        f[0, 2] = f[1, 3] = dt
        # The layout in memory is that of `BoxMotion`, for which the kernels are compiled.
        jacobian = np.ndarray((n, 4, 4), np.float64, f, 0, (0, *f.strides))
        mean = x.copy()
        mean[0:2] += dt * x[2:4]
        return mean, jacobian, self._noise_covariance(dt, n).transpose(2, 0, 1)

    def warp_states(self, x: F8, warp: F8) -> F8:
        """Always raises `InputError`: the ground does not move with the image."""
        raise InputError(
            "a target on the ground does not lie in the image: how its pixels move says nothing"
            " of it",
            where="camera motion",
            cure=(
                "Compensate the camera's motion with motion.kind=box or point; on the ground, let"
                " it stand still"
            ),
        )

    warp_jacobian = warp_states


class PositionSensor(Checked):
    """g of two measured components. A sensor has these fields and defines R."""

    __slots__ = ()
    observed: ClassVar[tuple[int, ...]] = (0, 1)
    linear: ClassVar[bool] = True
    angles: ClassVar[tuple[bool, ...]] = (False, False)
    # R is the same for all targets; else it belongs to each measurement.
    constant_noise: ClassVar[bool] = True
    birth_speed: float
    gate_probability: float

    @property
    def _gate(self) -> float:
        """G, the gate's half-width in deviations."""
        return math.sqrt(chi2_quantile(2, self.gate_probability))

    def _noise(self, z: F8) -> tuple[F8, F8, F8]:
        """R as R_xx, R_xy, R_yy of the shape of ``z[0]``: rows of z, unless R is the same for
        all.
        """
        return z[2], z[3], z[4]

    def predicted_measurements(self, x: F8) -> F8:
        """(2, …) the positions."""
        return x[:2]

    def innovation(self, z: F8, predicted: F8) -> F8:
        """(2, …) z − ``predicted``."""
        return z[:2] - predicted

    def covariance(self, z: F8, x: F8) -> F8:
        """(P, 2, 2) R for pairs of columns."""
        xx, xy, yy = self._noise(z)
        return np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)

    def target_noise(self, x: F8) -> F8:
        """(L, 2, 2) R if it is the same for all, else (0, 2, 2)."""
        return self.covariance(x if self.constant_noise else np.zeros((5, 0)), x)

    def measurement_noise(self, z: F8) -> F8:
        """(N, 2, 2) R if it belongs to the measurements, else (0, 2, 2)."""
        return self.covariance(z[:, :0] if self.constant_noise else z, z)

    def particle_model(self, z: F8) -> SensorNumbers:
        """The numbers of g for the particle filters, and a column for each measurement; p_D depends
        on the state.
        """
        return SensorNumbers(*position_numbers(z, self.covariance(z, z)), np.zeros(0))

    def gate(self, z: F8) -> tuple[F8, F8]:
        """Rectangles of G deviations along each axis about z; they contain the ellipse d ≤ G."""
        xx, _, yy = self._noise(z)
        half = self._gate * np.sqrt(np.stack([xx, yy]))
        return z[:2] - half, z[:2] + half

    def states(self, z: F8) -> tuple[F8, F8]:
        """States at rest that z alone implies, and their covariances."""
        n = z.shape[1]
        x = np.zeros((4, n))
        cov = np.zeros((n, 4, 4))
        x[:2] = z[:2]
        cov[:, :2, :2] = self.covariance(z, x)
        cov[:, 2, 2] = cov[:, 3, 3] = self.birth_speed**2 / 2
        return x, cov
