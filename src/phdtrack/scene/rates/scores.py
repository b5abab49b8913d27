"""What a detector's score is worth as evidence: p(s|object)/p(s|false alarm), learned from what became of the detections.

Scores are compared by their order alone: they are cut into parts of equally many detections, and of each part the share of
false alarms is estimated, with some detections of the average added to it; the shares then fall with the score (isotonic
regression by pooling adjacent violators). So a score may have any range and any distribution, one that says nothing is worth
1, and one that was never learned from too.

A filter multiplies the evidence of frame after frame as if each were new, but who is scored high once is scored high again.
With the correlation ρ of the scores (of their ranks) from one detection of a track to its next, n frames say as much as
n (1 − ρ)/(1 + ρ) independent ones (an autoregressive series), and the logarithm of the odds is multiplied by that share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from phdtrack.types import F8, I8

# Parts that the scores are cut into, and detections of the average that each has beside its own.
PARTS, ADDED = 12, 8.0
# Newest detections that are learned from.
NEWEST = 1500
# Pairs of detections from which their correlation is known: before it counts as if there were so many of correlation 1.
PAIRED = 30.0
# The evidence of one score at most, in nats either way: a factor of 30.
MOST = math.log(30.0)


def _none() -> F8:
    return np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Detections whose fate is known: ``score`` (n,), and the probability ``false`` (n,) that each was a false alarm."""

    score: F8 = field(default_factory=_none)
    false: F8 = field(default_factory=_none)

    def joined(self, score: F8, false: F8) -> Judged:
        """With more of them, the newest alone; scores that are no numbers are left out."""
        known = ~np.isnan(score)
        return Judged(
            np.concatenate([self.score, score[known]])[-NEWEST:], np.concatenate([self.false, false[known]])[-NEWEST:]
        )


@dataclass(frozen=True, slots=True, eq=False)
class Scale:
    """The logarithm ``worth`` (k,) of p(s|object)/p(s|false alarm) at the scores ``at`` (k,), both ascending; between them
    it is linear, beyond them constant. Nothing: every score is worth 1."""

    at: F8 = field(default_factory=_none)
    worth: F8 = field(default_factory=_none)

    def odds(self, score: F8) -> F8:
        """(N,) p(s|object)/p(s|false alarm) of the scores (N,); 1 for one that is no number."""
        if len(self.at) < 2:
            return np.ones(len(score))
        # An infinite score is beyond all others, which is all that matters.
        near = np.clip(score, self.at[0], self.at[-1])
        return np.where(np.isnan(score), 1.0, np.exp(np.interp(near, self.at, self.worth)))


@dataclass(frozen=True, slots=True, eq=False)
class Successive:
    """Scores ``first`` and ``second`` (n,) of a track's detections, one after the other; and ``identity`` and ``last`` (m,):
    of the tracks seen of late, ascending, the score of the last detection."""

    first: F8 = field(default_factory=_none)
    second: F8 = field(default_factory=_none)
    identity: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    last: F8 = field(default_factory=_none)

    def joined(self, identity: I8, frame: I8, score: F8) -> Successive:
        """With more detections of tracks: their identities, frames and scores (n,); the newest pairs alone."""
        order = np.lexsort((frame, identity))
        who = np.concatenate([self.identity, identity[order]])
        value = np.concatenate([self.last, score[order]])
        # The last ones known stand before those that follow.
        order = np.argsort(who, kind="stable")
        who, value = who[order], value[order]
        same = who[1:] == who[:-1]
        known = same & ~np.isnan(value[1:]) & ~np.isnan(value[:-1])
        ends = np.append(~same, True) if len(who) else np.zeros(0, np.bool_)
        kept = ends & np.isin(who, identity) if len(identity) else ends
        return Successive(
            np.concatenate([self.first, value[:-1][known]])[-NEWEST:],
            np.concatenate([self.second, value[1:][known]])[-NEWEST:],
            who[kept],
            value[kept],
        )

    @property
    def share(self) -> float:
        """(1 − ρ)/(1 + ρ): as what share of independent frames the scores of a track's frames count."""
        n = len(self.first)
        both = np.concatenate([self.first, self.second])
        _, place = np.unique(both, return_inverse=True)
        if n == 0 or place.max() == 0:
            return 0.0
        # The mean rank of equal ones.
        many = np.bincount(place)
        rank = (np.cumsum(many) - 0.5 * many)[place] / len(both) - 0.5
        alike = float(rank[:n] @ rank[n:] / (0.5 * rank @ rank))
        correlation = max(0.0, (n * alike + PAIRED) / (n + PAIRED))
        return (1 - correlation) / (1 + correlation)


def scale(judged: Judged, new: float = 1.0) -> Scale:
    """What scores are worth by these detections, of which each frame counts as a share ``new`` of an independent one."""
    order = np.argsort(judged.score, kind="stable")
    score, false = judged.score[order], judged.false[order]
    if len(score) == 0 or score[0] == score[-1]:
        return Scale()
    ends = _ends(score)
    begins = np.concatenate([[0], ends[:-1]])
    many = (ends - begins).astype(np.float64)
    sums = np.add.reduceat(false, begins)
    # Neither kind is ever quite absent.
    mean = (float(false.sum()) + 0.5) / (len(false) + 1)
    share = _falling((sums + ADDED * mean) / (many + ADDED), many + ADDED)
    worth = np.log((1 - share) / share) - math.log((1 - mean) / mean)
    at = np.clip(score, *_finite(score))[(begins + ends - 1) // 2]
    return Scale(at, new * np.clip(worth, -MOST, MOST))


def _finite(score: F8) -> tuple[float, float]:
    """The smallest and the largest that is finite; 0 where none is."""
    finite = score[np.isfinite(score)]
    return (float(finite[0]), float(finite[-1])) if len(finite) else (0.0, 0.0)


def _ends(score: F8) -> F8:
    """Where the parts of ascending scores end; equal ones are in one part."""
    n = len(score)
    wanted = np.unique(np.ceil(np.arange(1, PARTS + 1) * n / PARTS).astype(np.int64))
    out: F8 = np.unique(np.searchsorted(score, score[wanted - 1], side="right"))
    return out


def _falling(value: F8, weight: F8) -> F8:
    """The falling sequence nearest to ``value`` (k,) in weighted squares (pooled adjacent violators)."""
    means, weights, counts = list[float](), list[float](), list[int]()
    for v, w in zip(value.tolist(), weight.tolist(), strict=True):
        means.append(v)
        weights.append(w)
        counts.append(1)
        while len(means) > 1 and means[-2] < means[-1]:
            total = weights[-2] + weights[-1]
            means[-2] = (means[-2] * weights[-2] + means[-1] * weights[-1]) / total
            weights[-2], counts[-2] = total, counts[-2] + counts[-1]
            del means[-1], weights[-1], counts[-1]
    return np.repeat(means, counts)
