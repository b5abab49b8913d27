"""Positions in the gap of a track: the motion model between what was known before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from phdtrack.protocols import Motion
from phdtrack.types import F8, STILL


def bridge(motion: Motion, before: F8, cov_before: F8, after: F8, cov_after: F8, steps: F8, warps: Sequence[F8] = ()) -> F8:
    """(d, n) means of the states between two estimates, given both: a fixed-interval smoother over the gap.

    ``before`` and ``after`` are (d,), their covariances (d, d); ``steps`` (n + 1,) the intervals from ``before`` through
    the n frames of the gap to ``after``. With m, P the predictions and Φ the transition from i to the end,
    x_i = m_i + P_i Φᵀ (P_end + P_after)⁻¹ (after − m_end): Rauch, Tung and Striebel's smoother with one observation.
    ``warps`` say how the camera moved in each interval (`Model.warp`); every state lies in its own frame's pixels.
    """
    mean, cov = before[:, None], cov_before
    means, covs, jacobians = [], [], []
    for dt, warp in zip(steps, warps or (STILL,) * len(steps), strict=True):
        mean, slope = _carried(motion, mean, warp)
        mean, jacobian, noise = motion.transition(mean, float(dt))
        slope = jacobian[0] @ slope
        cov = slope @ cov @ slope.T + noise[0]
        means.append(mean[:, 0])
        covs.append(cov)
        jacobians.append(slope)
    pull = np.linalg.solve(covs[-1] + cov_after, after - means[-1])
    out = np.empty((len(before), len(steps) - 1))
    to_end = np.eye(len(before))
    for i in range(len(steps) - 2, -1, -1):
        to_end = to_end @ jacobians[i + 1]
        out[:, i] = means[i] + covs[i] @ to_end.T @ pull
    return out


def _carried(motion: Motion, mean: F8, warp: F8) -> tuple[F8, F8]:
    """The state (d, 1) in the pixels of the next frame, and the Jacobian (d, d)."""
    if len(warp) == 0:
        return mean, np.eye(len(mean))
    return motion.carried(mean, warp), motion.carried_slope(mean, warp)[0]
