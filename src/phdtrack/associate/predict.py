"""The window's states, moved on to the present frame."""

from __future__ import annotations

import numpy as np

from phdtrack.associate.triangle import lower
from phdtrack.associate.window import Window
from phdtrack.kernels.association import predict_covariances
from phdtrack.protocols import Motion
from phdtrack.types import F8, I8, Estimates

# States predicted at once: what the model answers then stays in the cache, and its memory is used again.
BLOCK = 1200


def predicted(window: Window, estimates: Estimates, dt: float, motion: Motion) -> tuple[F8, F8, F8]:
    """The window's R states predicted for now, and the n new ones behind them.

    Returns
    -------
    mean, cov : (d, R + n), (k, R + n); of covariances the lower triangles, as in `Window`.
    noise : (d, d, n or more) motion's noise of one step from the new states, which are the last.
    """
    n, count, d = len(estimates), len(window.rows.since), len(estimates.state)
    triangle = lower(d)
    gone = window.mean.shape[1] - count
    mean = np.concatenate((window.mean[:, gone:], estimates.state), axis=1)
    cov = np.empty((len(triangle.row), count + n))
    noise = np.zeros((d, d, 0))
    for begin in range(0, max(count, 1), BLOCK):
        last = begin + BLOCK >= count
        end = count if last else begin + BLOCK
        moved, jacobian, spread = motion.transition(mean[:, begin : count + n if last else end], dt)
        noise = np.ascontiguousarray(spread.transpose(1, 2, 0))
        mean[:, begin:end] = moved[:, : end - begin]
        row, column, value = _off_identity(jacobian, end - begin)
        predict_covariances(window.cov, gone, noise, row, column, value, triangle.place, cov, begin)
    cov[:, count:] = estimates.covariance[:, triangle.row, triangle.column].T
    return mean, cov, noise


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
