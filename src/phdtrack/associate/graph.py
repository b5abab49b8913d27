"""Multi-frame association by graph matching with false-hypothesis correction [M07 §3].

Vertices are the extracted states of the last seconds. An edge joins a vertex to a later one; its gain is the log-density of
the later state under the j-step transition from the earlier, minus that of leaving both ends open, minus the cost of the
time that the track then spends without a state. The best set of tracks is the path cover of maximum total gain: with each
vertex split into an out-side and an in-side, a bipartite matching (Shafique and Shah 2005). It is extended frame by frame,
by one augmenting path per new vertex (`kernels.linking`).

The log-density of a loose end is that of a state ``loose_end_distance`` deviations away from a typical one-step prediction,
so that the setting does not depend on the size of image or target, nor on the frame rate. The degenerate f is convolved with
the covariances of both states and evaluated on the rows that a measurement shows.

Online rows, once given, never change; the tracks of `finish` use all corrections.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.associate.history import History, Moment, measurements, open_links
from phdtrack.associate.online import Due, Given, Output, give
from phdtrack.associate.rows import Path, back_dated, gaps, rows_of
from phdtrack.checks import Count, NonNegative, Positive, PositiveCount, Probability, check
from phdtrack.errors import InputError
from phdtrack.kernels.linking import Fresh, Links, Terms, Window, link_states
from phdtrack.models.gaussian import predicted
from phdtrack.protocols import Model
from phdtrack.types import F8, Estimates, MeasurementHistory, Tracks


@dataclass(frozen=True, slots=True)
class GraphState:
    """Open links, everything seen, what was given online, the number of vertices and the model time."""

    window: Window
    history: History
    given: Given
    vertices: int = 0
    time: float = 0.0


@dataclass(frozen=True, slots=True)
class GraphMatching:
    """Settings of the association.

    Parameters
    ----------
    window : seconds over which states are linked; M07's K = 50 frames at 25 Hz.
    min_track_length : states, and detections that a track is led back to, below which a corrected track is discarded; states
        below which an online track is not confirmed.
    loose_end_distance : deviations from a typical prediction at which a link is worth two loose ends.
    gap_cost : nats per second by which a link is worth less for the time without a state.
    min_link_gain : share of loose_end_distance²/2 that a track's links must gain on average, or it is discarded (offline) or
        not confirmed (online). Links between false alarms are poor.
    max_link_distance : deviations that linked states may be apart.
    output_delay : frames by which the online output lags, so that what follows can correct links and confirm tracks.
    max_coast : seconds for which, at most, a confirmed track without a state is continued online by the motion model. It is
        continued while tracks that were missing as long came back in more than half of the cases.
    bridge_gaps : fill the gaps of tracks with predicted rows.
    back_dating : earlier detections through which a corrected track is led back, at most.
    history : seconds after which the past is forgotten, for cameras that run for days; 0: never. Corrected tracks then go no
        further back than this and a little more.
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
    history: NonNegative = 0.0

    def __post_init__(self) -> None:
        check(self)

    def start(self) -> GraphState:
        """Nothing seen."""
        return GraphState(empty_window(0), History(), Given.nothing())

    def extend(
        self, state: GraphState, estimates: Estimates, z: F8, number: int, dt: float, model: Model
    ) -> tuple[GraphState, Tracks]:
        """The state with the states of frame ``number`` linked, and the online rows that are now due [M07 §3].

        Parameters
        ----------
        state : after the frame before.
        estimates : the n extracted states.
        z : (m, N) measurements.
        number : frame number.
        dt : model time since the frame before.
        model : of this frame.

        Raises
        ------
        InputError : a position is not finite.
        """
        window, final = self._linked(
            state.window if state.vertices else empty_window(len(estimates.state)), estimates, dt, model
        )
        time, vertices = state.time + dt, state.vertices + len(estimates)
        history = state.history.append(Moment(number, time, state.vertices, estimates, final, z, model.warp))
        extended = GraphState(window, history, state.given, vertices, time)
        due = len(history) - 1 - self.output_delay
        if due < 0:
            return extended, Tracks.empty()
        given, tracks = self._give(extended, due, model)
        return GraphState(window, self._recent(history, due, time, model), given, vertices, time), tracks

    def flush(self, state: GraphState, model: Model) -> Tracks:
        """The online rows of the last ``output_delay`` frames, under the final links."""
        parts = []
        for due in range(max(0, len(state.history) - self.output_delay), len(state.history)):
            given, tracks = self._give(state, due, model)
            state = replace(state, given=given)
            parts.append(tracks)
        return Tracks.concatenate(parts)

    def finish(self, state: GraphState, model: Model) -> Tracks:
        """The corrected tracks: short ones left out, gaps bridged, identities from 1 in order of appearance."""
        moments = list(state.history)
        parts, taken, identity = [], set[tuple[int, int]](), 1
        place = {m.number: k for k, m in enumerate(moments)}
        for path in self._paths(moments, state.window):
            before = back_dated(moments, path[0], self.back_dating, taken, model)
            if len(path) + len(before) < self.min_track_length:
                continue
            used = [place[number] for number in before.frame.tolist()]
            taken.update(zip(used, before.detection.tolist(), strict=True))
            parts += [replace(before, identity=before.identity + identity), rows_of(moments, path, identity)]
            if self.bridge_gaps:
                parts += gaps(moments, path, identity, model)
            identity += 1
        return Tracks.concatenate(parts)

    def measurements(self, state: GraphState) -> MeasurementHistory:
        """The measurements of everything that is remembered."""
        return measurements(state.history)

    @property
    def _least_gain(self) -> float:
        """The mean gain that a track's links must reach; a perfect typical link gains loose_end_distance²/2."""
        return self.min_link_gain * 0.5 * self.loose_end_distance**2

    def _linked(self, window: Window, estimates: Estimates, dt: float, model: Model) -> tuple[Window, Links]:
        """The window with the new states, and the links that can no longer change."""
        rows = np.array(model.sensor.observed)
        if not np.isfinite(estimates.state[rows[:2]]).all():
            raise InputError("expected positions that are finite", where="the extracted states")
        mean, covariance = window.mean, window.covariance
        if len(mean):
            if len(model.warp):
                carried, covariance = model.warp_gaussians(np.ascontiguousarray(mean.T), covariance)
                mean = np.ascontiguousarray(carried.T)
            mean, covariance, _ = predicted(model, mean, covariance, dt, "linear")
        _, _, noise = model.motion.transition(estimates.state, dt)
        typical = noise[:, rows[:, None], rows].copy()
        typical[:, range(len(rows)), range(len(rows))] += 2 * model.sensor.noise(estimates.state)[rows].T ** 2
        fresh = Fresh(np.ascontiguousarray(estimates.state.T), np.ascontiguousarray(estimates.covariance), typical, rows)
        # The small addition keeps a state exactly that old.
        span, gap_cost = self.window * model.rate + 1e-9, self.gap_cost / model.rate
        terms = Terms(span, self.loose_end_distance, gap_cost, self.max_link_distance)
        after, closed = link_states(window, mean, covariance, fresh, terms, float(dt))
        return after, open_links(window, closed)

    def _paths(self, moments: list[Moment], window: Window) -> list[Path]:
        """Tracks in order of appearance whose links gain enough."""
        place = [(k, i) for k, m in enumerate(moments) for i in range(len(m.estimates))]
        before, gain = np.full(len(place), -1, np.int64), np.zeros(len(place))
        first = moments[0].first if moments else 0
        for part in (*(m.final for m in moments), open_links(window)):
            # What went before the first moment may be forgotten: tracks then begin here.
            known = part.earlier >= first
            later = part.later[known] - first
            before[later], gain[later] = part.earlier[known] - first, part.gain[known]
        ending: dict[int, list[int]] = {}
        paths = []
        for vertex in range(len(place)):
            path = ending.pop(int(before[vertex]), [])
            if not path:
                paths.append(path)
            path.append(vertex)
            ending[vertex] = path
        return [[place[v] for v in path] for path in paths if gain[path].sum() >= self._least_gain * (len(path) - 1)]

    def _recent(self, history: History, due: int, time: float, model: Model) -> History:
        """The history without what is forgotten; what open links and rows still due rest on stays."""
        if self.history == 0:
            return history
        needed = history[due].time - (2 * self.window + self.max_coast) * model.rate
        return history.since(min(time - self.history * model.rate, needed))

    def _give(self, state: GraphState, due: int, model: Model) -> tuple[Given, Tracks]:
        """The rows of the frame at place ``due`` of the history, under the present links."""
        coast = self.max_coast * model.rate + 1e-9 if self.bridge_gaps else 0.0
        output = Output(self.min_track_length, self._least_gain, coast)
        return give(state.given, Due.at(due, state.window, state.time, state.history), output, model)


def empty_window(dim: int) -> Window:
    """A window without vertices, for states of ``dim`` components."""
    none, zero = np.zeros(0, np.int64), np.zeros(0)
    begin = np.zeros(1, np.int64)
    return Window(0, 0, none, zero, zero, none, zero, zero, begin, none, zero, np.zeros((0, dim)), np.zeros((0, dim, dim)))
