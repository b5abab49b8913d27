"""Plain twins of the kernels: one loop over everything, as the definition reads."""

from __future__ import annotations

import math

import numpy as np


def gated_pairs(px, py, lower, upper):
    """{(point, rectangle)} with the point inside the closed rectangle."""
    return {
        (i, j)
        for j in range(lower.shape[1])
        for i in range(len(px))
        if lower[0, j] <= px[i] <= upper[0, j] and lower[1, j] <= py[i] <= upper[1, j]
    }


def scaled_distance2(x, centre, scale, point, which):
    return np.array(
        [
            math.fsum(((a - b) / s) ** 2 for a, b, s in zip(x[:, i], centre[:, j], scale[:, j], strict=True))
            for i, j in zip(point, which, strict=True)
        ]
    )


def quadratic_form(x, centre, precision, point, which):
    out = np.empty(len(point))
    for p, (i, j) in enumerate(zip(point, which, strict=True)):
        step = x[:, i] - centre[:, j]
        out[p] = step @ precision[j] @ step
    return out


def nearest(distance2, point, which, count):
    label, best = np.full(count, -1), np.full(count, np.inf)
    for i in range(count):
        mine = sorted((d, j) for d, p, j in zip(distance2, point, which, strict=True) if p == i)
        if mine:
            best[i], label[i] = mine[0]
    return label, best


def shares(log_density, point, count):
    """In exact logarithms: what is far below its point's best still has its small share."""
    out = np.empty(len(point))
    for i in range(count):
        mine = np.flatnonzero(point == i)
        for p in mine:
            out[p] = 1 / math.fsum(math.exp(min(log_density[q] - log_density[p], 700.0)) for q in mine)
    return out


def moments(x, weight, point, which, k):
    d = len(x)
    mass, mean, cov = np.zeros(k), np.zeros((d, k)), np.zeros((k, d, d))
    for j in range(k):
        mine = which == j
        w, y = weight[mine], x[:, point[mine]]
        mass[j] = math.fsum(w)
        if mass[j] > 0:
            mean[:, j] = (w * y).sum(1) / mass[j]
            step = y - mean[:, [j]]
            cov[j] = (w * step) @ step.T / mass[j]
    return mass, mean, cov


def systematic(weight, count, offset):
    """Tooth n belongs to the first point whose cumulative weight exceeds it."""
    total = np.cumsum(weight)
    teeth = (np.arange(count) + offset) * (total[-1] / count)
    return np.searchsorted(total, teeth, side="right")


def gaussian_parts(step, cov):
    distance2 = [s @ np.linalg.solve(c, s) for s, c in zip(step.T, cov, strict=True)]
    return np.array(distance2), np.array([np.linalg.slogdet(c)[1] for c in cov])


def best_matching(rows, columns, edges):
    """The largest total gain of a matching in which everybody may stay alone at gain 0; ``edges`` {(row, column): gain}."""
    from scipy.optimize import linear_sum_assignment

    # One more column for each row: to stay alone. Forbidden pairs cost more than all gains together.
    never = -1.0 - sum(abs(g) for g in edges.values())
    table = np.full((rows, columns + rows), never)
    for (r, c), gain in edges.items():
        table[r, c] = gain
    table[range(rows), range(columns, columns + rows)] = 0.0
    return float(table[linear_sum_assignment(table, maximize=True)].sum())
