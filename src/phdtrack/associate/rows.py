"""The rows of corrected tracks: from states, in gaps between them, and before the first."""

from __future__ import annotations

import itertools

import numpy as np

from phdtrack.associate.history import Moment
from phdtrack.kernels.gaussian import gaussian_parts
from phdtrack.models import warp as warp_of
from phdtrack.models.rts import bridge, update
from phdtrack.protocols import Model
from phdtrack.types import F8, Tracks

# Squared Mahalanobis radius of the 99 % region in four dimensions.
REGION = 13.28

# A track: the places (moment, state) of its states.
Path = list[tuple[int, int]]


def rows_of(moments: list[Moment], path: Path, identity: int) -> Tracks:
    """The rows of a track that rest on extracted states."""
    parts = [(moments[k], i) for k, i in path]
    return Tracks(
        np.array([m.number for m, _ in parts], np.int64),
        np.full(len(path), identity),
        np.array([m.estimates.xyxy[i] for m, i in parts]),
        np.minimum(1.0, np.array([m.estimates.weight[i] for m, i in parts])),
        np.array([m.estimates.detection[i] for m, i in parts], np.int64),
        np.ones(len(path), np.bool_),
    )


def gaps(moments: list[Moment], path: Path, identity: int, model: Model) -> list[Tracks]:
    """Predicted rows between the states of a track that are more than one frame apart."""
    parts = []
    for (k, i), (m, j) in itertools.pairwise(path):
        if m == k + 1:
            continue
        a, b = moments[k].estimates, moments[m].estimates
        steps = np.diff(np.array([x.time for x in moments[k : m + 1]]))
        ends = a.state[:, i], a.covariance[i], b.state[:, j], b.covariance[j]
        states = bridge(model.motion, ends, steps, [x.warp for x in moments[k + 1 : m + 1]])
        confidence, n = min(1.0, float(a.weight[i]), float(b.weight[j])), m - k - 1
        parts.append(
            Tracks(
                np.array([x.number for x in moments[k + 1 : m]], np.int64),
                np.full(n, identity),
                model.sensor.boxes(states),
                np.full(n, confidence),
                np.full(n, -1),
                np.ones(n, np.bool_),
            )
        )
    return parts


def back_dated(
    moments: list[Moment], start: tuple[int, int], most: int, taken: set[tuple[int, int]], model: Model
) -> Tracks:
    """The rows of detections that lead to a track's first state, the latest first, of identity 0.

    A filter that removes clutter confirms a target only after some coherent detections. Here a Kalman filter runs backward
    in time from the first state: predict by the inverse transition, take the nearest unused detection in the 99 % region,
    update with it; stop where there is none.

    Parameters
    ----------
    moments : all frames.
    start : place (moment, state) of the track's first state.
    most : rows at most.
    taken : detections (moment, detection) that other tracks were led back to.
    model : of the last frame.
    """
    place, i = start
    first = moments[place].estimates
    state, cov, rows = first.state[:, i], first.covariance[i], np.array(model.sensor.observed)
    number, states, detections = [], [], []
    for k in range(place - 1, max(-1, place - 1 - most), -1):
        earlier = moments[k]
        free = [s for s in earlier.spare.tolist() if (k, s) not in taken]
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
        number.append(earlier.number)
        states.append(state)
        detections.append(free[best])
    n = len(number)
    boxes = model.sensor.boxes(np.stack(states, axis=1)) if n else np.zeros((0, 4))
    weight = np.full(n, min(1.0, float(first.weight[i])))
    return Tracks(
        np.array(number, np.int64),
        np.zeros(n, np.int64),
        boxes,
        weight,
        np.array(detections, np.int64),
        np.ones(n, np.bool_),
    )


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
