"""The outline of the ground that a camera sees."""

from __future__ import annotations

import numpy as np

from phdtrack.devices import Camera
from phdtrack.errors import InputError
from phdtrack.types import F8, Bool

# Points along an edge of the frame, points along a side of the grid that is searched for a visible
# centre, and halvings of the interval between visible and invisible pixels.
_EDGE = 64
_GRID = 33
_HALVINGS = 50


def footprint(camera: Camera, frame_size: tuple[float, float], limit: float = 100.0) -> F8:
    """(2, K) outline of the visible ground, metres, from the upper left corner of the frame on
    around it; K = 0 if no ground is visible. Raises `InputError` for a size or a limit that is not
    above 0.

    If a point on the edge of the frame shows no ground, or ground deeper than ``limit``, the line
    to it from a visible pixel is cut where the ground ends. On terrain, which may hide ground in
    between, the result is the outline as seen from the middle.

    Parameters
    ----------
    camera : between pixels and ground.
    frame_size : width and height, pixels.
    limit : largest depth (`Camera.depth`), metres.

    Returns
    -------
    The corners, metres.
    """
    width, height = frame_size
    if not (width > 0 and height > 0 and limit > 0):
        raise InputError(
            f"expected a frame size and a limit above 0, got {width:g} x {height:g} and {limit:g} m"
        )

    def is_visible(pixel: F8) -> Bool:
        return np.asarray(camera.depth(camera.ground(pixel)) <= limit)

    grid = np.stack(
        np.meshgrid(np.linspace(0, width, _GRID), np.linspace(0, height, _GRID))
    ).reshape(2, -1)
    visible = grid[:, is_visible(grid)]
    if not visible.shape[1]:
        return np.zeros((2, 0))
    # The visible pixel nearest to their mean: the mean itself need not be visible.
    mean = visible.mean(axis=1, keepdims=True)
    middle = visible[:, [np.argmin(((visible - mean) ** 2).sum(axis=0))]]
    edge = _frame_edge(width, height)
    inner = np.zeros(edge.shape[1])
    outer = np.ones(edge.shape[1])
    for _ in range(_HALVINGS):
        share = (inner + outer) / 2
        good = is_visible(middle + share * (edge - middle))
        inner = np.where(good, share, inner)
        outer = np.where(good, outer, share)
    return camera.ground(middle + inner * (edge - middle))


def _frame_edge(width: float, height: float) -> F8:
    """(2, 4·_EDGE) points around the frame, pixels."""
    t = np.arange(_EDGE) / _EDGE
    zero = np.zeros(_EDGE)
    unit = np.array([[*t, *zero + 1, *1 - t, *zero], [*zero, *t, *zero + 1, *1 - t]])
    edge: F8 = np.array([[width], [height]]) * unit
    return edge
