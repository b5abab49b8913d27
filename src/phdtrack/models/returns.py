"""The odds that a new target is one that was lost before [APP (5)].

A target that ends comes back with the probability p_R, after a time with the mean τ, near where it
was lost, by a Gaussian that widens with the time Δ, or anywhere. Its odds against a new target are

    p_R/τ exp(−Δ/τ) · p(place | Δ) / (births per second and unit of area) · exp ℓ

with ℓ the log-likelihood ratio of what both look like, if another target may look the same
(`among`). What is learned: how many come back (`returning_share`), after how long (`mean_away`),
and how many look alike (`twin_chance`), by those that are there together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from phdtrack.types import F8

# The probability that a target that ends comes back, before any have, and the mean seconds until
# then.
RETURN = 0.5
RETURN_TIME = 30.0
# Ended targets that this probability counts for.
PRIOR_ENDED = 10.0
# The probability that a target looks like another one of the stream, before any were compared, and
# the targets that this counts for.
TWINS = 0.1
PRIOR_TWINS = 10.0
# Those that came back for which the mean time counts.
PRIOR_BACK = 5.0
# The part of those that come back that do so near where they were lost, and how fast what is known
# of their place fades, in heights of the box a second.
NEARBY = 0.5
DRIFT = 1.0

# The log odds that two that have met have exchanged identities. Errors of looks in a meeting last,
# so that this is low.
EXCHANGED = -4.5


class Rates(NamedTuple):
    """How often targets are new and come back.

    ``births``: new targets a second. ``back``: the probability that one that ends comes back.
    ``away``: mean seconds until then.
    """

    births: float
    back: float
    away: float = RETURN_TIME


def returning_share(back: float, ended: int) -> float:
    """The probability that a target that ends comes back, if ``back`` of those that ended did
    [APP (5)].
    """
    return (back + PRIOR_ENDED * RETURN) / (ended + PRIOR_ENDED)


def mean_away(seconds: float, back: float) -> float:
    """The mean seconds until targets come back, if ``back`` of them were away for so many
    ``seconds`` together [APP (5)].
    """
    return (seconds + PRIOR_BACK * RETURN_TIME) / (back + PRIOR_BACK)


def twin_chance(found: float, chances: float, people: int) -> float:
    """The probability that another target looks like a given one [APP (5)].

    Parameters
    ----------
    found, chances : how many targets looked like another one, of how many that were compared with
        all others.
    people : how many there were.
    """
    share = (found + PRIOR_TWINS * TWINS) / (chances + PRIOR_TWINS)
    return min(share, 1.0) / max(people, 1)


def twins_among(ratio: F8, twin: float) -> float:
    """How many of the pairs (P,) of two targets each look the same, as expected.

    Parameters
    ----------
    ratio : (P,) log-likelihood ratios of looks.
    twin : the probability that two do.
    """
    found = twin * np.exp(ratio)
    return float((found / (found + 1 - twin)).sum())


def among(ratio: F8, twin: float) -> F8:
    """(P,) log-likelihood ratios of looks, if another target looks the same with the probability
    ``twin``.
    """
    out: F8 = -np.log((1 - twin) * np.exp(-ratio) + twin)
    return out


def log_odds(gap: F8, lost: F8, new: F8, rates: Rates, area: float) -> F8:
    """(P,) the logarithm of these odds without ℓ; −∞ where the new target was there before.

    Parameters
    ----------
    gap : (P,) seconds from the last detection of the lost target to the first of the new one.
    lost, new : (P, 4) the boxes of both.
    rates : how often targets are new and come back.
    area : pixels² in which targets appear.
    """
    apart = np.maximum(gap, 0.0)
    place = NEARBY * _nearness(gap, lost, new, area) + 1 - NEARBY
    back = rates.back / rates.away * np.exp(-apart / rates.away) * place / rates.births
    out: F8 = np.where(gap > 0, np.log(np.maximum(back, 1e-300)), -np.inf)
    return out


def _nearness(gap: F8, lost: F8, new: F8, area: float) -> F8:
    """(P,) how many times as probable the place of a new target is if it came back near where it
    was lost than if it may be anywhere; arguments as of `log_odds`.
    """
    height = lost[:, 3] - lost[:, 1]
    step = (new[:, :2] + new[:, 2:] - lost[:, :2] - lost[:, 2:]) / 2
    variance = (height * (0.5 + DRIFT * np.maximum(gap, 0.0))) ** 2
    # What is wider than the area is cut off there.
    peak = np.maximum(area / (2 * math.pi * variance), 1.0)
    ratio: F8 = peak * np.exp(-0.5 * (step**2).sum(axis=1) / variance)
    return ratio
