"""The naive forms of the kernels of multiple hypotheses."""

from __future__ import annotations

import itertools

import numpy as np


def all_assignments(gain, alone, held, base):
    """Every assignment of every hypothesis as (log-weight, hypothesis, choice), best first."""
    out = []
    for p, tracks in enumerate(held):
        mine = [int(t) for t in tracks if t >= 0]
        for choice in itertools.product([-1, *mine], repeat=len(alone)):
            taken = [c for c in choice if c >= 0]
            weight = base[p] + sum(
                alone[j] + (gain[j, c] if c >= 0 else 0.0) for j, c in enumerate(choice)
            )
            if len(taken) == len(set(taken)) and weight > -np.inf:
                out.append((float(weight), p, choice))
    return sorted(out, key=lambda item: -item[0])


def components(count, first, second):
    """The component of each vertex, found by spreading from each vertex in turn."""
    number = [-1] * count
    for start in range(count):
        if number[start] < 0:
            number[start] = max(number) + 1
            waiting = [start]
            while waiting:
                here = waiting.pop()
                for a, b in [*zip(first, second, strict=True), *zip(second, first, strict=True)]:
                    if a == here and number[b] < 0:
                        number[b] = number[start]
                        waiting.append(int(b))
    return np.array(number)


def competing(leaf, trace):
    """The component of each track; two are joined where a form of each rests on the same
    measurement of a frame.
    """
    tracks = leaf.shape[1]
    taken = [
        {
            (w, int(j))
            for form in leaf[:, t]
            if form >= 0
            for w, j in enumerate(trace[form])
            if j >= 0
        }
        for t in range(tracks)
    ]
    pairs = [(a, b) for a in range(tracks) for b in range(a) if taken[a] & taken[b]]
    return components(tracks, [a for a, _ in pairs], [b for _, b in pairs])
