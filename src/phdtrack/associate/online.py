"""Online output: rows that never change once they are given.

The identity of a state is fixed when its frame is given: it is that of the state it is then linked to. A later correction
cannot recall what was given; it only decides how the identities go on. Where two states claim one identity, the one linked
to its last holder keeps it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.associate.bridge import bridge
from phdtrack.associate.history import History, Moment
from phdtrack.associate.window import NO_LINKS, Links, Window
from phdtrack.kernels.identities import come_back, hand_on
from phdtrack.models import warp as warp_of
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, STILL, Bool, Tracks

# Frames after which a missing identity is no longer asked for: what comes back later is hardly ever where it is looked for.
AGES = 32


@dataclass(frozen=True, slots=True)
class Output:
    """When a track is confirmed (states, mean gain of its links), how long at most it is continued without one (model
    time)."""

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
class Carried:
    """States of missing identities, carried on by the motion model to the last frame given.

    ``vertex`` (a,) the last of each, ascending; ``state`` (d, a); ``confidence`` (a,), above 0.
    """

    vertex: I8
    state: F8
    confidence: F8


_NONE, _NEVER, _ZERO = np.zeros(0, np.int64), np.zeros(0, np.bool_), np.zeros(0)
_NOBODY = Carried(_NONE, np.zeros((0, 0)), _ZERO)


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """What was given, (V,) for each vertex from ``first`` on that may still be linked to.

    ``identity``; ``length``, ``gain``, ``confirmed``: states under it up to that vertex, what their links gained, whether
    they were believed; ``holds``: no later vertex has the identity; ``missed``: for how many frames it has had no state, or
    AGES where it has left. ``waits`` (2, AGES): of how many identities it was asked, after so many frames without a state,
    whether they come back in the next, and how many did. ``carried`` are the states of the missing. ``used`` counts the
    identities.
    """

    first: int
    identity: I8
    length: I8
    gain: F8
    confirmed: Bool
    holds: Bool
    missed: I8
    waits: I8
    carried: Carried
    used: int = 0

    @classmethod
    def nothing(cls) -> Given:
        """Before the first frame."""
        return cls(0, _NONE, _NONE, _ZERO, _NEVER, _NEVER, _NONE, np.zeros((2, AGES), np.int64), _NOBODY)


def give(given: Given, due: int, present: Present, output: Output, model: Model) -> tuple[Given, Tracks]:
    """The rows of the frame at place ``due`` of the history under the present links, and the new record."""
    history, open_links = present.history, present.window.rows
    moment = history[due]
    estimates, first, old = moment.estimates, given.first, len(given.identity)
    held = [history[k] for k in range(due + 1, len(history))]
    n, known = len(estimates), open_links.first + len(open_links.previous) - first
    identity, length, missed = np.empty((3, old + n), np.int64)
    gain, waits = np.empty(old + n), given.waits.copy()
    confirmed, holds = np.empty((2, old + n), np.bool_)
    absent, source = np.empty((2, old), np.int64)
    onward, settled = np.empty(known, np.int64), _settled(held)
    used, missing = hand_on(
        first,
        open_links.first,
        open_links.previous,
        open_links.gain,
        settled.later,
        settled.earlier,
        settled.gain,
        given.used,
        output.shortest,
        output.least,
        given.identity,
        given.length,
        given.gain,
        given.confirmed,
        given.holds,
        given.missed,
        given.carried.vertex,
        history[due - 1].first if old else moment.first,
        onward,
        np.empty(known),
        identity,
        length,
        gain,
        confirmed,
        holds,
        missed,
        waits,
        absent,
        source,
        np.empty(n, np.int64),
    )
    rows, carried = Rows(identity[old:], estimates.xyxy, estimates.weight, estimates.detection, confirmed[old:]), _NOBODY
    if missing and output.coast > 0:
        place = absent[:missing]
        absences = Absences(first + place, identity[place], onward[place], missed[place], source[:missing], due)
        carried, parts, left = _awaited(absences, held, given.carried, waits, present, output.coast, model)
        missed[place[left]] = AGES
        rows = _with(rows, parts, model)
    gone = _oldest(present.window, moment, held) - first
    kept = Given(
        first + gone,
        identity[gone:],
        length[gone:],
        gain[gone:],
        confirmed[gone:],
        holds[gone:],
        missed[gone:],
        waits,
        carried,
        used,
    )
    return kept, _in_order(rows, moment.number)


def _settled(held: list[Moment]) -> Links:
    """The links that became final with frames whose rows are held back."""
    if not held:
        return NO_LINKS
    parts = [moment.final for moment in held]
    later, earlier, gain = ([getattr(part, name) for part in parts] for name in ("later", "earlier", "gain"))
    return Links(np.concatenate(later), np.concatenate(earlier), np.concatenate(gain))


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
    """Confirmed tracks without a state in the frame at place ``due``: their last vertices, ascending, their identities, the
    vertices that they go on to or −1, for how many frames they have been missing, and where their states are among those
    carried on and the last frame's, −1 where nowhere; all (a,)."""

    vertex: I8
    identity: I8
    after: I8
    missed: I8
    source: I8
    due: int


