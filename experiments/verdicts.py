"""Verdicts on claims that consist of several, and what a page says of the seeds."""

from __future__ import annotations

from collections.abc import Iterable

from experiments.claims import FEWEST
from phdtrack.report.pages import counted


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
