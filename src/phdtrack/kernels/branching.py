"""How the hypotheses of a cluster go on with a frame's measurements."""

from __future__ import annotations

import numpy as np

from phdtrack.kernels import F8, I8, Bool
from phdtrack.kernels.association import best_assignments
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, INNER


@njit(**INNER)
def _gains(
    leaf: I8, pair: tuple[I8, I8, F8], columns: I8, unassigned: F8, place: I8
) -> tuple[F8, I8, I8]:
    """Gains (m, A) of a cluster's forms that have a measurement in their gate, which each
    hypothesis holds, and the tracks.

    ``leaf`` and the others as of `children`; ``place`` (L,) of −1 becomes the place of each leaf
    among the forms.
    """
    row = np.full(unassigned.size, -1)
    forms = 0
    for i in range(columns.size):
        row[columns[i]] = i
    for q in range(pair[0].size):
        if place[pair[0][q]] < 0:
            place[pair[0][q]] = forms
            forms += 1
    gain = np.full((columns.size, forms), -np.inf)
    for q in range(pair[0].size):
        j = pair[1][q]
        gain[row[j], place[pair[0][q]]] = pair[2][q] - unassigned[j]
    track = np.empty(leaf.shape[1], np.int64)
    used = 0
    for t in range(leaf.shape[1]):
        for h in range(leaf.shape[0]):
            if leaf[h, t] >= 0 and place[leaf[h, t]] >= 0:
                track[used] = t
                used += 1
                break
    held = np.empty((leaf.shape[0], used), np.int64)
    for h in range(leaf.shape[0]):
        for k in range(used):
            here = leaf[h, track[k]]
            held[h, k] = place[here] if here >= 0 else -1
    return gain, held, track[:used]


@njit(**ENTRY)
def children(
    leaf: I8,
    weight: F8,
    pair: tuple[I8, I8, F8],
    columns: I8,
    missed: F8,
    unassigned: F8,
    begins: Bool,
    limits: tuple[int, float],
) -> tuple[I8, F8, F8]:
    """The best hypotheses that follow from a cluster's, the most probable first.

    ``leaf`` (H, T), ``weight`` (H,): the cluster. ``pair`` (P,): leaf, measurement and gain of the
    pairs in the gates of its leaves; ``columns`` (m,): the measurements of these. ``missed`` (L,),
    ``unassigned`` (N,): log-weights of leaves that are missed, and of measurements that no earlier
    track has; ``begins`` (N,): whether a measurement may begin a track. ``limits``: how many come
    back at most, and the log of the least weight as a share of the best's.

    Returns the hypotheses (K, T'), in which (leaf + 1)(N + 1) + measurement + 1 stands for a leaf
    and its measurement, where −1 is for none, and −1 for no track; their weights (K,); and the
    probability (m,) that each measurement is no earlier track's.
    """
    place = np.full(missed.size, -1)
    number = unassigned.size + 1
    gain, held, track = _gains(leaf, pair, columns, unassigned, place)
    base = np.empty(weight.size)
    tracks = leaf.shape[1]
    m = columns.size
    for h in range(weight.size):
        base[h] = np.log(weight[h])
        for t in range(tracks):
            if leaf[h, t] >= 0:
                base[h] += missed[leaf[h, t]]
    parent, choice, log_weight = best_assignments(
        gain, unassigned[columns], held, base, limits[0], limits[1]
    )
    count = parent.size
    total = 0.0
    share = np.empty(count)
    alone = np.zeros(m)
    out = np.full((count, tracks + m), -1)
    for k in range(count):
        share[k] = np.exp(log_weight[k] - log_weight[0])
        total += share[k]
    for k in range(count):
        share[k] /= total
        for t in range(tracks):
            if leaf[parent[k], t] >= 0:
                out[k, t] = (leaf[parent[k], t] + 1) * number
        for i in range(m):
            if choice[k, i] < 0:
                alone[i] += share[k]
                out[k, tracks + i] = columns[i] + 1 if begins[columns[i]] else -1
                continue
            for t in track:
                here = leaf[parent[k], t]
                if here >= 0 and place[here] == choice[k, i]:
                    out[k, t] += columns[i] + 1
    return without_empty(out), share, alone


@njit(**INNER)
def without_empty(rows: I8) -> I8:
    """The columns of ``rows`` (H, T) that are not −1 everywhere."""
    kept = np.empty(rows.shape[1], np.int64)
    count = 0
    for t in range(rows.shape[1]):
        for h in range(rows.shape[0]):
            if rows[h, t] >= 0:
                kept[count] = t
                count += 1
                break
    out = np.empty((rows.shape[0], count), np.int64)
    for h in range(rows.shape[0]):
        for k in range(count):
            out[h, k] = rows[h, kept[k]]
    return out


@njit(**ENTRY)
def equal_rows(rows: I8) -> I8:
    """(H,) the first row that each of ``rows`` (H, T) of numbers from −1 on is equal to: itself, or
    an earlier one.
    """
    count = rows.shape[0]
    size = 2 * rows.shape[0] + 1
    place = np.full(size, -1, np.int64)
    out = np.empty(count, np.int64)
    for h in range(count):
        key = 0
        for t in range(rows.shape[1]):
            key = (31 * key + rows[h, t] + 1) % size
        while place[key] >= 0 and not np.array_equal(rows[place[key]], rows[h]):
            key = (key + 1) % size
        if place[key] < 0:
            place[key] = h
        out[h] = place[key]
    return out
