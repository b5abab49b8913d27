"""Walking people, drawn once per phase of the step and then only scaled; and the sprites that all pictures are made of.

A sprite is (h, w, 4) uint8: blue, green, red multiplied by the opacity, and the opacity. Premultiplied, it can be scaled and
moved by parts of pixels without seams. A figure is drawn in units of its height, from the side, walking to the right: y = 0
at the crown, y = 1 at the ground. Arms and legs swing as pendulums, and the body sinks until the lower foot stands.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np

from phdtrack.types import F8, Image

PHASES = 12
STRIDE = 0.85
"""Body heights walked in one cycle of two steps."""
HEIGHT = 128
FINE = 3
"""Drawn this many times larger, then reduced: smooth edges."""

Colour = tuple[int, int, int]
Spot = tuple[float, float]

SKIN: tuple[Colour, ...] = ((130, 160, 215), (110, 140, 200), (70, 100, 160), (50, 70, 110))
HAIR: tuple[Colour, ...] = ((20, 25, 35), (30, 45, 70), (70, 120, 170), (150, 150, 150))
COATS: tuple[Colour, ...] = (
    *((35, 30, 150), (140, 60, 25), (30, 25, 25), (235, 235, 240)),
    *((40, 120, 35), (30, 160, 225), (110, 35, 95), (190, 150, 40)),
)
TROUSERS: tuple[Colour, ...] = ((25, 25, 28), (85, 45, 25), (110, 75, 45), (40, 55, 75), (215, 215, 215))
COAT: tuple[Spot, ...] = (
    *((-0.07, 0.16), (0.06, 0.16), (0.085, 0.22), (0.075, 0.40)),
    *((0.09, 0.55), (-0.09, 0.55), (-0.08, 0.40), (-0.095, 0.22)),
)
"""The outline of a coat."""


class Clothes(NamedTuple):
    """The colours of one person and the pattern of the coat: 0 plain, 1 stripes, 2 checks."""

    skin: Colour
    hair: Colour
    coat: Colour
    trousers: Colour
    pattern: int


def draw_clothes(rng: np.random.Generator) -> Clothes:
    """The looks of a person, drawn by chance."""
    skin, hair, coat, trousers = (each[int(rng.integers(len(each)))] for each in (SKIN, HAIR, COATS, TROUSERS))
    return Clothes(skin, hair, coat, trousers, int(rng.integers(3)))


def walking(clothes: Clothes, aspect: float) -> tuple[tuple[Image, ...], ...]:
    """For each of the `PHASES` the sprite pyramid of the person; ``aspect`` is its width over its height."""
    return tuple(pyramid(_phase(clothes, aspect, 2 * np.pi * k / PHASES)) for k in range(PHASES))


class _Pen:
    """Draws on a fine canvas in units of the figure's height; x = 0 is its axis. Keeps colour and opacity together."""

    def __init__(self, aspect: float) -> None:
        self.scale = HEIGHT * FINE
        self.size = (max(round(aspect * HEIGHT), 8), HEIGHT)
        self.colour = np.zeros((self.scale, self.size[0] * FINE, 3), np.uint8)
        self.opacity = np.zeros(self.colour.shape[:2], np.uint8)

    def _at(self, spot: Spot) -> tuple[int, int]:
        return round(spot[0] * self.scale + self.colour.shape[1] / 2), round(spot[1] * self.scale)

    def limb(self, colour: Colour, thick: float, *joints: Spot) -> None:
        """A line through the joints, rounded at them."""
        for a, b in pairwise(joints):
            for target, value in ((self.colour, colour), (self.opacity, 255)):
                cv2.line(target, self._at(a), self._at(b), value, max(1, round(thick * self.scale)), cv2.LINE_AA)

    def oval(self, colour: Colour, centre: Spot, radii: Spot, start: float = 0, end: float = 360) -> None:
        """A filled ellipse, or the sector of it between two angles."""
        axes = (round(radii[0] * self.scale), round(radii[1] * self.scale))
        for target, value in ((self.colour, colour), (self.opacity, 255)):
            cv2.ellipse(target, self._at(centre), axes, 0, start, end, value, -1, cv2.LINE_AA)

    def cloth(self, picture: Image, *corners: Spot) -> None:
        """A polygon that shows the part of ``picture`` (of the canvas's size) under it."""
        outline = np.array([self._at(c) for c in corners], np.int32)
        mask = np.zeros_like(self.opacity)
        cv2.fillPoly(mask, [outline], 255, cv2.LINE_AA)
        self.colour[mask > 0] = picture[mask > 0]
        np.maximum(self.opacity, mask, out=self.opacity)

    def finish(self) -> Image:
        """The sprite, shaded: lit from the upper left."""
        across = np.linspace(1.12, 0.78, self.colour.shape[1], dtype=np.float32)[None, :, None]
        down = np.linspace(1.08, 0.88, self.colour.shape[0], dtype=np.float32)[:, None, None]
        shaded = np.clip(self.colour * (across * down), 0, 255).astype(np.uint8)
        fine = premultiplied(shaded, self.opacity)
        small: Image = cv2.resize(fine, self.size, interpolation=cv2.INTER_AREA)
        return small


