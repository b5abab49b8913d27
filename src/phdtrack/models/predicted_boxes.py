"""Decides whether the box of a target that was not detected is shown."""

from __future__ import annotations

import numpy as np

from phdtrack.kernels.coasting import overlap_probability
from phdtrack.protocols import Model
from phdtrack.types import F8, Bool

# Measurements with so many rows are boxes; others have no size that says when two are the same.
_OF_BOXES = 4
# A box is shown if it lies on a target with more than this probability.
SHOWN = 0.5


def shown(model: Model, state: F8, covariance: F8, existence: F8) -> Bool:
    """(n,) whether the box of each state lies on a target more probably than not.

    Parameters
    ----------
    model, state, covariance : as of `on_target`.
    existence : (n,) the probability that there is a target.
    """
    if not len(existence):
        return np.zeros(0, np.bool_)
    out: Bool = existence * on_target(model, state, covariance) > SHOWN
    return out


def on_target(model: Model, state: F8, covariance: F8) -> F8:
    """(n,) the probability that the box of each state overlaps that of its target by half or more.

    Only the place is uncertain, as its size changes slowly; 1 where boxes are not measured.

    Parameters
    ----------
    model : whose sensor draws the boxes.
    state, covariance : (d, n), (n, d, d); the first two components are the place.
    """
    n = state.shape[1]
    if len(model.sensor.observed) < _OF_BOXES:
        return np.ones(n)
    boxes = model.sensor.boxes(state)
    size = np.maximum(boxes[:, 2:] - boxes[:, :2], 1e-9)
    variance = np.zeros((n, 2))
    for axis in range(2):
        moved = state.copy()
        moved[axis] += np.sqrt(covariance[:, axis, axis])
        shift = model.sensor.boxes(moved) - boxes
        variance += np.square((shift[:, :2] + shift[:, 2:]) / (2 * size))
    deviation = np.sqrt(variance)
    out: F8 = overlap_probability(
        np.ascontiguousarray(deviation[:, 0]), np.ascontiguousarray(deviation[:, 1])
    )
    return out
