"""K-means and EM of the extraction with every pair in reach written out: what the forms over blocks must agree with.

Particles are (d, L), weights (L,), centres (d, k). Everything is a dense table of particles and centres, in float64.
"""

from __future__ import annotations

import numpy as np

from phdtrack.arrays import iou
from phdtrack.kernels.dividing import PATIENCE, STRAY
from phdtrack.kernels.kmeans import STILL

REACH = 8.0


def table(x, centres, scale):
    """(L, k) scaled distance², infinite where the centre does not reach the particle."""
    step = (x[:, :, None] - centres[:, None, :]) / scale[:, None, :]
    inside = (np.abs(step[:2]) <= REACH).all(0)
    return np.where(inside, (step**2).sum(0), np.inf)


def label(x, centres, scale):
    """The nearest centre in reach of each particle (−1: none), and its scaled distance²."""
    if centres.shape[1] == 0:
        return np.full(x.shape[1], -1), np.full(x.shape[1], np.inf)
    distance2 = table(x, centres, scale)
    best = distance2.min(1)
    return np.where(np.isfinite(best), distance2.argmin(1), -1), best


def moments(x, weight, k):
    """Masses, means, covariances for weights (L, k)."""
    d = len(x)
    mass, mean, cov = weight.sum(0), np.zeros((d, k)), np.zeros((k, d, d))
    for j in np.flatnonzero(mass > 0):
        mean[:, j] = x @ weight[:, j] / mass[j]
        step = x - mean[:, [j]]
        cov[j] = (weight[:, j] * step) @ step.T / mass[j]
    return mass, mean, cov


def members(labels, weight, k):
    """(L, k) the weight of each particle where it belongs to the cluster."""
    return np.where(labels[:, None] == np.arange(k), weight[:, None], 0.0)


def names(labels, other, k):
    """(k,) what another numbering of the same clusters calls each; −1 for one that is empty."""
    out = np.full(k, -1)
    out[labels[labels >= 0]] = other[labels >= 0]
    return out


def settle(x, weight, centre, mean, moved, alive, steps, scale, labels, iterations):
    """Assignment and means in turn until no particle changes: what is needed to go on. A centre follows its mean where
    that has moved by more than STILL deviations, or where its cluster has come to life or died, ``iterations`` times at
    most; ``steps`` is counted up."""
    k = centre.shape[1]
    while True:
        centre = np.where(moved, mean, centre)
        steps += moved
        before, (labels, _) = labels, label(x, np.where(alive, centre, np.inf), scale)
        mass, mean, _ = moments(x, members(labels, weight, k), k)
        held = np.bincount(labels[labels >= 0], minlength=k) > 0
        mean = np.where(held, mean, centre)
        moved = ((held != alive) | (np.abs(mean - centre) > STILL * scale).any(0)) & (steps < iterations)
        alive = held
        if np.array_equal(labels, before):
            break
    return centre, mean, mass, alive, labels


def cluster(x, weight, centre, scale, split, iterations, rounds):
    """Labels (L,), masses and means after K-means in which clusters heavier than ``split`` are divided."""
    labels, mean, began = np.full(len(weight), -1), centre, 0
    alive, moved = (np.ones(centre.shape[1], bool) for _ in range(2))
    parent, strays, steps = (np.zeros(centre.shape[1], int) for _ in range(3))
    steps -= 1
    for turn in range(rounds + 1):
        centre, mean, mass, alive, labels = settle(x, weight, centre, mean, moved, alive, steps, scale, labels, iterations)
        for j in range(began, len(mass)) if began else ():
            i = parent[j]
            if max(mass[i], mass[j]) > split and min(mass[i], mass[j]) < STRAY * split:
                strays[i] += 1
                strays[j] = strays[i]
        began = len(mass)
        _, distance2 = label(x, np.where(alive, centre, np.inf), scale)
        heavy = np.flatnonzero((mass > split) & (strays < PATIENCE))
        far = {j: int(np.argmax(np.where(labels == j, distance2, -1.0))) for j in heavy}
        far = {j: i for j, i in far.items() if distance2[i] > 0}
        if turn == rounds or not far:
            break
        divided, stray = list(far), x[:, list(far.values())]
        centre, mean, scale = np.hstack([centre, stray]), np.hstack([centre, stray]), np.hstack([scale, scale[:, divided]])
        moved, alive = np.arange(centre.shape[1]) >= began, np.append(alive, np.ones(len(far), bool))
        steps[divided] = 0
        steps = np.append(steps, np.full(len(far), -1))
        parent, strays = np.append(parent, divided), np.append(strays, np.zeros(len(far), int))
    return labels, mass, mean


