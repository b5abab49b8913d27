"""Multi-frame association by graph matching with false-hypothesis correction [M07 §3].

Vertices are the extracted states of the last seconds. An edge joins a vertex to a later one; its gain is the log-density of
the later state under the j-step transition from the earlier, minus that of leaving both ends open, less the price of the
time that the track then spends without a state. The best set of tracks is the path cover of maximum total gain: with each
vertex split into an out-side and an in-side, a bipartite matching (Shafique and Shah 2005). It is extended frame by frame,
by one augmenting path per new vertex.

The density of a loose end is that of a state ``gate`` deviations away from a typical one-step prediction: so the
parameter is free of the image's size, the target's size and the frame rate. The degenerate f is convolved with the
covariances of both states and evaluated on the rows that a measurement shows.

Online rows, once given, never change; the tracks of `finish` use all corrections.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.associate import offline, online
from phdtrack.associate.history import History, Moment
from phdtrack.associate.window import Columns, Window, advance, empty_window, insert
from phdtrack.checks import Count, NonNegative, Positive, PositiveCount, Probability, Share, check
from phdtrack.kernels.gating import gated_pairs
from phdtrack.kernels.gaussian import gaussian_parts
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Estimates, Tracks


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
    span : seconds over which states are linked; M07's K = 50 frames at 25 Hz.
    shortest : tracks of fewer states are discarded (offline, where earlier detections that they are led back to count too)
        or not yet confirmed (online).
    gate : an edge is worth as much as two loose ends at this many deviations.
    miss : probability that a target inside its track goes on without a state for one more time unit of the model (1/25 s
        as shipped): the price of a gap, whatever the frame rate.
    worth : tracks whose links gain less than this share of gate²/2 on average are discarded (offline) or not confirmed
        (online): false alarms can be strung together, but their links are poor.
    consistent : no edge joins states that are more than this many deviations apart, however little it would cost.
    delay : frames by which the online output lags, so that links can still be corrected and tracks be confirmed by what
        follows; 0 allowed.
    coast : seconds for which a confirmed track without a state is continued online by the motion model; a gap whose end the
        delay already shows is bridged instead. 0: neither.
    bridge : fill the gaps of tracks with predicted, flagged boxes.
    backfill : offline, a track is led back through at most this many earlier detections that the filter did not yet believe.
    """

    span: Positive = 2.0
    shortest: PositiveCount = 5
    gate: Positive = 4.0
    miss: Share = 0.8
    worth: Probability = 0.75
    consistent: Positive = 3.0
    delay: Count = 0
    coast: NonNegative = 0.2
    bridge: bool = True
    backfill: Count = 5

    def __post_init__(self) -> None:
        check(self)

    def start(self) -> GraphState:
        """Nothing seen."""
        return GraphState(empty_window(0), History(), online.Given())

    def extend(
        self, state: GraphState, estimates: Estimates, z: F8, number: int, dt: float, model: Model
    ) -> tuple[GraphState, Tracks]:
        """Link the states of frame ``number`` to the past; give the online rows that are now due [M07 §3]."""
        window = state.window if state.vertices else empty_window(len(estimates.state))
        window, final = advance(window, model.motion, dt, self.span * model.rate + 1e-9)
        vertex = state.vertices + np.arange(len(estimates))
        row, column, gain = self._edges(window.columns, estimates, dt, model)
        window = insert(window, vertex, estimates, row, column, gain)
        spare = np.setdiff1d(np.arange(z.shape[1]), estimates.detection)
        moment = Moment(number, state.time + dt, state.vertices, estimates, final, z[:, spare], spare)
        extended = GraphState(
            window, state.history.append(moment), state.online, state.vertices + len(estimates), moment.time
        )
        due = len(extended.history) - 1 - self.delay
        if due < 0:
            return extended, Tracks.empty()
        given, tracks = self._give(extended.online, due, extended, model)
        return replace(extended, online=given), tracks

    def flush(self, state: GraphState, model: Model) -> Tracks:
        """The online rows of the last ``delay`` frames, under the final links."""
        parts, given = [], state.online
        for due in range(max(0, len(state.history) - self.delay), len(state.history)):
            given, tracks = self._give(given, due, state, model)
            parts.append(tracks)
        return Tracks.concatenate(parts)

    def finish(self, state: GraphState, model: Model) -> Tracks:
        """The corrected tracks: short ones left out, gaps bridged, identities from 1 in order of appearance."""
        wanted = offline.Wanted(self.shortest, self._least(), self.bridge, self.backfill)
        return offline.tracks(state.history, state.window, wanted, model)

    def _least(self) -> float:
        """The mean gain that a track's links must reach; a perfect typical link gains gate²/2."""
        return self.worth * 0.5 * self.gate**2

    def _give(self, given: online.Given, due: int, state: GraphState, model: Model) -> tuple[online.Given, Tracks]:
        """The rows of the frame at place ``due`` of the history, under the present links."""
        held = tuple(state.history[k] for k in range(due + 1, len(state.history)))
        output = online.Output(self.shortest, self._least(), self.coast * model.rate + 1e-9 if self.bridge else 0.0)
        return online.give(given, state.history[due], online.Present(state.window, state.time, held), output, model)

    def _edges(self, columns: Columns, estimates: Estimates, dt: float, model: Model) -> tuple[I8, I8, F8]:
        """Edges (new state, column) of positive gain, by state: log f minus the loose ends' and the gap's price [M07 §3]."""
        rows = list(model.sensor.observed)
        covs = np.ascontiguousarray(estimates.covariance[:, rows][:, :, rows])
        open_end = self._open_end(estimates, covs, dt, model)
        price = (columns.since - dt) * math.log(self.miss)
        before = np.ascontiguousarray(columns.cov[:, rows][:, :, rows])
        far = self._reach(before, covs, open_end, price)
        row, column = gated_pairs(estimates.state[0], estimates.state[1], columns.mean[:2] - far, columns.mean[:2] + far)
        order = np.argsort(row, kind="stable")
        row, column = row[order], column[order]
        step = estimates.state[rows][:, row] - columns.mean[rows][:, column]
        distance2, log_det = gaussian_parts(step, covs[row] + before[column])
        gain = open_end[row] - 0.5 * (distance2 + log_det) + price[column]
        kept = (gain > 0) & (distance2 <= self.consistent**2) & (columns.since[column] <= self.span * model.rate + 1e-9)
        return row[kept], column[kept], gain[kept]

    def _open_end(self, estimates: Estimates, covs: F8, dt: float, model: Model) -> F8:
        """(n,) minus the log-density of two loose ends, less the Gaussian's constant.

        It is the density at ``gate`` deviations from a typical one-step prediction: two measurements' noise and one step
        of the motion's.
        """
        rows = list(model.sensor.observed)
        _, _, noise = model.motion.transition(estimates.state, dt)
        typical = np.ascontiguousarray(noise[:, rows][:, :, rows])
        sigma = model.sensor.noise(estimates.state)[rows]
        typical[:, range(len(rows)), range(len(rows))] += 2 * sigma.T**2
        _, log_det = gaussian_parts(np.zeros((len(rows), len(typical))), typical)
        result: F8 = 0.5 * (self.gate**2 + log_det)
        return result

    def _reach(self, before: F8, covs: F8, open_end: F8, price: F8) -> F8:
        """(2, C) half extent in position beyond which no edge to a column, of covariance ``before``, can be worth taking."""
        if len(covs) == 0:
            return np.zeros((2, len(before)))
        widest = np.stack([covs[:, r, r].max() for r in (0, 1)])[:, None]
        spread = np.stack([before[:, r, r] for r in (0, 1)])
        # gain > 0 needs distance² < 2·(open_end + price) − log|S|, and |S| is at least that of either state's covariance.
        _, log_det = gaussian_parts(np.zeros((covs.shape[1], len(covs))), covs)
        _, log_det_before = gaussian_parts(np.zeros((covs.shape[1], len(before))), before)
        limit = 2 * (open_end.max() + price) - np.maximum(log_det.min(), log_det_before)
        reach: F8 = np.sqrt(np.clip(limit, 0.0, self.consistent**2) * (spread + widest))
        return reach
