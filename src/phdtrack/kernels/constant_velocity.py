"""Boxes at constant velocity: noises of one interval, and Gaussians moved on by it, for many states at once."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# States that are moved at once, so that their covariances stay in the inner cache meanwhile.
BLOCK = 256


@njit(**INNER)
def motion_noises(
    size: float, dt: float, acceleration: float, resize: float, smallest: float, scaled: bool
) -> tuple[float, float, float, float]:
    """Along one axis, of one box: variances of position, with velocity, of velocity and of size [M09 (11)]."""
    unit = 1.0 if not scaled else smallest if size < smallest else size
    pushed, resized = acceleration * unit * (acceleration * unit), resize * unit * (resize * unit)
    position = dt * dt * dt / 3.0 - (dt if dt > 1.0 else dt * dt * dt) / 12.0
    return pushed * position, pushed * dt * dt / 2.0, pushed * dt, resized * dt


@njit(**ENTRY)
def box_motion_noise(
    size: F8, dt: float, acceleration: float, resize: float, smallest: float, scaled: bool, out: F8
) -> None:
    """Noise covariances of boxes of ``size`` (2, n), written into planes of zeros ``out`` (d, d, n) [M09 (11)].

    States' first rows are centre, velocity and size. Noises are multiples of the size, at least ``smallest``, where
    ``scaled``; else of one pixel.
    """
    # As many axes as there are and not 2: the compiler would write the loop out.
    for axis in range(size.shape[0]):
        for i in range(size.shape[1]):
            own, mixed, speed, extent = motion_noises(size[axis, i], dt, acceleration, resize, smallest, scaled)
            out[axis, axis, i] = own
            out[axis, axis + 2, i] = mixed
            out[axis + 2, axis, i] = mixed
            out[axis + 2, axis + 2, i] = speed
            out[axis + 4, axis + 4, i] = extent


@njit(**ENTRY)
def predict_boxes(
    old: F8,
    skip: int,
    covariance: F8,
    dt: float,
    acceleration: float,
    resize: float,
    smallest: float,
    scaled: bool,
    place: I8,
    mean: F8,
    cov: F8,
    noise: F8,
) -> None:
    """Moves R boxes on by ``dt``, means and covariances (F P Fᵀ + Q); n new ones behind them stay as they are [M09 (11)].

    Parameters
    ----------
    old : (21, skip + R) lower triangles of the covariances P, by planes.
    covariance : (n, 6, 6) of the new ones.
    acceleration, resize, smallest, scaled : as for `box_motion_noise`.
    place : (6, 6) the plane of each element.
    mean : (6, R + n) all states, in place.
    cov : (21, R + n) output.
    noise : (21, n) zeros, output: the motion's variances in this interval of each new state.
    """
    n, states = covariance.shape[0], mean.shape[0]
    count = mean.shape[1] - n
    # Numbers that the compiler does not know: it would write the loops over rows out, and take four times as long.
    axes = states // 3
    for r in range(states):
        for s in range(r + 1):
            for i in range(n):
                cov[place[r, s], count + i] = covariance[i, r, s]
    for begin in range(0, count, BLOCK):
        width = np.uint64(BLOCK if begin + BLOCK < count else count - begin)
        source, target = np.uint64(skip + begin), np.uint64(begin)
        for k in range(cov.shape[0]):
            for i in range(width):
                cov[k, target + i] = old[k, source + i]
        for axis in range(axes):
            v = axis + 2
            a, b, c, d = place[axis, axis], place[v, axis], place[v, v], place[axis + 4, axis + 4]
            for i in range(width):
                t = target + i
                own, mixed, speed, extent = motion_noises(mean[axis + 4, t], dt, acceleration, resize, smallest, scaled)
                cov[a, t] += own
                cov[b, t] += mixed
                cov[c, t] += speed
                cov[d, t] += extent
                mean[axis, t] += dt * mean[v, t]
        # With F = I + E: P + E P + P Eᵀ + E P Eᵀ. What moves a position moves it with all others, and both together.
        for axis in range(axes):
            for s in range(states + axis + 1):
                other = s if s < states else s - states
                k, p = place[axis, other], place[axis + 2, other if s < states else other + 2]
                times = dt * dt if s >= states else 2.0 * dt if s == axis else dt
                for i in range(width):
                    cov[k, target + i] += times * old[p, source + i]
    for axis in range(axes):
        for i in range(n):
            own, _, _, extent = motion_noises(mean[axis + 4, count + i], dt, acceleration, resize, smallest, scaled)
            noise[place[axis, axis], i] = own
            noise[place[axis + 4, axis + 4], i] = extent
