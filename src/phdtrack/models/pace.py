"""How fast the time of a stream runs: streams of few pictures show slow things, and how slow their first links tell.

Speeds, accelerations and lifetimes of a model are per second, as in videos. Cells of which a picture is taken every five
minutes would go through the whole image in between. So where the usual interval T of a stream is longer than
``longest_interval``, the filter's time runs slower: by a factor c, the same for everything that takes time. It is the most
likely one, given which detections could follow which,

    log p(Z | c) = Σ_frames Σ_z log(κ(z) + p_D Σ_z' N(z; h(f(x_z', cT)), S_z'(cT)))

with z' the detections of the frame before and x_z' the state that z' alone shows. Targets of one stream differ, so that time
runs `MARGIN` times as fast as most of them say; never faster than the clock, and never slower than at one picture per
``longest_interval``. The first two pictures decide already.

The usual interval is the geometric mean: one pause in a video changes nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from phdtrack.errors import Checked, Positive
from phdtrack.protocols import Model
from phdtrack.types import F8

# The factors c that are compared, down to a picture in ten hours.
FACTORS: F8 = np.power(3.0, -0.5 * np.arange(24), dtype=np.float64)
MARGIN = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class PaceState:
    """What links have shown.

    Attributes
    ----------
    factor : by which the filter's time is slower than the clock, at most 1.
    evidence : array (24,), log p(Z | c) of the `FACTORS`.
    before : array (m, n), the measurements of the frame before; none where the stream is no slow one.
    intervals, log_seconds : how many intervals there were, and the sum of the logarithms of their seconds.
    """

    factor: float = 1.0
    evidence: F8 = field(default_factory=lambda: np.zeros(len(FACTORS)))
    before: F8 = field(default_factory=lambda: np.zeros((0, 0)))
    intervals: int = 0
    log_seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class Pace(Checked):
    """The rule of a stream's time.

    Parameters
    ----------
    longest_interval : seconds between pictures up to which speeds are as in videos.
    """

    longest_interval: Positive = 0.2

    def start(self, z: F8) -> PaceState:
        """After the first frame, of the measurements ``z`` (m, n)."""
        return PaceState(before=z)

    def advance(self, state: PaceState, z: F8, seconds: float, model: Model) -> PaceState:
        """The state after a frame.

        Parameters
        ----------
        state : after the frame before.
        z : array (m, n), measurements of the frame.
        seconds : since the frame before.
        model : of the present frame.

        Returns
        -------
        The state, whose factor holds for the interval before the frame already.
        """
        intervals, logs = state.intervals + 1, state.log_seconds + math.log(seconds)
        least = self.longest_interval / math.exp(logs / intervals)
        # 1e-6: an interval of 0.2 s is one, whatever rounding makes of it.
        if least > 1 - 1e-6:
            return PaceState(1.0, state.evidence, z[:, :0], intervals, logs)
        evidence = state.evidence
        if z.shape[1] and state.before.shape[1]:
            evidence = evidence + _log_evidence(state.before, z, seconds * model.rate, model)
        best = MARGIN * float(FACTORS[evidence.argmax()])
        return PaceState(min(max(best, least), 1.0), evidence, z, intervals, logs)


def _log_evidence(before: F8, z: F8, dt: float, model: Model) -> F8:
    """(24,) log p(z | c) of the `FACTORS`, for measurements ``dt`` time units after those ``before``."""
    state, covariance = model.warp_gaussians(*model.sensor.states(before))
    rows, clutter, out = list(model.sensor.observed), model.clutter.intensity(z), np.empty(len(FACTORS))
    noise = model.sensor.noise(state)[rows] ** 2
    p_detect = model.sensor.p_detect(state)
    for k, factor in enumerate(FACTORS):
        mean, slope, more = model.motion.transition(state, dt * float(factor))
        variance = np.diagonal(slope @ covariance @ slope.transpose(0, 2, 1) + more, axis1=1, axis2=2).T[rows] + noise
        away = z[: len(rows), None] - mean[rows][:, :, None]
        log = -0.5 * ((away**2 / variance[:, :, None]).sum(axis=0) + np.log(2 * math.pi * variance).sum(axis=0)[:, None])
        out[k] = np.log(np.maximum(clutter + p_detect @ np.exp(log), np.finfo(float).tiny)).sum()
    return out
