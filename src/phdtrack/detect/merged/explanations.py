"""The best explanation of a small group: every one is looked at.

An explanation gives each target no blob (missed), one blob, or several that are its own (pieces); a blob of several targets
is their merged one, and a blob of nobody a false alarm. Its log-likelihood is the sum over these cells.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Protocol

Choice = tuple[tuple[int, ...], ...]
"""The blobs of each target of a group, in the order of its targets."""


class Scores(Protocol):
    """Log-likelihoods of the cells that explanations are made of."""

    def clutter(self, blob: int) -> float:
        """The blob is nobody."""

    def missed(self, target: int) -> float:
        """The target shows nowhere."""

    def merged(self, blob: int, targets: tuple[int, ...]) -> float:
        """The blob is these targets, one or more."""

    def split(self, target: int, blobs: tuple[int, ...]) -> float:
        """These blobs, two or more, are the target's pieces."""


def best(blobs: list[int], targets: list[int], inside: set[tuple[int, int]], scores: Scores, pieces: int) -> Choice:
    """The likeliest explanation; of equal ones the first, in the order that blobs and targets are given in."""
    options = [_options([b for b in blobs if (b, t) in inside], t, scores, pieces) for t in targets]
    known: dict[tuple[int, tuple[int, ...]], float] = {}
    top, found = -float("inf"), tuple[tuple[int, ...], ...](() for _ in targets)
    for choice in itertools.product(*options):
        value = _score(choice, blobs, targets, scores, known)
        if value > top:
            top, found = value, choice
    return found


def _options(touching: list[int], target: int, scores: Scores, pieces: int) -> list[tuple[int, ...]]:
    """What the target may be given: nothing, a blob, or several that fit it."""
    several: Iterator[tuple[int, ...]] = itertools.chain.from_iterable(
        itertools.combinations(touching, k) for k in range(2, min(pieces, len(touching)) + 1)
    )
    fitting = [some for some in several if scores.split(target, some) > -float("inf")]
    return [(), *((b,) for b in touching), *fitting]


def _score(
    choice: Choice, blobs: list[int], targets: list[int], scores: Scores, known: dict[tuple[int, tuple[int, ...]], float]
) -> float:
    """The log-likelihood of an explanation; −∞ where a piece of one target is also another's."""
    total = 0.0
    of: dict[int, tuple[int, ...]] = {}
    torn: set[int] = set()
    for target, given in zip(targets, choice, strict=True):
        if not given:
            total += scores.missed(target)
        elif len(given) > 1:
            total += scores.split(target, given)
            torn.update(given)
        for b in given:
            of[b] = (*of.get(b, ()), target)
    for b in blobs:
        owners = of.get(b, ())
        if b in torn:
            if len(owners) > 1:
                return -float("inf")
        elif not owners:
            total += scores.clutter(b)
        else:
            if (b, owners) not in known:
                known[b, owners] = scores.merged(b, owners)
            total += known[b, owners]
    return total
