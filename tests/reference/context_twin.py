"""Learned densities Gaussian by Gaussian, with matrix inverses."""

from __future__ import annotations

import numpy as np

from reference.gm_twin import density as gaussian


def mixture_density(x, low, high, uniform, outside, weight, mean, cov):
    """At x (d, n): ``uniform`` and the Gaussians, means (d, M), from ``low`` to ``high``, else
    ``outside``.
    """
    out = []
    for place in x.T:
        total = uniform + sum(
            w * gaussian(place - m, c) for w, m, c in zip(weight, mean.T, cov, strict=True)
        )
        out.append(total if (low <= place).all() and (place <= high).all() else outside)
    return np.array(out)


def given_detections(state, noise, rows, low, high, uniform, weight, mean, cov):
    """Densities (n,), means (d, n), covariances (n, d, d) of `SceneBirth.around`."""
    hidden = [r for r in range(len(state)) if r not in rows]
    densities = []
    states = state.copy()
    covs = noise.copy()
    for j in range(state.shape[1]):
        z = state[rows, j]
        r = noise[j][np.ix_(rows, rows)]
        shares = [uniform]
        means = [state[hidden, j]]
        spreads = [noise[j][np.ix_(hidden, hidden)]]
        for w, m, c in zip(weight, mean.T, cov, strict=True):
            seen = c[np.ix_(rows, rows)] + r
            cross = c[np.ix_(hidden, rows)]
            shares.append(w * gaussian(z - m[rows], seen))
            means.append(m[hidden] + cross @ np.linalg.inv(seen) @ (z - m[rows]))
            spreads.append(c[np.ix_(hidden, hidden)] - cross @ np.linalg.inv(seen) @ cross.T)
        share = np.array(shares) / sum(shares)
        about = share @ np.array(means)
        within = sum(
            s * (c + np.outer(m - about, m - about))
            for s, m, c in zip(share, means, spreads, strict=True)
        )
        densities.append(sum(shares) if (low <= z).all() and (z <= high).all() else 0.0)
        states[hidden, j] = about
        covs[np.ix_([j], hidden, hidden)] = within
    return np.array(densities), states, covs
