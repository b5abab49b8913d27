"""Cameras of every kind over the same ground, and pixels to try them with."""

from __future__ import annotations

import numpy as np

from phdtrack.ground import (
    CountedFrom,
    Flat,
    HomographyCamera,
    OpenCVLens,
    PosedCamera,
    Surface,
    Terrain,
    TsaiLens,
)

SIZE = (768.0, 576.0)
MATRIX = np.array([[850.0, 0, 380], [0, 870, 290], [0, 0, 1]])
BARREL = np.array([-0.28, 0.09, 8e-4, -6e-4, -0.01])
RATIONAL = np.array([0.3, -0.08, 6e-4, 4e-4, 0.02, 0.5, -0.05, 0.01])
PRISM = np.array([-0.2, 0.05, 5e-4, 3e-4, 0.01, 0.02, 0.01, 0.0, 1e-3, -5e-4, 7e-4, 2e-4])


def tsai(kappa: float) -> TsaiLens:
    """A lens of 5.5 mm before pixels of 5 µm; ``kappa`` per square millimetre."""
    return TsaiLens(
        focal=5.5e-3, dx=5.1e-6, dy=4.6e-6, kappa=1e6 * kappa, cx=370.0, cy=280.0, sx=1.08
    )


def looking(
    position: tuple[float, float, float], at: tuple[float, float], roll: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """R and T of a camera at ``position`` that looks at the ground point ``at``, turned about its
    axis by ``roll``.
    """
    forward = np.array([*at, 0.0]) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    upright = np.array([right, np.cross(forward, right), forward])
    c = np.cos(roll)
    s = np.sin(roll)
    rotation = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ upright
    return rotation, -rotation @ np.array(position)


ROTATION, TRANSLATION = looking((-20.0, -25.0, 7.0), (0.0, 0.0))


def posed(lens: object, surface: Surface | None = None, roll: float = 0.0) -> PosedCamera:
    rotation, translation = looking((-20.0, -25.0, 7.0), (0.0, 0.0), roll)
    return PosedCamera(lens, rotation, translation, surface or Flat())  # type: ignore[arg-type]


def hills(height: float = 1.5) -> Terrain:
    """Rolling ground, 200 m wide, known every 2 m."""
    x, y = np.meshgrid(np.arange(-100, 101, 2.0), np.arange(-100, 101, 2.0))
    return Terrain(
        np.array([-100.0, -100]),
        np.array([2.0, 2]),
        height * np.sin(x / 15) * np.cos(y / 20) + 0.01 * x,
    )


# From pixels to metres of the undistorted camera at the same place.
PLANE = np.linalg.inv(MATRIX @ np.column_stack([ROTATION[:, 0], ROTATION[:, 1], TRANSLATION]))

CAMERAS = {
    "tsai": posed(tsai(5e-3)),
    "tsai, barrel": posed(tsai(-5e-3)),
    "tsai, no distortion": posed(tsai(0.0)),
    "tsai, turned": posed(tsai(5e-3), roll=0.7),
    "tsai, lower ground": posed(tsai(5e-3), Flat(-1.5)),
    "opencv, pinhole": posed(OpenCVLens(MATRIX)),
    "opencv, five": posed(OpenCVLens(MATRIX, BARREL)),
    "opencv, rational": posed(OpenCVLens(MATRIX, RATIONAL)),
    "opencv, prism": posed(OpenCVLens(MATRIX, PRISM)),
    "homography": HomographyCamera(PLANE),
    "homography, counted from 1": CountedFrom(HomographyCamera(PLANE)),
    "homography, other sign": HomographyCamera(-3 * PLANE, inside=(380.0, 500.0)),
    "terrain": posed(tsai(5e-3), hills()),
    "opencv on terrain": posed(OpenCVLens(MATRIX, BARREL), hills()),
}


def pixels(rng: np.random.Generator, n: int) -> np.ndarray:
    """(2, n) pixels of the frame, the horizon and the sky included."""
    return rng.uniform([[0.0], [-200.0]], [[SIZE[0]], [SIZE[1]]], (2, n))
