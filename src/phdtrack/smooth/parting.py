"""Tracks that look like two objects, one after the other, are parted, so that stitching joins the
pieces anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.smooth.paths import Paths
from phdtrack.smooth.sequence import Sequence
from phdtrack.smooth.stitching import free_boxes, likeness_of_means
from phdtrack.types import F8, I8, Bool, Tracks

# A track is parted where what it looks like before and after has a log-likelihood ratio below this
# of being one object, the least within so many seconds.
PARTED = -0.5
NEIGHBOURHOOD = 1.0
# Times without detections are as long from this share of the longest on.
LONG = 0.75
# Independent descriptors on each side that this needs.
LEAST = 1.5


def parted(tracks: Tracks, paths: Paths, sequence: Sequence) -> Tracks:
    """The tracks, with those that look like two objects under two identities.

    Predicted rows between the two are left out.

    Parameters
    ----------
    tracks, paths : corrected tracks, and the same as paths.
    sequence : their measurements.
    """
    looks = sequence.looks
    if looks is None or looks.law.means_weight <= 0:
        return tracks
    measurements = sequence.measurements
    raw = measurements.embeddings
    if raw.shape[1] != looks.raw.shape[1]:
        return tracks
    length = np.sqrt(np.einsum("nd,nd->n", raw, raw))
    weight = free_boxes(sequence) * (length > 0)
    unit = raw / np.maximum(length, 1e-9)[:, None].astype(np.float32)
    time = measurements.time / sequence.rate
    identity = tracks.identity.copy()
    kept = np.ones(len(tracks), np.bool_)
    fresh = int(identity.max(initial=0))
    for k in range(len(paths)):
        rows = np.arange(paths.first[k], paths.last[k] + 1)
        rows = rows[paths.measurement[rows] >= 0]
        if len(rows) < 4:
            continue
        column = paths.measurement[rows]
        when = time[paths.frame[rows]]
        cuts = _cuts(unit[column], weight[column], when, sequence)
        if not len(cuts):
            continue
        name = tracks.identity[paths.row[rows[0]]]
        mine = np.flatnonzero(tracks.identity == name)
        numbers = measurements.number[paths.frame[rows]]
        for cut in cuts.tolist():
            fresh += 1
            later = mine[tracks.frame[mine] >= numbers[cut + 1]]
            between = (tracks.frame[mine] > numbers[cut]) & (tracks.frame[mine] < numbers[cut + 1])
            kept[mine[between]] = False
            identity[later] = fresh
    if fresh == int(tracks.identity.max(initial=0)):
        return tracks
    return replace(tracks, identity=identity).select(kept)


def _cuts(unit: F8, weight: F8, time: F8, sequence: Sequence) -> I8:
    """The detections of a track after which it is parted; ``unit`` (n, D), ``weight`` and ``time``
    (n,) are theirs.
    """
    looks = sequence.looks
    assert looks is not None
    n = len(time)
    total = np.zeros((n + 1, unit.shape[1]))
    np.cumsum(unit * weight[:, None], axis=0, out=total[1:])
    mass = np.concatenate(([0.0], np.cumsum(weight)))
    here = np.arange(1, n)
    begin = np.searchsorted(time, time[:-1] - looks.memory)
    end = np.searchsorted(time, time[1:] + looks.memory, side="right")
    before = mass[here] - mass[begin]
    after = mass[end] - mass[here]
    means = np.concatenate([total[here] - total[begin], total[end] - total[here]])
    count = np.concatenate([before, after])
    means /= np.maximum(count, 1e-9)[:, None]
    ratio, independent = likeness_of_means(
        means.astype(np.float32), count, here - 1, n - 1 + here - 1, sequence
    )
    enough = (independent[: n - 1] >= LEAST) & (independent[n - 1 :] >= LEAST)
    ratio = np.where(enough, ratio, 0.0)
    cuts = list[int]()
    while True:
        least = ratio.min()
        if not least < PARTED:
            return np.sort(np.array(cuts, np.int64))
        # Of places that are as good the middle one, of those without detections for longest.
        flat = np.flatnonzero(ratio <= least + 1e-9)
        apart = time[flat + 1] - time[flat]
        flat = flat[apart >= LONG * apart.max()]
        cut = int(flat[len(flat) // 2])
        cuts.append(cut)
        middle = (time[cut] + time[cut + 1]) / 2
        near: Bool = np.abs((time[:-1] + time[1:]) / 2 - middle) <= looks.memory
        ratio = np.where(near, 0.0, ratio)
