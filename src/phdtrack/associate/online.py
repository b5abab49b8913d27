"""Online rows of the graph association, which never change once they are given.

The identity of a state is fixed when the rows of its frame are given: it is that of the state it is then linked to. A later
correction does not recall a row; it only decides how the identities go on. Where two states claim one identity, the one that
is linked to its last state has it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.associate.history import History, Moment, open_links
from phdtrack.kernels.linking import Window
from phdtrack.models import warp as warp_of
from phdtrack.models.rts import bridge
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, STILL, Bool, Estimates, Tracks

# Frames after which a missing identity is no longer continued.
AGES = 32


@dataclass(frozen=True, slots=True)
class Output:
    """Settings: states and mean gain that confirm a track, and how long it is continued without a state (model time)."""

    min_length: int
    least_gain: float
    max_coast: float


@dataclass(frozen=True, slots=True, eq=False)
class Due:
    """A frame whose rows are due, and what is known now.

    Attributes
    ----------
    place, moment : the frame and its place in the history.
    held : the frames after it, whose rows are held back.
    window : the open links.
    time : the present model time.
    history : all frames up to now.
    """

    place: int
    moment: Moment
    held: list[Moment]
    window: Window
    time: float
    history: History

    @classmethod
    def at(cls, place: int, window: Window, time: float, history: History) -> Due:
        """The frame at this place of the history."""
        held = [history[k] for k in range(place + 1, len(history))]
        return cls(place, history[place], held, window, time, history)

    @property
    def end(self) -> int:
        """The first vertex of the frames after it."""
        return self.moment.first + len(self.moment.estimates)


@dataclass(frozen=True, slots=True, eq=False)
class Identities:
    """The identities (A,) that may still be linked to, ascending.

    Attributes
    ----------
    identity : (A,) its number.
    last : (A,) the vertex of its last state.
    length, gain : (A,) its states, and what their links gained.
    confirmed : (A,) whether it has been confirmed.
    missed : (A,) frames since its last state; AGES where the target has left.
    state : (d, A) the last state, carried on by the motion model.
    confidence : (A,) of that state; 0 where it is not known any more.
    """

    identity: I8
    last: I8
    length: I8
    gain: F8
    confirmed: Bool
    missed: I8
    state: F8
    confidence: F8

    @classmethod
    def of(cls, identity: I8, estimates: Estimates, vertex: I8) -> Identities:
        """New ones, of states that are the vertices ``vertex`` (n,)."""
        n = len(identity)
        one, zero = np.ones(n, np.int64), np.zeros(n)
        weight = np.minimum(1.0, estimates.weight)
        return cls(identity, vertex, one, zero, zero > 0, one - 1, estimates.state, weight)

    def take(self, index: I8 | Bool) -> Identities:
        """Those at ``index``."""
        return Identities(
            self.identity[index],
            self.last[index],
            self.length[index],
            self.gain[index],
            self.confirmed[index],
            self.missed[index],
            self.state[:, index],
            self.confidence[index],
        )

    def join(self, other: Identities) -> Identities:
        """These, then the other ones."""
        if not len(self.identity) or not len(other.identity):
            return self if len(self.identity) else other
        return Identities(
            np.concatenate((self.identity, other.identity)),
            np.concatenate((self.last, other.last)),
            np.concatenate((self.length, other.length)),
            np.concatenate((self.gain, other.gain)),
            np.concatenate((self.confirmed, other.confirmed)),
            np.concatenate((self.missed, other.missed)),
            np.concatenate((self.state, other.state), axis=1),
            np.concatenate((self.confidence, other.confidence)),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """What was given online.

    Attributes
    ----------
    first : the first vertex that may still be linked to.
    track : (V,) the identity of each vertex from there on.
    known : the identities.
    returned : (2, AGES) how many identities were without a state for so many frames, and how many of them had one in the
        next.
    used : identities given so far.
    """

    first: int
    track: I8
    known: Identities
    returned: I8 = field(default_factory=lambda: np.zeros((2, AGES), np.int64))
    used: int = 0

    @classmethod
    def nothing(cls) -> Given:
        """Before the first frame."""
        none = np.zeros(0, np.int64)
        return cls(0, none, Identities.of(none, Estimates.empty(0), none))


def give(given: Given, due: Due, output: Output, model: Model) -> tuple[Given, Tracks]:
    """The rows of a frame under the present links, and the new record.

    Parameters
    ----------
    given : what was given before.
    due : the frame, and what is known now.
    output : settings.
    model : of the present frame.
    """
    moment, held = due.moment, due.held
    onward, gain = _onward(given.first, due.window, held)
    identity, known, used = _claimed(given, due, onward, gain)
    known = replace(known, confirmed=_confirmed(known, onward, gain, given.first, due.end, output))
    returned = _returned(given, known)
    e, confirmed = moment.estimates, known.confirmed[np.searchsorted(known.identity, identity)]
    parts = [Tracks(np.full(len(e), moment.number), identity, e.xyxy, np.minimum(1.0, e.weight), e.detection, confirmed)]
    after, missing = onward[known.last - given.first], known.last < moment.first
    absent = missing & known.confirmed & ((after >= due.end) | ((after < 0) & (known.missed < AGES)))
    going = np.zeros(0, np.int64)
    if output.max_coast > 0 and absent.any():
        bridging = _where(absent & (after >= 0))
        parts += _bridged(known.take(bridging), after[bridging], due, model)
        going = _where(absent & (known.confidence > 0))
    state, confidence, missed = known.state, np.where(missing, 0.0, known.confidence), known.missed
    if len(going):
        moved = _carried_on(known.take(going), due, model)
        state, missed = state.copy(), missed.copy()
        state[:, going], confidence[going] = moved.state, moved.confidence
        missed[going[moved.confidence <= 0]] = AGES
        most = _max_frames(moved, returned, due, output, model)
        shown = moved.take((moved.missed <= most) & (after[going] < 0) & (moved.confidence > 0))
        parts.append(_predicted(shown.identity, shown.state, shown.confidence, moment.number, model))
    known = replace(known, state=state, confidence=confidence, missed=missed)
    # The first vertex whose identity a row still to be given may ask for.
    oldest = min([due.window.column, moment.first, *(int(m.final.earlier.min(initial=moment.first)) for m in held)])
    track = np.concatenate((given.track, identity))[oldest - given.first :]
    return Given(oldest, track, known.take(known.last >= oldest), returned, used), Tracks.concatenate(parts)


def _where(condition: Bool) -> I8:
    """The places where the condition holds."""
    return condition.nonzero()[0]


def _onward(first: int, window: Window, held: list[Moment]) -> tuple[I8, F8]:
    """Of each vertex from ``first`` on the vertex that it is linked to later, −1 for none, and the link's gain."""
    count = window.row + len(window.previous) - first
    onward, gain = np.full(count, -1), np.zeros(count)
    for links in (open_links(window), *(m.final for m in held)):
        kept = links.earlier >= first
        onward[links.earlier[kept] - first], gain[links.earlier[kept] - first] = links.later[kept], links.gain[kept]
    return onward, gain


