"""A camera for pixels that are counted from another number than 0, as MOTChallenge's files count them from 1."""

from __future__ import annotations

from dataclasses import dataclass

from phdtrack.protocols import Camera
from phdtrack.types import F8


@dataclass(frozen=True, slots=True)
class CountedFrom:
    """``camera``, whose pixels count from 0, for pixels whose first is ``first`` along both axes."""

    camera: Camera
    first: float = 1.0

    def ground(self, pixel: F8) -> F8:
        """(2, N) points of the ground, metres, that the pixels (2, N) show."""
        return self.camera.ground(pixel - self.first)

    def pixels(self, world: F8) -> F8:
        """(2, N) pixels that show the world points (3, N), or (2, N) of the ground, metres."""
        return self.camera.pixels(world) + self.first

    def jacobian(self, pixel: F8) -> F8:
        """(N, 2, 2) derivatives of `ground` at the pixels (2, N), metres per pixel."""
        return self.camera.jacobian(pixel - self.first)

    def depth(self, world: F8) -> F8:
        """(N,) distance along the viewing direction, metres."""
        return self.camera.depth(world)
