"""A learned density as a picture: where in the frame, all sizes and velocities together [M09 Figs. 7, 8]."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.scene.density import ContextDensity, marginal
from phdtrack.types import F8


def place_map(p: ContextDensity, shape: tuple[int, int], step: float, *, sized: bool = True) -> F8:
    """(H, W) how likely p's Gaussians make each place, cells of ``step`` pixels or metres; the most likely one has 1.

    What happens at a place is seen as a box and not as its centre: a quarter of the mean size is added as deviation. The
    last two components of p are width and height where it is ``sized``. Cells begin at p's lower bounds.
    """
    cov = p.covariance.copy()
    for axis in range(2 if sized else 0):
        cov[:, axis, axis] += (0.25 * p.mean[p.dim - 2 + axis]) ** 2
    place = marginal(replace(p, covariance=cov), (0, 1))
    down, across = np.meshgrid((np.arange(shape[0]) + 0.5) * step, (np.arange(shape[1]) + 0.5) * step, indexing="ij")
    at = np.stack([across.ravel(), down.ravel()]) + place.low[:, None]
    likely = np.exp(place.parts(at)[1:]).sum(axis=0)
    out: F8 = (likely / max(likely.max(initial=0.0), 1e-300)).reshape(shape)
    return out
