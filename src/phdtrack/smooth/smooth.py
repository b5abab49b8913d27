"""Rauch, Tung and Striebel's fixed-interval smoother, over many trajectories at once.

All paths go through the frames together, so that the motion is asked once a frame. Forward, with x the state, F and Q the
motion's, H the observed rows and R the measurement's covariance:

    m⁻ = f(m),  P⁻ = F P Fᵀ + Q        K = P⁻Hᵀ (H P⁻ Hᵀ + R)⁻¹,  m = m⁻ + K (z − H m⁻),  P = P⁻ − K H P⁻

and back, G = P Fᵀ (P⁻₊)⁻¹ of the next frame:

    m* = m + G (m*₊ − m⁻₊)             P* = P + G (P*₊ − P⁻₊) Gᵀ
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.protocols import Motion
from phdtrack.smooth.ahead import ahead
from phdtrack.smooth.paths import Paths, Seen
from phdtrack.types import F8, I8, Bool, MeasurementHistory


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """Of each row the state given all of its path's measurements: ``mean`` (M, d) and ``covariance`` (M, d, d)."""

    mean: F8
    covariance: F8


def smooth(paths: Paths, measured: MeasurementHistory, seen: Seen, motion: Motion) -> Smoothed:
    """The states of all rows, given the measurements ``seen`` [R65]."""
    order = np.argsort(paths.frame, kind="stable")
    bounds = np.searchsorted(paths.frame[order], np.arange(len(measured.time) + 1))
    size, d = len(order), len(seen.state)
    mean, predicted = np.empty((2, size, d))
    cov, expected, jacobian = np.empty((3, size, d, d))
    begins = np.zeros(size, np.bool_)
    begins[paths.first] = True
    later = [_later(order[bounds[p] : bounds[p + 1]], begins) for p in range(len(measured.time))]
    for p, (fresh, going) in enumerate(later):
        if len(fresh):
            column = paths.measurement[fresh]
            mean[fresh], cov[fresh] = seen.state[:, column].T, seen.covariance[column]
        if len(going):
            before = going - 1
            now = ahead(mean[before], cov[before], p, measured, motion)
            predicted[going], expected[going], jacobian[going] = now.mean, now.covariance, now.jacobian
            mean[going], cov[going] = now.mean, now.covariance
            _update(going[paths.measurement[going] >= 0], paths.measurement, seen, mean, cov)
    for _, going in reversed(later):
        if len(going):
            before = going - 1
            gain = _solve(expected[going], jacobian[going] @ cov[before]).transpose(0, 2, 1)
            mean[before] += (gain @ (mean[going] - predicted[going])[:, :, None])[:, :, 0]
            cov[before] += gain @ (cov[going] - expected[going]) @ gain.transpose(0, 2, 1)
    return Smoothed(mean, cov)


def _later(rows: I8, begins: Bool) -> tuple[I8, I8]:
    """Of a frame's rows those that begin a path, and those that go on."""
    return rows[begins[rows]], rows[~begins[rows]]


def _update(rows: I8, measurement: I8, seen: Seen, mean: F8, cov: F8) -> None:
    """Take in the measurements of these rows."""
    if len(rows) == 0:
        return
    column, shown = measurement[rows], seen.observed
    noise = seen.covariance[column][:, shown[:, None], shown]
    part = cov[rows][:, shown]
    gain = _solve(part[:, :, shown] + noise, part).transpose(0, 2, 1)
    step = seen.state[shown[:, None], column].T - mean[rows][:, shown]
    mean[rows] += (gain @ step[:, :, None])[:, :, 0]
    cov[rows] -= gain @ part


def _solve(a: F8, b: F8) -> F8:
    """a⁻¹ b of positive semidefinite a (n, d, d)."""
    try:
        out = np.linalg.solve(a, b)
    except np.linalg.LinAlgError:
        # A motion without noise in some component may make it singular.
        out = np.linalg.pinv(a, hermitian=True) @ b
    return out.astype(np.float64, copy=False)
