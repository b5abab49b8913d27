"""Verdicts on a claim from differences over seeds: with errors from three seeds on, by the mean
with fewer, which is then said.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from experiments.claims import decided
from phdtrack.report.pages import counted

# With fewer seeds an error says nothing: half the 95 % interval of two is 12.7 standard errors.
FEWEST = 3


def over_seeds(gaps: Sequence[float]) -> bool | None:
    """True if a claim holds, False if it does not, None if its differences are within their error.

    Parameters
    ----------
    gaps : differences, one a seed, positive if as claimed. From `FEWEST` on they are judged by
        `decided`; fewer by the sign of their mean. Differences that are not numbers are not as
        claimed.
    """
    if len(gaps) >= FEWEST:
        return decided(gaps)
    return bool(len(gaps) > 0 and np.mean(gaps) > 0)


def all_hold(verdicts: Iterable[bool | None]) -> bool | None:
    """The verdict on a claim that consists of several: False if one does not hold, None if one is
    within its error.
    """
    each = list(verdicts)
    if False in each:
        return False
    return None if None in each else True


def most_hold(verdicts: Iterable[bool | None]) -> bool | None:
    """The verdict on a claim that must hold in most of several cases; None if those within their
    error decide.
    """
    each = list(verdicts)
    if 2 * each.count(True) > len(each):
        return True
    return False if 2 * each.count(False) >= len(each) else None


def with_seeds(figures: str, seeds: int) -> str:
    """The figures of a claim, with the number of seeds if these are too few for an error.

    Parameters
    ----------
    figures : in words.
    seeds : of runs that are random; 0 if none is.
    """
    return f"{figures}; {counted(seeds, 'seed')}" if 0 < seeds < FEWEST else figures


def rule() -> str:
    """The sentence of a page about how its claims are judged."""
    return (
        "Where runs are random, a claim holds, or does not, if its mean difference over the seeds\n"
        "exceeds half its 95 % interval (Student's t); otherwise it is *within its error*. A\n"
        f"claim from fewer than {FEWEST} seeds names their number, and the mean decides."
    )
