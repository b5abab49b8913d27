"""The looks of the states that a graph of links joins, and which target each is of without doubt
(docs/methods.md, Appearance).

Each open vertex has a past: that of the vertex which it was linked to when it came, with its own
detection. Labels follow links that motion alone leaves no doubt of, so that appearance is learned
from verdicts that do not look at it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from phdtrack.kernels.appearance import HOLDER, NO_PASTS, Looks, Pasts, plain, remembered
from phdtrack.kernels.linking import Window
from phdtrack.kernels.verdicts import DOUBTFUL, MISSED
from phdtrack.models.pasts import carried, with_looks
from phdtrack.types import I8, Appeared

_NONE: I8 = np.zeros(0, np.int64)


class VertexLooks(NamedTuple):
    """The looks of the open vertices of a window.

    ``past`` (R,): which of ``pasts`` each has, −1 for none. ``label`` (R,): of the target whose
    last vertex it is; −1 for those that have gone on without doubt. ``fresh``: how many of the
    vertices, the last ones, are of the newest frame. ``sure`` (K, 2): label, ascending, and
    measurement of targets without doubt in that frame, −1 for none. ``next_label``: of the next
    target.
    """

    past: I8 = _NONE
    label: I8 = _NONE
    pasts: Pasts = NO_PASTS
    fresh: int = 0
    sure: I8 = np.zeros((0, 2), np.int64)
    next_label: int = 0


class Ahead(NamedTuple):
    """The looks before new states are linked.

    ``known``: of the open vertices. ``detection`` (n,): the measurement of each new state, −1 for
    none. ``looks``: of the measurements.
    """

    known: VertexLooks
    detection: I8
    looks: Looks

    @property
    def arguments(self) -> tuple[Any, ...]:
        """`kernels.linking.Linked` as plain tuples."""
        return self.known.past, self.detection, tuple(self.known.pasts), plain(self.looks)


def ahead_of(known: VertexLooks, vertices: int, detection: I8, looks: Looks | None) -> Ahead:
    """The looks before a frame.

    Parameters
    ----------
    known : of the frame before.
    vertices : how many are open.
    detection, looks : of each new state, −1 for none; of the measurements, None where nothing is
        known.
    """
    if looks is not None and len(known.past) != vertices:
        # The first frame with descriptors.
        label = known.next_label + np.arange(vertices)
        none = np.full(vertices, -1)
        known = known._replace(past=none, label=label, next_label=known.next_label + vertices)
    past, pasts, seen = carried(known.past, known.pasts, looks)
    return Ahead(known._replace(past=past, pasts=pasts), detection, seen)


def linked(ahead: Ahead, window: Window, closed: int, verdicts: I8) -> VertexLooks:
    """The looks after a frame.

    Parameters
    ----------
    ahead : before it.
    window : with the new states.
    closed : how many of the vertices before are open no more.
    verdicts : (R,) of `kernels.linking.link_states`, on the others.
    """
    known, detection, looks = ahead
    if not len(looks.mean):
        return known
    n = len(detection)
    past = known.past[closed:]
    label = known.label[closed:].copy()
    # Pasts: those of the vertices that the new ones are linked to, with their detections
    previous = window.previous[len(past) :]
    earlier = np.where(previous >= 0, previous - window.row, len(past))
    before = np.append(past, -1)[earlier]
    holders = np.zeros(n, HOLDER)
    holders["target"] = np.arange(n)
    holders["detection"] = detection
    holders["past"] = np.where(before >= 0, np.cumsum(before >= 0) - 1, -1)
    own = Pasts._make(column[before[before >= 0]] for column in known.pasts)
    fresh = remembered(holders, tuple(own), plain(looks))
    least = int(past[past >= 0].min(initial=len(known.pasts.rows)))
    kept = len(known.pasts.rows) - least
    pasts = Pasts._make(
        np.concatenate([column[least:], more])
        for column, more in zip(tuple[Any, ...](known.pasts), fresh, strict=True)
    )
    place = np.where(holders["past"] >= 0, holders["past"] + kept, -1)
    # Labels: those of the vertices that go on with the new ones without doubt
    sure = np.flatnonzero((verdicts != DOUBTFUL) & (label >= 0))
    sure = sure[np.argsort(label[sure])]
    verdict = verdicts[sure]
    table = np.stack([label[sure], np.append(detection, MISSED)[verdict]], axis=1)
    goes_on = verdict >= 0
    name = known.next_label + np.arange(n)
    name[verdict[goes_on]] = label[sure[goes_on]]
    label[sure[goes_on]] = -1
    return VertexLooks(
        np.concatenate([np.where(past >= 0, past - least, -1), place]),
        np.concatenate([label, name]),
        pasts,
        n,
        table,
        known.next_label + n,
    )


def appeared(known: VertexLooks, seen: Appeared) -> Appeared:
    """The targets of the newest frame with their labels and looks, and those without doubt."""
    begin = len(known.past) - known.fresh
    estimates = replace(seen.estimates, tag=known.label[begin:])
    estimates = with_looks(
        estimates, known.past[begin:], known.pasts, np.unique(known.label[known.label >= 0])
    )
    return Appeared(seen.looks, estimates, known.sure)
