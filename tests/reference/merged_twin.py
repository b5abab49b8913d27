"""The merged-measurement model as `detect.merged` states it: every explanation written out, with
matrix inverses.

Blobs (N, 4) and targets' boxes (n, 4) are left, top, right, bottom.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from phdtrack.arrays import area, intersection

GATE = 5.0
GROUP = 6
NEAR = 9.21
TINY = 1e-300
MAX_EXISTENCE = 0.99
MIN_EXISTENCE = 0.1
# (left, top, right, bottom) of (centre x, centre y, width, height), and the direction in which each
# edge lies outward.
EDGES = np.array([[1, 0, -0.5, 0], [0, 1, 0, -0.5], [1, 0, 0.5, 0], [0, 1, 0, 0.5]])
OUTWARD = np.array([-1.0, -1.0, 1.0, 1.0])


def members(rule, model, targets, detections):
    """The targets of each blob in the best explanation, by number, in the order of their edges."""
    # In that order throughout, so that nothing depends on the order in which they come.
    blobs = np.lexsort(detections.xyxy.T[::-1])
    rows = np.lexsort(model.sensor.boxes(targets.state).T[::-1])
    out = [()] * len(blobs)
    for b, several in zip(
        blobs, _in_order(rule, model, targets.select(rows), detections.select(blobs)), strict=True
    ):
        out[b] = tuple(rows[list(several)].tolist())
    return out


def _in_order(rule, model, targets, detections):
    z = model.sensor.measure(detections)
    sensor = model.sensor
    blobs = detections.xyxy
    boxes = sensor.boxes(targets.state)
    known = np.isfinite(z).all(axis=0)
    spread = EDGES @ targets.covariance[:, sensor.observed][:, :, sensor.observed] @ EDGES.T
    # The targets' edges are moved out by a deviation.
    reach = np.sqrt(np.einsum("nii->ni", spread))
    low = boxes - reach
    high = boxes + reach
    meet = (blobs[:, None, :2] <= high[:, 2:]) & (low[:, :2] <= blobs[:, None, 2:])
    touching = meet.all(axis=2) & known[:, None]
    if max(touching.sum(axis=0).max(), touching.sum(axis=1).max()) < 2:
        return [tuple(np.flatnonzero(row)) for row in touching]
    shared = intersection(blobs, boxes)
    p = sensor.p_detect(targets.state)
    r = targets.existence
    covered = np.where(touching, shared, 0.0).max(axis=0) / np.maximum(area(boxes), TINY)
    missed = np.log(np.maximum(1 - r * (p + (1 - p) * np.minimum(covered, 1.0)), TINY)).tolist()
    clutter = np.zeros(len(blobs))
    clutter[known] = np.log(
        np.maximum(model.clutter.intensity(np.ascontiguousarray(z[:, known])), TINY)
    )

    def likelihood(blob, several):
        if not several:
            return clutter[blob]
        noise = sensor.covariance(z[:, [blob] * len(several)], targets.state[:, several])
        fit = log_fit(
            rule,
            blobs[blob],
            boxes[several],
            spread[several] + EDGES @ noise @ EDGES.T,
            targets.select(several),
        )
        return fit + np.log(np.maximum(r[several] * p[several], TINY)).sum()

    out = [()] * len(blobs)
    for some, several, kept in groups(
        touching, shared / np.maximum(np.minimum(area(blobs)[:, None], area(boxes)), TINY)
    ):
        if len(some) == len(several) == 1:
            out[some[0]] = (several[0],)
            continue
        top = -math.inf
        known_of = {}
        # Of equally likely explanations the first.
        for choice in itertools.product(*([-1, *np.flatnonzero(kept[:, t])] for t in several)):
            of = {b: [t for t, at in zip(several, choice, strict=True) if at == b] for b in some}
            value = 0.0
            rest = 0.0
            for t, b in zip(several, choice, strict=True):
                value += missed[t] if b < 0 else 0.0
            for b in some:
                key = b, *of[b]
                if key not in known_of:
                    known_of[key] = likelihood(b, of[b])
                rest += known_of[key]
            if value + rest > top + 1e-9:
                top = value + rest
                best = of
        for b in some:
            out[b] = tuple(best[b])
    return out


def log_fit(rule, blob, boxes, covariance, targets):
    """Log-likelihood of a blob's edges where these targets (k) were detected, whose edges have
    covariances (k, 4, 4).
    """
    k = len(boxes)
    owner = owners(boxes)
    side = np.arange(4)
    if k > 1 and not (
        (targets.separate >= rule.min_separate_time).all()
        and (targets.hidden[hidden(boxes)] <= rule.max_hidden_time).all()
    ):
        return -math.inf
    same = owner[:, None] == owner[None, :]
    spread = np.where(same, covariance[owner[:, None], side[:, None], side[None, :]], 0.0)
    step = blob - boxes[owner, side]
    distance2 = (step * np.linalg.solve(spread, step)).sum()
    if distance2 > GATE**2:
        return -math.inf
    log_density = -0.5 * (distance2 + np.linalg.slogdet(2 * np.pi * spread)[1])
    return log_density + (k - 1) * math.log(max(rule.merge_probability, TINY))


def groups(touching, strength):
    """Blobs, targets and pairs (N, n) of the groups that pairs connect, the strongest first, of at
    most `GROUP` members.
    """
    n, m = touching.shape
    blob, target = np.nonzero(touching)
    group = np.arange(n + m)
    kept = np.zeros((n, m), bool)
    for p in np.argsort(-strength[blob, target], kind="stable"):
        a = group[blob[p]]
        c = group[n + target[p]]
        if a == c or np.count_nonzero((group == a) | (group == c)) <= GROUP:
            group[group == c] = a
            kept[blob[p], target[p]] = True
    for key in np.unique(group[:n][kept.any(axis=1)]):
        yield (
            np.flatnonzero(group[:n] == key).tolist(),
            np.flatnonzero(group[n:] == key).tolist(),
            kept,
        )


def owners(boxes):
    """(4,) which of the boxes (k, 4) has each edge of their union."""
    return (boxes * OUTWARD).argmax(axis=0)


def hidden(boxes):
    """(k,) which of the boxes (k, 4) have neither the left nor the right edge of their union."""
    out = np.ones(len(boxes), bool)
    out[owners(boxes)[[0, 2]]] = False
    return out


def placed(blob, boxes):
    """(k, 4) where a merged blob (4,) puts its targets' boxes (k, 4), their size unchanged."""
    owner = owners(boxes)
    k = np.arange(len(boxes))
    out = boxes.copy()
    for axis in (0, 1):
        low = blob[axis]
        high = blob[axis + 2]
        size = boxes[:, axis + 2] - boxes[:, axis]
        at_low = owner[axis] == k
        at_high = owner[axis + 2] == k
        start = np.where(at_low, low, boxes[:, axis])
        start = np.where(at_high, np.where(at_low, (low + high - size) / 2, high - size), start)
        room = high - low - size
        start = np.where(
            room > 0, np.clip(start, low, np.maximum(low, high - size)), low + room / 2
        )
        out[:, axis] = start
        out[:, axis + 2] = start + size
    return out


