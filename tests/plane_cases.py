"""A level camera over the ground, written down anew for tests, and people who walk in front of
it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.types import Detections

FRAME = (640.0, 480.0)


@dataclass(frozen=True)
class LevelCamera:
    """At ``height`` metres, looking along Y; foot points lie ``focal``·height/Y pixels below the
    ``horizon`` row.
    """

    focal: float = 500.0
    height: float = 5.0
    horizon: float = 40.0
    centre: float = 320.0

    def ground(self, pixel):
        below = np.where(pixel[1] > self.horizon, pixel[1] - self.horizon, np.nan)
        y = self.focal * self.height / below
        return np.stack([(pixel[0] - self.centre) * y / self.focal, y])

    def pixels(self, world):
        y = np.where(world[1] > 0, world[1], np.nan)
        up = world[2] if len(world) == 3 else 0.0
        return np.stack(
            [
                self.centre + self.focal * world[0] / y,
                self.horizon + self.focal * (self.height - up) / y,
            ]
        )

    def jacobian(self, pixel):
        x, y = self.ground(pixel)
        row = y / (self.focal * self.height)
        out = np.zeros((pixel.shape[1], 2, 2))
        out[:, 0, 0] = y / self.focal
        out[:, 0, 1] = -x * row
        out[:, 1, 1] = -y * row
        return out

    def depth(self, world):
        return world[1].copy()


@dataclass(frozen=True)
class MapCamera(LevelCamera):
    """One that knows the ground and no heights, as a homography does."""

    def pixels(self, world):
        return super().pixels(world) if len(world) == 2 else np.full((2, world.shape[1]), np.nan)


def people(rng: np.random.Generator, n: int) -> np.ndarray:
    """(4, n) people at rest or walking, all of whose box is in the image."""
    place = np.stack([rng.uniform(-3, 3, n), rng.uniform(12, 30, n)])
    return np.vstack([place, rng.normal(0, 1, (2, n))])


def with_covariance(xyxy: np.ndarray, variance: np.ndarray) -> Detections:
    """Boxes (n, 4) with variances (n, 4) of centre and size."""
    found = Detections.of(xyxy)
    cov = np.apply_along_axis(np.diag, 1, variance) if len(variance) else np.zeros((0, 4, 4))
    return Detections(found.xyxy, found.confidence, found.class_id, cov)
