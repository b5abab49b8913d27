"""Online output: rows that never change once they are given.

The identity of a state is fixed when its frame is given: it is that of the state it is then linked to. A later correction
cannot recall what was given; it only decides how the identities go on. Where two states claim one identity, the one linked
to its last holder keeps it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.associate.bridge import bridge
from phdtrack.associate.history import Moment
from phdtrack.associate.window import Window, links
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Tracks


@dataclass(frozen=True, slots=True)
class Output:
    """When a track is confirmed (states, mean gain of its links), how long it is continued without one (model time)."""

    shortest: int
    least: float
    coast: float


@dataclass(frozen=True, slots=True)
class Present:
    """What is known when a frame's rows are given: the open links, the model time, and the frames since.

    ``held`` are the moments after the given one, whose rows the delay holds back; none without a delay.
    """

    window: Window
    time: float
    held: tuple[Moment, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Holder:
    """The last state given under an identity: vertex, state (d,), covariance (d, d), confidence, time, how
    many states there were and what their links gained."""

    vertex: int
    state: F8
    covariance: F8
    confidence: float
    time: float
    length: int
    gain: float
    confirmed: bool = False


@dataclass(frozen=True, slots=True)
class Given:
    """What was given: identity of each vertex that may still be linked to, last holder of each live identity."""

    identity: dict[int, int] = field(default_factory=dict)
    holder: dict[int, Holder] = field(default_factory=dict)
    used: int = 0


def give(given: Given, moment: Moment, present: Present, output: Output, model: Model) -> tuple[Given, Tracks]:
    """The rows of one frame under the present links, and the new record of what was given."""
    estimates, window, held = moment.estimates, present.window, present.held
    n = len(estimates)
    vertex = moment.first + np.arange(n)
    identities, used = _claims(given, vertex, predecessors(window, held, vertex))
    identity, holder = dict(given.identity), dict(given.holder)
    onward = _onward(window, held)
    gains = {link.vertex: link.gain for link in onward.values()}
    for i in range(n):
        name, v = int(identities[i]), int(vertex[i])
        before = holder.get(name)
        length, gain, confirmed = (before.length, before.gain, before.confirmed) if before else (0, 0.0, False)
        confidence = float(min(1.0, estimates.weight[i]))
        state, cov = estimates.state[:, i], estimates.covariance[i]
        gain += gains.get(v, 0.0) if length else 0.0
        holder[name] = Holder(v, state, cov, confidence, moment.time, length + 1, gain, confirmed)
        identity[v] = name
    coming = {v: link for v, link in onward.items() if link.vertex >= moment.first + n}
    holder = {name: _judged(h, coming, output) for name, h in holder.items()}
    seen = Tracks(
        np.full(n, moment.number),
        identities,
        estimates.xyxy,
        np.minimum(1.0, estimates.weight),
        estimates.detection,
        np.array([holder[int(i)].confirmed for i in identities], np.bool_),
    )
    # A holder that goes on to a state given before has lost its track to another identity.
    lost = onward.keys() - coming.keys()
    absent = {name: h for name, h in holder.items() if h.vertex < moment.first and h.confirmed and h.vertex not in lost}
    filled = _fill(absent, coming, moment, present, output.coast, model)
    oldest = _oldest(window, moment, held)
    identity = {v: name for v, name in identity.items() if v >= oldest}
    live = set(identity.values())
    holder = {name: h for name, h in holder.items() if name in live}
    return Given(identity, holder, used), Tracks.concatenate([seen, filled])


@dataclass(frozen=True, slots=True)
class Link:
    """The vertex that another goes on to, and what the link gains."""

    vertex: int
    gain: float


def _onward(window: Window, held: Sequence[Moment]) -> dict[int, Link]:
    """Where each linked vertex goes on to."""
    known = [links(window), *(moment.final for moment in held)]
    return {
        v: Link(w, gain)
        for part in known
        for v, w, gain in zip(part.earlier.tolist(), part.later.tolist(), part.gain.tolist(), strict=True)
    }


def _judged(holder: Holder, coming: dict[int, Link], output: Output) -> Holder:
    """Confirmed where the states given under the identity and those known to follow suffice; for good once it is."""
    length, gain, vertex = holder.length, holder.gain, holder.vertex
    while vertex in coming and not _suffices(length, gain, output):
        link = coming[vertex]
        length, gain, vertex = length + 1, gain + link.gain, link.vertex
    return replace(holder, confirmed=holder.confirmed or _suffices(length, gain, output))


def _suffices(length: int, gain: float, output: Output) -> bool:
    return length >= output.shortest and gain >= output.least * (length - 1)


def predecessors(window: Window, held: Sequence[Moment], vertex: I8) -> I8:
    """(n,) the vertex that each of ``vertex`` is linked to, −1 where it starts a track.

    Where the delay is longer than the window, the link was made final by one of the frames ``held`` back since.
    """
    column = np.append(window.rows.column, -1)[np.searchsorted(window.rows.vertex, vertex)]
    column[~np.isin(vertex, window.rows.vertex)] = -1
    out = np.full(len(vertex), -1, np.int64)
    out[column >= 0] = window.columns.vertex[column[column >= 0]]
    for later in held:
        _, mine, theirs = np.intersect1d(vertex, later.final.later, assume_unique=True, return_indices=True)
        out[mine] = later.final.earlier[theirs]
    return out


def _oldest(window: Window, moment: Moment, held: Sequence[Moment]) -> int:
    """The first vertex whose identity a row still to be given may ask for."""
    asked = [window.columns.vertex[:1], *(later.final.earlier for later in held)]
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


def _fill(
    absent: dict[int, Holder], coming: dict[int, Link], moment: Moment, present: Present, coast: float, model: Model
) -> Tracks:
    """Rows for confirmed tracks that have no state in this frame.

    Where the delay shows that a track goes on, the gap is bridged between its ends. Otherwise it is continued by the motion
    model while, at the present, it has not been missing for longer than ``coast``.
    """
    if coast <= 0:
        return Tracks.empty()
    names, states, confidences = [], [], []
    for name, h in absent.items():
        after = _find(coming[h.vertex].vertex, present.held) if h.vertex in coming else None
        if after is not None:
            state = _between(h, moment, after, model)
            confidence = h.confidence
        elif present.time - h.time <= coast:
            state, _, _ = model.motion.transition(h.state[:, None], moment.time - h.time)
            confidence = h.confidence * float(model.motion.p_survive(state, moment.time - h.time)[0])
        else:
            continue
        if confidence > 0:
            names.append(name)
            states.append(state)
            confidences.append(confidence)
    if not names:
        return Tracks.empty()
    n = len(names)
    return Tracks(
        np.full(n, moment.number),
        np.array(names, np.int64),
        model.sensor.boxes(np.hstack(states)),
        np.array(confidences),
        np.full(n, -1),
        np.ones(n, np.bool_),
    )


def _find(vertex: int, moments: tuple[Moment, ...]) -> tuple[Moment, int] | None:
    """The moment among ``moments`` that holds a vertex, and its place there."""
    for moment in moments:
        if moment.first <= vertex < moment.first + len(moment.estimates):
            return moment, vertex - moment.first
    return None


def _between(holder: Holder, moment: Moment, after: tuple[Moment, int], model: Model) -> F8:
    """(d, 1) the state at ``moment`` given the last state before it and the next one after it."""
    later, i = after
    x = later.estimates
    steps = np.array([moment.time - holder.time, later.time - moment.time])
    return bridge(model.motion, holder.state, holder.covariance, x.state[:, i], x.covariance[i], steps)
