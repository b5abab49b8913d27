"""Tracks that end as no target does.

A filter says of a track, at its best, with which probability p it was a target. When all is known,
its end speaks, too: a false alarm that comes again and again stops anywhere, after τ seconds on
average; a target that is in view seldom does. It vanishes there at a rate h, or leaves the picture,
or the record ends before it would have been detected again. After m detections in frames that are Δ
seconds apart, the odds that a track is a target are

    p/(1 − p) · 1/O · L e^((m − 1)Δ/τ) / (1 − e^(−Δ/τ))

    L = Σ_k a_k (1 − s_k) + a_{n+1},   a_{k+1} = a_k s_k (1 − d)

with a_1 = 1, over the n frames after its last detection in which it is still in the picture. s_k =
e^(−hΔ) is the probability that it does not vanish in an interval Δ, and d that it is detected: the
share of the frames of its track in which it was. O is by how much the best moment of a track
flatters it. A track whose odds are below one is no target.

How often targets vanish depends on the scene and on the detector, and so does O. Both are those of
this sequence's own tracks: h of each track with the probability that it is a target, and O so that
as many are targets as the filter says, p/O by odds. Its logarithm has a Gaussian prior. The
probabilities depend on both; all are found in turn, by expectation and maximisation.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from phdtrack.models.rts import predict
from phdtrack.smooth.paths import Paths
from phdtrack.smooth.sequence import Sequence, Smoothed
from phdtrack.types import F8, Tracks

# Seconds after which, on average, a false alarm that comes again and again stops.
REPEATED = 0.5
# By how many times the odds of a track's best moment are too high, before the sequence shows it
# (docs/decisions.md), and the deviation of the logarithm.
FLATTERY = 15.0
FLATTERY_DEVIATION = 1.5
# Frames after a track's end that are looked at.
_FRAMES = 50
# Seconds of tracks for which the model's rate of vanishing counts.
_PRIOR = 10.0
# How often the rate, the flattery and the probabilities are found in turn.
_TURNS = 20
# Bisections by which the flattery is found, between these factors of its prior.
_BISECTIONS = 40
_FACTORS = 1e10


class Endings(NamedTuple):
    """The ends of K paths.

    Attributes
    ----------
    intervals : (`_FRAMES`, K) seconds to each of the frames that follow in which a target would
        still be in the picture; 0 after them.
    missed : (K,) the probability that it is not detected in one of them.
    detected : (K,) the detections of each path.
    lasted : (K,) seconds from the first to the last.
    usual : seconds between frames, as a rule.
    """

    intervals: F8
    missed: F8
    detected: F8
    lasted: F8
    usual: float


def without_vanished(
    tracks: Tracks, paths: Paths, states: Smoothed, sequence: Sequence
) -> tuple[Tracks, Paths, Smoothed]:
    """The tracks that are targets more probably than not, now that it is known how they ended.

    Parameters
    ----------
    tracks : rows, whose confidence is the probability that there is a target.
    paths, states : of these, one for each target, and the states of their rows.
    sequence : the measurements.
    """
    endings = _endings(paths, states, sequence)
    gone = target_probability(_best(tracks, paths), endings, _vanishing(sequence))[0] < 0.5
    if not gone.any():
        return tracks, paths, states
    lost = gone[paths.path]
    names = np.unique(tracks.identity[paths.row[lost & (paths.row >= 0)]])
    kept = ~np.isin(tracks.identity, names)
    place = np.cumsum(kept) - 1
    left = paths.select(~gone)
    row = np.where(left.row >= 0, place[left.row], -1)
    states = Smoothed(states.mean[~lost], states.covariance[~lost])
    return tracks.select(kept), replace(left, row=row), states


def target_probability(best: F8, endings: Endings, expected: float) -> tuple[F8, float]:
    """(K,) the probability that each path is a target, and the rate per second at which targets
    vanish in the picture.

    Parameters
    ----------
    best : (K,) the greatest probability that it was one, by the filter.
    endings : of the paths.
    expected : the model's rate of vanishing, per second.
    """
    claimed = np.log(np.maximum(best, 1e-12)) - np.log(np.maximum(1 - best, 1e-12))
    step = endings.usual / REPEATED
    stops = math.log(-math.expm1(-step)) - (endings.detected - 1) * step
    rate = expected
    flattery = math.log(FLATTERY)
    target = best
    for _ in range(_TURNS):
        likelihood, inside = ending_likelihood(endings, rate)
        target = 1 / (1 + np.exp(flattery + stops - claimed) / likelihood)
        often = (target * inside).sum() + expected * _PRIOR
        rate = float(often / ((target * endings.lasted).sum() + _PRIOR))
        # The filter counts that a target did not vanish, too.
        flattery = _flattery(claimed + rate * endings.lasted, float(target.sum()))
    return target, rate


def _flattery(claimed: F8, targets: float) -> float:
    """log O for which there are so many ``targets``, more or less, as its prior counts, too.

    Parameters
    ----------
    claimed : (K,) log odds of each path, by the filter's evidence alone.
    targets : the expected number of targets among them.
    """
    prior = math.log(FLATTERY)
    low = prior - math.log(_FACTORS)
    high = prior + math.log(_FACTORS)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        expected = (1 / (1 + np.exp(middle - claimed))).sum()
        if expected - targets > (middle - prior) / FLATTERY_DEVIATION**2:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def ending_likelihood(endings: Endings, rate: float) -> tuple[F8, F8]:
    """(K,) the probability that a target ends like each path, and (K,) that such a one vanished in
    the picture; ``rate`` is per second.
    """
    alive = np.ones(len(endings.missed))
    vanishes = np.zeros_like(alive)
    for interval in endings.intervals:
        stays = np.exp(-rate * interval)
        vanishes += alive * (1 - stays)
        alive *= np.where(interval > 0, stays * endings.missed, 1.0)
    total = vanishes + alive
    return total, vanishes / np.maximum(total, 1e-300)


def _endings(paths: Paths, states: Smoothed, sequence: Sequence) -> Endings:
    """How paths end."""
    time = sequence.measurements.time
    end = paths.frame[paths.last]
    intervals = np.zeros((_FRAMES, len(paths)))
    inside = np.ones(len(paths), np.bool_)
    mean = states.mean[paths.last]
    covariance = states.covariance[paths.last]
    for place in range(int(end.min()) + 1, len(time)):
        now = np.flatnonzero(inside & (end < place) & (end >= place - _FRAMES))
        if not len(now):
            continue
        interval, warp = sequence.step(place)
        ahead = predict(sequence.motion, mean[now], covariance[now], interval, warp)
        mean[now] = ahead.mean
        covariance[now] = ahead.covariance
        seconds = interval / sequence.rate
        survival = sequence.motion.p_survive(np.ascontiguousarray(ahead.mean.T), seconds)
        inside[now] = survival > 0
        stay = now[survival > 0]
        intervals[place - 1 - end[stay], stay] = seconds
    seen = np.bincount(paths.path[paths.measurement >= 0], minlength=len(paths))
    # A first detection is no evidence of how often it is detected.
    missed = 1 - seen / (np.diff(paths.start) + 1)
    lasted = (time[end] - time[paths.frame[paths.first]]) / sequence.rate
    usual = float(np.median(np.diff(time))) / sequence.rate
    return Endings(intervals, missed, seen.astype(np.float64), lasted, usual)


def _vanishing(sequence: Sequence) -> float:
    """The model's rate of vanishing in the picture, per second."""
    motion = sequence.motion
    stays = float(motion.p_survive(np.ascontiguousarray(sequence.state), 1.0).max(initial=0.0))
    return -math.log(min(max(stays, 1e-9), 1 - 1e-9))


def _best(tracks: Tracks, paths: Paths) -> F8:
    """(K,) the greatest confidence of the rows of each path that rest on a detection."""
    rows = np.flatnonzero((paths.row >= 0) & (paths.measurement >= 0))
    best = np.zeros(len(paths))
    np.maximum.at(best, paths.path[rows], tracks.confidence[paths.row[rows]])
    return best
