"""Sprites of people, plants, leaves, lamps and obstacles.

A sprite is (h, w, 4) uint8: blue, green, red multiplied by the opacity, and the opacity.
Premultiplied, it can be scaled and moved by fractions of pixels without seams. Sprites are drawn a
few times larger, then reduced. A person is drawn once per phase of the step, in units of the
height, from the side, walking to the right: y = 0 at the crown, y = 1 at the ground. A plant is
drawn once and then bent: its image is sampled at x − d, with d growing from the foot to the top.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.opencv_package import cv2
from phdtrack.types import F8, Image, SequenceInfo

F4 = NDArray[np.float32]
Colour = tuple[int, ...]
Spot = tuple[float, float]

# Phases of a cycle of two steps.
PHASES = 12
_HEIGHT = 128
_FINE = 3
_SKIN: tuple[Colour, ...] = ((130, 160, 215), (110, 140, 200), (70, 100, 160), (50, 70, 110))
_HAIR: tuple[Colour, ...] = ((20, 25, 35), (30, 45, 70), (70, 120, 170), (150, 150, 150))
_COATS: tuple[Colour, ...] = (
    *((35, 30, 150), (140, 60, 25), (30, 25, 25), (235, 235, 240)),
    *((40, 120, 35), (30, 160, 225), (110, 35, 95), (190, 150, 40)),
)
_TROUSERS: tuple[Colour, ...] = (
    (25, 25, 28),
    (85, 45, 25),
    (110, 75, 45),
    (40, 55, 75),
    (215, 215, 215),
)
_COAT: tuple[Spot, ...] = (
    *((-0.07, 0.16), (0.06, 0.16), (0.085, 0.22), (0.075, 0.40)),
    *((0.09, 0.55), (-0.09, 0.55), (-0.08, 0.40), (-0.095, 0.22)),
)
_LEAVES: tuple[Colour, ...] = ((30, 90, 150), (40, 130, 170), (40, 110, 60), (25, 60, 95))


class Placed(NamedTuple):
    """An image (h, w, 3 or 4) and the pixel of its upper left corner."""

    image: Image
    left: int
    top: int


def put(canvas: Image, placed: Placed) -> None:
    """Draw a sprite on the canvas (H, W, 3) in place, clipped to it."""
    sprite, left, top = placed
    x = max(left, 0)
    y = max(top, 0)
    part = sprite[
        y - top : max(canvas.shape[0] - top, 0), x - left : max(canvas.shape[1] - left, 0)
    ]
    if part.size:
        room = canvas[y : y + part.shape[0], x : x + part.shape[1]]
        clear = cv2.bitwise_not(part[:, :, 3])
        below = cv2.multiply(room, cv2.merge((clear, clear, clear)), scale=1 / 255)
        cv2.add(below, np.ascontiguousarray(part[:, :, :3]), dst=room)


def pyramid(sprite: Image) -> tuple[Image, ...]:
    """The sprite at full, half, quarter … size, down to 12 pixels in height."""
    levels = [sprite]
    while levels[-1].shape[0] // 2 >= 12 and levels[-1].shape[1] >= 4:
        levels.append(_smaller(levels[-1], 2))
    return tuple(levels)


def scaled(levels: tuple[Image, ...], box: F8, *, mirrored: bool = False) -> Placed:
    """A sprite, given in the sizes of `pyramid`, that fills ``box`` (4,) to fractions of a
    pixel.

    Parameters
    ----------
    levels : the sizes of the sprite.
    box : (4,) xyxy, pixels.
    mirrored : True to mirror it left to right.
    """
    left, top, right, bottom = box.tolist()
    sprite = levels[0]
    for level in levels:
        if level.shape[0] >= bottom - top:
            sprite = level
    x0 = int(np.floor(left))
    y0 = int(np.floor(top))
    size = (int(np.ceil(right)) - x0, int(np.ceil(bottom)) - y0)
    across = (right - left) / sprite.shape[1]
    down = (bottom - top) / sprite.shape[0]
    start = (right - across / 2 if mirrored else left + across / 2) - x0 - 0.5
    move = np.array(
        [[-across if mirrored else across, 0, start], [0, down, top + down / 2 - y0 - 0.5]]
    )
    return Placed(cv2.warpAffine(sprite, move, size, flags=cv2.INTER_LINEAR), x0, y0)


def walking_person(rng: np.random.Generator, aspect: float) -> tuple[tuple[Image, ...], ...]:
    """The sprites of a person of random appearance for each of the `PHASES`; ``aspect`` is width
    over height.
    """
    colours = [each[int(rng.integers(len(each)))] for each in (_SKIN, _HAIR, _COATS, _TROUSERS)]
    return tuple(pyramid(_phase(colours, aspect, 2 * np.pi * k / PHASES)) for k in range(PHASES))


def _phase(colours: Sequence[Colour], aspect: float, angle: float) -> Image:
    """The sprite of one phase of the step; ``angle`` in radians is 0 when the legs pass."""
    skin, hair, coat, trousers = colours
    scale = _HEIGHT * _FINE
    width = max(round(aspect * _HEIGHT), 8)
    canvas = np.zeros((scale, width * _FINE, 4), np.uint8)
    swing = min(0.5, 1.15 * aspect)
    thighs = [(swing * np.sin(a), 0.6 * max(0.0, float(np.cos(a)))) for a in (angle + np.pi, angle)]
    legs = [_bones((0.0, 0.52), (0.235, 0.235), (thigh, thigh - knee)) for thigh, knee in thighs]
    sink = 0.985 - max(leg[2][1] for leg in legs)
    swings = [0.9 * swing * np.sin(a) for a in (angle, angle + np.pi)]
    far_arm, near_arm = (_bones((0.0, 0.21), (0.15, 0.14), (arm, arm + 0.3)) for arm in swings)

    def at(spot: Spot) -> tuple[int, int]:
        return round(spot[0] * scale + canvas.shape[1] / 2), round((spot[1] + sink) * scale)

    def limb(colour: Colour, thick: float, *joints: Spot) -> None:
        line = np.array([at(joint) for joint in joints], np.int32)
        cv2.polylines(
            canvas, [line], False, (*colour, 255), max(1, round(thick * scale)), cv2.LINE_AA
        )

    def oval(colour: Colour, centre: Spot, radii: Spot, start: float = 0, end: float = 360) -> None:
        axes = (round(radii[0] * scale), round(radii[1] * scale))
        cv2.ellipse(canvas, at(centre), axes, 0, start, end, (*colour, 255), -1, cv2.LINE_AA)

    limb(coat, 0.042, *far_arm)
    for (hip, knee, ankle), light in zip(legs, (0.75, 1.0), strict=True):
        colour = tuple(int(light * part) for part in trousers)
        limb(colour, 0.085, hip, knee)
        limb(colour, 0.06, knee, ankle)
        limb(
            (25, 25, 30),
            0.035,
            (ankle[0] - 0.01, ankle[1] - 0.005),
            (ankle[0] + 0.055, ankle[1] - 0.003),
        )
    cv2.fillPoly(
        canvas, [np.array([at(corner) for corner in _COAT], np.int32)], (*coat, 255), cv2.LINE_AA
    )
    limb(skin, 0.05, (0.0, 0.12), (0.0, 0.16))
    oval(skin, (0.008, 0.078), (0.05, 0.066))
    oval(hair, (-0.004, 0.066), (0.056, 0.064), 150, 330)
    limb(tuple(int(0.8 * part) for part in coat), 0.045, *near_arm)
    oval(skin, near_arm[-1], (0.024, 0.024))
    # Lit from the upper left.
    lit = (
        np.linspace(1.12, 0.78, canvas.shape[1])[None, :, None]
        * np.linspace(1.08, 0.88, scale)[:, None, None]
    )
    canvas[:, :, :3] = np.clip(canvas[:, :, :3] * lit, 0, 255)
    return _smaller(canvas)


def _smaller(canvas: Image, factor: int = _FINE) -> Image:
    """The canvas reduced by the factor."""
    size = canvas.shape[1] // factor, canvas.shape[0] // factor
    return np.asarray(cv2.resize(canvas, size, interpolation=cv2.INTER_AREA))


def _bones(joint: Spot, lengths: Spot, angles: Spot) -> list[Spot]:
    """The ends of two bones that hang at ``joint``; angles in radians, forward positive."""
    spots = [joint]
    for length, angle in zip(lengths, angles, strict=True):
        spots.append((spots[-1][0] + length * np.sin(angle), spots[-1][1] + length * np.cos(angle)))
    return spots


class Plant(NamedTuple):
    """A plant at ``rest``; the row of its ``foot``; its ``bend`` (h, 1) from foot to top; and the
    ``phase`` (h, w) of its trembling.
    """

    rest: Placed
    foot: float
    bend: F4
    phase: F4

    def waving(self, time: float, gust: float) -> Placed:
        """The plant at a ``time`` in seconds, with its top displaced by ``gust`` pixels."""
        sway = gust * (
            0.7 * np.sin(2 * np.pi * 0.9 * time + self.foot) + 0.3 * np.sin(2 * np.pi * 2.3 * time)
        )
        tremble = np.sin(self.phase + np.float32(2 * np.pi * 3.1 * time))
        y, x = np.ogrid[: self.phase.shape[0], : self.phase.shape[1]]
        across = x - self.bend * (np.float32(sway) + np.float32(0.6 * gust) * tremble)
        down = y - self.bend * np.float32(0.35 * gust) * tremble
        bent = cv2.remap(
            self.rest.image, across.astype(np.float32), down.astype(np.float32), cv2.INTER_LINEAR
        )
        return self.rest._replace(image=bent)


def grow_plant(box: F8, rng: np.random.Generator) -> Plant:
    """A plant that fills ``box`` (4,), pixels, at rest: a stem and leaves in many shades of green,
    dark ones behind.
    """
    inner = max(round(float(box[2] - box[0])), 8), max(round(float(box[3] - box[1])), 8)
    margin = max(4, inner[1] // 8)
    width = inner[0] + 2 * margin
    height = inner[1] + margin
    turn = rng.uniform(0, 2 * np.pi, 3)
    y, x = np.ogrid[:height, :width]
    phase = 0.45 * x + turn[0] + 2 * np.sin(0.23 * y + turn[1]) + 0.31 * y
    bend = np.sqrt((height - y) / height)
    canvas = np.zeros((height * _FINE, width * _FINE, 4), np.uint8)
    stem = width * _FINE // 2
    thick = max(2, inner[0] * _FINE // 12)
    cv2.line(canvas, (stem, height * _FINE), (stem, height), (40, 60, 80, 255), thick, cv2.LINE_AA)
    number = int(np.clip(inner[0] * inner[1] / 20, 60, 400))
    angle = rng.uniform(0, 2 * np.pi, number)
    radius = np.sqrt(rng.random(number))
    centre_x = margin + inner[0] * (0.5 + 0.46 * radius * np.cos(angle))
    centre_y = margin + inner[1] * (0.45 + 0.43 * radius * np.sin(angle))
    light = np.clip(np.sort(rng.random(number)) + 0.3 * np.sin(5 * angle + 6 * radius), 0, 1)
    length = _FINE * min(inner) * rng.uniform(0.08, 0.17, number)
    for i in range(number):
        tone = (
            int(25 + 60 * light[i]),
            int(50 + 150 * light[i]),
            int(30 + 110 * light[i] * rng.random()),
            255,
        )
        centre = (round(centre_x[i] * _FINE), round(centre_y[i] * _FINE))
        axes = (round(length[i]), round(0.45 * length[i]))
        cv2.ellipse(canvas, centre, axes, float(rng.uniform(0, 180)), 0, 360, tone, -1, cv2.LINE_AA)
    rest = Placed(_smaller(canvas), round(float(box[0])) - margin, round(float(box[1])) - margin)
    return Plant(rest, float(box[3]), bend.astype(np.float32), phase.astype(np.float32))


def blown_leaf(height: int, rng: np.random.Generator) -> Image:
    """A leaf in the wind in front of the camera, blurred along its path, which is mostly downward.
    ``height`` is that of the frame, pixels.
    """
    length = max(8.0, 0.05 * height * 3.6 ** rng.random())
    thick = max(4.0, length * float(rng.uniform(0.3, 0.6)))
    side = int(np.ceil(length)) + 8
    tilt = float(rng.normal(90, 30))
    tone = np.clip(np.array(_LEAVES[rng.integers(len(_LEAVES))]) * rng.uniform(0.7, 1.3), 0, 255)
    canvas = np.zeros((side, side, 4), np.uint8)
    axes = (max(2, round(length / 2)), max(2, round(thick / 2)))
    cv2.ellipse(
        canvas,
        (side // 2, side // 2),
        axes,
        tilt,
        0,
        360,
        (*(tone * 235 / 255), 235),
        -1,
        cv2.LINE_AA,
    )
    return np.asarray(cv2.GaussianBlur(canvas, (0, 0), max(0.6, 0.04 * length)))


def lamp(info: SequenceInfo, rng: np.random.Generator) -> Placed:
    """A lamp or reflection at a random position, switched on; its width is a fiftieth to a
    twentieth of that of the frame.
    """
    radius = float(rng.uniform(0.012, 0.025)) * info.width
    flat = float(rng.uniform(0.4, 1.0))
    half = (max(3, round(1.6 * radius)), max(3, round(1.6 * radius * flat)))
    y, x = np.mgrid[-half[1] : half[1] + 1, -half[0] : half[0] + 1]
    shape = np.exp(-(((x / radius) ** 2 + (y / (radius * flat)) ** 2) ** 2))
    colour = np.array([rng.uniform(60, 170), rng.uniform(120, 190), 200])
    left = int(rng.integers(0, max(info.width - 2 * half[0] - 1, 1)))
    top = int(rng.integers(0, max(info.height - 2 * half[1] - 1, 1)))
    return Placed((shape[:, :, None] * colour).astype(np.uint8), left, top)


def shadow(darkness: float) -> Image:
    """(24, 64, 4) the sprite of a soft shadow on the ground; ``darkness`` from 0 to 1."""
    y, x = np.mgrid[-1:1:24j, -1:1:64j]
    sprite = np.zeros((24, 64, 4), np.uint8)
    sprite[:, :, 3] = darkness * 255 * np.clip(1.2 * (1 - (x**2 + y**2)), 0, 1)
    return sprite


def surface(colour: tuple[float, float, float], light: F8) -> Image:
    """(h, w, 3) a surface of ``colour`` (blue, green, red) under the brightness factors ``light``
    (h, w).
    """
    return np.clip(np.array(colour) * light[:, :, None], 0, 255).astype(np.uint8)


def grain(height: int, width: int, rng: np.random.Generator) -> F8:
    """(height, width) noise of about unit variance with structure at all scales from 1 to 64
    pixels.

    Parameters
    ----------
    height, width : size in pixels.
    rng : the random generator.
    """
    total = np.zeros((height, width))
    for step in (64, 32, 16, 8, 4, 2, 1):
        small = rng.normal(size=(height // step + 2, width // step + 2))
        total += cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
    total /= total.std() + 1e-6
    return total


def obstacle(box: F8, rng: np.random.Generator) -> Placed:
    """A stone column that fills ``box`` (4,), lit from the left."""
    width = max(round(float(box[2] - box[0])), 4)
    height = max(round(float(box[3] - box[1])), 4)
    across = np.linspace(-0.9, 1, width)
    stone = surface(
        (150, 160, 166),
        (1.05 - 0.35 * across**2 - 0.12 * across) * (1 + 0.05 * grain(height, width, rng)),
    )
    stone[height // 12 :: max(height // 6, 4)] = (110, 118, 124)
    opaque = np.full((height, width, 1), 255, np.uint8)
    return Placed(
        np.concatenate([stone, opaque], axis=2), round(float(box[0])), round(float(box[1]))
    )
