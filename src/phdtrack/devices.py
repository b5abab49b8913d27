"""What stands before a tracker: the detector, and the geometry of a camera that is calibrated."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from phdtrack.types import F8, Detections, Frame, Image


class Camera(Protocol):
    """Between the pixels of one camera and the ground, metres in a world of its own.

    A ray that does not meet the ground in front of the camera, and a point that no pixel shows,
    give columns of NaN: they are faults of single points and never errors of the call.
    """

    def ground(self, pixel: F8) -> F8:
        """(2, N) points of the ground, metres, that the pixels (2, N) show."""

    def pixels(self, world: F8) -> F8:
        """(2, N) pixels that show the world points (3, N), or points (2, N) of the ground,
        metres.
        """

    def jacobian(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `ground` at the pixels (2, N), metres per pixel; rows X, Y."""

    def depth(self, world: F8) -> F8:
        """(N,) distance along the viewing direction, metres, of points (3, N), or (2, N) of the
        ground; negative behind.
        """


class Picture(Protocol):
    """A picture as a decoder gives it; BGR is made of it where somebody needs that."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    def bgr(self, size: tuple[int, int] | None = None) -> Image:
        """(H, W, 3) BGR uint8 of this width and height, or of its own: that is made once."""

    def planes(self, size: tuple[int, int] | None = None) -> Image:
        """(n,) uint8, YUV 4:2:0 (black is 16) of this width and height, or its own: brightness, H·W
        numbers, then blue and red colour differences, as the source defines them, of half width and
        height, rounded up. May be written into."""

    def prepare(self, size: tuple[int, int]) -> None:
        """Make the planes of this width and height now, for the next one who asks for them."""


class Planar:
    """A picture kept as ``planes`` of this ``size``, as `Picture.planes` gives them."""

    def __init__(self, size: tuple[int, int], planes: Image) -> None:
        self.size = size
        self._planes = planes
        self._image: Image | None = None

    def bgr(self, size: tuple[int, int] | None = None) -> Image:
        """(H, W, 3) BGR uint8 of this width and height, or of its own: that is made once."""
        import cv2

        if self._image is None:
            width, height = self.size
            grey = np.pad(
                self._planes[: height * width].reshape(height, width),
                ((0, height % 2), (0, width % 2)),
                "edge",
            )
            whole = np.concatenate([grey.ravel(), self._planes[height * width :]]).reshape(
                -1, grey.shape[1]
            )
            bgr = cv2.cvtColor(whole, cv2.COLOR_YUV2BGR_I420)[:height, :width]
            self._image = np.ascontiguousarray(bgr, np.uint8)
        if size is None:
            return self._image
        return np.asarray(cv2.resize(self._image, size), np.uint8)

    def planes(self, size: tuple[int, int] | None = None) -> Image:
        """As `Picture.planes`."""
        if size in (None, self.size):
            return self._planes.copy()
        return planes_of(self.bgr(), size)

    def prepare(self, size: tuple[int, int]) -> None:
        """Nothing is prepared: `planes` has them already."""


def bgr_of(picture: Image | Picture, size: tuple[int, int] | None = None) -> Image:
    """What `Picture.bgr` says, of a picture or an image (H, W, 3) BGR uint8."""
    import cv2

    if not isinstance(picture, np.ndarray):
        return picture.bgr(size)
    same = size is None or size == picture.shape[1::-1]
    if same:
        return picture
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def planes_of(picture: Image | Picture, size: tuple[int, int] | None = None) -> Image:
    """What `Picture.planes` says, of a picture or an image (H, W, 3) BGR uint8."""
    import cv2

    if not isinstance(picture, np.ndarray):
        return picture.planes(size)
    image = bgr_of(picture, size)
    height, width = image.shape[:2]
    # Of a row and a column that are added only the colours are kept.
    even = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
    whole = np.asarray(cv2.cvtColor(even, cv2.COLOR_BGR2YUV_I420), np.uint8)
    return np.concatenate([whole[:height, :width].ravel(), whole[len(even) :].ravel()])


def size_of(frame: Frame) -> tuple[int, int]:
    """Width and height in pixels of a frame; no image is made for that."""
    picture = frame.picture
    width, height = picture.shape[1::-1] if isinstance(picture, np.ndarray) else picture.size
    return width, height
