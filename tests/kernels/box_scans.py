"""Scans of boxes for the tests of fused steps."""

from __future__ import annotations

import numpy as np


def box_scans(seed: int, count: int, size: tuple[float, float], margin: float, speed: float) -> list[np.ndarray]:
    """(8, N) measurements with variances: who walks, comes close and leaves, misses, doubles, clutter; some are empty.

    Six walkers begin at least ``margin`` from the border of a frame of this ``size`` and move with deviation ``speed``.
    """
    rng = np.random.default_rng(seed)
    at, velocity = rng.uniform([margin, margin], np.subtract(size, margin), (6, 2)), rng.normal(0, speed, (6, 2))
    at[1], velocity[1] = at[0] + 15, -velocity[0]
    extent = rng.uniform(20, 90, (6, 2))
    out = []
    for k in range(count):
        here = np.hstack([at + k * velocity, extent])
        seen = here[rng.random(6) < 0.85]
        clutter = np.hstack([rng.uniform([0, 0], size, (4, 2)), rng.uniform(10, 120, (4, 2))])
        found = np.vstack([seen, seen[:1] + 3, clutter])
        found = found + rng.normal(0, 0.05, found.shape) * np.hstack([found[:, 2:], found[:, 2:]])
        found = found[: 0 if k % 5 == 4 else 1 if k % 7 == 6 else None]
        out.append(np.ascontiguousarray(np.hstack([found, rng.uniform(2, 30, found.shape)]).T))
    return out
