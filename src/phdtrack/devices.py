"""What stands before a tracker: the detector, and the geometry of a camera that is calibrated."""

from __future__ import annotations

from typing import Protocol

from phdtrack.types import F8, Detections, Frame


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


class Detector(Protocol):
    """From a frame to detections. Background models keep what they have learned of the scene inside: `reset` forgets it."""

    def __call__(self, frame: Frame) -> Detections:
        """The boxes found in the frame, in its own pixel coordinates."""

    def reset(self) -> None:
        """Forget everything learned from earlier frames."""
