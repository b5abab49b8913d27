"""Corrected output: the tracks of a whole sequence under the final links."""

from __future__ import annotations

import itertools

import numpy as np

from phdtrack.associate.bridge import bridge
from phdtrack.associate.history import History, Moment
from phdtrack.associate.window import Window
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Tracks


def tracks(history: History, window: Window, shortest: int, bridged: bool, model: Model) -> Tracks:
    """All tracks of at least ``shortest`` states, gaps filled where ``bridged``, sorted by frame, then identity."""
    moments = list(history)
    if not moments:
        return Tracks.empty()
    parts = []
    long_enough = [path for path in _paths(moments, window) if len(path) >= shortest]
    for name, path in enumerate(long_enough, start=1):
        parts.append(_states(moments, path, name))
        if bridged:
            parts.extend(_gaps(moments, path, name, model))
    return Tracks.concatenate(parts)


def _paths(moments: list[Moment], window: Window) -> list[list[tuple[int, int]]]:
    """Tracks as lists of (moment, place in it), in order of appearance."""
    place = [(k, i) for k, m in enumerate(moments) for i in range(len(m.estimates))]
    before = np.full(len(place), -1, np.int64)
    for m in moments:
        before[m.later] = m.earlier
    open_rows = window.rows.column >= 0
    before[window.rows.vertex[open_rows]] = window.columns.vertex[window.rows.column[open_rows]]
    path_of: dict[int, list[tuple[int, int]]] = {}
    paths: list[list[tuple[int, int]]] = []
    for vertex, where in enumerate(place):
        path = path_of.pop(int(before[vertex]), None)
        if path is None:
            path = []
            paths.append(path)
        path.append(where)
        path_of[vertex] = path
    return paths


def _states(moments: list[Moment], path: list[tuple[int, int]], name: int) -> Tracks:
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


def _gaps(moments: list[Moment], path: list[tuple[int, int]], name: int, model: Model) -> list[Tracks]:
    """Predicted rows between the states of a track that are more than one frame apart."""
    parts = []
    for (k, i), (m, j) in itertools.pairwise(path):
        if m == k + 1:
            continue
        a, b = moments[k].estimates, moments[m].estimates
        times: F8 = np.array([x.time for x in moments[k : m + 1]])
        states = bridge(model.motion, a.state[:, i], a.covariance[i], b.state[:, j], b.covariance[j], np.diff(times))
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
