"""The PHD update as it is printed, every particle against every detection; the Kalman filter of one target."""

from __future__ import annotations

import math

import numpy as np


def box_likelihood(z, x, spread, floor):
    """g(z|x) with deviations from the particle's own size, for one detection and one particle."""
    sw, sh = max(spread * x[4], floor), max(spread * x[5], floor)
    out = 1.0
    for value, mean, sigma in ((z[0], x[0], sw / 2), (z[1], x[1], sh / 2), (z[2], x[4], sw), (z[3], x[5], sh)):
        out *= math.exp(-0.5 * ((value - mean) / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi))
    return out


def update(state, weight, z, p_detect, likelihood, clutter):
    """Weights and C(z): D(x) = [1 - p_D + Σ p_D g(z|x) / (κ(z) + C(z))] D⁺(x), by two loops.

    ``likelihood(z_j, x_i)`` of one pair; ``clutter`` (N,) κ(z); where κ + C = 0 the detection's term is 0.
    """
    n, count = z.shape[1], len(weight)
    g = np.array([[likelihood(z[:, j], state[:, i]) for i in range(count)] for j in range(n)]).reshape(n, count)
    evidence = np.array([math.fsum(p_detect * g[j] * weight) for j in range(n)])
    out = (1 - p_detect) * weight
    for j in range(n):
        if clutter[j] + evidence[j] > 0:
            out = out + p_detect * g[j] / (clutter[j] + evidence[j]) * weight
    return out, evidence


def kalman(mean, cov, measurements, f, q, h, r):
    """Means (K, d) and covariances (K, d, d) of the Kalman filter after each measurement, predicted first."""
    means, covs = [], []
    for z in measurements:
        mean, cov = f @ mean, f @ cov @ f.T + q
        s = h @ cov @ h.T + r
        gain = cov @ h.T @ np.linalg.inv(s)
        mean = mean + gain @ (z - h @ mean)
        cov = cov - gain @ s @ gain.T
        means.append(mean)
        covs.append(cov)
    return np.array(means), np.array(covs)
