"""Plants whose leaves wave: the clutter that stays in its place and still cannot be foreseen.

A plant is drawn once and then bent: its picture is sampled at x − d, with a displacement d that grows from the foot to
the top, sways as a whole and trembles from leaf to leaf. Gusts scale it: they come and go irregularly, so that a change
detector fires there often, but not always, and with ever different boxes.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from phdtrack.simulate.paint.sprite import premultiplied, put
from phdtrack.types import F8, Image

F4 = NDArray[np.float32]

GUST_SECONDS = 1.2
"""How long a gust lasts, about."""


@dataclass(frozen=True, slots=True, eq=False)
class Plant:
    """A plant ready to wave.

    ``sprite`` (h, w, 4) with a margin around; ``left``, ``top`` its corner in the picture; ``foot`` the row where it stands;
    ``x``, ``y`` (h, w) pixel coordinates; ``bend`` (h, w) 0 at the foot, 1 at the top; ``phase`` (h, w) of the trembling.
    """

    sprite: Image
    left: int
    top: int
    foot: float
    x: F4
    y: F4
    bend: F4
    phase: F4

    def wave(self, canvas: Image, time: float, gust: float) -> None:
        """Draw the plant on the canvas, in place, at ``time`` in seconds; ``gust`` is its displacement in pixels."""
        sway = gust * (0.7 * np.sin(2 * np.pi * 0.9 * time + self.foot) + 0.3 * np.sin(2 * np.pi * 2.3 * time))
        tremble = np.sin(self.phase + np.float32(2 * np.pi * 3.1 * time))
        across = self.x - self.bend * (np.float32(sway) + np.float32(0.6 * gust) * tremble)
        down = self.y - self.bend * np.float32(0.35 * gust) * tremble
        put(canvas, cv2.remap(self.sprite, across, down, cv2.INTER_LINEAR), self.left, self.top)


def grow(box: F8, rng: np.random.Generator) -> Plant:
    """A plant that fills ``box`` (4,), pixels, when it is at rest."""
    inner = max(round(float(box[2] - box[0])), 8), max(round(float(box[3] - box[1])), 8)
    margin = max(4, inner[1] // 8)
    width, height = inner[0] + 2 * margin, inner[1] + margin
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    bend: F4 = np.clip((height - y) / np.float32(height), 0, 1).astype(np.float32) ** np.float32(0.5)
    turn = rng.uniform(0, 2 * np.pi, 3)
    phase: F4 = 0.45 * x + np.float32(turn[0]) + 2 * np.sin(0.23 * y + np.float32(turn[1])) + 0.31 * y
    sprite = _leaves(inner, margin, width, height, rng)
    return Plant(sprite, round(float(box[0])) - margin, round(float(box[1])) - margin, float(box[3]), x, y, bend, phase)


def _leaves(inner: tuple[int, int], margin: int, width: int, height: int, rng: np.random.Generator) -> Image:
    """(height, width, 4) a stem and many leaves in all shades of green, dark ones behind."""
    fine = 3
    colour = np.zeros((height * fine, width * fine, 3), np.uint8)
    opacity = np.zeros(colour.shape[:2], np.uint8)
    middle = (width * fine // 2, height * fine)
    for target, value in ((colour, (40, 60, 80)), (opacity, 255)):
        cv2.line(target, middle, (middle[0], height * fine // 3), value, max(2, inner[0] * fine // 12), cv2.LINE_AA)
    number = int(np.clip(inner[0] * inner[1] / 20, 60, 400))
    angle, radius = rng.uniform(0, 2 * np.pi, number), np.sqrt(rng.random(number))
    centre_x = margin + inner[0] / 2 + 0.46 * inner[0] * radius * np.cos(angle)
    centre_y = margin + 0.45 * inner[1] + 0.43 * inner[1] * radius * np.sin(angle)
    light = np.clip(np.sort(rng.random(number)) + 0.3 * np.sin(5 * angle + 6 * radius), 0, 1)
    length = rng.uniform(0.08, 0.17, number) * min(inner)
    for i in range(number):
        tone = (int(25 + 60 * light[i]), int(50 + 150 * light[i]), int(30 + 110 * light[i] * rng.random()))
        at = (round(centre_x[i] * fine), round(centre_y[i] * fine))
        axes = (max(2, round(length[i] * fine)), max(1, round(0.45 * length[i] * fine)))
        tilt = float(rng.uniform(0, 180))
        cv2.ellipse(colour, at, axes, tilt, 0, 360, tone, -1, cv2.LINE_AA)
        cv2.ellipse(opacity, at, axes, tilt, 0, 360, 255, -1, cv2.LINE_AA)
    small: Image = cv2.resize(premultiplied(colour, opacity), (width, height), interpolation=cv2.INTER_AREA)
    return small


def gusts(frames: int, fps: float, plants: int, strength: F8, rng: np.random.Generator) -> F8:
    """(frames, plants) displacement in pixels: ``strength`` (plants,) times what is often near 0 and at times 2."""
    keep = np.exp(-1 / (GUST_SECONDS * fps))
    level = rng.normal(size=plants)
    force = np.empty((frames, plants))
    for k, kick in enumerate(rng.normal(size=(frames, plants)) * np.sqrt(1 - keep**2)):
        level = keep * level + kick
        force[k] = level
    return strength * np.clip(0.5 + 0.8 * force, 0.05, 2.0)
