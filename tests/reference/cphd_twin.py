"""Bayes' rule for a number of independent targets in a few cells, by enumeration of everything that
can have happened.
"""

from __future__ import annotations

import math
from itertools import permutations, product


def posterior(cardinality, where, p_detect, likelihood, clutter):
    """Distribution of the number of targets, and the expected number in each cell, after one scan.

    ``cardinality`` of the number, ``where`` (c,) each target's place, ``p_detect`` (c,),
    ``likelihood[z][c]`` the density of each measurement from a target in a cell, ``clutter`` (m,)
    its intensity; the number of false alarms is Poisson.
    """
    number = [0.0] * len(cardinality)
    expected = [0.0] * len(where)
    for n, prior in enumerate(cardinality):
        for cells in product(range(len(where)), repeat=n):
            belief = (
                prior
                * math.prod(where[c] for c in cells)
                * scan(cells, p_detect, likelihood, clutter)
            )
            number[n] += belief
            for c in cells:
                expected[c] += belief
    total = math.fsum(number)
    return [value / total for value in number], [value / total for value in expected]


def scan(cells, p_detect, likelihood, clutter) -> float:
    """Density of the scan, up to a constant, given the targets' cells: the sum over who gave which
    measurement.
    """
    n = len(cells)
    m = len(clutter)
    total = 0.0
    for seen in product((False, True), repeat=n):
        detected = [i for i in range(n) if seen[i]]
        chance = math.prod(
            p_detect[c] if s else 1 - p_detect[c] for c, s in zip(cells, seen, strict=True)
        )
        for given in permutations(range(m), len(detected)):
            false = math.prod(clutter[z] for z in range(m) if z not in given)
            true = math.prod(likelihood[z][cells[i]] for z, i in zip(given, detected, strict=True))
            total += chance * false * true
    return total
