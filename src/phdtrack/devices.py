"""What stands before a tracker: the detector, and the geometry of a camera that is calibrated."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from phdtrack.types import F8, Detections, Frame, Image


class Camera(Protocol):
    """Between the pixels of one camera and the ground, metres in a world of its own.

    A ray that does not meet the ground in front of the camera, and a point that no pixel shows, give columns of NaN: they
    are faults of single points and never errors of the call.
    """

    def ground(self, pixel: F8) -> F8:
        """(2, N) points of the ground, metres, that the pixels (2, N) show."""

    def pixels(self, world: F8) -> F8:
        """(2, N) pixels that show the world points (3, N), or points (2, N) of the ground, metres."""

    def jacobian(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `ground` at the pixels (2, N), metres per pixel; rows X, Y."""

    def depth(self, world: F8) -> F8:
        """(N,) distance along the viewing direction, metres, of points (3, N), or (2, N) of the ground; negative behind."""


class Picture(Protocol):
    """A picture as a decoder gives it; BGR is made of it where somebody needs that."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    def bgr(self, size: tuple[int, int] | None = None) -> Image:
        """(H, W, 3) BGR uint8 of this width and height, or of its own."""

    def planes(self) -> Image | None:
        """(3H/2, W) uint8, a copy of brightness and below it the colours (YUV 4:2:0); None where it is kept otherwise."""


def size_of(frame: Frame) -> tuple[int, int]:
    """Width and height in pixels of a frame; no image is made for that."""
    picture = frame.picture
    width, height = picture.shape[1::-1] if isinstance(picture, np.ndarray) else picture.size
    return width, height


class Detector(Protocol):
    """From a frame to detections. Background models keep what they have learned of the scene inside: `reset` forgets it."""

    def __call__(self, frame: Frame) -> Detections:
        """The boxes found in the frame, in its own pixel coordinates."""

    def reset(self) -> None:
        """Forget everything learned from earlier frames."""
