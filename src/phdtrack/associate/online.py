"""Online output: rows that never change once they are given.

The identity of a state is fixed when its frame is given: it is that of the state it is then linked to. A later correction
cannot recall what was given; it only decides how the identities go on. Where two states claim one identity, the one linked
to its last holder keeps it.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from phdtrack.associate.bridge import bridge
from phdtrack.associate.history import History, Moment
from phdtrack.associate.window import Window
from phdtrack.kernels.identities import claim, follow
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Bool, Tracks


@dataclass(frozen=True, slots=True)
class Output:
    """When a track is confirmed (states, mean gain of its links), how long it is continued without one (model time)."""

    shortest: int
    least: float
    coast: float


@dataclass(frozen=True, slots=True)
class Present:
    """What is known when a frame's rows are given: the open links, the model time, and all frames up to now."""

    window: Window
    time: float
    history: History


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """What was given, (V,) for each vertex from ``first`` on that may still be linked to.

    ``identity``; ``length``, ``gain``, ``confirmed``: states under it up to that vertex, what their links gained, whether
    they were believed; ``holds``: no later vertex has the identity. ``used`` counts the identities.
    """

    first: int
    identity: I8
    length: I8
    gain: F8
    confirmed: Bool
    holds: Bool
    used: int = 0

    @classmethod
    def nothing(cls) -> Given:
        """Before the first frame."""
        none, never = np.zeros(0, np.int64), np.zeros(0, np.bool_)
        return cls(0, none, none, np.zeros(0), never, never)


def give(given: Given, due: int, present: Present, output: Output, model: Model) -> tuple[Given, Tracks]:
    """The rows of the frame at place ``due`` of the history under the present links, and the new record."""
    moment = present.history[due]
    estimates, n = moment.estimates, len(moment.estimates)
    held = [present.history[k] for k in range(due + 1, len(present.history))]
    first, old = given.first, len(given.identity)
    onward, worth = _onward(first, present.window, held)
    zero, never = np.zeros(n, np.int64), np.zeros(n, np.bool_)
    identity, length = np.concatenate((given.identity, zero)), np.concatenate((given.length, zero))
    gain = np.concatenate((given.gain, np.zeros(n)))
    confirmed, holds = np.concatenate((given.confirmed, never)), np.concatenate((given.holds, never))
    absent = np.empty(old, np.int64)
    used, missing = claim(
        first,
        given.used,
        given.identity,
        given.holds,
        onward,
        worth,
        output.shortest,
        output.least,
        identity,
        length,
        gain,
        confirmed,
        holds,
        zero,
        absent,
    )
    rows = Rows(identity[old:], estimates.xyxy, estimates.weight, estimates.detection, confirmed[old:])
    if missing and output.coast > 0:
        absent = absent[:missing]
        absences = Absences(first + absent, identity[absent], onward[absent], due)
        rows = _with(rows, _fill(absences, held, present, output.coast, model), model)
    gone = _oldest(present.window, moment, held) - first
    kept = Given(first + gone, identity[gone:], length[gone:], gain[gone:], confirmed[gone:], holds[gone:], used)
    return kept, _in_order(rows, moment.number)


def _onward(first: int, window: Window, held: list[Moment]) -> tuple[I8, F8]:
    """Where each vertex from ``first`` on goes on to, −1 where nowhere; and what the link gains."""
    rows = window.rows
    size = rows.first + len(rows.previous) - first
    onward, worth = np.empty(size, np.int64), np.empty(size)
    follow(first, rows.first, rows.previous, rows.gain, onward, worth)
    for moment in held:
        final = moment.final
        onward[final.earlier - first] = final.later
        worth[final.earlier - first] = final.gain
    return onward, worth


def _oldest(window: Window, moment: Moment, held: list[Moment]) -> int:
    """The first vertex whose identity a row still to be given may ask for."""
    oldest = min(window.columns.first, moment.first)
    for later in held:
        oldest = int(later.final.earlier.min(initial=oldest))
    return oldest


