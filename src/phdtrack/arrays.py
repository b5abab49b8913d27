"""Small array operations that several packages share: sums by index, boxes, draws from mixtures.

Boxes have two forms. ``xyxy`` is (N, 4): left, top, right, bottom. ``cxcywh`` is (4, N):
centre x, centre y, width, height as columns, the measurement vector z = (px, py, w, h) of M07 and
M09.
"""

from __future__ import annotations

import math
import sys
from functools import lru_cache
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phdtrack.errors import InputError
from phdtrack.types import F4, F8, I8, GaussianMixture, Image, Particles, Real

# Share of the measurements of a box inside the usual gate: five deviations in four dimensions.
GATE = 0.99995


@lru_cache(maxsize=64)
def chi2_quantile(dof: int, probability: float) -> float:
    """The squared radius that contains this part of a standard Gaussian in ``dof`` dimensions; 1e8,
    beyond everything, for 1.
    """
    if probability >= 1:
        return 1e8
    low = 0.0
    high = 1500.0
    for _ in range(80):
        middle = (low + high) / 2
        half = middle / 2
        odd = 0.5 * (dof % 2)
        # 1 − F, in closed form for whole and half degrees.
        outside = math.erfc(math.sqrt(half)) if dof % 2 else 0.0
        outside += sum(
            math.exp(-half) * half ** (k + odd) / math.gamma(k + odd + 1) for k in range(dof // 2)
        )
        if outside > 1 - probability:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def _references(memories: list[NDArray[np.uint8]]) -> list[int]:
    """The number of references to each array."""
    return [sys.getrefcount(memory) for memory in memories]


# Memory of large arrays, the size in bytes from which an array is large, the largest number of
# blocks, and the number of references to memory that no array uses.
_MEMORY: list[NDArray[np.uint8]] = []
_LARGE = 2**20
_MOST = 12
_LOCK = Lock()
_UNUSED = _references([np.empty(0, np.uint8)])[0]


def reused(shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """An uninitialised array; a large one reuses memory that no array uses any more.

    Fresh pages from the operating system cost more than writing all their numbers.
    """
    size = math.prod(shape) * dtype.itemsize
    if size < _LARGE:
        return np.empty(shape, dtype)
    with _LOCK:
        for k, references in enumerate(_references(_MEMORY)):
            if references == _UNUSED and size <= _MEMORY[k].nbytes <= 2 * size:
                return _MEMORY[k][:size].view(dtype).reshape(shape)
        _MEMORY.append(np.empty(size + size // 4, np.uint8))
        del _MEMORY[:-_MOST]
        return _MEMORY[-1][:size].view(dtype).reshape(shape)


def sum_by(index: I8, value: F8, count: int) -> F8:
    """(count,) sums over equal indices.

    Parameters
    ----------
    index, value, count : (n,) each, and the number of sums.
    """
    # NumPy's sums of no values are integers.
    return np.asarray(np.bincount(index, value, count), dtype=np.float64)


def to_cxcywh(xyxy: F8) -> F8:
    """(4, N) centre x, centre y, width, height of the (N, 4) boxes."""
    first = xyxy[:, :2].T
    last = xyxy[:, 2:].T
    out = np.empty((4, len(xyxy)))
    out[:2] = (first + last) / 2
    out[2:] = last - first
    return out


def to_xyxy(cxcywh: F8) -> F8:
    """(N, 4) left, top, right, bottom of the (4, N) centres and sizes."""
    x, y, w, h = cxcywh
    return np.stack([x - w / 2, y - h / 2, x + w / 2, y + h / 2], axis=1)


def area(xyxy: F8) -> F8:
    """(N,) areas in pixels²."""
    return (xyxy[:, 2] - xyxy[:, 0]) * (xyxy[:, 3] - xyxy[:, 1])


def intersection(a: F8, b: F8) -> F8:
    """(N, M) areas of the intersections of boxes ``a`` (N, 4) and ``b`` (M, 4), in pixels²."""
    width = np.minimum(a[:, None, 2], b[None, :, 2]) - np.maximum(a[:, None, 0], b[None, :, 0])
    height = np.minimum(a[:, None, 3], b[None, :, 3]) - np.maximum(a[:, None, 1], b[None, :, 1])
    shared: F8 = np.maximum(width, 0) * np.maximum(height, 0)
    return shared


def iou(a: F8, b: F8) -> F8:
    """(N, M) intersection over union of the boxes ``a`` (N, 4) and ``b`` (M, 4); 0 if both have no
    area.
    """
    shared = intersection(a, b)
    union = area(a)[:, None] + area(b)[None, :] - shared
    return np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)


def iou_of_pairs(a: F8, b: F8) -> F8:
    """(P,) intersection over union of the boxes ``a`` and ``b`` (P, 4), pair by pair; 0 if both
    have no area.
    """
    shared: F8 = np.clip(
        np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2]), 0, None
    ).prod(axis=1)
    union = area(a) + area(b) - shared
    return np.divide(shared, union, out=np.zeros_like(shared), where=union > 0)


def share_inside(xyxy: F8, width: float, height: float) -> F8:
    """(n,) the share of each box that lies in an image; 0 for a box without area.

    Parameters
    ----------
    xyxy, width, height : (n, 4) boxes, and the size of the image, pixels.
    """
    shared = intersection(xyxy, np.array([[0.0, 0.0, width, height]]))[:, 0]
    return np.divide(shared, area(xyxy), out=np.zeros_like(shared), where=shared > 0)


def draw(mixture: GaussianMixture, count: int, scale: float, rng: np.random.Generator) -> Particles:
    """Particles drawn from a mixture, of total mass ``scale`` times each component's weight.

    Parameters
    ----------
    mixture, count : the mixture, and the number of particles of each component.
    scale, rng : factor of the weights; source of the draws.
    """
    d, k = mixture.mean.shape
    root = np.linalg.cholesky(mixture.covariance)
    state = mixture.mean.T[:, :, None] + root @ rng.standard_normal((k, d, count))
    weight = np.repeat(mixture.weight * scale / max(1, count), count)
    return Particles(np.ascontiguousarray(state.transpose(1, 0, 2).reshape(d, k * count)), weight)


BLURS = ("boxes", "faces")
# A blurred region has at most so many cells along its longer side, of at least so many pixels, and
# each side is a tenth longer than the box.
_CELLS = 6
_CELL = 8
_MARGIN = 0.1


def pixelated(image: Image, xyxy: F8, blur: str) -> Image:
    """A copy of a picture in which boxes, or their upper thirds, are a few cells of one colour
    each.

    A cell has the mean colour of its pixels; docs/security.md says what can still be recognised. No
    network looks for faces: the upper third of a standing person's box contains the head. Raises
    `InputError` if ``blur`` is none of these.

    Parameters
    ----------
    image : (H, W, 3) uint8.
    xyxy : (N, 4) boxes in its pixels; those that are not finite are left out.
    blur : ``boxes``, ``faces``, or nothing: the picture itself.
    """
    if not blur:
        return image
    if blur not in BLURS:
        raise InputError(f"expected {' or '.join(BLURS)}, got {blur!r}", where="--blur")
    out = image.copy()
    height, width = image.shape[:2]
    boxes = xyxy[np.isfinite(xyxy).all(axis=1)]
    margin = _MARGIN / 2 * (boxes[:, 2:] - boxes[:, :2])
    part = np.hstack([boxes[:, :2] - margin, boxes[:, 2:] + margin])
    if blur == "faces":
        part[:, 3] = boxes[:, 1] + (boxes[:, 3] - boxes[:, 1]) / 3 + margin[:, 1]
    limit = np.array([width, height, width, height])
    for left, top, right, bottom in np.clip(
        np.hstack([np.floor(part[:, :2]), np.ceil(part[:, 2:])]), 0, limit
    ).astype(int):
        side = max(_CELL, -(-max(right - left, bottom - top) // _CELLS))
        for y in range(top, bottom, side):
            for x in range(left, right, side):
                cell = out[y : min(y + side, bottom), x : min(x + side, right)]
                cell[:] = cell.mean(axis=(0, 1)).round()
    return out


def half_if_exact(values: F4) -> Real:
    """The values as float16 if that changes none of them, else as they are."""
    with np.errstate(over="ignore"):
        half = values.astype(np.float16)
    if np.array_equal(half, values, equal_nan=True):
        return half
    return values
