"""Simulated scenes filmed by a moving camera: boxes, truth and pictures warped along a
known path.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.models import warp as warp_of
from phdtrack.simulate import Scene
from phdtrack.types import DetectionTable, Frame

MIDDLE = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])


def handheld(count: int, rng: np.random.Generator, shake: float = 8.0) -> np.ndarray:
    """(count + 1, 3, 3) maps from the still scene to frame k, from 1: a slow pan, hands that
    tremble, turn and zoom.
    """
    out = np.empty((count + 1, 3, 3))
    for k in range(count + 1):
        angle = rng.normal(0, 0.006)
        scale = np.exp(0.06 * np.sin(k / 15))
        c = scale * np.cos(angle)
        s = scale * np.sin(angle)
        x = 50 * np.sin(k / 9) + rng.normal(0, shake)
        y = 15 * np.sin(k / 6) + rng.normal(0, shake / 2)
        out[k] = [[c, -s, x], [s, c, y], [0, 0, 1]]
    return out


def step(path: np.ndarray, k: int) -> np.ndarray:
    """(3, 3) from the pixels of frame k − 1 to those of frame k."""
    return path[k] @ warp_of.back(path[k - 1])


def seen(path: np.ndarray, frame: np.ndarray, xyxy: np.ndarray) -> np.ndarray:
    """(n, 4) boxes of the frames (n,) where the camera sees them."""
    out = xyxy.copy()
    for k in np.unique(frame):
        z = to_cxcywh(xyxy[frame == k])
        moved = warp_of.warp_states(np.vstack([z[:2], 0 * z[:2], z[2:]]), path[k])
        half = moved[4:6] / 2
        out[frame == k] = np.vstack([moved[:2] - half, moved[:2] + half]).T
    return out


def points(warp: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(2, n) where the pixels ``p`` (2, n) of the frame before are in this one."""
    return cv2.perspectiveTransform(p.T[:, None], warp)[:, 0].T


def moving(scene: Scene, path: np.ndarray) -> Scene:
    """The scene's detections and truth in the pixels of the camera that moves."""
    truth = scene.truth
    table = scene.detections
    found = replace(table.detections, xyxy=seen(path, table.frame, table.detections.xyxy))
    return replace(
        scene,
        truth=replace(truth, xyxy=seen(path, truth.frame, truth.xyxy)),
        detections=DetectionTable(table.frame, found),
    )


def filmed(frame: Frame, path: np.ndarray, size: tuple[int, int]) -> Frame:
    """The part of the still picture that the camera shows, (width, height)."""
    by_middles = warp_of.back(MIDDLE) @ path[frame.number] @ MIDDLE
    picture = cv2.warpPerspective(
        frame.image, by_middles, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
    )
    return replace(frame, picture=picture)
