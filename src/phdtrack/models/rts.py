"""The fixed-interval smoother of Rauch, Tung and Striebel, step by step, over n Gaussians at once
[R65].

Equations: docs/methods.md, Smoothing. Forward, too, a covariance is a sum of squares, P = A P⁻ Aᵀ +
K R Kᵀ with A = I − K H: rounding cannot make a variance negative, unlike P⁻ − K H P⁻ when a camera
zooms in.

Means are (n, d), covariances (n, d, d).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from phdtrack.kernels import rts
from phdtrack.protocols import Motion
from phdtrack.types import F8, I8, STILL


class Ahead(NamedTuple):
    """Predictions ``mean`` (n, d) and ``covariance`` (n, d, d), with their Jacobians and noises (n,
    d, d).
    """

    mean: F8
    covariance: F8
    jacobian: F8
    noise: F8


def moved(motion: Motion, mean: F8, dt: float, warp: F8 = STILL) -> tuple[F8, F8, F8]:
    """Means (n, d), Jacobians and noises (n, d, d) one frame later: the camera's motion, then the
    targets'.

    Parameters
    ----------
    motion, mean : the model's motion; (n, d).
    dt, warp : interval in the model's time unit; (3, 3) the camera's motion in it, `types.STILL`
        for none.
    """
    x = np.ascontiguousarray(mean.T)
    if len(warp):
        slope = motion.warp_jacobian(x, warp)
        later, jacobian, noise = motion.transition(motion.warp_states(x, warp), dt)
        f = jacobian @ slope
    else:
        later, f, noise = motion.transition(x, dt)
    return np.ascontiguousarray(later.T), np.ascontiguousarray(f), np.ascontiguousarray(noise)


def predict(motion: Motion, mean: F8, covariance: F8, dt: float, warp: F8 = STILL) -> Ahead:
    """Gaussians one frame later.

    Parameters
    ----------
    motion, dt, warp : as for `moved`.
    mean, covariance : (n, d), (n, d, d).
    """
    later, f, noise = moved(motion, mean, dt, warp)
    return Ahead(later, rts.predicted(np.ascontiguousarray(covariance), f, noise), f, noise)


def update(mean: F8, covariance: F8, z: F8, noise: F8, rows: I8) -> tuple[F8, F8]:
    """Means and covariances given measurements of some rows of the state.

    Parameters
    ----------
    mean, covariance : (n, d), (n, d, d) predictions.
    z, noise : (n, r), (n, r, r) measurements and their covariances.
    rows : (r,) of the state that they show.
    """
    after: tuple[F8, F8] = rts.updated(
        *map(np.ascontiguousarray, (mean, covariance, z, noise)), rows
    )
    return after


def smooth_back(
    mean: F8, covariance: F8, ahead: Ahead, later: F8, later_covariance: F8
) -> tuple[F8, F8]:
    """Means and covariances given the smoothed states of the next frame.

    Parameters
    ----------
    mean, covariance : (n, d), (n, d, d) filtered.
    ahead : their predictions for the next frame.
    later, later_covariance : (n, d), (n, d, d) smoothed states of the next frame.
    """
    smoothed = mean.copy(), covariance.copy()
    rts.smooth(
        tuple(map(np.ascontiguousarray, smoothed)),
        tuple(map(np.ascontiguousarray, ahead)),
        (np.ascontiguousarray(later), np.ascontiguousarray(later_covariance)),
        np.ones(len(mean), np.bool_),
    )
    return smoothed


def bridge(motion: Motion, ends: tuple[F8, F8, F8, F8], steps: F8, warps: Sequence[F8] = ()) -> F8:
    """(d, n, L) means of the states in n gaps of L frames, given the states before and after each.

    Parameters
    ----------
    motion : the model's motion.
    ends : means (n, d) and covariances (n, d, d) before the gaps, then those after them.
    steps : (L + 1,) intervals from the states before through the frames of the gaps to the states
        after.
    warps : (L + 1) camera motions in the intervals; empty for a fixed camera.
    """
    before, cov_before, after, cov_after = ends
    forward: list[tuple[F8, F8, Ahead]] = []
    mean = before
    cov = cov_before
    for dt, warp in zip(steps.tolist(), warps or (STILL,) * len(steps), strict=True):
        ahead = predict(motion, mean, cov, dt, warp)
        forward.append((mean, cov, ahead))
        mean = ahead.mean
        cov = ahead.covariance
    mean, cov = update(mean, cov, after, cov_after, np.arange(before.shape[1]))
    out = np.empty((before.shape[1], len(before), len(steps) - 1))
    for k in range(len(steps) - 1, 0, -1):
        mean, cov = smooth_back(*forward[k], mean, cov)
        out[:, :, k - 1] = mean.T
    return out
