"""The empty scene from samples of a video, also where objects stand or come all the time.

The median of each pixel over the samples is the scene wherever it is seen in most of them. Where it
is not, the scene's edges still are: an object hides an edge behind it, and has edges of its own,
only where it stands just then. So the median of the gradients over the samples is the scene's
gradient long after the median of the values is not (Weiss, 2001, whose intrinsic images these are).
Where samples disagree, the picture is integrated from these gradients,

    min_P Σ ‖P(q) − P(p) − median_k (S_k(q) − S_k(p))‖²   over neighbours p, q, one of them or both
    in U, P = median_k S_k outside of U,

on a smaller picture, because it only has to say which of the values that a pixel had is the
scene's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.change import middle
from phdtrack.kernels.planes import BLACK, FROM_BGR, TO_BGR, colours, luma
from phdtrack.types import F8, STILL, Bool, Image

F4 = NDArray[np.float32]
# Grey levels within which two samples show the same, and the share of samples that must for the
# median to be certain.
_SAME = 12
_CERTAIN = 0.9
# Grey levels of the two pictures' difference from which the median is not the scene.
_WRONG = 12.0
# Grey levels by which the scene differs from the median where something hid it most of the time.
_HIDDEN = 6.0
# Pixels of the smaller picture; bytes of which the median is made at a time.
_COARSE = 12_000
_BAND = 4_000_000
_RING = np.ones((3, 3), np.uint8)
# Corners that are followed at most, and share of the width that they are apart; window and levels
# of the pyramids.
_CORNERS = 150
_APART = 0.03
_LOOK = (15, 15)
_LEVELS = 3
# The fewest corners that tell of a motion, the pixels within which they agree with it, the share
# that has to; by what share a camera that stands may zoom, and by what share of the width it may
# move the picture.
_FEWEST = 12
_AGREE = 1.0
_MOST = 0.25
_ZOOM = 0.1
_FARTHEST = 0.15
# Brightness and colour differences of black.
_ZERO: F8 = np.array([BLACK, 128.0, 128.0])


class Anchor:
    """Corners of a picture, by which it is told where others of the same scene lie: a camera in the
    wind shakes.

    Each is followed by pyramids of Lucas and Kanade's method. RANSAC finds the similarity that most
    of them agree on: objects hide some.
    """

    def __init__(self, picture: Image) -> None:
        """``picture`` : (H, W) uint8, brightness."""
        corners = cv2.goodFeaturesToTrack(
            picture, _CORNERS, 0.01, max(3.0, _APART * picture.shape[1])
        )
        if corners is None:
            self._corners = np.zeros((0, 1, 2), np.float32)
        else:
            self._corners = np.asarray(corners, np.float32)
        self._picture = picture.copy()
        self.middle: F8 = np.append(
            self._corners.reshape(-1, 2).sum(axis=0) / max(1, len(self._corners)), 1.0
        )

    def pose(self, picture: Image) -> F8:
        """(3, 3) from pixels of the anchor's picture to those of another one (H, W); `types.STILL`
        where it is not found.
        """
        if len(self._corners) < _FEWEST:
            return STILL
        there, found, _ = cv2.calcOpticalFlowPyrLK(
            self._picture, picture, self._corners, None, winSize=_LOOK, maxLevel=_LEVELS
        )
        good = found.ravel() == 1
        if good.sum() < _FEWEST:
            return STILL
        matrix, inside = cv2.estimateAffinePartial2D(
            self._corners[good], there[good], ransacReprojThreshold=_AGREE
        )
        if matrix is None or inside.mean() < _MOST or inside.sum() < _FEWEST:
            return STILL
        pose = np.vstack([matrix, [0.0, 0.0, 1.0]])
        near = (
            np.abs(self.moved(pose)).max() < _FARTHEST * picture.shape[1]
            and abs(math.hypot(*matrix[:, 0]) - 1) < _ZOOM
        )
        return pose if near else STILL

    def moved(self, pose: F8) -> F8:
        """(2,) pixels by which the middle of the corners is moved; 0 where it is not known."""
        if len(pose):
            return pose[:2] @ self.middle - self.middle[:2]
        return np.zeros(2)


def stabilised(picture: Image, shape: tuple[int, int], pose: F8) -> Image:
    """(n,) the planes of a picture moved back from where it lies; what comes in is as at the
    border.

    Parameters
    ----------
    picture : (n,) planes.
    shape : (H, W) of it.
    pose : (3, 3) of `Anchor.pose`.
    """
    out = np.empty_like(picture)
    planes = [(luma(each, shape), *colours(each, shape)) for each in (out, picture)]
    for now, was, scale in zip(*planes, (1.0, 0.5, 0.5), strict=True):
        matrix = pose[:2] * [1, 1, scale]
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        now[:] = cv2.warpAffine(
            was, matrix, was.shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
    return out


def median(samples: Sequence[Image]) -> Image:
    """(n,) the median of each number of an odd number of samples (n,) uint8."""
    out = np.empty_like(samples[0])
    # In bands of some megabytes: the samples side by side would take as much memory as they do.
    step = max(1, _BAND // len(samples))
    for start in range(0, len(out), step):
        band = slice(start, start + step)
        out[band] = middle_of(np.stack([one[band] for one in samples]))
    return out


def background(samples: Sequence[Image], shape: tuple[int, int]) -> tuple[Image, Bool]:
    """(n,) the empty scene, and (H, W) where something hid it most of the time.

    It is the median, but where gradients contradict that the sample that they agree with most.

    Parameters
    ----------
    samples : an odd number of pictures (n,), planes as in `kernels.change`, far apart in time.
    shape : (H, W) of them.
    """
    typical = median(samples)
    height, width = shape
    scale = min(1.0, (_COARSE / (height * width)) ** 0.5)
    size = (max(8, round(width * scale)), max(8, round(height * scale)))
    small = np.stack([_shrunk(one, shape, size) for one in samples])
    integrated = _integrated(small)
    wrong = np.abs(integrated - middle_of(small).astype(np.float32)).max(axis=2) > _WRONG
    if not wrong.any():
        return typical, np.zeros(shape, np.bool_)
    wrong = cv2.resize(cv2.dilate(wrong.astype(np.uint8), _RING), (width, height)) > 0
    # Where the three numbers of each pixel are.
    y, x = np.indices(shape)
    first = height * width + y // 2 * ((width + 1) // 2) + x // 2
    whole = np.stack([y * width + x, first, first + (height + 1) // 2 * ((width + 1) // 2)], axis=2)
    places = whole[wrong]
    aim = cv2.resize(integrated, (width, height))[wrong]
    nearest = np.asarray(aim @ FROM_BGR.T + _ZERO, np.float32)
    least = np.full(len(aim), 2 * _WRONG, np.float32)
    for one in samples:
        values = one[places]
        distance = np.abs(_bgr(values) - aim).max(axis=1)
        closer = distance < least
        nearest[closer] = values[closer]
        least[closer] = distance[closer]
    out = typical.copy()
    chosen = np.zeros((*shape, 3), np.uint8)
    # A pixel that chose otherwise than all around it chose by noise.
    chosen[wrong] = np.clip(np.rint(nearest), 0, 255)
    chosen[~wrong] = typical[whole][~wrong]
    found = cv2.medianBlur(chosen, 5)[wrong]
    out[places] = found
    hidden = np.zeros(shape, np.bool_)
    hidden[wrong] = np.abs(_bgr(found) - _bgr(typical[places])).max(axis=1) > _HIDDEN
    return out, hidden


def _shrunk(picture: Image, shape: tuple[int, int], size: tuple[int, int]) -> Image:
    """(h, w, 3) BGR of planes (n,) in another size."""
    planes = (luma(picture, shape), *colours(picture, shape))
    small = [cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in planes]
    return np.asarray(np.clip(np.rint(_bgr(np.dstack(small))), 0, 255), np.uint8)


def _bgr(planes: NDArray[Any]) -> F4:
    """(..., 3) blue, green and red of brightness and colour differences."""
    return np.asarray((planes - _ZERO) @ TO_BGR.T, np.float32)


def of_objects(hidden: Bool, least: F8, margin: int) -> Bool:
    """(H, W) what objects hid, for leaves hide some pixels each: parts into which a square fits,
    widened.

    Parameters
    ----------
    hidden : (H, W) where something hid the scene most of the time.
    least : (H,) side in pixels of a square that fits into an object in this row.
    margin : pixels by which what hides is widened in all, odd.
    """
    spots = hidden.astype(np.uint8)
    # From the edge of the picture on it is taken to go on.
    inside = cv2.distanceTransform(
        cv2.copyMakeBorder(spots, 1, 1, 1, 1, cv2.BORDER_REPLICATE), cv2.DIST_C, 3
    )[1:-1, 1:-1]
    _, part = cv2.connectedComponents(cv2.morphologyEx(spots, cv2.MORPH_OPEN, _RING))
    large = np.setdiff1d(part[2 * inside - 1 >= least[:, None]], 0)
    return np.asarray(
        cv2.dilate(np.isin(part, large).astype(np.uint8), np.ones((margin, margin), np.uint8)) > 0
    )


def middle_of(values: NDArray[Any]) -> NDArray[Any]:
    """The median along the first axis, of an odd number of values."""
    return np.asarray(middle(np.ascontiguousarray(values).reshape(len(values), -1))).reshape(
        values.shape[1:]
    )


def _integrated(samples: Image) -> F4:
    """(h, w, 3) the picture of the median gradients of samples (n, h, w, 3), within the median
    where that is certain.
    """
    # They take long to import, and a live source needs neither.
    from scipy.sparse import diags, eye, kron, vstack
    from scipy.sparse.linalg import cg

    typical = middle_of(samples).astype(np.float32)
    values = samples.astype(np.int16)
    agree = (np.abs(values - typical).max(axis=3) <= _SAME).mean(axis=0)
    unknown: Bool = cv2.dilate((agree < _CERTAIN).astype(np.uint8), _RING) > 0
    # Without a certain pixel anywhere the picture would be known but for a constant.
    if not unknown.any() or unknown.mean() > 0.95:
        return typical
    hidden = unknown.ravel()
    known = typical.reshape(-1, 3)
    down, along = (diags([-1.0, 1.0], [0, 1], (side - 1, side)) for side in unknown.shape)
    # An equation for each pair of neighbours: the second one less the first is the median gradient.
    steps = vstack([kron(eye(unknown.shape[0]), along), kron(down, eye(unknown.shape[1]))]).tocsc()
    gradient = np.concatenate(
        [middle_of(np.diff(values, axis=axis)).reshape(-1, 3) for axis in (2, 1)]
    )
    free = steps[:, hidden]
    right = gradient - steps[:, ~hidden] @ known[~hidden]
    normal = (free.T @ free).tocsr()
    out = typical.copy()
    for channel in range(3):
        start = known[hidden, channel]
        out[unknown, channel] = cg(
            normal, free.T @ right[:, channel], start, rtol=1e-3, maxiter=300
        )[0]
    return out