def _claimed(given: Given, due: Due, onward: I8, gain: F8) -> tuple[I8, Identities, int]:
    """The identities (n,) of the frame's states, all identities with them, and how many were ever used.

    A state takes the identity of the one that is linked to it. Of several that claim one, that which is linked to the
    identity's last state has it, else the first; the others get new ones.
    """
    known, e, first = given.known, due.moment.estimates, due.moment.first
    earlier = onward[: len(given.track)]
    source = _where((earlier >= first) & (earlier < due.end))
    state, name = earlier[source] - first, given.track[source]
    at = np.searchsorted(known.identity, name)
    direct = known.last[at] - given.first == source
    order = np.lexsort((state, ~direct))
    _, foremost = np.unique(name[order], return_index=True)
    won = order[foremost]
    source, state, name, at = source[won], state[won], name[won], at[won]
    identity = np.zeros(len(e), np.int64)
    identity[state] = name
    fresh = _where(identity == 0)
    identity[fresh] = given.used + 1 + np.arange(len(fresh))
    last, length, total, missed = known.last.copy(), known.length.copy(), known.gain.copy(), known.missed + 1
    place, confidence = known.state.copy(), known.confidence.copy()
    last[at], length[at], total[at], missed[at] = first + state, length[at] + 1, total[at] + gain[source], 0
    if len(at):
        place[:, at], confidence[at] = e.state[:, state], np.minimum(1.0, e.weight[state])
    going = Identities(known.identity, last, length, total, known.confirmed, missed, place, confidence)
    return identity, going.join(Identities.of(identity[fresh], e.take(fresh), first + fresh)), given.used + len(fresh)


def _confirmed(known: Identities, onward: I8, gain: F8, first: int, end: int, output: Output) -> Bool:
    """(A,) whether each identity is confirmed by its states, or together with those that it is linked to later."""
    confirmed, states, total, here = known.confirmed, known.length, known.gain, known.last - first
    while True:
        confirmed = confirmed | ((states >= output.min_length) & (total >= output.least_gain * (states - 1)))
        goes_on = onward[here] >= end
        if not goes_on.any():
            return confirmed
        states, total = states + goes_on, total + np.where(goes_on, gain[here], 0.0)
        here = np.where(goes_on, onward[here] - first, here)


