"""What stands, waves and shines in a rendered scene: backdrop, obstacles, plants, blown leaves, lamps, light and noise.

A plant is drawn once and then bent: its picture is sampled at x − d, with a displacement d that grows from the foot to the
top and trembles from leaf to leaf. Gusts scale it: a change detector fires there often, not always, with ever different
boxes. A leaf that the wind blows past the camera is in one frame only: to a detector it is Poisson clutter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phdtrack.simulate.paint_figures import premultiplied, put
from phdtrack.types import F8, I8, Image, SequenceInfo

F4 = NDArray[np.float32]

WALL = (118.0, 128.0, 142.0)
PAVEMENT = (136.0, 140.0, 142.0)
ROAD = (98.0, 97.0, 95.0)
STONE = (150.0, 160.0, 166.0)
LEAF_LENGTHS = (0.05, 0.18)
"""Of a blown leaf, smeared, in frame heights."""
LEAF_COLOURS = ((30, 90, 150), (40, 130, 170), (40, 110, 60), (25, 60, 95))
GUST_SECONDS = 1.2
MIDDLE = 64
"""The grey level that stands for no noise."""
SHIFT = 48
"""The noise is drawn this much larger than a frame; every frame takes another part of it."""


class Placed(NamedTuple):
    """A picture (h, w, 3 or 4) and the pixel of its upper left corner."""

    picture: Image
    left: int
    top: int


def _grain(height: int, width: int, rng: np.random.Generator, coarsest: int = 64) -> F4:
    """(height, width) noise of about unit variance with structure at all scales from 1 to ``coarsest`` pixels."""
    total = np.zeros((height, width), np.float32)
    step = coarsest
    while step >= 1:
        small = rng.normal(size=(height // step + 2, width // step + 2)).astype(np.float32)
        total += cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
        step //= 2
    return total / np.float32(total.std() + 1e-6)


def _tinted(colour: tuple[float, float, float], light: F4) -> Image:
    """(h, w, 3) a surface of ``colour`` (blue, green, red) under the brightness factors ``light`` (h, w)."""
    surface: Image = np.clip(np.array(colour, np.float32) * light[:, :, None], 0, 255).astype(np.uint8)
    return surface


def backdrop(info: SequenceInfo, base: int, doors: F8, rng: np.random.Generator) -> Image:
    """(H, W, 3) the empty scene; ``base`` is the row where the wall meets the ground, ``doors`` (D, 4) are boxes."""
    wall_rng, ground_rng = rng.spawn(2)
    wall, ground = _wall(base, info.width, wall_rng), _ground(info.height - base, info.width, ground_rng)
    picture = np.concatenate([wall, ground])
    for left, top, right, bottom in np.round(doors).astype(int).tolist():
        edge = max(2, (right - left) // 10)
        cv2.rectangle(picture, (left - edge, top - edge), (right + edge, bottom), (150, 158, 164), -1)
        for row in range(max(top, 0), min(bottom, info.height)):
            shade = 30 + 40 * (row - top) // max(bottom - top, 1)
            cv2.line(picture, (left, row), (right, row), (shade, shade, shade + 4), 1)
    picture[base : base + 2] //= 2
    return np.ascontiguousarray(cv2.GaussianBlur(picture, (0, 0), 0.6))


def _wall(height: int, width: int, rng: np.random.Generator) -> Image:
    """(height, width, 3) bricks, and windows whose panes are brighter towards the sky."""
    light = 1 + 0.05 * _grain(height, width, rng)
    brick = max(6, width // 60)
    for course, row in enumerate(range(0, height, brick // 2)):
        light[row] *= 0.85
        light[row : row + brick // 2, (course % 2) * brick // 2 :: brick] *= 0.88
    wall = _tinted(WALL, light)
    storey, bay, frame = max(width // 6, 24), max(width // 8, 20), (168, 176, 180)
    wide, high = int(0.5 * bay), int(0.5 * storey)
    for top in range(height - int(0.75 * storey), -storey, -storey):
        for left in range(bay // 3, width, bay):
            cv2.rectangle(wall, (left - 2, top - 2), (left + wide + 2, top + high + 2), frame, -1)
            bright = float(rng.uniform(0.6, 1.3))
            for row in range(max(top, 0), top + high):
                shade = bright * (1.2 - 0.5 * (row - top) / high)
                cv2.line(wall, (left, row), (left + wide, row), (int(92 * shade), int(80 * shade), int(66 * shade)), 1)
            cv2.line(wall, (left + wide // 2, top), (left + wide // 2, top + high), frame, 1)
    return wall


def _ground(height: int, width: int, rng: np.random.Generator) -> Image:
    """(height, width, 3) a pavement of slabs along the wall, then the road; joints converge as seen from above."""
    kerb = int(0.3 * height)
    light = 1 + 0.045 * _grain(height, width, rng) + np.linspace(-0.04, 0.06, height, dtype=np.float32)[:, None]
    ground = _tinted(ROAD, light)
    ground[:kerb] = _tinted(PAVEMENT, light[:kerb])
    joint = (112, 115, 117)
    for foot in np.linspace(-2 * width, 3 * width, 60):
        cv2.line(ground[:kerb], (width // 2, -2 * height), (int(foot), height), joint, 1, cv2.LINE_AA)
    for row in (0.08, 0.18):
        cv2.line(ground, (0, int(row * height)), (width, int(row * height)), joint, 1, cv2.LINE_AA)
    cv2.rectangle(ground, (0, kerb), (width, kerb + max(2, height // 50)), (170, 174, 176), -1)
    for left in np.arange(-0.2, 1.2, 0.22):
        corners = [[left, 0.62], [left + 0.1, 0.62], [left + 0.102, 0.65], [left - 0.002, 0.65]]
        mark = np.array(corners) * [width, height]
        cv2.fillConvexPoly(ground, mark.astype(np.int32), (176, 180, 182), cv2.LINE_AA)
    return ground


def obstacle(box: F8, rng: np.random.Generator) -> Placed:
    """A stone column that fills ``box`` (4,), lit from the left."""
    width, height = max(round(float(box[2] - box[0])), 4), max(round(float(box[3] - box[1])), 4)
    across = np.linspace(-0.9, 1, width, dtype=np.float32)
    light = (1.05 - 0.35 * across**2 - 0.12 * across)[None, :] * (1 + 0.05 * _grain(height, width, rng, 16))
    stone = _tinted(STONE, light.astype(np.float32))
    for row in range(height // 12, height, max(height // 6, 4)):
        cv2.line(stone, (0, row), (width, row), (110, 118, 124), 1)
    stone[: max(2, height // 30)] = stone[: max(2, height // 30)] // 2 + 90
    sprite = premultiplied(stone, np.full((height, width), 255, np.uint8))
    return Placed(sprite, round(float(box[0])), round(float(box[1])))


@dataclass(frozen=True, slots=True, eq=False)
class Plant:
    """A plant ready to wave.

    ``sprite`` (h, w, 4) with a margin around; ``left``, ``top`` its corner in the picture; ``foot`` the row where it stands;
    ``bend`` (h, 1) 0 at the foot, 1 at the top; ``phase`` (h, w) of the trembling.
    """

    sprite: Image
    left: int
    top: int
    foot: float
    bend: F4
    phase: F4

    def wave(self, canvas: Image, time: float, gust: float) -> None:
        """Draw the plant on the canvas, in place, at ``time`` in seconds; ``gust`` is its displacement in pixels."""
        sway = gust * (0.7 * np.sin(2 * np.pi * 0.9 * time + self.foot) + 0.3 * np.sin(2 * np.pi * 2.3 * time))
        tremble = np.sin(self.phase + np.float32(2 * np.pi * 3.1 * time))
        x, y = _pixels(*self.phase.shape)
        across = x - self.bend * (np.float32(sway) + np.float32(0.6 * gust) * tremble)
        down = y - self.bend * np.float32(0.35 * gust) * tremble
        put(canvas, cv2.remap(self.sprite, across, down, cv2.INTER_LINEAR), self.left, self.top)


def _pixels(height: int, width: int) -> tuple[F4, F4]:
    """x (1, width) and y (height, 1) of the pixels of a picture."""
    return np.arange(width, dtype=np.float32)[None], np.arange(height, dtype=np.float32)[:, None]


def grow(box: F8, rng: np.random.Generator) -> Plant:
    """A plant that fills ``box`` (4,), pixels, when it is at rest."""
    inner = max(round(float(box[2] - box[0])), 8), max(round(float(box[3] - box[1])), 8)
    margin = max(4, inner[1] // 8)
    width, height = inner[0] + 2 * margin, inner[1] + margin
    x, y = _pixels(height, width)
    bend: F4 = np.clip((height - y) / np.float32(height), 0, 1).astype(np.float32) ** np.float32(0.5)
    turn = rng.uniform(0, 2 * np.pi, 3)
    phase: F4 = 0.45 * x + np.float32(turn[0]) + 2 * np.sin(0.23 * y + np.float32(turn[1])) + 0.31 * y
    sprite = _leaves(inner, margin, width, height, rng)
    return Plant(sprite, round(float(box[0])) - margin, round(float(box[1])) - margin, float(box[3]), bend, phase)


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


def gusts(frames: int, fps: float, strength: F8, rng: np.random.Generator) -> F8:
    """(frames, P) displacements of plants by the wind, pixels: often near 0, at times twice their ``strength`` (P,)."""
    force = _wandering((frames, len(strength)), GUST_SECONDS * fps, rng)
    return strength * np.clip(0.5 + 0.8 * force, 0.05, 2.0)


def blown(info: SequenceInfo, rate: float, rng: np.random.Generator) -> tuple[I8, list[Placed]]:
    """The frames (M,), ascending, and the places of Poisson(``rate``) leaves in each frame, uniform over it."""
    frame = np.repeat(np.arange(1, info.frames + 1), rng.poisson(rate, info.frames))
    centre = rng.random((len(frame), 2)) * np.array([info.width, info.height])
    sprites = [_blown_leaf(info.height, rng) for _ in range(40)] if len(frame) else []
    leaves = [sprites[k] for k in rng.integers(max(len(sprites), 1), size=len(frame))]
    corner = centre - np.array([leaf.shape[1::-1] for leaf in leaves]).reshape(-1, 2) / 2
    return frame, [Placed(leaf, round(x), round(y)) for leaf, (x, y) in zip(leaves, corner.tolist(), strict=True)]


def _blown_leaf(height: int, rng: np.random.Generator) -> Image:
    """One leaf, smeared along its way; mostly it falls."""
    low, high = LEAF_LENGTHS
    length = max(8.0, height * low * (high / low) ** rng.random())
    thick = max(4.0, length * float(rng.uniform(0.3, 0.6)))
    side = int(np.ceil(length)) + 8
    opacity = np.zeros((side, side), np.uint8)
    axes = (max(2, round(length / 2)), max(2, round(thick / 2)))
    cv2.ellipse(opacity, (side // 2, side // 2), axes, float(rng.normal(90, 30)), 0, 360, 235, -1, cv2.LINE_AA)
    opacity = cv2.GaussianBlur(opacity, (0, 0), max(0.6, 0.04 * length))
    tone = np.array(LEAF_COLOURS[rng.integers(len(LEAF_COLOURS))]) * rng.uniform(0.7, 1.3)
    colour = np.full((side, side, 3), np.clip(tone, 0, 255), np.uint8)
    return premultiplied(colour, opacity)


def flicker(frames: int, fps: float, strength: float, rng: np.random.Generator) -> F8:
    """(frames,) brightness factors around 1: flickering lamps and slow clouds; ``strength`` is their standard deviation."""
    fast, slow = (_wandering((frames,), seconds * fps, rng) for seconds in (0.06, 3.0))
    return np.clip(1 + strength * (0.8 * fast + 0.6 * slow), 0.5, 1.5)


def _wandering(shape: tuple[int, ...], memory: float, rng: np.random.Generator) -> F8:
    """A stationary process of unit variance over the first axis, whose correlation falls to 1/e in ``memory`` frames."""
    keep = np.exp(-1 / memory)
    value = rng.normal(size=shape[1:])
    out = np.empty(shape)
    for k, kick in enumerate(rng.normal(size=shape) * np.sqrt(1 - keep**2)):
        value = keep * value + kick
        out[k] = value
    return out


def camera_noise(info: SequenceInfo, strength: float, rng: np.random.Generator) -> list[Image]:
    """For each frame its noise (H, W, 3) of ``strength`` grey levels around `MIDDLE`: parts of one larger picture."""
    shape = (info.height + SHIFT, info.width + SHIFT, 3)
    pool = np.clip(np.rint(rng.normal(MIDDLE, max(strength, 1e-9), size=shape)), 0, 255).astype(np.uint8)
    corners = rng.integers(0, SHIFT, (info.frames, 2)).tolist()
    return [pool[top : top + info.height, left : left + info.width] for top, left in corners]


def lamps(info: SequenceInfo, number: int, rng: np.random.Generator) -> list[Placed]:
    """Lamps and reflections at random places, a fiftieth to a twentieth of the frame wide, as they look when they are on."""
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
        made.append(Placed((shape[:, :, None] * colour).astype(np.uint8), left, top))
    return made


def blinking(frames: int, fps: float, number: int, rng: np.random.Generator) -> F8:
    """(frames, number) levels 0 or 1 that change by chance about every second; the odd ones shimmer in between instead."""
    switches = rng.random((frames, number)) < 1 / fps
    on = (np.cumsum(switches, axis=0) + rng.integers(0, 2, number)) % 2
    shimmer = np.array([_wandering((frames,), 0.15 * fps, rng) for _ in range(number)]).reshape(number, frames).T
    odd = np.arange(number) % 2 == 1
    return np.where(odd, np.clip(0.4 + 0.4 * shimmer, 0, 1), on.astype(np.float64))


def shadow(darkness: float) -> Image:
    """(24, 64, 4) the sprite of a soft shadow on the ground."""
    y, x = np.mgrid[-1:1:24j, -1:1:64j]
    opacity = darkness * 255 * np.clip(1.2 * (1 - (x**2 + y**2)), 0, 1)
    return premultiplied(np.zeros((24, 64, 3), np.uint8), opacity.astype(np.uint8))
