"""Boxes: the two ways to write them, and their overlap. Shared by models, metrics, simulation and detectors.

``xyxy`` is (N, 4): left, top, right, bottom. ``cxcywh`` is (4, N): centre x, centre y, width, height as columns, the
measurement vector z = (px, py, w, h) of M07 and M09.
"""

from __future__ import annotations

import numpy as np

from phdtrack.types import F8


def to_cxcywh(xyxy: F8) -> F8:
    """(4, N) centre x, centre y, width, height of the (N, 4) boxes."""
    left, top, right, bottom = xyxy.T
    return np.stack([(left + right) / 2, (top + bottom) / 2, right - left, bottom - top])


def to_xyxy(cxcywh: F8) -> F8:
    """(N, 4) left, top, right, bottom of the (4, N) centres and sizes."""
    x, y, w, h = cxcywh
    return np.stack([x - w / 2, y - h / 2, x + w / 2, y + h / 2], axis=1)


def area(xyxy: F8) -> F8:
    """(N,) areas in pixels²."""
    return (xyxy[:, 2] - xyxy[:, 0]) * (xyxy[:, 3] - xyxy[:, 1])


def intersection(a: F8, b: F8) -> F8:
    """(N, M) areas that the boxes ``a`` (N, 4) and ``b`` (M, 4) share, in pixels²."""
    width = np.minimum(a[:, None, 2], b[None, :, 2]) - np.maximum(a[:, None, 0], b[None, :, 0])
    height = np.minimum(a[:, None, 3], b[None, :, 3]) - np.maximum(a[:, None, 1], b[None, :, 1])
    shared: F8 = np.maximum(width, 0) * np.maximum(height, 0)
    return shared


def iou(a: F8, b: F8) -> F8:
    """(N, M) intersection over union of the boxes ``a`` (N, 4) and ``b`` (M, 4); 0 where both have no area."""
    shared = intersection(a, b)
    union = area(a)[:, None] + area(b)[None, :] - shared
    return np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)
