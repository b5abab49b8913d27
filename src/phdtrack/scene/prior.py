"""What is believed of a scene beside little that is seen of it: anywhere, of the sizes that appear.

A density learned from few samples is too sure of the places that it has not seen. It is held beside `PRIOR` samples that
might have been anywhere: α_u is at least PRIOR / (n + PRIOR) for n samples, which is Laplace's rule with a prior of that
weight. And anywhere means sizes that the detector reports: over all sizes of the image the uniform part would be so thin
that nothing new is believed. And a Gaussian is as wide as the next sample is uncertain: wider than lie those that it was
fitted to.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.errors import InputError
from phdtrack.scene.batch_em import parameters
from phdtrack.scene.density import ContextDensity
from phdtrack.scene.scene_file import Learned
from phdtrack.types import F8

# As many samples as are the fewest that are learned from.
PRIOR = 10
# How much wider than the sizes that were detected the range of those that may be is, and which of the detected count.
WIDER = 1.5
_COUNTED = (0.01, 0.99)

Sizes = tuple[F8, F8]
"""Smallest and largest width and height, (2,) each, pixels."""


def detected_sizes(size: F8) -> Sizes:
    """The range of sizes that may appear where ``size`` (2, n) were detected: 1st to 99th percentile, widened.

    Raises `InputError` where nothing was detected.
    """
    if size.shape[1] == 0:
        raise InputError("there are no detections whose sizes could be known", where="sizes")
    smallest, largest = np.quantile(size, _COUNTED, axis=1)
    return smallest / WIDER, largest * WIDER


def of_the_next(p: ContextDensity, samples: float) -> ContextDensity:
    """What a density that was fitted to so many samples tells of the next one [G13 §3.6].

    After n samples in d dimensions of a Gaussian that is not known the next one has Student's density with n − d degrees of
    freedom. The Gaussian nearest to that has its covariance, (n + 1)/(n − d − 2) times that of the samples. A component
    explains more than τ of them, so that it exists.
    """
    n = np.maximum(samples * (1 - p.uniform) * p.weight, parameters(p.dim) / 2)
    return replace(p, covariance=p.covariance * ((n + 1) / (n - p.dim - 2))[:, None, None])


def humbled(learned: Learned, sizes: Sizes) -> Learned:
    """What was learned, beside `PRIOR` samples anywhere; the last two components of its density are sizes."""
    density, n = learned.density, learned.samples
    low, high = density.low.copy(), density.high.copy()
    low[-2:], high[-2:] = sizes
    uniform = max(density.uniform, PRIOR / (n + PRIOR))
    return replace(learned, density=replace(density, low=low, high=high, uniform=uniform))