# Identities (a,), states (d, a) and confidences (a,).
Predicted = tuple[I8, F8, F8]


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Columns of `Tracks` for one frame, in any order."""

    identity: I8
    xyxy: F8
    confidence: F8
    detection: I8
    confirmed: Bool


@dataclass(frozen=True, slots=True, eq=False)
class Absences:
    """Confirmed tracks without a state in the frame at place ``due``: their last vertices, ascending, their identities, and
    the vertices that they go on to or −1; all (a,)."""

    vertex: I8
    identity: I8
    after: I8
    due: int


def _fill(absences: Absences, held: list[Moment], present: Present, coast: float, model: Model) -> list[Predicted]:
    """What is predicted for tracks that have no state in this frame, by the frame that saw them last.

    Where the delay shows that a track goes on, the gap is bridged between its ends. Otherwise it is continued by the motion
    model while, at the present, it has not been missing for longer than ``coast``.
    """
    moment = present.history[absences.due]
    vertices = absences.vertex.tolist()
    bridged = absences.after >= 0
    left = int(absences.vertex[bridged].min(initial=moment.first))
    parts: list[Predicted] = []
    end = len(vertices)
    for k in range(absences.due - 1, present.history.forgotten - 1, -1):
        last = present.history[k]
        fresh = present.time - last.time <= coast
        if end == 0 or (not fresh and last.first + len(last.estimates) <= left):
            break
        begin = bisect_left(vertices, last.first, hi=end)
        if begin == end:
            continue
        here, end = slice(begin, end), begin
        vertex, after, name = absences.vertex[here], absences.after[here], absences.identity[here]
        for i in bridged[here].nonzero()[0]:
            found = _find(int(after[i]), held)
            parts.append(_bridged(last, int(vertex[i]) - last.first, moment, found, int(name[i]), model))
        alone = ~bridged[here]
        if fresh and alone.any():
            parts.append(_coasted(last, vertex[alone] - last.first, moment, name[alone], model))
    return parts


def _coasted(last: Moment, place: I8, moment: Moment, identity: I8, model: Model) -> Predicted:
    """States predicted for ``moment`` from those at ``place`` of an earlier one."""
    x, dt = last.estimates, moment.time - last.time
    state, _, _ = model.motion.transition(x.state[:, place], dt)
    return identity, state, np.minimum(1.0, x.weight[place]) * model.motion.p_survive(state, dt)


def _bridged(last: Moment, place: int, moment: Moment, after: tuple[Moment, int], identity: int, model: Model) -> Predicted:
    """The state at ``moment`` given the last one before it and the next one after it."""
    later, i = after
    x, y = last.estimates, later.estimates
    steps = np.array([moment.time - last.time, later.time - moment.time])
    ends = (x.state[:, place], x.covariance[place], y.state[:, i], y.covariance[i])
    return np.array([identity]), bridge(model.motion, *ends, steps), x.weight[place : place + 1]


def _with(rows: Rows, parts: list[Predicted], model: Model) -> Rows:
    """The rows and those of the predicted tracks that may still be there."""
    if not parts:
        return rows
    identity, state, confidence = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
    alive = (confidence > 0).nonzero()[0]
    n = len(alive)
    return Rows(
        np.concatenate((rows.identity, identity[alive])),
        np.concatenate((rows.xyxy, model.sensor.boxes(state[:, alive]))),
        np.concatenate((rows.confidence, confidence[alive])),
        np.concatenate((rows.detection, np.full(n, -1))),
        np.concatenate((rows.confirmed, np.ones(n, np.bool_))),
    )


def _in_order(rows: Rows, number: int) -> Tracks:
    """The rows of frame ``number``, copied: sorted by identity, which stands once in a frame."""
    order = rows.identity.argsort()
    return Tracks(
        np.full(len(order), number),
        rows.identity[order],
        rows.xyxy[order],
        np.minimum(1.0, rows.confidence)[order],
        rows.detection[order],
        rows.confirmed[order],
    )


def _find(vertex: int, moments: list[Moment]) -> tuple[Moment, int]:
    """The moment among ``moments`` that holds a vertex, and its place there."""
    found = next(m for m in moments if vertex < m.first + len(m.estimates))
    return found, vertex - found.first
