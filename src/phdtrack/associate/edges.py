"""Edges of the association graph: who could follow whom, and what it would gain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from phdtrack.associate.triangle import block
from phdtrack.associate.window import Edges, Rows
from phdtrack.errors import InputError
from phdtrack.kernels.association import LANES, find_edges, log_determinants, near_pairs
from phdtrack.protocols import Sensor
from phdtrack.types import F8, I8, Estimates


@dataclass(frozen=True, slots=True)
class Ends:
    """What a link competes with: ``gate``, log of ``miss``, and ``consistent`` of `GraphMatching`."""

    gate: float
    log_miss: float
    consistent: float


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """The R states of the window predicted for now, and the n new ones behind them, as `predicted` gives them."""

    mean: F8
    cov: F8
    noise: F8


def edges_between(rows: Rows, estimates: Estimates, states: Candidates, ends: Ends, dt: float, sensor: Sensor) -> Edges:
    """Edges of positive gain from the new states back to those of the window [M07 §3].

    gain = log N(step; 0, S) − log-density of two loose ends + (since − dt)·log miss, S = predicted + own covariance, on the
    rows that a measurement shows. The loose ends' is the density at ``gate`` deviations from a typical one-step prediction:
    two measurements' noise and one step of the motion's.
    """
    n, count = len(estimates), len(rows.since)
    start = np.zeros(n + 1, np.int64)
    if n == 0 or count == 0:
        return Edges(start, np.empty(0, np.int64), np.empty(0))
    mean, cov = states.mean, states.cov
    if not np.isfinite(estimates.state[:2]).all():
        raise InputError("expected positions that are finite", where="the extracted states")
    shown = block(len(mean), sensor.observed)
    seen, plane = shown.rows, shown.triangle
    work = np.empty((len(seen) + 3, len(seen), LANES))
    log_det, open_end = np.empty(count + n), np.empty(n)
    log_determinants(cov, plane, work, log_det)
    log_determinants(_typical(estimates, states.noise, sensor), shown.square, work, open_end)
    open_end = 0.5 * (ends.gate**2 + open_end)
    price = (rows.since - dt) * ends.log_miss
    given = mean, cov, open_end, price, seen, plane, ends.consistent
    state, column = _pairs(log_det, *given)
    found = len(state)
    target, gain, value = np.empty(found, np.int64), np.empty(found), np.empty(found)
    find_edges(*given, state, column, rows.first, work, start, target, gain, value)
    kept = int(start[n])
    return Edges(start, target[:kept], gain[:kept])


def _typical(estimates: Estimates, noise: F8, sensor: Sensor) -> F8:
    """(d·d, n) planes: two measurements' noise and one step of the motion's ``noise`` (d, d, n or more)."""
    n, d = len(estimates), len(estimates.state)
    typical = noise.reshape(d * d, -1)[:, noise.shape[2] - n :].copy()
    typical[:: d + 1] += 2.0 * np.square(sensor.noise(estimates.state))
    return typical


def _pairs(log_det: F8, mean: F8, cov: F8, open_end: F8, price: F8, *others: Any) -> tuple[I8, I8]:
    """The pairs of `near_pairs`: new states and columns."""
    n = len(open_end)
    side = int(n**0.5) + 1
    # Most often enough; memory that is not written to costs nothing.
    room = 8 * len(price) + 64
    while True:
        start, order = np.zeros(side * side + 1, np.int64), np.empty(n, np.int64)
        state, column = np.empty(room, np.int64), np.empty(room, np.int64)
        found = near_pairs(mean, cov, log_det, open_end, price, *others, start, order, state, column)
        if found <= room:
            return state[:found], column[:found]
        room = found
