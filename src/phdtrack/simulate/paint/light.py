"""Light: the flicker of the illumination, the noise of the camera, blinking lamps, shimmering reflections, shadows."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from phdtrack.simulate.paint.sprite import premultiplied
from phdtrack.types import F8, I8, Image, SequenceInfo

MIDDLE = 64
"""The grey level that stands for no noise in the pool."""
SHIFT = 48
"""The pool of noise is this much larger than a frame; every frame takes another part of it."""


def flicker(frames: int, fps: float, strength: float, rng: np.random.Generator) -> F8:
    """(frames,) brightness factors around 1: flickering lamps and slow clouds; ``strength`` is their standard deviation."""
    fast, slow = (_wandering(frames, seconds * fps, rng) for seconds in (0.06, 3.0))
    return np.clip(1 + strength * (0.8 * fast + 0.6 * slow), 0.5, 1.5)


def _wandering(frames: int, memory: float, rng: np.random.Generator) -> F8:
    """(frames,) a stationary process of unit variance whose correlation falls to 1/e in ``memory`` frames."""
    keep = np.exp(-1 / memory)
    value = rng.normal()
    out = np.empty(frames)
    for k, kick in enumerate(rng.normal(size=frames) * np.sqrt(1 - keep**2)):
        value = keep * value + kick
        out[k] = value
    return out


def noise_pool(info: SequenceInfo, strength: float, rng: np.random.Generator) -> Image:
    """(H + `SHIFT`, W + `SHIFT`, 3) noise of ``strength`` grey levels around `MIDDLE`."""
    shape = (info.height + SHIFT, info.width + SHIFT, 3)
    noise = rng.normal(MIDDLE, max(strength, 1e-9), size=shape)
    return np.clip(np.rint(noise), 0, 255).astype(np.uint8)


def exposed(canvas: Image, gain: float, pool: Image, corner: I8) -> Image:
    """(H, W, 3) what the camera makes of the canvas: brightness times ``gain``, plus the noise of the pool at ``corner``."""
    height, width = canvas.shape[:2]
    part = pool[corner[0] : corner[0] + height, corner[1] : corner[1] + width]
    seen: Image = cv2.addWeighted(canvas, gain, part, 1.0, -MIDDLE)
    return seen


@dataclass(frozen=True, slots=True, eq=False)
class Lamp:
    """A small light, ``glow`` (h, w, 3) when it is on, with its corner at ``left``, ``top``."""

    glow: Image
    left: int
    top: int

    def shine(self, canvas: Image, level: float) -> None:
        """Add the light to the canvas, in place, at ``level`` from 0 to 1."""
        height, width = self.glow.shape[:2]
        room = canvas[self.top : self.top + height, self.left : self.left + width]
        cv2.addWeighted(room, 1.0, self.glow, level, 0, dst=room)


def lamps(info: SequenceInfo, number: int, rng: np.random.Generator) -> tuple[Lamp, ...]:
    """Lamps and reflections at random places, a fiftieth to a twentieth of the frame wide."""
    made = []
    for _ in range(number):
        radius = float(rng.uniform(0.012, 0.025)) * info.width
        flat = float(rng.uniform(0.4, 1.0))
        half = (max(3, round(1.6 * radius)), max(3, round(1.6 * radius * flat)))
        y, x = np.mgrid[-half[1] : half[1] + 1, -half[0] : half[0] + 1]
        shape = np.exp(-(((x / radius) ** 2 + (y / (radius * flat)) ** 2) ** 2))
        colour = np.array([rng.uniform(60, 170), rng.uniform(120, 190), 200])
        left = int(rng.integers(0, max(info.width - 2 * half[0] - 1, 1)))
        top = int(rng.integers(0, max(info.height - 2 * half[1] - 1, 1)))
        made.append(Lamp((shape[:, :, None] * colour).astype(np.uint8), left, top))
    return tuple(made)


def blinking(frames: int, fps: float, number: int, rng: np.random.Generator) -> F8:
    """(frames, number) levels 0 or 1 that change by chance about every second; the odd ones shimmer in between instead."""
    switches = rng.random((frames, number)) < 1 / fps
    on = (np.cumsum(switches, axis=0) + rng.integers(0, 2, number)) % 2
    shimmer = np.array([_wandering(frames, 0.15 * fps, rng) for _ in range(number)]).reshape(number, frames).T
    odd = np.arange(number) % 2 == 1
    return np.where(odd, np.clip(0.4 + 0.4 * shimmer, 0, 1), on.astype(np.float64))


def shadow(darkness: float) -> Image:
    """(24, 64, 4) the sprite of a soft shadow on the ground."""
    y, x = np.mgrid[-1:1:24j, -1:1:64j]
    opacity = darkness * 255 * np.clip(1.2 * (1 - (x**2 + y**2)), 0, 1)
    return premultiplied(np.zeros((24, 64, 3), np.uint8), opacity.astype(np.uint8))