def join_light(mass, mean, noise, lightest, split):
    """(k,) what each cluster becomes part of; pairs of light ones that are near each other, nearest first."""
    root, mass = np.arange(len(mass)), mass.copy()
    light = np.flatnonzero((mass > 0) & (mass < lightest))
    scale = noise(mean)
    pairs = []
    for i in light:
        for j in light[light > i]:
            apart = (((mean[:, i] - mean[:, j]) / scale[:, i]) ** 2).sum()
            if apart <= REACH**2:
                pairs.append((apart, i, j))
    for _, a, b in sorted(pairs):
        i, j = root[a], root[b]
        if i != j and min(mass[i], mass[j]) < lightest and mass[i] + mass[j] <= split:
            root[root == j] = i
            mass[i], mass[j] = mass[i] + mass[j], 0.0
    return root


def kmeans(x, weight, centres, noise, lightest, split, iterations=5):
    """Masses, means and covariances of the clusters heavy enough, from the centres (d, k) on."""
    rounds = int(np.ceil(2 * weight.sum() / split))
    labels, mass, mean = cluster(x, weight, centres, noise(centres), split, iterations, rounds)
    root = join_light(mass, mean, noise, lightest, split)
    labels = np.where(labels >= 0, np.append(root, -1)[labels], -1)
    mass, mean, cov = moments(x, members(labels, weight, len(root)), len(root))
    kept = mass >= lightest
    return mass[kept], mean[:, kept], cov[kept]


def em(x, weight, amount, mean, cov, scale):
    """Masses, means and covariances after one EM iteration."""
    k = len(amount)
    inside = np.isfinite(table(x, mean, scale))
    log = np.full(inside.shape, -np.inf)
    for j in range(k):
        step = x - mean[:, [j]]
        log[:, j] = np.log(amount[j]) - 0.5 * np.linalg.slogdet(cov[j])[1]
        log[:, j] -= 0.5 * (step * np.linalg.solve(cov[j], step)).sum(0)
    log[~inside] = -np.inf
    top = log.max(1, keepdims=True, initial=-1e300)
    share = np.exp(log - top) * inside
    total = share.sum(1, keepdims=True)
    return moments(x, np.divide(share, total, out=np.zeros_like(share), where=total > 0) * weight[:, None], k)


def join_alike(boxes, overlap, mass, mean, cov):
    """Masses, means, covariances of what is left once no two boxes overlap by more, and the heaviest part of each.

    All pairs are looked at anew after every union.
    """
    left = [([i], m, x, c, b) for i, (m, x, c, b) in enumerate(zip(mass, mean.T, cov, boxes, strict=True))]
    while True:
        box = np.array([b for *_, b in left])
        overlaps = iou(box, box)
        shared = {(i, j): overlaps[i, j] for j in range(len(left)) for i in range(j)}
        above = {pair: s for pair, s in shared.items() if s > overlap}
        if not above:
            break
        i, j = min(above, key=lambda pair: (-above[pair], pair))
        (one, a, x, c, b), (other, e, y, f, g) = left[i], left[j]
        total, middle = a + e, (a * x + e * y) / (a + e)
        spread = sum(w * (s + np.outer(p - middle, p - middle)) for w, p, s in ((a, x, c), (e, y, f))) / total
        left[i] = (one + other, total, middle, spread, (a * b + e * g) / total)
        del left[j]
    part = [max(parts, key=lambda i: mass[i]) for parts, *_ in left]
    return [m for _, m, *_ in left], [x for _, _, x, *_ in left], [c for *_, c, _ in left], part
