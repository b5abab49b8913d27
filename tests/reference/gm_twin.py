"""The GM-PHD filter as it is printed, Gaussian by Gaussian, with matrix inverses and without gates
or grids.
"""

from __future__ import annotations

import math

import numpy as np


def predict(weight, mean, cov, p_survive, f, q):
    """Weights, means (d, J) and covariances (J, d, d) one interval later; ``p_survive``, ``f``,
    ``q`` one for each.
    """
    means = [f[i] @ mean[:, i] for i in range(len(weight))]
    covs = [f[i] @ cov[i] @ f[i].T + q[i] for i in range(len(weight))]
    return (
        weight * p_survive,
        np.array(means).reshape(-1, len(mean)).T,
        np.array(covs).reshape(-1, len(mean), len(mean)),
    )


def density(step, cov):
    """N(step; 0, cov)."""
    distance2 = step @ np.linalg.inv(cov) @ step
    return math.exp(-0.5 * distance2) / math.sqrt(np.linalg.det(2 * math.pi * cov))


def corrected(mean, cov, z, h, r):
    """Mean and covariance after a measurement, and its density."""
    s = h @ cov @ h.T + r
    gain = cov @ h.T @ np.linalg.inv(s)
    return mean + gain @ (z - h @ mean), cov - gain @ h @ cov, density(z - h @ mean, s)


def kalman(mean, cov, measurements, f, q, h, r):
    """Means (K, d) and covariances (K, d, d) of the Kalman filter after each measurement, predicted
    first.
    """
    means = []
    covs = []
    for z in measurements:
        mean, cov, _ = corrected(f @ mean, f @ cov @ f.T + q, z, h, r)
        means.append(mean)
        covs.append(cov)
    return np.array(means), np.array(covs)


def update(weight, mean, cov, z, h, noise, p_detect, clutter):
    """Weights, means, covariances and C(z): first those that were missed, then those of each
    measurement.

    ``z`` (m, N); ``noise(i, j)`` is R of a pair; ``p_detect`` (J,), ``clutter`` (N,).
    """
    weights = [*((1 - p_detect) * weight)]
    means = [*mean.T]
    covs = [*cov]
    evidence = []
    for j in range(z.shape[1]):
        terms = []
        for i in range(len(weight)):
            m, p, q = corrected(mean[:, i], cov[i], z[:, j], h, noise(i, j))
            terms.append(p_detect[i] * weight[i] * q)
            means.append(m)
            covs.append(p)
        evidence.append(math.fsum(terms))
        total = clutter[j] + evidence[-1]
        weights += [term / total if total > 0 else 0.0 for term in terms]
    return np.array(weights), np.array(means).T, np.array(covs), np.array(evidence)


def merge(weight, mean, cov, distance):
    """The strongest of what is left, with all that are within ``distance`` of it in their own
    covariance; and so on.
    """
    left = list(range(len(weight)))
    out = []
    while left:
        j = max(left, key=lambda i: (weight[i], -i))
        near = [j]
        for i in left:
            step = mean[:, i] - mean[:, j]
            if i != j and step @ np.linalg.inv(cov[i]) @ step <= distance**2:
                near.append(i)
        w = math.fsum(weight[i] for i in near)
        m = sum(weight[i] * mean[:, i] for i in near) / w
        p = sum(weight[i] * (cov[i] + np.outer(m - mean[:, i], m - mean[:, i])) for i in near) / w
        out.append((w, m, p))
        left = [i for i in left if i not in near]
    d = len(mean)
    return (
        np.array([w for w, _, _ in out]),
        np.array([m for _, m, _ in out]).reshape(-1, d).T,
        np.array([p for _, _, p in out]).reshape(-1, d, d),
    )


def reduce(weight, mean, cov, prune, distance, most, redistribute):
    """Prune, merge, cap; the mass that pruning and capping took is given to the rest where
    ``redistribute``.
    """
    total = weight.sum()
    kept = weight >= prune
    weight, mean, cov = merge(weight[kept], mean[:, kept], cov[kept], distance)
    if most and len(weight) > most:
        strong = np.argsort(-weight, kind="stable")[:most]
        weight = weight[strong]
        mean = mean[:, strong]
        cov = cov[strong]
    if redistribute and weight.sum() > 0:
        weight = weight * (total / weight.sum())
    return weight, mean, cov
