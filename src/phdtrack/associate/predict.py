"""The window's states, moved on to the present frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.associate.triangle import lower, whole
from phdtrack.associate.window import Moved, Window
from phdtrack.kernels.association import predict_covariances
from phdtrack.kernels.constant_velocity import predict_boxes
from phdtrack.models.box_motion import BoxMotion
from phdtrack.protocols import Model, Motion
from phdtrack.types import F8, I8, Estimates

# States predicted at once: what the model answers then stays in the cache, and its memory is used again.
BLOCK = 1200
# Components of a box's state without a remembered size.
BOX = 6


def carried(window: Window, model: Model) -> Window:
    """The window's states in the pixels of the present frame, where the camera has moved."""
    if len(model.warp) == 0 or window.mean.shape[1] == 0:
        return window
    triangle = lower(len(window.mean))
    mean, cov = model.carried_gaussians(window.mean, whole(window.cov.T, len(window.mean)))
    return replace(window, mean=mean, cov=np.ascontiguousarray(cov[:, triangle.row, triangle.column].T))


def predicted(window: Window, estimates: Estimates, dt: float, motion: Motion) -> Moved:
    """The window's states predicted for now, and the new ones behind them.

    The shipped motion of boxes is computed in one go; another is asked for its transition, a block of states at a time.
    """
    count, d = len(window.rows.since), len(estimates.state)
    gone = window.mean.shape[1] - count
    mean = np.concatenate((window.mean[:, gone:], estimates.state), axis=1)
    # Its own kind and none derived from it: who overrides a method wants it called.
    if type(motion) is BoxMotion and d == BOX:
        return _boxes(window.cov, gone, mean, estimates.covariance, dt, motion)
    return _any(window.cov, gone, mean, estimates.covariance, dt, motion)


def _boxes(old: F8, gone: int, mean: F8, covariance: F8, dt: float, motion: BoxMotion) -> Moved:
    """For states of centre, velocity and size; ``mean`` (6, R + n) is moved in place."""
    triangle = lower(BOX)
    k, n = len(triangle.row), len(covariance)
    cov, noise = np.empty((k, mean.shape[1])), np.zeros((k, n))
    settings = motion.acceleration, motion.size_noise, motion.min_size, motion.scaled_noise
    predict_boxes(old, gone, covariance, float(dt), *settings, triangle.place, mean, cov, noise)
    return Moved(mean, cov, noise)


def _any(old: F8, gone: int, mean: F8, covariance: F8, dt: float, motion: Motion) -> Moved:
    """For any motion; ``mean`` (d, R + n) is moved in place."""
    n, d = len(covariance), len(mean)
    count, triangle = mean.shape[1] - n, lower(d)
    cov = np.empty((len(triangle.row), count + n))
    noise = np.zeros((d, d, 0))
    for begin in range(0, max(count, 1), BLOCK):
        last = begin + BLOCK >= count
        end = count if last else begin + BLOCK
        moved, jacobian, spread = motion.transition(mean[:, begin : count + n if last else end], dt)
        noise = np.ascontiguousarray(spread.transpose(1, 2, 0))
        mean[:, begin:end] = moved[:, : end - begin]
        row, column, value = _off_identity(jacobian, end - begin)
        predict_covariances(old, gone, noise, row, column, value, triangle.place, cov, begin)
    cov[:, count:] = covariance[:, triangle.row, triangle.column].T
    own = noise[triangle.row, triangle.column, noise.shape[2] - n :]
    return Moved(mean, cov, own)


def _off_identity(jacobian: F8, width: int) -> tuple[I8, I8, F8]:
    """Rows, columns (e,) and values (e, width) of the elements of F − I (n, d, d) that are not 0, for the first states."""
    identity = np.eye(jacobian.shape[1])
    if jacobian.strides[0] == 0 and len(jacobian):
        # One Jacobian for all: a view that repeats itself.
        off = jacobian[0] - identity
        row, column = off.nonzero()
        value = np.empty((len(row), width))
        value[:] = off[row, column, None]
        return row, column, value
    each = jacobian[:width] - identity
    row, column = np.nonzero(each.any(axis=0))
    value = np.ascontiguousarray(each[:, row, column].T)
    return row, column, value
