"""Peak extraction as it is told: every particle against every centre, for targets that are well apart."""

from __future__ import annotations

import numpy as np


def kmeans(state, weight, centres, scale, lightest, split, iterations=50):
    """Masses (k,), means (d, k), covariances (k, d, d) of weighted K-means with distances in units of ``scale``."""
    while True:
        for _ in range(iterations):
            step = (state[:, :, None] - centres[:, None, :]) / scale[:, None, None]
            label = np.argmin((step**2).sum(0), axis=1)
            used = np.unique(label)
            moved = np.stack([np.average(state[:, label == j], axis=1, weights=weight[label == j]) for j in used], axis=1)
            if moved.shape == centres.shape and np.allclose(moved, centres, rtol=0, atol=1e-12):
                break
            centres = moved
        mass = np.array([weight[label == j].sum() for j in range(centres.shape[1])])
        heavy = np.flatnonzero(mass > split)
        if len(heavy) == 0:
            break
        own = (((state - centres[:, label]) / scale[:, None]) ** 2).sum(0)
        far = [np.flatnonzero(label == j)[np.argmax(own[label == j])] for j in heavy]
        centres = np.hstack([centres, state[:, far]])
    kept = np.flatnonzero(mass >= lightest)
    cov = [np.cov(state[:, label == j], aweights=weight[label == j], ddof=0) for j in kept]
    return mass[kept], centres[:, kept], np.array(cov)
