"""Learned densities Gaussian by Gaussian, with matrix inverses."""

from __future__ import annotations

import numpy as np

from reference.gm_twin import density as gaussian


def mixture_density(x, low, high, uniform, outside, weight, mean, cov):
    """At x (d, n): ``uniform`` and the Gaussians, means (d, M), from ``low`` to ``high``, else ``outside``."""
    out = []
    for place in x.T:
        total = uniform + sum(w * gaussian(place - m, c) for w, m, c in zip(weight, mean.T, cov, strict=True))
        out.append(total if (low <= place).all() and (place <= high).all() else outside)
    return np.array(out)


def given_detections(state, noise, rows, low, high, uniform, weight, mean, cov):
    """Densities (n,), means (d, n), covariances (n, d, d) of `kernels.context_density.given_detections`."""
    hidden = [r for r in range(len(state)) if r not in rows]
    densities, states, covs = [], state.copy(), noise.copy()
    for j in range(state.shape[1]):
        z, r = state[rows, j], noise[j][np.ix_(rows, rows)]
        shares, means, spreads = [uniform], [state[hidden, j]], [noise[j][np.ix_(hidden, hidden)]]
        for w, m, c in zip(weight, mean.T, cov, strict=True):
            seen, cross = c[np.ix_(rows, rows)] + r, c[np.ix_(hidden, rows)]
            shares.append(w * gaussian(z - m[rows], seen))
            means.append(m[hidden] + cross @ np.linalg.inv(seen) @ (z - m[rows]))
            spreads.append(c[np.ix_(hidden, hidden)] - cross @ np.linalg.inv(seen) @ cross.T)
        share = np.array(shares) / sum(shares)
        about = share @ np.array(means)
        within = sum(s * (c + np.outer(m - about, m - about)) for s, m, c in zip(share, means, spreads, strict=True))
        densities.append(sum(shares) if (low <= z).all() and (z <= high).all() else 0.0)
        states[hidden, j] = about
        covs[np.ix_([j], hidden, hidden)] = within
    return np.array(densities), states, covs


def around_each(z, volume=4.0, reach=1.0, sizes=(0.5, 1.5)):
    """l(z) (n,): the sum of 1/V over all boxes z (4, n) in whose neighbourhood each lies."""
    out = []
    for x, y, w, h in z[:4].T:
        total = 0.0
        for a, b, c, d in z[:4].T:
            beside = abs(x - a) <= reach * c and abs(y - b) <= reach * d
            if beside and sizes[0] * c <= w <= sizes[1] * c and sizes[0] * d <= h <= sizes[1] * d:
                total += 1 / (volume * (c * d) ** 2)
        out.append(total)
    return np.array(out)


def laid_births(state, noise, rows, births, among, beside):
    """Densities (n,) of births beside others, means and covariances of the states.

    ``births`` are low, high, uniform, weight, mean, cov of p(x|b), ``among`` the same of p(z|o).
    """
    density, mean, cov = given_detections(state, noise, rows, *births)
    z, flat = state[rows], births[2]
    low, high, uniform, *gaussians = among
    objects = mixture_density(z, low, high, uniform, uniform, *gaussians)
    return beside * around_each(z) * np.maximum(density, flat) / objects, mean, cov
