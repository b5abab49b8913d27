"""Tracks that look like two objects, one after the other, are parted, so that stitching joins the
pieces anew."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

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
# The fewest detections of a track that is parted.
FEWEST = 4
# Seconds within which two tracks are parted at one time.
TOGETHER = 1.0
# What a track looks like on each side is that of so many times the memory: an object that looks
# like another one only for a while is still itself.
HORIZONS = (1.0, 3.0)
_NONE: I8 = np.zeros(0, np.int64)


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
    seen = [_detected(paths, k, time) for k in range(len(paths))]
    cuts = [
        _cuts(known, each.column, each.time) if len(each.rows) >= FEWEST else _NONE for each in seen
    ]
    if not any(map(len, cuts)):
        return tracks
    cuts = _together(seen, cuts, sequence.boxes)
    identity = tracks.identity.copy()
    kept = np.ones(len(tracks), np.bool_)
    fresh = int(identity.max(initial=0))
    for each, places in zip(seen, cuts, strict=True):
        name = tracks.identity[paths.row[each.rows[0]]] if len(each.rows) else 0
        mine = np.flatnonzero(tracks.identity == name)
        numbers = measurements.number[paths.frame[each.rows]]
        for cut in places.tolist():
            fresh += 1
            later = mine[tracks.frame[mine] >= numbers[cut + 1]]
            between = (tracks.frame[mine] > numbers[cut]) & (tracks.frame[mine] < numbers[cut + 1])
            kept[mine[between]] = False
            identity[later] = fresh
    return replace(tracks, identity=identity).select(kept)


class _Detected(NamedTuple):
    """The rows (n,) of a path that have a measurement, these, and their seconds."""

    rows: I8
    column: I8
    time: F8


def _detected(paths: Paths, k: int, time: F8) -> _Detected:
    """The detections of path k; ``time`` (F,) are the seconds of frames."""
    rows = np.arange(paths.first[k], paths.last[k] + 1)
    rows = rows[paths.measurement[rows] >= 0]
    return _Detected(rows, paths.measurement[rows], time[paths.frame[rows]])


def _together(seen: list[_Detected], cuts: list[I8], boxes: F8) -> list[I8]:
    """The cuts, with those of two tracks that were side by side within a second of each other at
    one time: else the end of one and the rest of the other would overlap, and could not be joined.

    Parameters
    ----------
    seen, cuts : of each track, and the detections after which it is parted.
    boxes : (Z, 4) of the measurements.
    """
    place = [(k, cut) for k, each in enumerate(cuts) for cut in each.tolist()]
    when = np.array([seen[k].time[cut : cut + 2].mean() for k, cut in place])
    here = boxes[[int(seen[k].column[cut]) for k, cut in place]]
    common = when.copy()
    free = np.ones(len(place), np.bool_)
    pairs = [
        (abs(when[i] - when[j]), i, j)
        for i in range(len(place))
        for j in range(i + 1, len(place))
        if place[i][0] != place[j][0] and abs(when[i] - when[j]) <= TOGETHER
    ]
    for _, i, j in sorted(pairs):
        if free[i] and free[j] and _side_by_side(here[i], here[j]):
            free[[i, j]] = False
            common[[i, j]] = (when[i] + when[j]) / 2
    out = [list[int]() for _ in seen]
    for (k, cut), moved, kept in zip(place, common.tolist(), free.tolist(), strict=True):
        at = cut if kept else int(np.searchsorted(seen[k].time, moved, side="right")) - 1
        out[k].append(min(max(at, 0), len(seen[k].time) - 2))
    return [np.unique(np.array(each, np.int64)) for each in out]


def _side_by_side(a: F8, b: F8) -> bool:
    """True if two boxes, twice as large, overlap."""
    apart = np.abs(a[:2] + a[2:] - b[:2] - b[2:]) / 2
    return bool((apart < a[2:] - a[:2] + b[2:] - b[:2]).all())


def _cuts(known: SequenceLooks, column: I8, time: F8) -> I8:
    """The detections of a track after which it is parted; ``column`` (n,) are their measurements,
    ``time`` (n,) their seconds.
    """
    memory = known.frame.memory
    ratio = np.max([_ratios(known, column, time, each * memory) for each in HORIZONS], axis=0)
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


def _ratios(known: SequenceLooks, column: I8, time: F8, horizon: float) -> F8:
    """(n − 1,) log-likelihood ratios that what a track looks like in the seconds ``horizon`` before
    and after each place between two detections is one object; 0 where too little is known. Other
    arguments as of `_cuts`.
    """
    unit = known.unit[column]
    weight = known.weight[column]
    n = len(time)
    total = np.zeros((n + 1, unit.shape[1]))
    np.cumsum(unit * weight[:, None], axis=0, out=total[1:])
    mass = np.concatenate(([0.0], np.cumsum(weight)))
    here = np.arange(1, n)
    begin = np.searchsorted(time, time[:-1] - horizon)
    end = np.searchsorted(time, time[1:] + horizon, side="right")
    before = mass[here] - mass[begin]
    after = mass[end] - mass[here]
    means = np.concatenate([total[here] - total[begin], total[end] - total[here]])
    count = np.concatenate([before, after])
    means /= np.maximum(count, 1e-9)[:, None]
    number = known.independent(count)
    # Not by how long each side is: that would part a track in its middle.
    odd = np.zeros(len(number))
    ratio = known.likeness(means.astype(np.float32), number, odd, here - 1, n - 1 + here - 1)
    enough = (number[: n - 1] >= LEAST) & (number[n - 1 :] >= LEAST)
    return np.where(enough, ratio, 0.0)