def _awaited(
    absences: Absences,
    held: list[Moment],
    carried: Carried,
    waits: I8,
    present: Present,
    coast: float,
    model: Model,
) -> tuple[Carried, list[Predicted], I8]:
    """The states of the missing carried on to this frame, the rows predicted for them, and which of them have left.

    Where the delay shows that a track goes on, the gap is bridged between its ends. Otherwise it is continued by the motion
    model while, of tracks that were missing for so long, more came back than did not, and while at the present it has not
    been missing for longer than ``coast``.
    """
    parts = _bridges(absences, held, present, model)
    here = (absences.source >= 0).nonzero()[0]
    if len(here) == 0:
        return _NOBODY, parts, here
    history, due = present.history, absences.due
    dt = history[due].time - history[due - 1].time
    state, confidence = _last(carried, history[due - 1], absences.source[here])
    if len(history[due].warp):
        state = model.motion.carried(state, history[due].warp)
    state, _, _ = model.motion.transition(state, dt)
    survive, back = model.motion.p_survive(state, dt / model.rate), np.empty(AGES)
    confidence = confidence * survive
    come_back(survive, model.sensor.p_detect(state), waits, back)
    most = _patience(back, len(held), due, present, coast)
    shown = ((absences.missed[here] <= most) & (absences.after[here] < 0) & (confidence > 0)).nonzero()[0]
    if len(shown):
        parts.append((absences.identity[here[shown]], state[:, shown], confidence[shown]))
    stay = (confidence > 0).nonzero()[0]
    if len(stay) == len(here):
        return Carried(absences.vertex[here], state, confidence), parts, _NONE
    return Carried(absences.vertex[here[stay]], state[:, stay], confidence[stay]), parts, here[confidence <= 0]


def _last(carried: Carried, moment: Moment, source: I8) -> tuple[F8, F8]:
    """States (d, a) and confidences (a,) from those carried on and the moment's, end to end."""
    state, confidence = moment.estimates.state, np.minimum(1.0, moment.estimates.weight)
    if len(carried.vertex):
        if len(confidence) == 0:
            return carried.state[:, source], carried.confidence[source]
        state = np.concatenate((carried.state, state), axis=1)
        confidence = np.concatenate((carried.confidence, confidence))
    return state[:, source], confidence[source]


def _patience(back: F8, ahead: int, due: int, present: Present, coast: float) -> int:
    """For how many frames tracks are continued: how likely they ``come back`` is known, and that they did not in the
    frames ``ahead``."""
    history, most = present.history, 0
    while most + 1 + ahead < AGES and back[most + 1 + ahead] > 0.5:
        place = due - most - 1
        if place < history.forgotten or present.time - history[place].time > coast:
            break
        most += 1
    return most


def _bridges(absences: Absences, held: list[Moment], present: Present, model: Model) -> list[Predicted]:
    """The states at this frame, one by one, of tracks whose next state is known."""
    if not held:
        return []
    history, due, parts = present.history, absences.due, []
    before = [history[k] for k in range(due - 1, history.forgotten - 1, -1)] if (absences.after >= 0).any() else []
    for i in (absences.after >= 0).nonzero()[0].tolist():
        behind = next((k for k, m in enumerate(before) if m.first <= absences.vertex[i]), None)
        if behind is not None:
            ahead = next(k for k, m in enumerate(held) if absences.after[i] < m.first + len(m.estimates))
            last, here, later = before[behind], history[due], held[ahead]
            place, after = int(absences.vertex[i]) - last.first, int(absences.after[i]) - later.first
            warps = _between([*before[:behind][::-1], here]), _between(held[: ahead + 1])
            parts.append(_bridged(last, place, here, later, after, warps, int(absences.identity[i]), model))
    return parts


def _between(moments: list[Moment]) -> F8:
    """How the camera moved through these moments, since the one before the first of them."""
    return warp_of.after([m.warp for m in moments]) if any(len(m.warp) for m in moments) else STILL


def _bridged(
    last: Moment,
    place: int,
    moment: Moment,
    later: Moment,
    after: int,
    warps: tuple[F8, F8],
    identity: int,
    model: Model,
) -> Predicted:
    """The state at ``moment`` given the last one before it and the next one after it."""
    x, y = last.estimates, later.estimates
    steps = np.array([moment.time - last.time, later.time - moment.time])
    ends = (x.state[:, place], x.covariance[place], y.state[:, after], y.covariance[after])
    return np.array([identity]), bridge(model.motion, *ends, steps, warps), x.weight[place : place + 1]


def _with(rows: Rows, parts: list[Predicted], model: Model) -> Rows:
    """The rows and those of the predicted tracks."""
    if not parts:
        return rows
    identity, state, confidence = parts[0]
    if len(parts) > 1:
        identity, state, confidence = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
    n = len(identity)
    return Rows(
        np.concatenate((rows.identity, identity)),
        np.concatenate((rows.xyxy, model.sensor.boxes(state))),
        np.concatenate((rows.confidence, confidence)),
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
