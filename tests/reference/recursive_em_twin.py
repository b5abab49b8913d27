"""Recursive MAP-EM as M09 (16)–(20) print it, in plain NumPy, one sample at a time; with weights and missing values."""

from __future__ import annotations

import numpy as np


def recursive_em(weight, mean, cov, uniform, samples, tau, memory, extent, least, floor, worth=None, bound=0.5):
    """Steady rate only. Lists of components; returns what is left: weight, mean (M, d), cov, uniform."""
    weight, mean, cov = list(weight), [m.copy() for m in mean], [c.copy() for c in cov]
    d = samples.shape[1]
    worth = np.ones(len(samples)) if worth is None else worth
    for x, w in zip(samples, worth, strict=True):
        count = len(weight)
        rate = min(1 / memory, bound / (tau * count))
        seen, hidden = np.flatnonzero(~np.isnan(x)), np.flatnonzero(np.isnan(x))
        log_density, expected, covariance = [], [], []
        for share, m, c in zip(weight, mean, cov, strict=True):
            step, c_ss = (x - m)[seen], c[np.ix_(seen, seen)]
            distance2, log_det = step @ np.linalg.solve(c_ss, step), np.linalg.slogdet(2 * np.pi * c_ss)[1]
            log_density.append(np.log(share) - 0.5 * (log_det + distance2))
            gain = c[np.ix_(hidden, seen)] @ np.linalg.inv(c_ss)
            full, left = x.copy(), np.diag(np.where(np.isnan(x), 0.0, floor))
            full[hidden] = m[hidden] + gain @ step
            left[np.ix_(hidden, hidden)] = c[np.ix_(hidden, hidden)] - gain @ c[np.ix_(seen, hidden)]
            expected.append(full)
            covariance.append(left)
        log_gauss = np.logaddexp.reduce(log_density)
        o = np.exp(log_density - log_gauss)
        flat = uniform / np.prod(extent[seen])
        o_u = flat / (flat + (1 - uniform) * np.exp(log_gauss))
        beta = min(1, rate * w)
        uniform = np.clip(uniform + beta * (o_u - uniform), least, 1 - least)
        for m in range(count):
            rho = min(1, beta * o[m] / weight[m])
            weight[m] += beta * ((o[m] - tau * rate) / (1 - count * tau * rate) - weight[m])
            step = expected[m] - mean[m]
            cov[m] = cov[m] + rho * (np.outer(step, step) + covariance[m] - cov[m])
            mean[m] = mean[m] + rho * step
        kept = [m for m in range(count) if weight[m] > 0]
        total = sum(weight[m] for m in kept)
        weight, mean, cov = [weight[m] / total for m in kept], [mean[m] for m in kept], [cov[m] for m in kept]
    return np.array(weight), np.array(mean).reshape(-1, d), np.array(cov).reshape(-1, d, d), uniform
