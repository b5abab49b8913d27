"""The association's kernels once more, plainly: one column, one pair, one identity at a time."""

from __future__ import annotations

import numpy as np
from scipy.stats import multivariate_normal


def moved_boxes(x, dt, acceleration, resize, smallest, scaled):
    """Mean, Jacobian and noise of boxes at constant velocity, as matrices of the state's components."""
    d, n = x.shape
    f = np.eye(d)
    f[0, 2] = f[1, 3] = dt
    if d == 8:
        f[6:8, 4:6], f[6:8, 6:8] = np.eye(2), 0
    unit = np.maximum(x[4:6], smallest) if scaled else np.ones((2, n))
    noise = np.zeros((n, d, d))
    driven = np.array([[dt**3 / 3 - min(dt, dt**3) / 12, dt**2 / 2], [dt**2 / 2, dt]])
    for i in range(n):
        for axis in (0, 1):
            rows = [axis, axis + 2]
            noise[i][np.ix_(rows, rows)] = (acceleration * unit[axis, i]) ** 2 * driven
            noise[i, axis + 4, axis + 4] = (resize * unit[axis, i]) ** 2 * dt
    return f @ x, f, noise


def predicted(cov, jacobian, noise):
    """F P Fᵀ + Q."""
    f = np.broadcast_to(jacobian, (max(len(cov), len(jacobian)), *cov.shape[1:]))
    return np.array([f[i] @ cov[i] @ f[i].T + noise[i] for i in range(len(cov))]).reshape(cov.shape)


def edges(mean, cov, noise, sigma, since, rows, dt, gate, log_miss, consistent):
    """{(new state, column): gain} of every pair worth taking."""
    count, found = len(since), {}
    block = np.ix_(rows, rows)
    for i in range(sigma.shape[1]):
        typical = noise[i][block] + 2 * np.diag(sigma[rows, i] ** 2)
        loose = -0.5 * (gate**2 + np.linalg.slogdet(2 * np.pi * typical)[1])
        for c in range(count):
            spread = cov[c][block] + cov[count + i][block]
            step = mean[rows, count + i] - mean[rows, c]
            worth = multivariate_normal.logpdf(step, cov=spread) - loose + (since[c] - dt) * log_miss
            if worth > 0 and step @ np.linalg.solve(spread, step) <= consistent**2:
                found[i, c] = worth
    return found


def claimed(first, n, used, given, onward, worth, shortest, least):
    """Identities by dictionaries: name of each vertex, and of each name its last vertex, states, gain and belief."""
    names = {first + k: int(name) for k, name in enumerate(given[0])}
    now = first + len(names)
    holder = {
        int(given[0][k]): [first + k, int(given[1][k]), float(given[2][k]), bool(given[3][k])]
        for k in range(len(names))
        if given[4][k]
    }
    goes_on = {first + k: (int(w), float(worth[k])) for k, w in enumerate(onward) if w >= 0}
    before = {w: (v, gain) for v, (w, gain) in goes_on.items() if now <= w < now + n}
    follows = {v: v in before and holder[names[before[v][0]]][0] == before[v][0] for v in range(now, now + n)}
    taken = set()
    for v in sorted(follows, key=lambda v: (not follows[v], v)):
        name = names[before[v][0]] if v in before else 0
        length, gain, sure = 0, 0.0, False
        if name == 0 or name in taken:
            used += 1
            name = used
        else:
            _, length, gain, sure = holder[name]
            gain += before[v][1]
        taken.add(name)
        names[v] = name
        holder[name] = [v, length + 1, gain, sure]

    def enough(length, gain):
        return length >= shortest and gain >= least * (length - 1)

    for state in holder.values():
        v, length, gain, sure = state
        while not enough(length, gain) and goes_on.get(v, (-1, 0))[0] >= now + n:
            v, more = goes_on[v]
            length, gain = length + 1, gain + more
        state[3] = sure or enough(length, gain)
    absent = sorted(
        v for v, _, _, sure in holder.values() if v < now and sure and not 0 <= goes_on.get(v, (-1, 0))[0] < now + n
    )
    return names, holder, absent, used


def asked(first, given, holder, counts):
    """Adds to ``counts`` (2, A) who of the missing of the last frame was asked for, and who has come back since."""
    for k, name in enumerate(given[0].tolist()):
        age = int(given[5][k])
        if given[4][k] and given[3][k] and 0 < age < counts.shape[1]:
            counts[0, age] += 1
            counts[1, age] += holder[name][0] != first + k


def returning(survive, detect, counts):
    """The probability of at least one return from each age on, with one of the model's among those counted."""
    ages = counts.shape[1]
    # Of one target: there from age to age, as by Bayes' rule over its two ways of being missed.
    there, hazard = 1.0, []
    for age in range(ages):
        stays = there * survive
        hazard.append((counts[1, age] + stays * detect) / (counts[0, age] + 1))
        missed, gone = stays * (1 - detect), 1 - stays
        there = missed / (missed + gone) if missed + gone > 0 else 0.0
    return np.array([1 - np.prod([1 - h for h in hazard[age:]]) for age in range(ages)])
