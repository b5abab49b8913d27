"""Tracks that look like two objects, one after the other, are parted, so that stitching joins the
pieces anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.smooth.looks import SequenceLooks
from phdtrack.smooth.paths import Paths
from phdtrack.smooth.sequence import Sequence
from phdtrack.types import F8, I8, Bool, Tracks

# A track is parted where what it looks like before and after has a log-likelihood ratio below this
# of being one object.
PARTED = -0.5
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
    known = sequence.looks
    if known is None or known.frame.law.means_weight <= 0:
        return tracks
    measurements = sequence.measurements
    time = measurements.seconds(sequence.rate)
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
        cuts = _cuts(known, column, when)
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


def _cuts(known: SequenceLooks, column: I8, time: F8) -> I8:
    """The detections of a track after which it is parted; ``column`` (n,) are their measurements,
    ``time`` (n,) their seconds.
    """
    unit = known.unit[column]
    weight = known.weight[column]
    memory = known.frame.memory
    n = len(time)
    total = np.zeros((n + 1, unit.shape[1]))
    np.cumsum(unit * weight[:, None], axis=0, out=total[1:])
    mass = np.concatenate(([0.0], np.cumsum(weight)))
    here = np.arange(1, n)
    begin = np.searchsorted(time, time[:-1] - memory)
    end = np.searchsorted(time, time[1:] + memory, side="right")
    before = mass[here] - mass[begin]
    after = mass[end] - mass[here]
    means = np.concatenate([total[here] - total[begin], total[end] - total[here]])
    count = np.concatenate([before, after])
    means /= np.maximum(count, 1e-9)[:, None]
    number = known.independent(count)
    ratio = known.likeness(means.astype(np.float32), number, here - 1, n - 1 + here - 1)
    enough = (number[: n - 1] >= LEAST) & (number[n - 1 :] >= LEAST)
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
        near: Bool = np.abs((time[:-1] + time[1:]) / 2 - middle) <= memory
        ratio = np.where(near, 0.0, ratio)
