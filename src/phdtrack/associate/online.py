"""Online output: rows that never change once they are given.

The identity of a state is fixed when its frame is given: it is that of the state it is then linked to. A later correction
cannot recall what was given; it only decides how the identities go on. Where two states claim one identity, the one linked
to its last holder keeps it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from phdtrack.associate.history import Moment
from phdtrack.associate.window import Window
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Tracks


@dataclass(frozen=True, slots=True)
class Output:
    """When a track is confirmed (states), and for how long it is continued without one (model time)."""

    shortest: int
    coast: float


@dataclass(frozen=True, slots=True, eq=False)
class Holder:
    """The last state given under an identity: its vertex, state (d,), box confidence, time, and how many there were."""

    vertex: int
    state: F8
    confidence: float
    time: float
    length: int


@dataclass(frozen=True, slots=True)
class Given:
    """What was given: identity of each vertex that may still be linked to, last holder of each live identity."""

    identity: dict[int, int] = field(default_factory=dict)
    holder: dict[int, Holder] = field(default_factory=dict)
    used: int = 0


def give(
    given: Given, moment: Moment, held: Sequence[Moment], window: Window, output: Output, model: Model
) -> tuple[Given, Tracks]:
    """The rows of one frame under the present links, and the new record of what was given.

    ``held`` are the frames after ``moment`` whose rows the delay holds back.
    """
    estimates = moment.estimates
    n = len(estimates)
    vertex = moment.first + np.arange(n)
    before = predecessors(window, held, vertex)
    identities, used = _claims(given, vertex, before)
    identity, holder = dict(given.identity), dict(given.holder)
    for i in range(n):
        name = int(identities[i])
        length = holder[name].length + 1 if name in holder else 1
        confidence = float(min(1.0, estimates.weight[i]))
        holder[name] = Holder(int(vertex[i]), estimates.state[:, i], confidence, moment.time, length)
        identity[int(vertex[i])] = name
    confirmed = np.array([holder[int(i)].length >= output.shortest for i in identities], np.bool_)
    seen = Tracks(
        np.full(n, moment.number),
        identities,
        estimates.xyxy,
        np.minimum(1.0, estimates.weight),
        estimates.detection,
        confirmed,
    )
    coasting = _coast(holder, set(identities.tolist()), moment, output, model)
    oldest = _oldest(window, moment, held)
    identity = {v: name for v, name in identity.items() if v >= oldest}
    live = set(identity.values())
    holder = {name: h for name, h in holder.items() if name in live}
    return Given(identity, holder, used), Tracks.concatenate([seen, coasting])


def predecessors(window: Window, held: Sequence[Moment], vertex: I8) -> I8:
    """(n,) the vertex that each of ``vertex`` is linked to, −1 where it starts a track.

    Where the delay is longer than the window, the link was made final by one of the frames ``held`` back since.
    """
    column = np.append(window.rows.column, -1)[np.searchsorted(window.rows.vertex, vertex)]
    column[~np.isin(vertex, window.rows.vertex)] = -1
    out = np.full(len(vertex), -1, np.int64)
    out[column >= 0] = window.columns.vertex[column[column >= 0]]
    for later in held:
        _, mine, theirs = np.intersect1d(vertex, later.later, assume_unique=True, return_indices=True)
        out[mine] = later.earlier[theirs]
    return out


def _oldest(window: Window, moment: Moment, held: Sequence[Moment]) -> int:
    """The first vertex whose identity a row still to be given may ask for."""
    asked = [window.columns.vertex[:1], *(later.earlier for later in held)]
    return int(np.concatenate(asked).min(initial=moment.first))


def _claims(given: Given, vertex: I8, before: I8) -> tuple[I8, int]:
    """Identities of the states of a frame: inherited from the state before, or new."""
    identities = np.zeros(len(vertex), np.int64)
    names = [given.identity.get(int(p), 0) for p in before]
    holds = [bool(name) and given.holder[name].vertex == p for name, p in zip(names, before, strict=True)]
    taken: set[int] = set()
    used = given.used
    for i in sorted(range(len(vertex)), key=lambda i: (not holds[i], i)):
        name = names[i]
        if name == 0 or name in taken:
            used += 1
            name = used
        taken.add(name)
        identities[i] = name
    return identities, used


def _coast(holder: dict[int, Holder], seen: set[int], moment: Moment, output: Output, model: Model) -> Tracks:
    """Predicted rows for confirmed tracks that have no state in this frame."""
    names = [
        name
        for name, h in holder.items()
        if name not in seen and h.length >= output.shortest and moment.time - h.time <= output.coast
    ]
    states, confidences = [], []
    for name in names:
        h = holder[name]
        mean, _, _ = model.motion.transition(h.state[:, None], moment.time - h.time)
        states.append(mean)
        confidences.append(h.confidence * float(model.motion.p_survive(mean, moment.time - h.time)[0]))
    if not states:
        return Tracks.empty()
    alive = np.array(confidences) > 0
    n = int(alive.sum())
    return Tracks(
        np.full(n, moment.number),
        np.array(names, np.int64)[alive],
        model.sensor.boxes(np.hstack(states))[alive],
        np.array(confidences)[alive],
        np.full(n, -1),
        np.ones(n, np.bool_),
    )
