"""Multi-frame association by graph matching with false-hypothesis correction [M07 §3].

Vertices are the extracted states of the last seconds. An edge joins a vertex to a later one; its
gain is the log-density of the later state under the j-step transition from the earlier, minus that
of leaving both ends open, minus the cost of the time that the track then spends without a state.
The best set of tracks is the path cover of maximum total gain: with each vertex split into an
out-side and an in-side, a bipartite matching (Shafique and Shah 2005). It is extended frame by
frame, by one augmenting path per new vertex (`kernels.linking`).

If it is known what states look like, an edge gains as well the log-likelihood ratio of the past of
its earlier vertex and the detection of the later one [APP (2)] (`associate.vertex_looks`).

The log-density of a loose end is that of a state ``loose_end_distance`` deviations away from a
typical one-step prediction, so that the setting does not depend on the size of image or target, nor
on the frame rate. The degenerate f is convolved with the covariances of both states and evaluated
on the rows that a measurement shows.

Online rows never change; the tracks of `GraphMatching.finish` use all corrections. The
identity of a state is fixed when the rows of its frame are emitted: it is that of the state it is
then linked to. A later correction only decides how the identities go on. Where two states claim one
identity, the one that is linked to its last state has it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from phdtrack.associate.history import (
    HISTORY,
    NO_LINKS,
    History,
    Moment,
    Path,
    descriptors,
    measurements,
    observed_only,
    open_links,
    rows_of,
    seen_until,
)
from phdtrack.associate.vertex_looks import VertexLooks, ahead_of, appeared, linked
from phdtrack.errors import (
    Checked,
    Count,
    InputError,
    NonNegative,
    Positive,
    PositiveCount,
    Probability,
)
from phdtrack.kernels.gaussian import gaussian_parts
from phdtrack.kernels.linking import Fresh, Links, Terms, Window, link_states
from phdtrack.models import warp as warp_of
from phdtrack.models.gaussian import moved
from phdtrack.models.rts import bridge, update
from phdtrack.protocols import Model
from phdtrack.types import (
    F8,
    I8,
    Appeared,
    Bool,
    Detections,
    Estimates,
    Exchange,
    MeasurementHistory,
    Return,
    Tracks,
)

# Frames after which a missing identity is no longer continued.
AGES = 32
# Squared Mahalanobis radius of the 99 % region in four dimensions.
REGION = 13.28


class Identities(NamedTuple):
    """The identities (A,) that may still be linked to, ascending.

    Attributes
    ----------
    identity, last : (A,) its number, and the vertex of its last state.
    length, gain : (A,) its states, and what their links gained.
    confirmed : (A,) whether it has been confirmed.
    missed : (A,) frames since its last state; AGES where the target has left.
    confidence : (A,) of that state; 0 if it is not known any more.
    state : (d, A) the last state, carried on by the motion model.
    """

    identity: I8
    last: I8
    length: I8
    gain: F8
    confirmed: Bool
    missed: I8
    confidence: F8
    state: F8

    def select(self, index: I8 | Bool) -> Identities:
        """The identities at ``index``."""
        return Identities._make(column[..., index] for column in self)

    def join(self, other: Identities) -> Identities:
        """Both, one after the other."""
        if not len(self.identity) or not len(other.identity):
            return self if len(self.identity) else other
        return Identities._make(
            np.concatenate(pair, axis=-1) for pair in zip(self, other, strict=True)
        )


@dataclass(frozen=True, slots=True, eq=False)
class OnlineTracks:
    """The tracks of the online rows so far.

    Attributes
    ----------
    first : the first vertex that may still be linked to.
    track : (V,) the identity of each vertex from there on.
    known : the identities.
    returned : (2, AGES) how many identities were without a state for so many frames, and how many
        of them had one in the next.
    used : the highest identity so far.
    """

    first: int
    track: I8
    known: Identities
    returned: I8 = field(default_factory=lambda: np.zeros((2, AGES), np.int64))
    used: int = 0


class BackDated(NamedTuple):
    """The earlier detections that lead to a track's first state.

    Attributes
    ----------
    path : (n) places (observed moment, `Detections.row`), latest first.
    mean, covariance : (n + 1, d), (n + 1, d, d) the first state, and those at the places.
    """

    path: Path
    mean: F8
    covariance: F8

    def rows(self, observed: list[Moment], identity: int, weight: float, model: Model) -> Tracks:
        """The rows at the detections.

        Parameters
        ----------
        observed : the moments that were observed, of which `path` counts.
        identity, weight, model : of the track's rows, and of the last frame.
        """
        frames, detections = np.array([(observed[k].number, row) for k, row in self.path]).T
        boxes = model.sensor.boxes(np.ascontiguousarray(self.mean[1:].T))
        return Tracks.of(frames, identity, boxes, weight, detections)

    def unobserved_rows(
        self, moments: list[Moment], places: list[int], identity: int, weight: float, model: Model
    ) -> list[Tracks]:
        """The rows in the unobserved frames between.

        Parameters
        ----------
        moments, places : all moments, and where the n + 1 states are among them.
        identity, weight, model : of the track's rows, and of the last frame.
        """
        parts = []
        for k, (later, earlier) in enumerate(itertools.pairwise(places)):
            between = moments[earlier : later + 1]
            if len(between) == 2:
                continue
            before = slice(k + 1, k + 2)
            after = slice(k, k + 1)
            state = self.mean
            covariance = self.covariance
            ends = (state[before], covariance[before], state[after], covariance[after])
            steps = np.diff([moment.time for moment in between])
            warps = [moment.warp for moment in between[1:]]
            found = bridge(model.motion, ends, steps, warps)[:, 0]
            frames = np.array([moment.number for moment in between[1:-1]])
            boxes = model.sensor.boxes(np.ascontiguousarray(found))
            parts.append(Tracks.of(frames, identity, boxes, weight, -1))
        return parts


@dataclass(frozen=True, slots=True)
class GraphState:
    """Open links, everything seen, the online tracks, the number of vertices, the model time, and
    what open vertices look like.
    """

    window: Window
    history: History
    online: OnlineTracks
    vertices: int = 0
    time: float = 0.0
    looks: VertexLooks = field(default_factory=VertexLooks)


@dataclass(frozen=True, slots=True)
class GraphMatching(Checked):
    """Settings of the association.

    Parameters
    ----------
    window : seconds over which states are linked; M07's K = 50 frames at 25 Hz.
    min_track_length : states, and detections that a track is led back to, below which a corrected
        track is discarded; states below which an online track is not confirmed.
    loose_end_distance : deviations from a typical prediction at which a link gains as much as two
        loose ends.
    gap_cost : nats per second that a link loses for the time without a state.
    min_link_gain : share of loose_end_distance²/2 that a track's links must gain on average, or it
        is discarded (offline) or not confirmed (online). Links between false alarms are poor.
    max_link_distance : deviations that linked states may be apart.
    output_delay : frames by which the online output lags, so that what follows can correct links
        and confirm tracks.
    max_coast : seconds for which, at most, a confirmed track without a state is continued online by
        the motion model. It is continued while tracks that were missing as long came back in more
        than half of the cases.
    bridge_gaps : fill gaps of up to two seconds with predicted rows.
    back_dating : earlier detections through which a corrected track is led back, at most.
    history : seconds of the filter's time (`time.longest_interval`) after which the past is
        forgotten; 0: never. Corrected tracks then go no further back than this and a little more.
    """

    window: Positive = 2.0
    min_track_length: PositiveCount = 5
    loose_end_distance: Positive = 4.0
    gap_cost: NonNegative = 2.6340128914456576
    min_link_gain: Probability = 0.75
    max_link_distance: Positive = 3.0
    output_delay: Count = 0
    max_coast: NonNegative = 0.2
    bridge_gaps: bool = True
    back_dating: Count = 5
    history: NonNegative = HISTORY

    def start(self) -> GraphState:
        """Nothing seen."""
        none = np.zeros(0, np.int64)
        return GraphState(
            empty_window(0), History(), OnlineTracks(0, none, _new(none, Estimates.empty(0), none))
        )

    def extend(
        self,
        state: GraphState,
        estimates: Estimates,
        z: F8,
        detections: Detections,
        number: int,
        dt: float,
        model: Model,
    ) -> tuple[GraphState, Tracks]:
        """The state with the states of frame ``number`` linked, and the online rows that are now
        due [M07 §3].

        Raises `InputError` if a position is not finite.
        """
        window = state.window if state.vertices else empty_window(len(estimates.state))
        final = NO_LINKS
        looks = state.looks
        if detections.observed:
            window, final, looks = self._linked(window, looks, estimates, dt, model)
        else:
            # Its rows continue identities; what is only predicted is linked to nothing.
            estimates = Estimates.empty(len(estimates.state))
        moment = Moment(
            number,
            state.time + dt,
            state.vertices,
            estimates,
            final,
            z,
            detections.row,
            detections.class_id,
            detections.confidence,
            model.warp,
            detections.observed,
            descriptors(detections),
            model.pace,
        )
        history = state.history.followed_by(moment)
        if history is state.history:
            return state, Tracks.empty()
        vertices = state.vertices + len(estimates)
        time = moment.time if moment.observed else state.time
        extended = GraphState(window, history, state.online, vertices, time, looks)
        due = len(history) - 1 - self.output_delay
        if due < 0:
            return extended, Tracks.empty()
        extended, tracks = self._emit(extended, due, model)
        if self.history == 0:
            return extended, tracks
        # What open links and rows that are still due rest on stays.
        needed = history[due].time - (2 * self.window + self.max_coast) * model.rate
        return replace(
            extended, history=history.since(min(time - self.history * model.rate, needed))
        ), tracks

    def flush(self, state: GraphState, model: Model) -> Tracks:
        """The online rows of the last ``output_delay`` frames, under the final links."""
        parts = []
        for due in range(max(0, len(state.history) - self.output_delay), len(state.history)):
            state, tracks = self._emit(state, due, model)
            parts.append(tracks)
        return Tracks.concatenate(parts)

    def finish(self, state: GraphState, model: Model) -> Tracks:
        """The corrected tracks: short ones left out, gaps bridged, identities from 1 in order of
        appearance.
        """
        moments = list(iter(state.history))
        start = np.concatenate(
            ([0], np.cumsum([len(m.estimates) for m in moments], dtype=np.int64))
        )
        observed = observed_only(moments)
        seen = np.flatnonzero([moment.observed for moment in moments])
        parts = list[Tracks]()
        taken = set[tuple[int, int]]()
        at = list[int]()
        name = list[int]()
        identity = 1
        for path in self._paths(moments, state.window):
            first = int(np.searchsorted(seen, path[0][0])), path[0][1]
            before = _back_dated(observed, first, self.back_dating, taken, model)
            if len(path) + len(before.path) < self.min_track_length:
                continue
            taken.update(before.path)
            at += [int(start[k]) + i for k, i in path]
            name += [identity] * len(path)
            weight = observed[first[0]].estimates.weight[first[1]]
            if before.path:
                parts.append(before.rows(observed, identity, weight, model))
            if before.path and self.bridge_gaps:
                places = seen[[first[0], *(k for k, _ in before.path)]].tolist()
                parts += before.unobserved_rows(moments, places, identity, weight, model)
            identity += 1
        parts += rows_of(
            moments, np.array(at, np.int64), np.array(name, np.int64), self.bridge_gaps, model
        )
        return Tracks.concatenate(parts)

    def measurements(self, state: GraphState) -> MeasurementHistory:
        """The measurements of everything that is remembered."""
        return measurements(state.history)

    def returns(self, state: GraphState) -> tuple[Return, ...]:
        """None: identities are those of the matching."""
        return ()

    def exchanges(self, state: GraphState) -> tuple[Exchange, ...]:
        """None: identities are those of the matching."""
        return ()

    def appeared(self, state: GraphState, seen: Appeared) -> Appeared:
        """The targets as links tell them, unless the filter follows them by label."""
        if len(seen.estimates.followed):
            return seen
        return appeared(state.looks, seen)

    def oldest(self, state: GraphState) -> int:
        """The number of the first frame that is remembered."""
        first = next(iter(state.history), None)
        return first.number if first else 0

    def numbered_after(self, state: GraphState, identity: int) -> GraphState:
        """The state that numbers new tracks from ``identity`` + 1 on."""
        return replace(state, online=replace(state.online, used=identity))

    def _linked(
        self, window: Window, looks: VertexLooks, estimates: Estimates, dt: float, model: Model
    ) -> tuple[Window, Links, VertexLooks]:
        """The window with the new states, the links that can no longer change, and what the open
        vertices look like.
        """
        rows = np.array(model.sensor.observed)
        if not np.isfinite(estimates.state[rows[:2]]).all():
            raise InputError("expected positions that are finite", where="the extracted states")
        mean = window.mean
        covariance = window.covariance
        if len(mean):
            mean, covariance, _ = moved(model, mean, covariance, dt, "linear")[2]
        _, _, noise = model.motion.transition(estimates.state, dt)
        typical = noise[:, rows[:, None], rows].copy()
        typical[:, range(len(rows)), range(len(rows))] += (
            2 * model.sensor.noise(estimates.state)[rows].T ** 2
        )
        fresh = Fresh(
            np.ascontiguousarray(estimates.state.T),
            np.ascontiguousarray(estimates.covariance),
            typical,
            rows,
        )
        # The small addition keeps a state exactly that old.
        span = self.window * model.rate + 1e-9
        gap_cost = self.gap_cost / model.rate
        terms = Terms(span, self.loose_end_distance, gap_cost, self.max_link_distance)
        detection = np.ascontiguousarray(estimates.detection)
        ahead = ahead_of(looks, len(window.since), detection, model.appearance)
        after, closed, verdicts = link_states(
            window, mean, covariance, fresh, terms, float(dt), ahead.arguments
        )
        return after, open_links(window, closed), linked(ahead, after, closed, verdicts)

    def _paths(self, moments: list[Moment], window: Window) -> list[Path]:
        """Tracks in order of appearance whose links gain enough."""
        place = [(k, i) for k, m in enumerate(moments) for i in range(len(m.estimates))]
        before = np.full(len(place), -1, np.int64)
        gain = np.zeros(len(place))
        first = moments[0].first if moments else 0
        for part in (*(m.final for m in moments), open_links(window)):
            # What went before the first moment may be forgotten: tracks then begin here.
            known = part.earlier >= first
            later = part.later[known] - first
            before[later] = part.earlier[known] - first
            gain[later] = part.gain[known]
        ending: dict[int, list[int]] = {}
        paths = []
        for vertex in range(len(place)):
            path = ending.pop(int(before[vertex]), [])
            if not path:
                paths.append(path)
            path.append(vertex)
            ending[vertex] = path
        return [
            [place[v] for v in path] for path in paths if self._good(len(path), gain[path].sum())
        ]

    def _good(self, states: I8 | int, gain: F8) -> Bool:
        """True for tracks with links that gain enough; a perfect typical link gains
        loose_end_distance²/2.
        """
        return gain >= self.min_link_gain * 0.5 * self.loose_end_distance**2 * (states - 1)

    def _emit(self, state: GraphState, place: int, model: Model) -> tuple[GraphState, Tracks]:
        """The state after the online rows of the frame at ``place`` of the history under the
        present links, and these rows.
        """
        online = state.online
        moment = state.history[place]
        if not moment.observed:
            return state, self._unobserved(state, place, model)
        held = [state.history[k] for k in range(place + 1, len(state.history))]
        end = moment.first + len(moment.estimates)
        onward, gain = _onward(online.first, state.window, held)
        identity, known, used = _claimed(online, moment, onward, gain)
        known = known._replace(confirmed=self._confirmed(known, onward, gain, online.first, end))
        returned = _returned(online, known)
        e = moment.estimates
        confirmed = known.confirmed[np.searchsorted(known.identity, identity)]
        parts = [Tracks.of(moment.number, identity, e.xyxy, e.weight, moment.rows, confirmed)]
        after = onward[known.last - online.first]
        missing = known.last < moment.first
        absent = (
            missing & known.confirmed & ((after >= end) | ((after < 0) & (known.missed < AGES)))
        )
        coasting = known._replace(
            state=known.state.copy(),
            missed=known.missed.copy(),
            confidence=np.where(missing, 0.0, known.confidence),
        )
        if self.bridge_gaps and absent.any():
            bridging = (absent & (after >= 0)).nonzero()[0]
            parts += _bridged(known.select(bridging), after[bridging], state.history, place, model)
            going = (absent & (known.confidence > 0)).nonzero()[0]
            ahead, rows = self._coasted(
                state, place, known.select(going), after[going] < 0, returned, model
            )
            parts.append(rows)
            coasting.state[:, going] = ahead.state
            coasting.missed[going] = ahead.missed
            coasting.confidence[going] = ahead.confidence
        # The first vertex whose identity a later row may ask for.
        earlier = [int(m.final.earlier.min(initial=moment.first)) for m in held]
        oldest = min(state.window.column, moment.first, *earlier)
        track = np.concatenate((online.track, identity))[oldest - online.first :]
        kept = coasting.select(coasting.last >= oldest)
        online = OnlineTracks(oldest, track, kept, returned, used)
        return replace(state, online=online), Tracks.concatenate(parts)

    def _unobserved(self, state: GraphState, place: int, model: Model) -> Tracks:
        """The rows of the frame at ``place`` of the history, which was not observed."""
        online = state.online
        known = online.known
        if not (self.bridge_gaps and known.confirmed.any()):
            return Tracks.empty()
        held = [state.history[k] for k in range(place + 1, len(state.history))]
        onward, _ = _onward(online.first, state.window, held)
        after = onward[known.last - online.first]
        # A state of an earlier frame that goes on from it has another identity.
        bridging = (known.confirmed & (after >= state.history[place].first)).nonzero()[0]
        parts = _bridged(known.select(bridging), after[bridging], state.history, place, model)
        going = (known.confirmed & (after < 0) & (known.confidence > 0)).nonzero()[0]
        unlinked = np.ones(len(going), np.bool_)
        missing = known.select(going)
        rows = self._coasted(state, place, missing, unlinked, online.returned, model)[1]
        return Tracks.concatenate([*parts, rows])

    def _coasted(
        self,
        state: GraphState,
        place: int,
        missing: Identities,
        unlinked: Bool,
        returned: I8,
        model: Model,
    ) -> tuple[Identities, Tracks]:
        """Identities without a state in the frame at ``place``, carried on by the motion model, and
        the rows of those that are shown.

        ``unlinked`` (n,): those that are not linked to a later state. ``returned``: as in
        `OnlineTracks`, with this frame.
        """
        moment = state.history[place]
        ahead = missing.state
        since = place - 1
        while since > state.history.forgotten and not state.history[since].observed:
            since -= 1
        warp = warp_of.joined([state.history[k].warp for k in range(since + 1, place + 1)])
        if len(warp):
            ahead = model.motion.warp_states(ahead, warp)
        step = moment.time - state.history[since].time
        ahead, _, _ = model.motion.transition(ahead, step)
        survive = model.motion.p_survive(ahead, step / model.rate)
        confidence = missing.confidence * survive
        there = confidence > 0
        probability = _return_probability(
            survive[there], model.sensor.p_detect(ahead)[there], returned
        )
        most = self._max_frames(state, place, probability, model)
        shown = there & (missing.missed <= most) & unlinked
        boxes = model.sensor.boxes(ahead[:, shown])
        rows = Tracks.of(moment.number, missing.identity[shown], boxes, confidence[shown], -1)
        missed = np.where(there, missing.missed, AGES)
        return missing._replace(state=ahead, confidence=confidence, missed=missed), rows

    def _confirmed(self, known: Identities, onward: I8, gain: F8, first: int, end: int) -> Bool:
        """(A,) whether each identity is confirmed by its states, or together with those that it is
        linked to later.
        """
        confirmed = known.confirmed
        states = known.length
        total = known.gain
        here = known.last - first
        while True:
            confirmed = confirmed | ((states >= self.min_track_length) & self._good(states, total))
            goes_on = onward[here] >= end
            if not goes_on.any():
                return confirmed
            states = states + goes_on
            total = total + np.where(goes_on, gain[here], 0.0)
            here = np.where(goes_on, onward[here] - first, here)

    def _max_frames(
        self, state: GraphState, place: int, probability: list[float], model: Model
    ) -> int:
        """For how many observed frames without a state tracks are continued: while more come back
        than do not, and ``max_coast``. −1 for none, not even those of the last observed frame,
        which end where the detector is overdue.
        """
        history = state.history
        longest = self.max_coast * model.rate + 1e-9
        now = max(state.time, seen_until(history, place, history.forgotten))
        ages = iter(probability[sum(history[k].observed for k in range(place + 1, len(history))) :])
        most = -1
        for earlier in range(place, history.forgotten - 1, -1):
            if not history[earlier].observed:
                continue
            # Where no detector ran, the tracks of the last frame are not missing.
            returns = next(ages, 0.0) > 0.5 or (most < 0 and not history[place].observed)
            if now - history[earlier].time > longest or not returns:
                break
            most += 1
        return most


def empty_window(dim: int) -> Window:
    """A window without vertices, for states of ``dim`` components."""
    none = np.zeros(0, np.int64)
    zero = np.zeros(0)
    begin = np.zeros(1, np.int64)
    return Window(
        0,
        0,
        none,
        zero,
        zero,
        none,
        zero,
        zero,
        begin,
        none,
        zero,
        np.zeros((0, dim)),
        np.zeros((0, dim, dim)),
    )


def _new(identity: I8, estimates: Estimates, vertex: I8) -> Identities:
    """New identities, of states that are the vertices ``vertex`` (n,)."""
    one = np.ones(len(identity), np.int64)
    zero = np.zeros(len(identity))
    weight = np.minimum(1.0, estimates.weight)
    return Identities(identity, vertex, one, zero, zero > 0, one - 1, weight, estimates.state)


def _onward(first: int, window: Window, held: list[Moment]) -> tuple[I8, F8]:
    """For each vertex from ``first`` on the vertex that it is linked to later, −1 for none, and the
    link's gain.
    """
    count = window.row + len(window.previous) - first
    onward = np.full(count, -1)
    gain = np.zeros(count)
    for links in (open_links(window), *(m.final for m in held)):
        kept = links.earlier >= first
        onward[links.earlier[kept] - first] = links.later[kept]
        gain[links.earlier[kept] - first] = links.gain[kept]
    return onward, gain


def _claimed(
    online: OnlineTracks, moment: Moment, onward: I8, gain: F8
) -> tuple[I8, Identities, int]:
    """The identities (n,) of the frame's states, all identities with them, and how many were ever
    used.

    A state takes the identity of the one that is linked to it. Of several that claim one, that
    which is linked to the identity's last state has it, else the first; the others get new ones.
    """
    known = online.known
    e = moment.estimates
    first = moment.first
    earlier = onward[: len(online.track)]
    source = ((earlier >= first) & (earlier < first + len(e))).nonzero()[0]
    state = earlier[source] - first
    name = online.track[source]
    direct = known.last[np.searchsorted(known.identity, name)] - online.first == source
    order = np.lexsort((state, ~direct))
    _, foremost = np.unique(name[order], return_index=True)
    won = order[foremost]
    source = source[won]
    state = state[won]
    name = name[won]
    at = np.searchsorted(known.identity, name)
    identity = np.zeros(len(e), np.int64)
    identity[state] = name
    fresh = (identity == 0).nonzero()[0]
    identity[fresh] = online.used + 1 + np.arange(len(fresh))
    going = Identities._make(column.copy() for column in known._replace(missed=known.missed + 1))
    going.last[at] = first + state
    going.missed[at] = 0
    going.length[at] += 1
    going.gain[at] += gain[source]
    if len(at):
        going.state[:, at] = e.state[:, state]
        going.confidence[at] = np.minimum(1.0, e.weight[state])
    return (
        identity,
        going.join(_new(identity[fresh], e.select(fresh), first + fresh)),
        online.used + len(fresh),
    )


def _returned(online: OnlineTracks, known: Identities) -> I8:
    """`OnlineTracks.returned` with this frame: of confirmed identities without a state, how many
    have one now.
    """
    before = online.known
    returned = online.returned.copy()
    asked = (before.confirmed & (before.missed > 0) & (before.missed < AGES)).nonzero()[0]
    np.add.at(returned[0], before.missed[asked], 1)
    np.add.at(returned[1], before.missed[asked], known.missed[asked] == 0)
    return returned


def _return_probability(p_survive: F8, p_detect: F8, returned: I8) -> list[float]:
    """The probabilities that an identity that has had no state for 0, 1, … frames will have one
    again.

    They come from how many did so far, age by age (Kaplan and Meier's product of hazards). Each age
    also counts one that behaves as the model says: it exists with r, survives with p_S, is missed
    with 1 − p_D, and then exists with r p_S (1 − p_D)/(1 − r p_S p_D), as a Bernoulli filter has
    it.
    """
    stays, seen = (float(p.mean()) if len(p) else 0.0 for p in (p_survive, p_detect))
    exists = 1.0
    never = 1.0
    out = []
    for asked, came in zip(*returned.tolist(), strict=True):
        there = exists * stays
        out.append((came + there * seen) / (asked + 1.0))
        exists = there * (1.0 - seen) / (1.0 - there * seen) if there * seen < 1.0 else 0.0
    for age in range(len(out) - 1, -1, -1):
        never *= 1.0 - out[age]
        out[age] = 1.0 - never
    return out


def _bridged(
    known: Identities, after: I8, history: History, place: int, model: Model
) -> list[Tracks]:
    """The rows in the frame at ``place`` of identities whose next state, the vertex ``after`` (a,),
    is known already.
    """
    parts = []
    now = history[place]
    for i, (vertex, later) in enumerate(zip(known.last.tolist(), after.tolist(), strict=True)):
        behind = next(
            (k for k in range(place - 1, history.forgotten - 1, -1) if history[k].first <= vertex),
            None,
        )
        if behind is None:
            continue
        ahead = next(
            k
            for k in range(place + 1, len(history))
            if later < history[k].first + len(history[k].estimates)
        )
        a = history[behind]
        b = history[ahead]
        x = a.estimates
        y = b.estimates
        j = vertex - a.first
        k = later - b.first
        warps = [
            warp_of.joined([history[m].warp for m in between])
            for between in (range(behind + 1, place + 1), range(place + 1, ahead + 1))
        ]
        ends = (
            x.state[:, j][None],
            x.covariance[j][None],
            y.state[:, k][None],
            y.covariance[k][None],
        )
        state = bridge(model.motion, ends, np.array([now.time - a.time, b.time - now.time]), warps)[
            :, 0
        ]
        parts.append(
            Tracks.of(
                now.number, int(known.identity[i]), model.sensor.boxes(state), x.weight[j], -1
            )
        )
    return parts


def _back_dated(
    moments: list[Moment],
    start: tuple[int, int],
    most: int,
    taken: set[tuple[int, int]],
    model: Model,
) -> BackDated:
    """The detections that lead to a track's first state.

    A filter that removes clutter confirms a target only after some coherent detections. Here a
    Kalman filter runs backward in time from the first state: predict by the inverse transition,
    take the nearest unused detection in the 99 % region, update with it; stop where there is none.
    There are ``most`` at most, and other tracks have ``taken`` some.
    """
    place, i = start
    state = moments[place].estimates.state[:, i]
    cov = moments[place].estimates.covariance[i]
    rows = np.array(model.sensor.observed)
    path: Path = []
    states = [state]
    covs = [cov]
    for k in range(place - 1, max(-1, place - 1 - most), -1):
        earlier = moments[k]
        used = set(earlier.rows.tolist())
        columns = earlier.columns()
        rows_there = earlier.row[columns].tolist()
        free = [
            column
            for column, row in zip(columns.tolist(), rows_there, strict=True)
            if row not in used and (k, row) not in taken
        ]
        if not free:
            break
        state, cov = _one_frame_back(
            state, cov, moments[k + 1], moments[k + 1].time - earlier.time, model
        )
        seen, noise = model.sensor.states(earlier.z[:, free])
        noise = noise[:, rows][:, :, rows]
        innovation = cov[np.ix_(rows, rows)] + noise
        distance2, _ = gaussian_parts(
            seen[rows] - state[rows, None], np.ascontiguousarray(innovation)
        )
        best = int(np.argmin(distance2))
        if distance2[best] > REGION:
            break
        (state,), (cov,) = update(
            state[None], cov[None], seen[rows, best][None], noise[best][None], rows
        )
        path.append((k, int(earlier.row[free[best]])))
        states.append(state)
        covs.append(cov)
    return BackDated(path, np.stack(states), np.stack(covs))


def _one_frame_back(state: F8, cov: F8, later: Moment, dt: float, model: Model) -> tuple[F8, F8]:
    """State (d,) and covariance (d, d) in the frame before ``later``, by the inverse transition."""
    _, jacobian, noise = model.motion.transition(state[:, None], dt)
    # A component that the transition forgets (a remembered size) cannot be inferred from what came
    # after: it stays.
    back = np.linalg.pinv(jacobian[0])
    forgotten = ~jacobian[0].any(axis=0)
    state = np.where(forgotten, state, back @ state)
    cov = back @ (cov + noise[0]) @ back.T
    if len(later.warp):
        homeward = warp_of.back(later.warp)
        slope = model.motion.warp_jacobian(state[:, None], homeward)[0]
        state = model.motion.warp_states(state[:, None], homeward)[:, 0]
        cov = slope @ cov @ slope.T
    return state, cov


@dataclass(frozen=True, slots=True)
class DetectionMatching(GraphMatching):
    """Settings of the association of raw detections: those of `GraphMatching`.

    Parameters
    ----------
    min_link_gain : share of loose_end_distance²/2 that a track's links must gain on average, or it
        is discarded (offline) or not confirmed (online). A raw detection
        has no known velocity, so that the links of true tracks gain less than those of filtered
        states.
    """

    min_link_gain: Probability = 0.6
