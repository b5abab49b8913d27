"""K-means of the extraction with every pair in reach written out: what the form over blocks must
agree with.

Particles are (d, L), weights (L,), centres (d, k). Everything is a dense table of particles and
centres, in float64.
"""

from __future__ import annotations

import numpy as np

from phdtrack.arrays import iou
from phdtrack.kernels.kmeans import PATIENCE, STILL, STRAY

REACH = 8.0


def label(x, centres, scale, began):
    """The nearest centre of those near whose beginnings each particle lies (−1: none), and its
    scaled distance².
    """
    if centres.shape[1] == 0:
        return np.full(x.shape[1], -1), np.full(x.shape[1], np.inf)
    inside = (np.abs(x[:2, :, None] - began[:2, None, :]) <= REACH * scale[:2, None, :]).all(0)
    step = (x[:, :, None] - centres[:, None, :]) / scale[:, None, :]
    distance2 = np.where(inside, (step**2).sum(0), np.inf)
    best = distance2.min(1)
    return np.where(np.isfinite(best), distance2.argmin(1), -1), best


def moments(x, weight, k):
    """Masses, means, covariances for weights (L, k)."""
    d = len(x)
    mass = weight.sum(0)
    mean = np.zeros((d, k))
    cov = np.zeros((k, d, d))
    for j in np.flatnonzero(mass > 0):
        mean[:, j] = x @ weight[:, j] / mass[j]
        step = x - mean[:, [j]]
        cov[j] = (weight[:, j] * step) @ step.T / mass[j]
    return mass, mean, cov


def members(labels, weight, k):
    """(L, k) the weight of each particle where it belongs to the cluster."""
    return np.where(labels[:, None] == np.arange(k), weight[:, None], 0.0)


def cluster(x, weight, centre, scale, split, iterations):
    """Labels (L,), masses and means after K-means in which clusters heavier than ``split`` are
    divided.
    """
    rounds = int(np.ceil(2 * weight.sum() / split))
    began = centre
    centre = centre.copy()
    strays = np.zeros(centre.shape[1], int)
    steps = np.zeros(centre.shape[1], int)
    parent = np.zeros(0, int)
    for turn in range(rounds + 1):
        while True:
            labels, distance2 = label(x, centre, scale, began)
            mass, mean, _ = moments(x, members(labels, weight, centre.shape[1]), centre.shape[1])
            mean = np.where(mass > 0, mean, centre)
            moved = (np.abs(mean - centre) > STILL * scale).any(0) & (steps < iterations)
            if not moved.any():
                break
            steps += moved
            centre = np.where(moved, mean, centre)
        k = len(mass)
        for i, j in zip(parent, range(k - len(parent), k), strict=True):
            if max(mass[i], mass[j]) > split and min(mass[i], mass[j]) < STRAY * split:
                strays[i] += 1
                strays[j] = strays[i]
        heavy = np.flatnonzero((mass > split) & (strays < PATIENCE))
        far = {j: int(np.argmax(np.where(labels == j, distance2, -1.0))) for j in heavy}
        far = {j: i for j, i in far.items() if distance2[i] > 0}
        if turn == rounds or not far:
            break
        parent = np.array(list(far))
        new = x[:, list(far.values())]
        centre = np.hstack([centre, new])
        began = np.hstack([began, new])
        scale = np.hstack([scale, scale[:, parent]])
        steps[parent] = 0
        steps, strays = (np.append(a, np.zeros(len(far), int)) for a in (steps, strays))
    return labels, mass, mean


def join_light(mass, mean, noise, lightest, split):
    """(k,) what each cluster becomes part of; pairs of light ones that are near each other, nearest
    first.
    """
    root = np.arange(len(mass))
    mass = mass.copy()
    light = np.flatnonzero((mass > 0) & (mass < lightest))
    scale = noise(mean)
    pairs = []
    for i in light:
        for j in light[light > i]:
            apart = (((mean[:, i] - mean[:, j]) / scale[:, i]) ** 2).sum()
            if apart <= REACH**2:
                pairs.append((apart, i, j))
    for _, a, b in sorted(pairs):
        i = root[a]
        j = root[b]
        if i != j and min(mass[i], mass[j]) < lightest and mass[i] + mass[j] <= split:
            root[root == j] = i
            mass[i] = mass[i] + mass[j]
            mass[j] = 0.0
    return root


def kmeans(x, weight, centres, noise, lightest, split, iterations=5):
    """Masses, means and covariances of the clusters heavy enough, from the centres (d, k) on."""
    labels, mass, mean = cluster(x, weight, centres, noise(centres), split, iterations)
    root = join_light(mass, mean, noise, lightest, split)
    labels = np.where(labels >= 0, np.append(root, -1)[labels], -1)
    mass, mean, cov = moments(x, members(labels, weight, len(root)), len(root))
    kept = mass >= lightest
    return mass[kept], mean[:, kept], cov[kept]


def join_alike(boxes, overlap, mass, mean, cov):
    """Masses, means, covariances of what is left once no two boxes overlap by more, and the
    heaviest part of each.

    All pairs are looked at anew after every union.
    """
    left = [
        ([i], m, x, c, b)
        for i, (m, x, c, b) in enumerate(zip(mass, mean.T, cov, boxes, strict=True))
    ]
    while True:
        box = np.array([b for *_, b in left])
        overlaps = iou(box, box)
        shared = {(i, j): overlaps[i, j] for j in range(len(left)) for i in range(j)}
        above = {pair: s for pair, s in shared.items() if s > overlap}
        if not above:
            break
        i, j = min(above, key=lambda pair: (-above[pair], pair))
        one, a, x, c, b = left[i]
        other, e, y, f, g = left[j]
        total = a + e
        middle = (a * x + e * y) / (a + e)
        spread = (
            sum(w * (s + np.outer(p - middle, p - middle)) for w, p, s in ((a, x, c), (e, y, f)))
            / total
        )
        left[i] = (one + other, total, middle, spread, (a * b + e * g) / total)
        del left[j]
    part = [max(parts, key=lambda i: mass[i]) for parts, *_ in left]
    return [m for _, m, *_ in left], [x for _, _, x, *_ in left], [c for *_, c, _ in left], part
