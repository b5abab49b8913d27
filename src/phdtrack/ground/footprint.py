"""The field of view on the ground: the polygon that the frame's edge draws there, cut at the horizon and at a distance."""

from __future__ import annotations

import numpy as np

from phdtrack.errors import InputError
from phdtrack.protocols import Camera
from phdtrack.types import F8

# Points along an edge of the frame, points of the grid that a visible centre is looked for on, halvings of a pixel's way.
_EDGE, _GRID, _HALVINGS = 64, 33, 50


def footprint(camera: Camera, frame_size: tuple[float, float], limit: float = 100.0) -> F8:
    """(2, K) corners of the ground that the frame shows, metres; K = 0 where it shows none.

    The points go around the frame from its upper left corner. Where the edge of the frame shows no ground, or ground deeper
    than ``limit``, the way from a visible pixel to the edge is cut where the ground ends: on terrain, where ground may be
    hidden in between, that is the outline as far as it can be seen from the middle.

    Parameters
    ----------
    frame_size : width and height, pixels.
    limit : greatest depth (`Camera.depth`), metres.

    Raises
    ------
    InputError : the size or the limit is not above 0.
    """
    width, height = frame_size
    if not (width > 0 and height > 0 and limit > 0):
        raise InputError(f"expected a frame size and a limit above 0, came {width:g} x {height:g} and {limit:g} m")
    edge = _edge(width, height)
    grid = np.stack(np.meshgrid(np.linspace(0, width, _GRID), np.linspace(0, height, _GRID))).reshape(2, -1)
    shown = grid[:, _visible(camera, grid, limit)]
    if not shown.shape[1]:
        return np.zeros((2, 0))
    # Of the visible pixels the one nearest to their middle: the middle itself need not be visible.
    middle = shown[:, np.argmin(((shown - shown.mean(axis=1, keepdims=True)) ** 2).sum(axis=0))][:, None]
    seen, unseen = np.zeros(edge.shape[1]), np.ones(edge.shape[1])
    for _ in range(_HALVINGS):
        share = (seen + unseen) / 2
        good = _visible(camera, middle + share * (edge - middle), limit)
        seen, unseen = np.where(good, share, seen), np.where(good, unseen, share)
    return camera.ground(middle + seen * (edge - middle))


def _visible(camera: Camera, pixel: F8, limit: float) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """(N,) whether the pixels (2, N) show ground that is no deeper than the limit."""
    return np.asarray(camera.depth(camera.ground(pixel)) <= limit)


def _edge(width: float, height: float) -> F8:
    """(2, 4·64) pixels around the frame, clockwise as the picture shows it."""
    t = np.arange(_EDGE) / _EDGE
    none, all_ = np.zeros(_EDGE), np.ones(_EDGE)
    x = np.concatenate([t, all_, 1 - t, none]) * width
    y = np.concatenate([none, t, all_, 1 - t]) * height
    return np.stack([x, y])