def _returned(given: Given, known: Identities) -> I8:
    """`Given.returned` with this frame: of confirmed identities without a state, how many have one now."""
    before = given.known
    asked = _where(before.confirmed & (before.missed > 0) & (before.missed < AGES))
    if len(asked) == 0:
        return given.returned
    returned = given.returned.copy()
    np.add.at(returned[0], before.missed[asked], 1)
    np.add.at(returned[1], before.missed[asked], known.missed[asked] == 0)
    return returned


def _carried_on(known: Identities, due: Due, model: Model) -> Identities:
    """The identities with their states carried on to the frame by the motion model."""
    history, state = due.history, known.state
    if len(due.moment.warp):
        state = model.motion.warp_states(state, due.moment.warp)
    dt = due.moment.time - history[due.place - 1].time
    state, _, _ = model.motion.transition(state, dt)
    return replace(known, state=state, confidence=known.confidence * model.motion.p_survive(state, dt / model.rate))


def _max_frames(moved: Identities, returned: I8, due: Due, output: Output, model: Model) -> int:
    """For how many frames without a state tracks are continued: while more come back than do not, and ``max_coast``."""
    there = moved.confidence > 0
    step = due.moment.time - due.history[due.place - 1].time
    survive = model.motion.p_survive(moved.state, step / model.rate)
    probability = return_probability(survive[there], model.sensor.p_detect(moved.state)[there], returned)
    most, ahead = 0, len(due.held)
    while most + 1 + ahead < AGES and probability[most + 1 + ahead] > 0.5:
        place = due.place - most - 1
        if place < due.history.forgotten or due.time - due.history[place].time > output.max_coast:
            break
        most += 1
    return most


def return_probability(p_survive: F8, p_detect: F8, returned: I8) -> list[float]:
    """The probabilities that an identity that has had no state for 0, 1, … frames will have one again.

    They come from how many did so far, age by age (Kaplan and Meier's product of hazards). Each age also counts one that
    behaves as the model says: it exists with r, survives with p_S, is missed with 1 − p_D, and then exists with
    r p_S (1 − p_D)/(1 − r p_S p_D), as a Bernoulli filter has it.

    Parameters
    ----------
    p_survive, p_detect : (a,) at the states of the missing.
    returned : (2, AGES), see `Given`.
    """
    stays, seen = (float(p.mean()) if len(p) else 0.0 for p in (p_survive, p_detect))
    exists, never, out = 1.0, 1.0, []
    for asked, came in zip(*returned.tolist(), strict=True):
        there = exists * stays
        out.append((came + there * seen) / (asked + 1.0))
        exists = there * (1.0 - seen) / (1.0 - there * seen) if there * seen < 1.0 else 0.0
    for age in range(len(out) - 1, -1, -1):
        never *= 1.0 - out[age]
        out[age] = 1.0 - never
    return out


def _bridged(known: Identities, after: I8, due: Due, model: Model) -> list[Tracks]:
    """The rows of identities whose next state, ``after`` (a,), is known already."""
    history, held, parts = due.history, due.held, []
    before = [history[k] for k in range(due.place - 1, history.forgotten - 1, -1)] if len(after) else []
    for i, (vertex, later) in enumerate(zip(known.last.tolist(), after.tolist(), strict=True)):
        behind = next((k for k, m in enumerate(before) if m.first <= vertex), None)
        if behind is None:
            continue
        ahead = next(k for k, m in enumerate(held) if later < m.first + len(m.estimates))
        a, b = before[behind], held[ahead]
        x, y, j, k = a.estimates, b.estimates, vertex - a.first, later - b.first
        warps = _between([*before[:behind][::-1], due.moment]), _between(held[: ahead + 1])
        ends = x.state[:, j], x.covariance[j], y.state[:, k], y.covariance[k]
        state = bridge(model.motion, ends, np.array([due.moment.time - a.time, b.time - due.moment.time]), warps)
        parts.append(_predicted(known.identity[i : i + 1], state, x.weight[j : j + 1], due.moment.number, model))
    return parts


def _between(moments: list[Moment]) -> F8:
    """How the camera moved through these moments, since the one before the first of them."""
    return warp_of.after([m.warp for m in moments]) if any(len(m.warp) for m in moments) else STILL


def _predicted(identity: I8, state: F8, confidence: F8, number: int, model: Model) -> Tracks:
    """The rows of predicted states (d, a) in frame ``number``."""
    n = len(identity)
    confidence = np.minimum(1.0, confidence)
    return Tracks(np.full(n, number), identity, model.sensor.boxes(state), confidence, np.full(n, -1), np.ones(n, np.bool_))