def divided(blobs, boxes, shown):
    """The boxes (N′, 4) of each blob's targets, ``shown`` of it, or of itself; which blob and which
    target they are of.
    """
    rows = [
        placed(blob, boxes[list(s)]) if len(s) > 1 else blob[None]
        for blob, s in zip(blobs, shown, strict=True)
    ]
    source = [b for b, several in enumerate(shown) for _ in several or (-1,)]
    return np.concatenate(rows), source, [t for several in shown for t in several or (-1,)]


def times(targets, boxes, shown, seconds):
    """(n,) each: the seconds for which targets have been hidden, and have had a blob to
    themselves.
    """
    out_of_sight = targets.hidden.copy()
    separate = targets.separate.copy()
    for index in [list(several) for several in shown if several]:
        separate[index] += seconds if len(index) == 1 else 0.0
        out_of_sight[index] = np.where(hidden(boxes[index]), out_of_sight[index] + seconds, 0.0)
    return out_of_sight, separate


def continued(targets, target, estimates, model):
    """(k,) the target that each estimate continues: that of its detection, else the nearest left
    within the gate, or −1.
    """
    of = np.append(target, -1)[estimates.detection]
    later = np.ones(len(of), bool)
    later[np.unique(of, return_index=True)[1]] = False
    of[later] = -1
    free = np.setdiff1d(np.arange(len(targets)), of)
    lost = np.flatnonzero(of < 0)
    if not len(free) or not len(lost):
        return of
    step = estimates.state[:2, lost, None] - targets.state[:2, None, free]
    noise2 = np.square(model.sensor.noise(targets.state[:, free])[:2]).T
    spread = targets.covariance[free, :2, :2] + noise2[:, :, None] * np.eye(2)
    distance2 = np.einsum("aij,jab,bij->ij", step, np.linalg.inv(spread), step)
    while distance2.min() <= NEAR:
        i, j = np.argwhere(distance2 == distance2.min())[0]
        of[lost[i]] = free[j]
        distance2[i, :] = np.inf
        distance2[:, j] = np.inf
    return of


def unseen(rule, targets, target, of, model, seconds):
    """Indices, r and seconds hidden of the targets that no estimate shows but that may be there,
    and that no detection has shown where ``target`` (N′,) does not name them."""
    p = model.sensor.p_detect(targets.state)
    r = targets.existence
    r = np.where(
        np.isin(np.arange(len(r)), target),
        r,
        r * (1 - p) / np.maximum(1 - r * p, 1 - MAX_EXISTENCE),
    )
    late = targets.hidden + seconds
    left = ~np.isin(np.arange(len(r)), of) & (r > MIN_EXISTENCE) & (late <= rule.max_hidden_time)
    return np.flatnonzero(left), r[left], late[left]
