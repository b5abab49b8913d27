"""The association once more, plainly: gains one pair at a time, path covers by trying all, the
textbook's smoother.

A cover of vertices by paths is a set of links (later, earlier) in which each vertex occurs at most
once on either side.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import multivariate_normal


def gains(frames, intervals, matching, model):
    """{(later, earlier): gain} of all edges worth taking between states of different frames;
    vertices count through.

    ``frames`` is a list of `Estimates`, ``intervals`` the model time from the frame before to each.
    The gain is the log-density of the later state under the j-step transition, convolved with both
    covariances, less that of a state ``loose_end_distance`` deviations from a typical one-step
    prediction, less the price of the time without a state.
    """
    rows = np.ix_(model.sensor.observed, model.sensor.observed)
    seen = list(model.sensor.observed)
    first = np.cumsum([0, *(len(f) for f in frames)])
    found = {}
    for k, here in enumerate(frames):
        for back in range(k):
            for a in range(len(frames[back])):
                mean = frames[back].state[:, [a]]
                cov = frames[back].covariance[a]
                for dt in intervals[back + 1 : k + 1]:
                    mean, jacobian, noise = model.motion.transition(mean, dt)
                    cov = jacobian[0] @ cov @ jacobian[0].T + noise[0]
                if sum(intervals[back + 1 : k + 1]) > matching.window * model.rate + 1e-9:
                    continue
                for b in range(len(here)):
                    spread = cov[rows] + here.covariance[b][rows]
                    step = here.state[seen, b] - mean[seen, 0]
                    distance2 = float(step @ np.linalg.solve(spread, step))
                    density = multivariate_normal.logpdf(step, cov=spread)
                    worth = density - _loose(here.state[:, [b]], intervals[k], matching, model)
                    worth += sum(intervals[back + 1 : k]) * -matching.gap_cost / model.rate
                    if worth > 0 and distance2 <= matching.max_link_distance**2:
                        found[int(first[k] + b), int(first[back] + a)] = worth
    return found


def _loose(state, dt, matching, model):
    """The log-density of two loose ends: two measurements' noise and one step of the motion's, at
    `loose_end_distance`.
    """
    seen = list(model.sensor.observed)
    _, _, noise = model.motion.transition(state, dt)
    typical = noise[0][np.ix_(seen, seen)] + 2 * np.diag(model.sensor.noise(state)[seen, 0] ** 2)
    _, log_det = np.linalg.slogdet(2 * np.pi * typical)
    return -0.5 * (matching.loose_end_distance**2 + log_det)


def best_cover(edges):
    """The largest total gain of a cover, by trying for each vertex every earlier one and none."""
    later = sorted({b for b, _ in edges})
    options = [[(a, gain) for (b, a), gain in edges.items() if b == vertex] for vertex in later]

    @cache
    def best(row, used):
        if row == len(later):
            return 0.0
        tried = [best(row + 1, used)]
        tried += [
            gain + best(row + 1, used | 1 << a) for a, gain in options[row] if not used >> a & 1
        ]
        return max(tried)

    return best(0, 0)


def best_assignment(edges):
    """The same by SciPy's assignment, a pair without an edge being worth nothing."""
    if not edges:
        return 0.0
    later = sorted({b for b, _ in edges})
    earlier = sorted({a for _, a in edges})
    table = np.zeros((len(later), len(earlier)))
    for (b, a), gain in edges.items():
        table[later.index(b), earlier.index(a)] = gain
    row, column = linear_sum_assignment(table, maximize=True)
    return float(table[row, column].sum())


def smoothed(motion, before, cov_before, after, cov_after, steps):
    """(d, n) means in a gap: Kalman filter with one measurement of the full state at its end, and
    the RTS smoother.
    """
    mean = [before]
    cov = [cov_before]
    predicted = []
    jacobians = []
    for dt in steps:
        moved, jacobian, noise = motion.transition(mean[-1][:, None], float(dt))
        mean.append(moved[:, 0])
        cov.append(jacobian[0] @ cov[-1] @ jacobian[0].T + noise[0])
        predicted.append((mean[-1], cov[-1]))
        jacobians.append(jacobian[0])
    gain = cov[-1] @ np.linalg.inv(cov[-1] + cov_after)
    smooth = mean[-1] + gain @ (after - mean[-1])
    out = []
    for k in range(len(steps) - 1, 0, -1):
        back = cov[k] @ jacobians[k].T @ np.linalg.inv(predicted[k][1])
        smooth = mean[k] + back @ (smooth - predicted[k][0])
        out.append(smooth)
    return np.array(out[::-1]).reshape(-1, len(before)).T


def led_back(motion, sensor, state, cov, measured, dt):
    """(d, n) means of the n states before ``state``, each given it and the measurements (4, n) from
    itself on.

    The joint Gaussian of all states, written down at once and conditioned: x_k = F⁻¹ (x_{k+1} − w),
    w ~ N(0, Q).
    """
    d = len(state)
    seen = list(sensor.observed)
    _, jacobian, noise = motion.transition(state[:, None], dt)
    back = np.linalg.inv(jacobian[0])
    n = measured.shape[1]
    powers = [np.linalg.matrix_power(back, j) for j in range(n + 2)]
    out = []
    for count in range(1, n + 1):
        # x_j for j = 1 … count steps back as a linear map of (x_0, w_1, …, w_count)
        maps = [
            np.hstack(
                [
                    powers[j],
                    *(
                        -powers[j - i + 1] if i <= j else np.zeros((d, d))
                        for i in range(1, count + 1)
                    ),
                ]
            )
            for j in range(1, count + 1)
        ]
        sources = np.zeros(((count + 1) * d, (count + 1) * d))
        sources[:d, :d] = cov
        for i in range(1, count + 1):
            sources[i * d : (i + 1) * d, i * d : (i + 1) * d] = noise[0]
        z = measured[:, n - count :][:, ::-1]
        rows = np.vstack([m[seen] for m in maps])
        x, _ = sensor.states(z)
        spread = rows @ sources @ rows.T + np.diag((sensor.noise(x)[seen] ** 2).T.ravel())
        mean = [powers[j] @ state for j in range(1, count + 1)]
        step = z.T.ravel() - np.concatenate([m[seen] for m in mean])
        out.append(mean[-1] + maps[-1] @ sources @ rows.T @ np.linalg.solve(spread, step))
    return np.array(out[::-1]).T
