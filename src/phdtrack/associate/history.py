"""What the associators remember of each frame, and the rows of corrected tracks that come of it."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from phdtrack.kernels.gaussian import gaussian_parts
from phdtrack.kernels.linking import Links, Window
from phdtrack.models import warp as warp_of
from phdtrack.models.rts import bridge, update
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, STILL, Estimates, MeasurementHistory, Tracks

NO_LINKS = Links(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
# Moments in a chunk: adding a moment copies references to less than two chunks and to the chunks before.
CHUNK = 32
# Squared Mahalanobis radius of the 99 % region in four dimensions.
REGION = 13.28

# A track: the places (moment, state) of its states.
Path = list[tuple[int, int]]


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One frame.

    Attributes
    ----------
    number, time : frame number and model time.
    first : number of the first vertex; the states are the vertices ``first``, ``first`` + 1, …
    estimates : the states.
    final : the links, between vertices, that can no longer change since this frame.
    z : (m, N) measurements.
    warp : the camera's motion since the frame before (`Model.warp`); all else lies in the frame's own pixels.
    """

    number: int
    time: float
    first: int
    estimates: Estimates
    final: Links
    z: F8
    warp: F8 = field(default_factory=lambda: STILL)


@dataclass(frozen=True, slots=True)
class History:
    """All moments so far. Places count from the first frame; the first ``forgotten`` of them are no longer held."""

    full: tuple[tuple[Moment, ...], ...] = ()
    recent: tuple[Moment, ...] = ()
    forgotten: int = 0

    def append(self, moment: Moment) -> History:
        """A history with one more moment."""
        recent = (*self.recent, moment)
        if len(recent) < 2 * CHUNK:
            return History(self.full, recent, self.forgotten)
        return History((*self.full, recent[:CHUNK]), recent[CHUNK:], self.forgotten)

    def since(self, time: float) -> History:
        """Without the chunks that lie before model time ``time``."""
        gone = 0
        while gone < len(self.full) and self.full[gone][-1].time < time:
            gone += 1
        return History(self.full[gone:], self.recent, self.forgotten + CHUNK * gone) if gone else self

    def __len__(self) -> int:
        return self.forgotten + CHUNK * len(self.full) + len(self.recent)

    def __getitem__(self, index: int) -> Moment:
        chunk, place = divmod(index - self.forgotten, CHUNK)
        if chunk < len(self.full):
            return self.full[chunk][place]
        return self.recent[index - self.forgotten - CHUNK * len(self.full)]

    def __iter__(self) -> Iterator[Moment]:
        """Those still held."""
        return itertools.chain(*self.full, self.recent)


def open_links(window: Window, most: int | None = None) -> Links:
    """The links of the window's rows, or of the first ``most`` of them."""
    linked = (window.previous[:most] >= 0).nonzero()[0]
    return Links(window.row + linked, window.previous[linked], window.gain[linked]) if len(linked) else NO_LINKS


def measurements(moments: Iterable[Moment]) -> MeasurementHistory:
    """The measurements of all moments."""
    held = list(moments)
    shown = [m.z for m in held if m.z.shape[1]] or [m.z for m in held[:1]] or [np.zeros((0, 0))]
    moved = any(len(m.warp) for m in held)
    count = [m.z.shape[1] for m in held]
    return MeasurementHistory(
        np.array([m.number for m in held], np.int64),
        np.array([m.time for m in held]),
        np.concatenate(([0], np.cumsum(count, dtype=np.int64))),
        np.hstack(shown),
        np.array([m.warp if len(m.warp) else np.eye(3) for m in held if moved]).reshape(-1, 3, 3),
        np.zeros((sum(count), 0), np.float32),
    )


def rows_of(moments: list[Moment], path: Path, identity: int) -> Tracks:
    """The rows of a track that rest on extracted states.

    Parameters
    ----------
    moments : all frames.
    path : the places of its states.
    identity : its number.

    Returns
    -------
    One row for each state.
    """
    parts = [(moments[k], i) for k, i in path]
    return Tracks(
        np.array([m.number for m, _ in parts], np.int64),
        np.full(len(path), identity),
        np.array([m.estimates.xyxy[i] for m, i in parts]),
        np.minimum(1.0, np.array([m.estimates.weight[i] for m, i in parts])),
        np.array([m.estimates.detection[i] for m, i in parts], np.int64),
        np.ones(len(path), np.bool_),
    )


