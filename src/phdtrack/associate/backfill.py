"""Where a track really began: the detections before its first state.

A filter that removes clutter believes an object only after some coherent detections. Once it does, these detections are
explained: the first state is led back in time and takes up, frame by frame, the spare detection that it predicts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.associate.history import Moment
from phdtrack.kernels.gaussian import gaussian_parts
from phdtrack.models import warp as warp_of
from phdtrack.protocols import Model
from phdtrack.types import F8

# Squared Mahalanobis radius of the 99 % region in four dimensions.
REGION = 13.28


@dataclass(frozen=True, slots=True, eq=False)
class Earlier:
    """One row before a track's first state: place of its moment, state (d,), and which detection it took up."""

    place: int
    state: F8
    detection: int


def lead_back(
    moments: list[Moment], place: int, state: F8, cov: F8, most: int, taken: set[tuple[int, int]], model: Model
) -> list[Earlier]:
    """At most ``most`` rows before the state (d,) with covariance (d, d) at moment ``place``, the latest first.

    A Kalman filter backwards in time: predict by the inverse transition, take the nearest spare detection in the 99 %
    region, update with it; stop where there is none. Detections in ``taken`` (moment, detection) are not spare.
    """
    found: list[Earlier] = []
    rows = list(model.sensor.observed)
    for k in range(place - 1, max(-1, place - 1 - most), -1):
        earlier = moments[k]
        free = [s for s in earlier.spare.tolist() if (k, s) not in taken]
        if not free:
            break
        dt = moments[k + 1].time - earlier.time
        _, jacobian, noise = model.motion.transition(state[:, None], dt)
        # A component that the transition forgets (a remembered size) cannot be told from what came after: it stays.
        back = np.linalg.pinv(jacobian[0])
        forgotten = ~jacobian[0].any(axis=0)
        state = np.where(forgotten, state, back @ state)
        cov = back @ (cov + noise[0]) @ back.T
        if len(moments[k + 1].warp):
            homeward = warp_of.back(moments[k + 1].warp)
            slope = model.motion.carried_slope(state[:, None], homeward)[0]
            state, cov = model.motion.carried(state[:, None], homeward)[:, 0], slope @ cov @ slope.T
        seen, seen_cov = model.sensor.states(earlier.z[:, free])
        spread = cov[np.ix_(rows, rows)] + seen_cov[:, rows][:, :, rows]
        step = seen[rows] - state[rows, None]
        distance2, _ = gaussian_parts(step, np.ascontiguousarray(spread))
        best = int(np.argmin(distance2))
        if distance2[best] > REGION:
            break
        gain = np.linalg.solve(spread[best], cov[rows]).T
        state = state + gain @ step[:, best]
        cov = cov - gain @ cov[rows]
        found.append(Earlier(k, state, free[best]))
    return found
