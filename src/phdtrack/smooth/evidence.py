"""The evidence that one trajectory goes on in another: what is known at the end of one and at the beginning of the other.

With A, B the measurements of two trajectories, a and b the states at B's beginning, and π what is known of a state before
anything is measured (flat over what measurements show, a Gaussian over the rest, as velocities):

    p(B|A) / p(B) = ∫ p(x|A) p(x|B) / π(x) dx

with both densities Gaussian: A's prediction from its end, and B's own smoothed beginning. It takes B's prior out once, so
that B's velocity counts as its measurements tell it. The measure is that of a birth of density 1 over the observed rows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.smooth.paths import Paths, Seen
from phdtrack.smooth.smooth import Smoothed
from phdtrack.types import F8, I8


@dataclass(frozen=True, slots=True, eq=False)
class Others:
    """States of K trajectories by their own measurements: ``mean`` (K, d), ``inverse`` covariance (K, d, d) and its
    log-determinant; the same of the prior, which is 0 in observed rows."""

    mean: F8
    inverse: F8
    log_inverse: F8
    prior: F8
    prior_inverse: F8
    log_prior: F8
    shown: int


def others(paths: Paths, states: Smoothed, seen: Seen, kept: I8, whose: I8, place: I8) -> Others:
    """The states of the paths ``whose`` (K,) in the rows ``place`` (K,), as far as components are ``kept``."""
    column = paths.measurement[paths.first[whose]]
    inverse = _inverse(states.covariance[place][:, kept[:, None], kept])
    hidden = np.setdiff1d(kept, seen.observed)
    at = np.searchsorted(kept, hidden)
    block = _inverse(seen.covariance[column][:, hidden[:, None], hidden])
    prior, prior_inverse = np.zeros((len(place), len(kept))), np.zeros_like(inverse)
    prior[:, at] = seen.state[hidden[:, None], column].T
    prior_inverse[:, at[:, None], at] = block
    mean = states.mean[place][:, kept]
    shown = len(kept) - len(hidden)
    return Others(mean, inverse, _log_det(inverse), prior, prior_inverse, _log_det(block), shown)


def log_evidence(mean: F8, covariance: F8, begin: Others, which: I8) -> F8:
    """(P,) log p(B|A)/p(B) of states (P, k), (P, k, k) by A for those by B ``which`` (P,) are at the same time."""
    inverse = _inverse(covariance)
    own, prior = begin.inverse[which], begin.prior_inverse[which]
    total = inverse + own - prior
    # From the prediction, so that no large numbers are taken from each other.
    step, rest = (begin.mean[which] - mean)[:, :, None], (begin.prior[which] - mean)[:, :, None]
    pull = own @ step - prior @ rest
    square = step.transpose(0, 2, 1) @ own @ step - rest.transpose(0, 2, 1) @ prior @ rest
    square -= pull.transpose(0, 2, 1) @ np.linalg.solve(total, pull)
    logs = _log_det(inverse) + begin.log_inverse[which] - begin.log_prior[which] - _log_det(total)
    out: F8 = 0.5 * (logs - square[:, 0, 0] - begin.shown * math.log(2 * math.pi))
    return out


def _inverse(a: F8) -> F8:
    return np.linalg.inv(a).astype(np.float64, copy=False)


def _log_det(a: F8) -> F8:
    out: F8 = np.linalg.slogdet(a)[1]
    return out
