"""How much of each figure is hidden by nearer ones: who stands lower in the picture stands nearer to the camera."""

from __future__ import annotations

import numpy as np

from phdtrack.types import F8, Truth

GRID = 9


def covered(truth: Truth, obstacles: F8) -> F8:
    """(M,) part of each box that nearer boxes of its frame or ``obstacles`` (K, 4) hide, to within about 1/9 of its area.

    Estimated on a 9 × 9 grid of points, which counts what several boxes hide together only once.
    """
    hidden = np.zeros(len(truth))
    starts = np.flatnonzero(np.diff(truth.frame, prepend=0))
    for rows in np.split(np.arange(len(truth)), starts[1:]) if len(truth) else []:
        boxes = truth.xyxy[rows]
        hidden[rows] = _hidden_parts(boxes, np.concatenate([boxes, obstacles]))
    return hidden


def _hidden_parts(boxes: F8, hiders: F8) -> F8:
    """(n,) part of each box (n, 4) that those ``hiders`` (m, 4) hide whose lower edge is lower."""
    steps = (np.arange(GRID) + 0.5) / GRID
    x = boxes[:, :1] + steps * (boxes[:, 2:3] - boxes[:, :1])
    y = boxes[:, 1:2] + steps * (boxes[:, 3:4] - boxes[:, 1:2])
    in_x = (x[:, :, None] > hiders[:, 0]) & (x[:, :, None] < hiders[:, 2])
    in_y = (y[:, :, None] > hiders[:, 1]) & (y[:, :, None] < hiders[:, 3])
    nearer = hiders[None, :, 3] > boxes[:, None, 3]
    point_hidden = (in_x[:, :, None, :] & in_y[:, None, :, :] & nearer[:, None, None, :]).any(axis=3)
    part: F8 = point_hidden.mean(axis=(1, 2))
    return part