def _phase(clothes: Clothes, aspect: float, angle: float) -> Image:
    """The sprite of one phase of the step; ``angle`` in radians, 0 where the legs pass each other."""
    pen = _Pen(aspect)
    swing = min(0.5, 1.15 * aspect)
    thighs = [(swing * np.sin(a), 0.6 * max(0.0, float(np.cos(a)))) for a in (angle + np.pi, angle)]
    legs = [_limb((0.0, 0.52), (0.235, 0.235), (thigh, thigh - knee)) for thigh, knee in thighs]
    sink = 0.985 - max(foot[1] for *_, foot in legs)
    swings = [0.9 * swing * np.sin(a) for a in (angle, angle + np.pi)]
    far_arm, near_arm = (_limb((0.0, 0.21 + sink), (0.15, 0.14), (arm, arm + 0.3)) for arm in swings)
    dark: Colour = (clothes.trousers[0] * 3 // 4, clothes.trousers[1] * 3 // 4, clothes.trousers[2] * 3 // 4)
    pen.limb(clothes.coat, 0.042, *far_arm)
    for leg, colour in zip(legs, (dark, clothes.trousers), strict=True):
        hip, knee, ankle = ((x, y + sink) for x, y in leg)
        pen.limb(colour, 0.085, hip, knee)
        pen.limb(colour, 0.06, knee, ankle)
        pen.limb((25, 25, 30), 0.035, (ankle[0] - 0.01, ankle[1] - 0.005), (ankle[0] + 0.055, ankle[1] - 0.003))
    pen.cloth(_pattern(clothes, *pen.opacity.shape), *((x, y + sink) for x, y in COAT))
    pen.limb(clothes.skin, 0.05, (0.0, 0.12 + sink), (0.0, 0.16 + sink))
    pen.oval(clothes.skin, (0.008, 0.078 + sink), (0.05, 0.066))
    pen.oval(clothes.hair, (-0.004, 0.066 + sink), (0.056, 0.064), 150, 330)
    shade: Colour = (clothes.coat[0] * 4 // 5, clothes.coat[1] * 4 // 5, clothes.coat[2] * 4 // 5)
    pen.limb(shade, 0.045, *near_arm)
    pen.oval(clothes.skin, near_arm[-1], (0.024, 0.024))
    return pen.finish()


def _limb(joint: Spot, lengths: Spot, angles: Spot) -> list[Spot]:
    """The ends of two bones that hang at ``joint``; angles in radians, forward positive."""
    spots = [joint]
    for length, angle in zip(lengths, angles, strict=True):
        spots.append((spots[-1][0] + length * np.sin(angle), spots[-1][1] + length * np.cos(angle)))
    return spots


def _pattern(clothes: Clothes, height: int, width: int) -> Image:
    """(height, width, 3) the cloth of the coat."""
    cloth = np.empty((height, width, 3), np.uint8)
    cloth[:] = clothes.coat
    other = tuple((c + 255) // 2 if sum(clothes.coat) < 330 else c * 2 // 3 for c in clothes.coat)
    band = height // 32
    if clothes.pattern >= 1:
        cloth[(np.arange(height) // band) % 3 == 0] = other
    if clothes.pattern == 2:
        cloth[:, (np.arange(width) // band) % 3 == 0] = other
    return cloth


def premultiplied(colour: Image, opacity: Image) -> Image:
    """The sprite of ``colour`` (h, w, 3) where ``opacity`` (h, w) says so."""
    bgr = cv2.multiply(colour, cv2.merge([opacity] * 3), scale=1 / 255)
    return np.dstack([bgr, opacity])


def pyramid(sprite: Image, smallest: int = 12) -> tuple[Image, ...]:
    """The sprite at full, half, quarter … size, as long as it is ``smallest`` pixels high."""
    levels = [sprite]
    while levels[-1].shape[0] // 2 >= smallest and levels[-1].shape[1] >= 4:
        height, width = levels[-1].shape[:2]
        levels.append(cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA))
    return tuple(levels)


def put(canvas: Image, sprite: Image, left: int, top: int) -> None:
    """Put the sprite on the canvas, in place, with its corner at this pixel; what lies outside is cut."""
    height, width = sprite.shape[:2]
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + width, canvas.shape[1]), min(top + height, canvas.shape[0])
    if x0 >= x1 or y0 >= y1:
        return
    part = sprite[y0 - top : y1 - top, x0 - left : x1 - left]
    room = canvas[y0:y1, x0:x1]
    clear = cv2.bitwise_not(part[:, :, 3])
    below = cv2.multiply(room, cv2.merge((clear, clear, clear)), scale=1 / 255)
    cv2.add(below, np.ascontiguousarray(part[:, :, :3]), dst=room)


def put_scaled(canvas: Image, levels: tuple[Image, ...], box: F8, *, mirrored: bool = False) -> None:
    """Put the sprite on the canvas, in place, so that it fills ``box`` (4,) exactly, parts of pixels included."""
    left, top, right, bottom = (float(v) for v in box)
    fitting = [level for level in levels if level.shape[0] >= bottom - top]
    sprite = fitting[-1] if fitting else levels[0]
    x0, y0 = int(np.floor(left)), int(np.floor(top))
    size = (int(np.ceil(right)) - x0, int(np.ceil(bottom)) - y0)
    across, down = (right - left) / sprite.shape[1], (bottom - top) / sprite.shape[0]
    start = (right - across / 2 if mirrored else left + across / 2) - x0 - 0.5
    move = np.array([[-across if mirrored else across, 0, start], [0, down, top + down / 2 - y0 - 0.5]])
    put(canvas, cv2.warpAffine(sprite, move, size, flags=cv2.INTER_LINEAR), x0, y0)
