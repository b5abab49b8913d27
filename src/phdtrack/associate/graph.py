"""Multi-frame association by graph matching with false-hypothesis correction [M07 §3].

Vertices are the extracted states of the last seconds. An edge joins a vertex to a later one; its gain is the log-density of
the later state under the j-step transition from the earlier, minus that of leaving both ends open, less the price of the
time that the track then spends without a state. The best set of tracks is the path cover of maximum total gain: with each
vertex split into an out-side and an in-side, a bipartite matching (Shafique and Shah 2005). It is extended frame by frame,
by one augmenting path per new vertex.

The density of a loose end is that of a state ``loose_end_distance`` deviations away from a typical one-step prediction: so
the
parameter is free of the image's size, the target's size and the frame rate. The degenerate f is convolved with the
covariances of both states and evaluated on the rows that a measurement shows.

Online rows, once given, never change; the tracks of `finish` use all corrections.
"""

from __future__ import annotations

from dataclasses import dataclass

from phdtrack.associate import offline, online
from phdtrack.associate.history import History, Moment, measurements
from phdtrack.associate.predict import carried, predicted
from phdtrack.associate.triangle import block
from phdtrack.associate.window import Terms, Window, empty_window, extend
from phdtrack.checks import Count, NonNegative, Positive, PositiveCount, Probability, check
from phdtrack.protocols import Model
from phdtrack.types import F8, Estimates, MeasurementHistory, Tracks


@dataclass(frozen=True, slots=True)
class GraphState:
    """Window of open links, everything seen, and what was given out online."""

    window: Window
    history: History
    online: online.Given
    vertices: int = 0
    time: float = 0.0


@dataclass(frozen=True, slots=True)
class GraphMatching:
    """Settings of the association.

    Parameters
    ----------
    window : seconds over which states are linked; M07's K = 50 frames at 25 Hz.
    min_track_length : tracks of fewer states are discarded (offline, where earlier detections that they are led back to
        count too)
        or not yet confirmed (online).
    loose_end_distance : an edge is worth as much as two loose ends at this many deviations.
    gap_cost : nats per second by which a link is worth less when the track spends that time without a state.
    min_link_gain : tracks whose links gain less than this share of loose_end_distance²/2 on average are discarded (offline)
        or not confirmed
        (online): false alarms can be strung together, but their links are poor. Without a filter 0.6 where nothing else is
        said (`config.presets`).
    max_link_distance : no edge joins states that are more than this many deviations apart, however little it would cost.
    output_delay : frames by which the online output lags, so that links can still be corrected and tracks be confirmed by
        what
        follows; 0 allowed.
    max_coast : seconds for which, at most, a confirmed track without a state is continued online by the motion model: it is
        while of those that were missing as long more came back than did not. A gap whose end the delay already shows is
        bridged instead. 0: neither.
    bridge_gaps : fill the gaps of tracks with predicted, flagged boxes.
    back_dating : offline, a track is led back through at most this many earlier detections that the filter did not yet
        believe.
    history : seconds after which the past is forgotten, for cameras that run for days: the corrected tracks then go no
        further back (a little more is kept than this), and the state stops growing. 0: nothing is.
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
        return GraphState(empty_window(0), History(), online.Given.nothing())

    def extend(
        self, state: GraphState, estimates: Estimates, z: F8, number: int, dt: float, model: Model
    ) -> tuple[GraphState, Tracks]:
        """Link the states of frame ``number`` to the past; give the online rows that are now due [M07 §3]."""
        window = state.window if state.vertices else empty_window(len(estimates.state))
        window = carried(window, model)
        moved = predicted(window, estimates, dt, model.motion)
        shown, sigma = block(len(estimates.state), model.sensor.observed), model.sensor.noise(estimates.state)
        terms = Terms(self._span(model), self.loose_end_distance, -self.gap_cost / model.rate, self.max_link_distance)
        window, final = extend(window, moved, sigma, shown, terms, dt)
        time, vertices = state.time + dt, state.vertices + len(estimates)
        history = state.history.append(Moment(number, time, state.vertices, estimates, final, z, model.warp))
        extended = GraphState(window, history, state.online, vertices, time)
        due = len(history) - 1 - self.output_delay
        if due < 0:
            return extended, Tracks.empty()
        given, tracks = self._give(extended.online, due, extended, model)
        return GraphState(window, self._recent(history, due, time, model), given, vertices, time), tracks

    def flush(self, state: GraphState, model: Model) -> Tracks:
        """The online rows of the last ``output_delay`` frames, under the final links."""
        parts, given = [], state.online
        for due in range(max(0, len(state.history) - self.output_delay), len(state.history)):
            given, tracks = self._give(given, due, state, model)
            parts.append(tracks)
        return Tracks.concatenate(parts)

    def finish(self, state: GraphState, model: Model) -> Tracks:
        """The corrected tracks: short ones left out, gaps bridged, identities from 1 in order of appearance."""
        wanted = offline.Wanted(self.min_track_length, self._least(), self.bridge_gaps, self.back_dating)
        return offline.tracks(state.history, state.window, wanted, model)

    def measurements(self, state: GraphState) -> MeasurementHistory:
        """The measurements of everything that is remembered."""
        return measurements(state.history)

    def _least(self) -> float:
        """The mean gain that a track's links must reach; a perfect typical link gains loose_end_distance²/2."""
        return self.min_link_gain * 0.5 * self.loose_end_distance**2

    def _span(self, model: Model) -> float:
        """The window in model time; the small addition keeps a state exactly that old."""
        return self.window * model.rate + 1e-9

    def _recent(self, history: History, due: int, time: float, model: Model) -> History:
        """The history without what is past remembering; what open links and rows still due rest on stays."""
        if self.history == 0:
            return history
        needed = history[due].time - (2 * self.window + self.max_coast) * model.rate
        return history.since(min(time - self.history * model.rate, needed))

    def _give(self, given: online.Given, due: int, state: GraphState, model: Model) -> tuple[online.Given, Tracks]:
        """The rows of the frame at place ``due`` of the history, under the present links."""
        output = online.Output(
            self.min_track_length, self._least(), self.max_coast * model.rate + 1e-9 if self.bridge_gaps else 0.0
        )
        return online.give(given, due, online.Present(state.window, state.time, state.history), output, model)
