"""The empty scene from samples of a video, even where objects are present most of the time.

The median of a pixel over the samples shows the scene if most samples do. Otherwise the scene may
still be what recurs: objects differ from each other, and the scene is the same whenever it is
visible. So a patch of the picture that is the same in two fifths of the samples is the scene. Where
nothing recurs as often, the scene's edges are still visible: an object hides an edge, and adds
edges of its own, only where it stands at that moment. So the median of the gradients over the
samples is the scene's gradient even where the median of the values is not the scene (intrinsic
images; Weiss, 2001). In the region U where samples disagree, the picture is integrated from these
gradients,

    min_P Σ ‖P(q) − P(p) − median_k (S_k(q) − S_k(p))‖²
    over neighbours p, q with at least one in U; P = median_k S_k outside of U,

at a lower resolution, because it only has to select one of the values that a pixel had.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.change import middle
from phdtrack.kernels.planes import BLACK, FROM_BGR, TO_BGR, colours, luma
from phdtrack.kernels.recurring import recurrences, same_patches
from phdtrack.opencv_package import cv2
from phdtrack.types import F4, F8, I8, STILL, Bool, Image

# The median is certain if this share of the samples lies within so many grey levels of it.
_SAME = 12
_CERTAIN = 0.9
# The median is wrong if the integrated picture differs from it by more grey levels than this.
_WRONG = 12.0
# A pixel was hidden if its scene value differs from the median by more grey levels than this.
_HIDDEN = 6.0
# Patches of the low-resolution picture have so many pixels to each side of their middle, and are
# the same if this share of them is within `_SAME`. One that recurs in this share of the samples is
# the scene, if it is in at most this share of the runs that there would be in random order; its
# pixels are the medians of so many samples.
_REACH = 3
_ALIKE = 0.8
_RECURS = 0.4
_STAYS = 0.75
_FEW = 5
# Above this share of uncertain pixels the boundary values are too few to integrate from.
_MAX_UNCERTAIN = 0.95
# Pixels of the low-resolution picture; bytes whose median is computed at a time.
_COARSE = 12_000
_BAND = 4_000_000
_RING = np.ones((3, 3), np.uint8)
# Corners that are tracked at most, and their distance as a share of the width; window and levels of
# the pyramids.
_CORNERS = 150
_DISTANCE = 0.03
_WINDOW = (15, 15)
_LEVELS = 3
# A pose needs a minimum number and share of corners that fit it within so many pixels. A still
# camera may zoom by this share, and move the picture by this share of its width.
_MIN_INLIERS = 12
_MIN_INLIER_SHARE = 0.25
_MAX_ERROR = 1.0
_MAX_ZOOM = 0.1
_MAX_SHIFT = 0.15
# Brightness and colour differences of black.
_BLACK: F8 = np.array([BLACK, 128.0, 128.0])


class Anchor:
    """Registers pictures of a shaking camera to one picture of the scene.

    Corners are tracked with the pyramidal method of Lucas and Kanade. RANSAC finds the similarity
    that fits most of them, because objects hide some.
    """

    def __init__(self, picture: Image) -> None:
        """``picture``: (H, W) uint8, brightness."""
        corners = cv2.goodFeaturesToTrack(
            picture, _CORNERS, 0.01, max(3.0, _DISTANCE * picture.shape[1])
        )
        self._corners: F4 = np.zeros((0, 1, 2), np.float32)
        if corners is not None:
            self._corners = np.asarray(corners, np.float32)
        self._picture = picture.copy()
        self._centre: F8 = np.append(
            self._corners.reshape(-1, 2).sum(axis=0) / max(1, len(self._corners)), 1.0
        )

    def pose(self, picture: Image) -> F8:
        """(3, 3) map from pixels of the anchor's picture to those of another one (H, W), or
        `types.STILL` if it is not found.
        """
        if len(self._corners) < _MIN_INLIERS:
            return STILL
        tracked, found, _ = cv2.calcOpticalFlowPyrLK(
            self._picture, picture, self._corners, None, winSize=_WINDOW, maxLevel=_LEVELS
        )
        good = found.ravel() == 1
        if good.sum() < _MIN_INLIERS:
            return STILL
        matrix, inliers = cv2.estimateAffinePartial2D(
            self._corners[good], tracked[good], ransacReprojThreshold=_MAX_ERROR
        )
        if matrix is None or inliers.sum() < _MIN_INLIERS or inliers.mean() < _MIN_INLIER_SHARE:
            return STILL
        pose = np.vstack([matrix, [0.0, 0.0, 1.0]])
        if np.abs(self.moved(pose)).max() >= _MAX_SHIFT * picture.shape[1]:
            return STILL
        if abs(math.hypot(*matrix[:, 0]) - 1) >= _MAX_ZOOM:
            return STILL
        return pose

    def moved(self, pose: F8) -> F8:
        """(2,) pixels by which a pose shifts the centre of the corners; 0 if it is unknown."""
        if len(pose):
            return pose[:2] @ self._centre - self._centre[:2]
        return np.zeros(2)


def stabilised(picture: Image, shape: tuple[int, int], pose: F8) -> Image:
    """(n,) the planes of a picture registered to the scene; pixels from outside repeat the border.

    Parameters
    ----------
    picture : (n,) planes.
    shape : (H, W) of it.
    pose : (3, 3) from `Anchor.pose`.
    """
    out = np.empty_like(picture)
    targets = (luma(out, shape), *colours(out, shape))
    sources = (luma(picture, shape), *colours(picture, shape))
    for target, source, scale in zip(targets, sources, (1.0, 0.5, 0.5), strict=True):
        target[:] = cv2.warpAffine(
            source,
            pose[:2] * [1, 1, scale],
            source.shape[::-1],
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
    return out


def median(samples: Sequence[Image]) -> Image:
    """(n,) the median of each number of an odd number of samples (n,) uint8."""
    out = np.empty_like(samples[0])
    # Stacking all samples at once would double their memory.
    step = max(1, _BAND // len(samples))
    for start in range(0, len(out), step):
        band = slice(start, start + step)
        out[band] = middle_of(np.stack([one[band] for one in samples]))
    return out


def background(samples: Sequence[Image], shape: tuple[int, int]) -> tuple[Image, Bool]:
    """The empty scene: what recurs most, or else the median, or, where the gradients contradict it,
    the sample that fits them best.

    Parameters
    ----------
    samples : an odd number of pictures (n,), planes as in `kernels.change`, far apart in time.
    shape : (H, W) of them.

    Returns
    -------
    scene : (n,) its planes.
    hidden : (H, W) True where objects hid it most of the time.
    """
    typical = median(samples)
    height, width = shape
    scale = min(1.0, (_COARSE / (height * width)) ** 0.5)
    size = (max(8, round(width * scale)), max(8, round(height * scale)))
    small = np.stack([_shrunk(one, shape, size) for one in samples])
    recurs, alike = _recurring(small)
    usual = middle_of(small).astype(np.float32)
    shown = middle_of(small[alike, *np.indices(recurs.shape)]).astype(np.float32)
    target = _integrated(small, np.where(recurs[..., None], shown, usual), recurs)
    wrong = np.abs(target - usual).max(axis=2) > _WRONG
    if not wrong.any():
        return typical, np.zeros(shape, np.bool_)
    wrong = cv2.resize(cv2.dilate(wrong.astype(np.uint8), _RING), (width, height)) > 0
    # Each pixel's place in the low-resolution picture.
    rows = np.arange(height) * size[1] // height
    columns = np.arange(width) * size[0] // width
    recurring = wrong & recurs[np.ix_(rows, columns)]
    doubtful = wrong & ~recurring
    index = _plane_index(shape)
    chosen = typical[index]
    targets = cv2.resize(target, (width, height))[doubtful]
    chosen[doubtful] = _nearest(targets, samples, index[doubtful])
    row, column = np.nonzero(recurring)
    chosen[recurring] = _taken(samples, index[recurring], alike[:, rows[row], columns[column]])
    # The median removes a choice that differs from all around it: it is noise.
    chosen[doubtful] = cv2.medianBlur(chosen, 5)[doubtful]
    scene = typical.copy()
    scene[index[wrong]] = chosen[wrong]
    hidden = np.zeros(shape, np.bool_)
    difference = np.abs(_bgr(chosen[wrong]) - _bgr(typical[index[wrong]]))
    hidden[wrong] = difference.max(axis=1) > _HIDDEN
    return scene, hidden


def _recurring(small: Image) -> tuple[Bool, I8]:
    """(h, w) True where a patch recurs so often in samples (K, h, w, 3) that it is the scene, and
    (`_FEW`, h, w) samples that show it.

    It is visible for a while and hidden for a while; leaves change all the time.
    """
    counts = recurrences(small, _SAME, _REACH, _ALIKE)
    alike, runs = same_patches(small, _SAME, _REACH, _ALIKE, counts.argmax(axis=0), _FEW)
    often = counts.max(axis=0) + 1
    total = len(small)
    at_random = often * (total - often + 1) / total
    return np.asarray((often >= _RECURS * total) & (runs <= _STAYS * at_random)), np.asarray(alike)


def _taken(samples: Sequence[Image], index: I8, alike: I8) -> Image:
    """(m, 3) the medians of pixels in some samples each.

    ``index`` (m, 3): where the samples keep these pixels; ``alike`` (`_FEW`, m): the samples.
    """
    values = np.zeros((len(alike), *index.shape), np.uint8)
    for k, sample in enumerate(samples):
        turn, pixel = np.nonzero(alike == k)
        values[turn, pixel] = sample[index[pixel]]
    return np.asarray(middle_of(values), np.uint8)


def _plane_index(shape: tuple[int, int]) -> I8:
    """(H, W, 3) the index in planes (n,) of the brightness and both colours of each pixel."""
    height, width = shape
    half_width = (width + 1) // 2
    y, x = np.indices(shape)
    first = height * width + y // 2 * half_width + x // 2
    return np.stack([y * width + x, first, first + (height + 1) // 2 * half_width], axis=2)


def _nearest(targets: F4, samples: Sequence[Image], index: I8) -> Image:
    """(m, 3) brightness and colours of the samples nearest to the BGR ``targets`` (m, 3); the
    target itself if none is near.

    ``index`` (m, 3): where the samples keep these pixels.
    """
    nearest = np.asarray(targets @ FROM_BGR.T + _BLACK, np.float32)
    least = np.full(len(targets), 2 * _WRONG, np.float32)
    for sample in samples:
        values = sample[index]
        distance = np.abs(_bgr(values) - targets).max(axis=1)
        closer = distance < least
        nearest[closer] = values[closer]
        least[closer] = distance[closer]
    return np.asarray(np.clip(np.rint(nearest), 0, 255), np.uint8)


def _shrunk(picture: Image, shape: tuple[int, int], size: tuple[int, int]) -> Image:
    """(h, w, 3) BGR of planes (n,), resized."""
    planes = (luma(picture, shape), *colours(picture, shape))
    small = [cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in planes]
    return np.asarray(np.clip(np.rint(_bgr(np.dstack(small))), 0, 255), np.uint8)


def _bgr(planes: NDArray[Any]) -> F4:
    """(..., 3) blue, green and red from brightness and colour differences."""
    return np.asarray((planes - _BLACK) @ TO_BGR.T, np.float32)


def of_objects(hidden: Bool, min_side: F8, margin: int) -> Bool:
    """(H, W) True for hidden regions as large as objects, dilated; leaves hide smaller ones.

    Parameters
    ----------
    hidden : (H, W) True where the scene was hidden most of the time.
    min_side : (H,) side in pixels of the square that must fit into a region in this row.
    margin : side in pixels of the structuring element that dilates them, odd.
    """
    spots = hidden.astype(np.uint8)
    # Regions at the edge of the picture are assumed to continue outside.
    distance = cv2.distanceTransform(
        cv2.copyMakeBorder(spots, 1, 1, 1, 1, cv2.BORDER_REPLICATE), cv2.DIST_C, 3
    )[1:-1, 1:-1]
    _, label = cv2.connectedComponents(cv2.morphologyEx(spots, cv2.MORPH_OPEN, _RING))
    large = np.setdiff1d(label[2 * distance - 1 >= min_side[:, None]], 0)
    return np.asarray(
        cv2.dilate(np.isin(label, large).astype(np.uint8), np.ones((margin, margin), np.uint8)) > 0
    )


def middle_of(values: NDArray[Any]) -> NDArray[Any]:
    """The median of an odd number of values along the first axis."""
    return np.asarray(middle(np.ascontiguousarray(values).reshape(len(values), -1))).reshape(
        values.shape[1:]
    )


def _integrated(samples: Image, typical: F4, sure: Bool) -> F4:
    """(h, w, 3) the ``typical`` picture (h, w, 3) of samples (n, h, w, 3); where it is neither
    ``sure`` (h, w) nor that of nearly all samples, the picture integrated from the median
    gradients.
    """
    # Imported here because it takes long, and a live source does not need it.
    from scipy.sparse import diags, eye, kron, vstack
    from scipy.sparse.linalg import cg

    values = samples.astype(np.int16)
    agree = (np.abs(values - typical).max(axis=3) <= _SAME).mean(axis=0)
    uncertain: Bool = cv2.dilate(((agree < _CERTAIN) & ~sure).astype(np.uint8), _RING) > 0
    # Without certain pixels the picture would be determined only up to a constant.
    if not uncertain.any() or uncertain.mean() > _MAX_UNCERTAIN:
        return typical
    unknown = uncertain.ravel()
    known = typical.reshape(-1, 3)
    height, width = uncertain.shape
    down = diags([-1.0, 1.0], [0, 1], (height - 1, height))
    along = diags([-1.0, 1.0], [0, 1], (width - 1, width))
    # One equation for each pair of neighbours: their difference is the median gradient.
    steps = vstack([kron(eye(height), along), kron(down, eye(width))]).tocsc()
    gradient = np.concatenate(
        [middle_of(np.diff(values, axis=axis)).reshape(-1, 3) for axis in (2, 1)]
    )
    free = steps[:, unknown]
    right = gradient - steps[:, ~unknown] @ known[~unknown]
    normal = (free.T @ free).tocsr()
    out = typical.copy()
    for channel in range(3):
        start = known[unknown, channel]
        out[uncertain, channel] = cg(
            normal, free.T @ right[:, channel], start, rtol=1e-3, maxiter=300
        )[0]
    return out
