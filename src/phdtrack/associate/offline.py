"""Corrected output: the tracks of a whole sequence under the final links."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from phdtrack.associate.backfill import Earlier, lead_back
from phdtrack.associate.bridge import bridge
from phdtrack.associate.history import History, Moment
from phdtrack.associate.window import Window, links
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Tracks


@dataclass(frozen=True, slots=True)
class Wanted:
    """Fewest states, least mean gain of the links, whether gaps are filled, most earlier detections to be led back to."""

    shortest: int
    least: float
    bridge: bool
    backfill: int


def tracks(history: History, window: Window, wanted: Wanted, model: Model) -> Tracks:
    """All tracks of enough states, led back to their beginning, gaps filled, sorted by frame, then identity."""
    moments = list(history)
    if not moments:
        return Tracks.empty()
    parts = []
    taken: set[tuple[int, int]] = set()
    name = 0
    for path in _paths(moments, window, wanted.least):
        k, i = path[0]
        first = moments[k].estimates
        before = lead_back(moments, k, first.state[:, i], first.covariance[i], wanted.backfill, taken, model)
        if len(path) + len(before) < wanted.shortest:
            continue
        name += 1
        taken.update((row.place, row.detection) for row in before)
        parts.append(_beginning(moments, before, float(first.weight[i]), name, model))
        parts.append(rows_of(moments, path, name))
        if wanted.bridge:
            parts.extend(gaps(moments, path, name, model))
    return Tracks.concatenate(parts)


def _paths(moments: list[Moment], window: Window, least: float) -> list[list[tuple[int, int]]]:
    """Tracks as lists of (moment, place in it), in order of appearance, whose links gain ``least`` on average."""
    place = [(k, i) for k, m in enumerate(moments) for i in range(len(m.estimates))]
    before, gain = np.full(len(place), -1, np.int64), np.zeros(len(place))
    first = moments[0].first
    for part in (*(m.final for m in moments), links(window)):
        # What went before the first moment may be forgotten: tracks then begin here.
        known = part.earlier >= first
        later = part.later[known] - first
        before[later], gain[later] = part.earlier[known] - first, part.gain[known]
    path_of: dict[int, list[int]] = {}
    paths: list[list[int]] = []
    for vertex in range(len(place)):
        path = path_of.pop(int(before[vertex]), None)
        if path is None:
            path = []
            paths.append(path)
        path.append(vertex)
        path_of[vertex] = path
    return [[place[v] for v in path] for path in paths if gain[path].sum() >= least * (len(path) - 1)]


def _beginning(moments: list[Moment], rows: list[Earlier], weight: float, name: int, model: Model) -> Tracks:
    """The rows before a track's first state, from detections that the filter did not believe yet."""
    if not rows:
        return Tracks.empty()
    n = len(rows)
    return Tracks(
        np.array([moments[row.place].number for row in rows], np.int64),
        np.full(n, name),
        model.sensor.boxes(np.stack([row.state for row in rows], axis=1)),
        np.full(n, min(1.0, weight)),
        np.array([row.detection for row in rows], np.int64),
        np.ones(n, np.bool_),
    )


def rows_of(moments: list[Moment], path: list[tuple[int, int]], name: int) -> Tracks:
    """The rows of a track that rest on extracted states."""
    n = len(path)
    parts = [(moments[k], i) for k, i in path]
    return Tracks(
        np.array([m.number for m, _ in parts], np.int64),
        np.full(n, name),
        np.array([m.estimates.xyxy[i] for m, i in parts]),
        np.minimum(1.0, np.array([m.estimates.weight[i] for m, i in parts])),
        np.array([m.estimates.detection[i] for m, i in parts], np.int64),
        np.ones(n, np.bool_),
    )


def gaps(moments: list[Moment], path: list[tuple[int, int]], name: int, model: Model) -> list[Tracks]:
    """Predicted rows between the states of a track that are more than one frame apart."""
    parts = []
    for (k, i), (m, j) in itertools.pairwise(path):
        if m == k + 1:
            continue
        a, b = moments[k].estimates, moments[m].estimates
        times: F8 = np.array([x.time for x in moments[k : m + 1]])
        ends, warps = (
            (a.state[:, i], a.covariance[i], b.state[:, j], b.covariance[j]),
            [x.warp for x in moments[k + 1 : m + 1]],
        )
        states = bridge(model.motion, *ends, np.diff(times), warps)
        n = m - k - 1
        frames: I8 = np.array([x.number for x in moments[k + 1 : m]], np.int64)
        confidence = np.full(n, min(1.0, float(a.weight[i]), float(b.weight[j])))
        parts.append(
            Tracks(
                frames,
                np.full(n, name),
                model.sensor.boxes(states),
                confidence,
                np.full(n, -1),
                np.ones(n, np.bool_),
            )
        )
    return parts
