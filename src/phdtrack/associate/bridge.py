"""Positions in the gap of a track: the motion model between what was known before and after."""

from __future__ import annotations

import numpy as np

from phdtrack.protocols import Motion
from phdtrack.types import F8


def bridge(motion: Motion, before: F8, cov_before: F8, after: F8, cov_after: F8, steps: F8) -> F8:
    """(d, n) means of the states between two estimates, given both: a fixed-interval smoother over the gap.

    ``before`` and ``after`` are (d,), their covariances (d, d); ``steps`` (n + 1,) the intervals from ``before`` through
    the n frames of the gap to ``after``. With m, P the predictions and Φ the transition from i to the end,
    x_i = m_i + P_i Φᵀ (P_end + P_after)⁻¹ (after − m_end): Rauch, Tung and Striebel's smoother with one observation.
    """
    mean, cov = before[:, None], cov_before
    means, covs, jacobians = [], [], []
    for dt in steps:
        mean, jacobian, noise = motion.transition(mean, float(dt))
        cov = jacobian[0] @ cov @ jacobian[0].T + noise[0]
        means.append(mean[:, 0])
        covs.append(cov)
        jacobians.append(jacobian[0])
    pull = np.linalg.solve(covs[-1] + cov_after, after - means[-1])
    out = np.empty((len(before), len(steps) - 1))
    to_end = np.eye(len(before))
    for i in range(len(steps) - 2, -1, -1):
        to_end = to_end @ jacobians[i + 1]
        out[:, i] = means[i] + covs[i] @ to_end.T @ pull
    return out
