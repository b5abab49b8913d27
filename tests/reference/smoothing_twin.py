"""Smoothing and the evidence for a link, from the joint density of everything at once: dense, slow
and plain.
"""

from __future__ import annotations

import math

import numpy as np


def joint(motion, times, seen, columns):
    """Mean (n, d) and covariance (n, d, d) of the states at ``times``, of which those with a column
    ≥ 0 were measured.

    One Gaussian over all states, as the motion alone has it, given all measurements but the first
    at once.
    """
    n = len(times)
    d = len(seen.state)
    shown = seen.observed
    mean = np.zeros(n * d)
    cov = np.zeros((n * d, n * d))
    mean[:d] = seen.state[:, columns[0]]
    cov[:d, :d] = seen.covariance[columns[0]]
    for k in range(1, n):
        here = slice(k * d, (k + 1) * d)
        before = slice((k - 1) * d, k * d)
        moved, f, q = motion.transition(mean[before, None], times[k] - times[k - 1])
        mean[here] = moved[:, 0]
        cov[here] = f[0] @ cov[before]
        cov[:, here] = cov[here].T
        cov[here, here] = f[0] @ cov[before, before] @ f[0].T + q[0]
    told = [k for k in range(1, n) if columns[k] >= 0]
    rows = np.concatenate([k * d + shown for k in told])
    noise = np.zeros((len(rows), len(rows)))
    for place, k in enumerate(told):
        own = slice(place * len(shown), (place + 1) * len(shown))
        noise[own, own] = seen.covariance[columns[k]][np.ix_(shown, shown)]
    gain = np.linalg.solve(cov[np.ix_(rows, rows)] + noise, cov[rows]).T
    z = np.concatenate([seen.state[shown, columns[k]] for k in told])
    mean = mean + gain @ (z - mean[rows])
    cov = cov - gain @ cov[rows]
    return mean.reshape(n, d), np.array(
        [cov[k * d : (k + 1) * d, k * d : (k + 1) * d] for k in range(n)]
    )


def log_density(motion, times, seen, columns):
    """log p of the measurements of one trajectory, the first anywhere with density 1: a Kalman
    filter's innovations.
    """
    shown = seen.observed
    mean = seen.state[:, columns[0]]
    cov = seen.covariance[columns[0]]
    total = 0.0
    for k in range(1, len(times)):
        moved, f, q = motion.transition(mean[:, None], times[k] - times[k - 1])
        mean = moved[:, 0]
        cov = f[0] @ cov @ f[0].T + q[0]
        if columns[k] < 0:
            continue
        spread = cov[np.ix_(shown, shown)] + seen.covariance[columns[k]][np.ix_(shown, shown)]
        step = seen.state[shown, columns[k]] - mean[shown]
        total += -0.5 * (
            step @ np.linalg.solve(spread, step) + np.linalg.slogdet(2 * math.pi * spread)[1]
        )
        gain = cov[:, shown] @ np.linalg.inv(spread)
        mean = mean + gain @ step
        cov = cov - gain @ cov[shown]
    return total
