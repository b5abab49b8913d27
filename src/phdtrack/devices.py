"""Pictures as decoders give them, and the geometry of a calibrated camera."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from phdtrack.opencv_package import cv2
from phdtrack.types import F8, Frame, Image


class Camera(Protocol):
    """Maps between the pixels of one camera and the ground, in metres of its own world.

    A ray that does not meet the ground in front of the camera, and a point that no pixel shows,
    give columns of NaN. They never raise an error.

    Parameters
    ----------
    pixel : (2, N) pixels.
    world : (3, N) points in metres, or (2, N) those on the ground.
    """

    def ground(self, pixel: F8) -> F8:
        """(2, N) ground points, metres, shown by the pixels (2, N)."""

    def pixels(self, world: F8) -> F8:
        """(2, N) pixels that show world points (3, N), or ground points (2, N), metres."""

    def jacobian(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `ground` at the pixels (2, N), metres per pixel; rows X, Y."""

    def depth(self, world: F8) -> F8:
        """(N,) distance in metres along the viewing direction of world points (3, N), or ground
        points (2, N); negative behind the camera.
        """


class Picture(Protocol):
    """A picture as a decoder gives it, converted when it is needed.

    Parameters
    ----------
    size : width and height in pixels; None: the picture's own.
    """

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    def bgr(self, size: tuple[int, int] | None = None) -> Image:
        """(H, W, 3) BGR uint8 of this width and height, or of its own size, which is converted
        only once.
        """

    def planes(self, size: tuple[int, int] | None = None) -> Image:
        """(n,) uint8, YUV 4:2:0 (black is 16) of this width and height, or of its own size.

        Brightness, H·W numbers, is followed by blue and red colour differences, as the source
        defines them, of half width and height, rounded up. The caller may write into it.
        """

    def prepare(self, size: tuple[int, int]) -> None:
        """Convert to planes of this width and height now, for the next call of `planes`."""


class Planar:
    """A picture stored as ``planes`` of this ``size`` (`Picture.planes`)."""

    def __init__(self, size: tuple[int, int], planes: Image) -> None:
        self.size = size
        self._planes = planes
        self._image: Image | None = None

    def bgr(self, size: tuple[int, int] | None = None) -> Image:
        """(H, W, 3) BGR uint8 of this width and height, or of its own size, which is converted
        only once.
        """
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
        """The planes of `Picture.planes`."""
        if size in (None, self.size):
            return self._planes.copy()
        return planes_of(self.bgr(), size)

    def prepare(self, size: tuple[int, int]) -> None:
        """Do nothing: the planes are stored."""


def bgr_of(picture: Image | Picture, size: tuple[int, int] | None = None) -> Image:
    """`Picture.bgr` of a picture, or of an image (H, W, 3) BGR uint8."""
    if not isinstance(picture, np.ndarray):
        return picture.bgr(size)
    if size is None or size == picture.shape[1::-1]:
        return picture
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def planes_of(picture: Image | Picture, size: tuple[int, int] | None = None) -> Image:
    """`Picture.planes` of a picture, or of an image (H, W, 3) BGR uint8."""
    if not isinstance(picture, np.ndarray):
        return picture.planes(size)
    image = bgr_of(picture, size)
    height, width = image.shape[:2]
    # An added row or column only matters for the colours.
    even = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
    whole = np.asarray(cv2.cvtColor(even, cv2.COLOR_BGR2YUV_I420), np.uint8)
    return np.concatenate([whole[:height, :width].ravel(), whole[len(even) :].ravel()])


def size_of(frame: Frame) -> tuple[int, int]:
    """Width and height in pixels of a frame, without converting its picture."""
    picture = frame.picture
    if isinstance(picture, np.ndarray):
        return picture.shape[1], picture.shape[0]
    width, height = picture.size
    return width, height
