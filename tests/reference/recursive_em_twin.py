"""Recursive MAP-EM as M09 (16)–(20) print it, in plain NumPy, one sample at a time."""

from __future__ import annotations

import numpy as np


def recursive_em(weight, mean, cov, uniform, samples, tau, memory, log_flat, least, floor, bound=0.5):
    """Steady rate only. Lists of components; returns what is left: weight, mean (M, d), cov, uniform."""
    weight, mean, cov = list(weight), [m.copy() for m in mean], [c.copy() for c in cov]
    d = samples.shape[1]
    for x in samples:
        count = len(weight)
        rate = min(1 / memory, bound / (tau * count))
        log_density = np.array(
            [
                np.log(w) - 0.5 * np.linalg.slogdet(2 * np.pi * c)[1] - 0.5 * (x - m) @ np.linalg.solve(c, x - m)
                for w, m, c in zip(weight, mean, cov, strict=True)
            ]
        )
        log_gauss = np.logaddexp.reduce(log_density)
        o = np.exp(log_density - log_gauss)
        flat = uniform * np.exp(log_flat)
        o_u = flat / (flat + (1 - uniform) * np.exp(log_gauss))
        uniform = np.clip(uniform + rate * (o_u - uniform), least, 1 - least)
        for m in range(count):
            rho = min(1, rate * o[m] / weight[m])
            weight[m] += rate * ((o[m] - tau * rate) / (1 - count * tau * rate) - weight[m])
            step = x - mean[m]
            cov[m] = cov[m] + rho * (np.outer(step, step) + np.diag(floor) - cov[m])
            mean[m] = mean[m] + rho * step
        kept = [m for m in range(count) if weight[m] > 0]
        total = sum(weight[m] for m in kept)
        weight, mean, cov = [weight[m] / total for m in kept], [mean[m] for m in kept], [cov[m] for m in kept]
    return np.array(weight), np.array(mean).reshape(-1, d), np.array(cov).reshape(-1, d, d), uniform
