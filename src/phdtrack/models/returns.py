"""The odds that a new target is one that was lost before [APP (5)].

A target that ends comes back with the probability p_R, after a time with the mean τ, near where it
was lost, by a Gaussian that widens with the time Δ, or anywhere. Its odds against a new target are

    p_R/τ exp(−Δ/τ) · p(place | Δ) / (births per second and unit of area) · exp ℓ

with ℓ the log-likelihood ratio of what both look like, if another target may look the same
(`among`). How many come back is learned (`returning_share`).
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
PRIOR_ENDED = 40.0
# The probability that a target looks like another one of the stream.
TWINS = 0.1
# The part of those that come back that do so near where they were lost, and how fast what is known
# of their place fades, in heights of the box a second.
NEARBY = 0.5
DRIFT = 1.0


class Rates(NamedTuple):
    """How often targets are new and come back.

    ``births``: new targets a second. ``back``: the probability that one that ends comes back.
    """

    births: float
    back: float


def returning_share(back: float, ended: int) -> float:
    """The probability that a target that ends comes back, if ``back`` of those that ended did
    [APP (5)].
    """
    return (back + PRIOR_ENDED * RETURN) / (ended + PRIOR_ENDED)


def among(ratio: F8, people: int) -> F8:
    """(P,) log-likelihood ratios of looks, if some of so many targets look like another one."""
    twin = min(TWINS / max(people, 1), 1.0)
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
    height = lost[:, 3] - lost[:, 1]
    step = (new[:, :2] + new[:, 2:] - lost[:, :2] - lost[:, 2:]) / 2
    apart = np.maximum(gap, 0.0)
    variance = (height * (0.5 + DRIFT * apart)) ** 2
    near = np.exp(-0.5 * (step**2).sum(axis=1) / variance) / (2 * math.pi * variance)
    place = NEARBY * near * area + 1 - NEARBY
    back = rates.back / RETURN_TIME * np.exp(-apart / RETURN_TIME) * place / rates.births
    out: F8 = np.where(gap > 0, np.log(np.maximum(back, 1e-300)), -np.inf)
    return out