def predicted_rows(number: int | I8, identity: int | I8, state: F8, confidence: float | F8, model: Model) -> Tracks:
    """Rows of states that rest on no detection.

    Parameters
    ----------
    number, identity : frame number and identity, of all or each.
    state : (d, n) predicted states.
    confidence : of all or each; more than 1 counts as 1.
    model : its sensor gives the boxes.

    Returns
    -------
    n confirmed rows.
    """
    n = state.shape[1]
    boxes, sure = model.sensor.boxes(state), np.minimum(1.0, np.full(n, confidence))
    return Tracks(np.full(n, number), np.full(n, identity), boxes, sure, np.full(n, -1), np.ones(n, np.bool_))


def gaps(moments: list[Moment], path: Path, identity: int, model: Model) -> list[Tracks]:
    """Predicted rows between the states of a track that are more than one frame apart.

    Parameters
    ----------
    moments : all frames.
    path : the places of its states.
    identity : its number.
    model : of the last frame.

    Returns
    -------
    The rows of each gap.
    """
    parts = []
    for (k, i), (m, j) in itertools.pairwise(path):
        if m == k + 1:
            continue
        a, b = moments[k].estimates, moments[m].estimates
        steps = np.diff(np.array([x.time for x in moments[k : m + 1]]))
        ends = a.state[:, i], a.covariance[i], b.state[:, j], b.covariance[j]
        states = bridge(model.motion, ends, steps, [x.warp for x in moments[k + 1 : m + 1]])
        numbers = np.array([x.number for x in moments[k + 1 : m]], np.int64)
        parts.append(predicted_rows(numbers, identity, states, min(float(a.weight[i]), float(b.weight[j])), model))
    return parts


def back_dated(
    moments: list[Moment], start: tuple[int, int], most: int, taken: set[tuple[int, int]], model: Model
) -> tuple[Path, F8]:
    """The detections that lead to a track's first state, and the boxes of the track there.

    A filter that removes clutter confirms a target only after some coherent detections. Here a Kalman filter runs backward
    in time from the first state: predict by the inverse transition, take the nearest unused detection in the 99 % region,
    update with it; stop where there is none.

    Parameters
    ----------
    moments : all frames.
    start : place (moment, state) of the track's first state.
    most : detections at most.
    taken : detections (moment, detection) that other tracks were led back to.
    model : of the last frame.

    Returns
    -------
    The places (moment, detection), the latest first, and the boxes (n, 4).
    """
    place, i = start
    state, cov = moments[place].estimates.state[:, i], moments[place].estimates.covariance[i]
    rows = np.array(model.sensor.observed)
    path: Path = []
    states = [np.zeros((len(state), 0))]
    for k in range(place - 1, max(-1, place - 1 - most), -1):
        earlier = moments[k]
        used = set(earlier.estimates.detection.tolist())
        free = [s for s in range(earlier.z.shape[1]) if s not in used and (k, s) not in taken]
        if not free:
            break
        state, cov = _one_frame_back(state, cov, moments[k + 1], moments[k + 1].time - earlier.time, model)
        seen, noise = model.sensor.states(earlier.z[:, free])
        noise = noise[:, rows][:, :, rows]
        innovation = cov[np.ix_(rows, rows)] + noise
        distance2, _ = gaussian_parts(seen[rows] - state[rows, None], np.ascontiguousarray(innovation))
        best = int(np.argmin(distance2))
        if distance2[best] > REGION:
            break
        means, covs = update(state[None], cov[None], seen[rows, best][None], noise[best][None], rows)
        state, cov = means[0], covs[0]
        path.append((k, free[best]))
        states.append(state[:, None])
    return path, model.sensor.boxes(np.hstack(states))


def _one_frame_back(state: F8, cov: F8, later: Moment, dt: float, model: Model) -> tuple[F8, F8]:
    """State (d,) and covariance (d, d) in the frame before ``later``, by the inverse transition."""
    _, jacobian, noise = model.motion.transition(state[:, None], dt)
    # A component that the transition forgets (a remembered size) cannot be inferred from what came after: it stays.
    back = np.linalg.pinv(jacobian[0])
    forgotten = ~jacobian[0].any(axis=0)
    state = np.where(forgotten, state, back @ state)
    cov = back @ (cov + noise[0]) @ back.T
    if len(later.warp):
        homeward = warp_of.back(later.warp)
        slope = model.motion.warp_jacobian(state[:, None], homeward)[0]
        state, cov = model.motion.warp_states(state[:, None], homeward)[:, 0], slope @ cov @ slope.T
    return state, cov
