"""Plain twins of the kernels: one loop over everything, as the definition reads."""

from __future__ import annotations

import numpy as np


def gated_pairs(px, py, lower, upper):
    """{(point, rectangle)} with the point inside the closed rectangle."""
    return {
        (i, j)
        for j in range(lower.shape[1])
        for i in range(len(px))
        if lower[0, j] <= px[i] <= upper[0, j] and lower[1, j] <= py[i] <= upper[1, j]
    }


def quadratic_form(x, centre, precision, point, which):
    out = np.empty(len(point))
    for p, (i, j) in enumerate(zip(point, which, strict=True)):
        step = x[:, i] - centre[:, j]
        out[p] = step @ precision[j] @ step
    return out


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
