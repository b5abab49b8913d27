"""The scene without people: a wall with windows, a pavement, a road, and the doors."""

from __future__ import annotations

import cv2
import numpy as np

from phdtrack.simulate.paint.sprite import premultiplied
from phdtrack.simulate.paint.texture import grain, tinted
from phdtrack.types import F8, Image, SequenceInfo

WALL = (118.0, 128.0, 142.0)
PAVEMENT = (136.0, 140.0, 142.0)
ROAD = (98.0, 97.0, 95.0)
STONE = (150.0, 160.0, 166.0)


def backdrop(info: SequenceInfo, base: int, doors: F8, rng: np.random.Generator) -> Image:
    """(H, W, 3) the empty scene; ``base`` is the row where the wall meets the ground, ``doors`` (D, 4) are boxes."""
    wall_rng, ground_rng = rng.spawn(2)
    picture = np.empty((info.height, info.width, 3), np.uint8)
    picture[:base] = _wall(base, info.width, wall_rng)
    picture[base:] = _ground(info.height - base, info.width, ground_rng)
    for door in doors:
        _door(picture, door)
    picture[base : base + 2] = picture[base : base + 2] // 2
    return np.ascontiguousarray(cv2.GaussianBlur(picture, (0, 0), 0.6))


def _wall(height: int, width: int, rng: np.random.Generator) -> Image:
    """(height, width, 3) bricks and windows."""
    light = 1 + 0.05 * grain(height, width, rng)
    brick = max(6, width // 60)
    for course, row in enumerate(range(0, height, brick // 2)):
        light[row] *= 0.85
        light[row : row + brick // 2, (course % 2) * brick // 2 :: brick] *= 0.88
    wall = tinted(WALL, light)
    storey, bay = max(width // 6, 24), max(width // 8, 20)
    for top in range(height - int(0.75 * storey), -storey, -storey):
        for left in range(bay // 3, width, bay):
            _window(wall, left, top, int(0.5 * bay), int(0.5 * storey), float(rng.uniform(0.6, 1.3)))
    return wall


def _window(wall: Image, left: int, top: int, width: int, height: int, light: float) -> None:
    """One window, in place: a frame and a pane that is brighter towards the sky."""
    cv2.rectangle(wall, (left - 2, top - 2), (left + width + 2, top + height + 2), (168, 176, 180), -1)
    for row in range(max(top, 0), top + height):
        shade = light * (1.2 - 0.5 * (row - top) / height)
        cv2.line(wall, (left, row), (left + width, row), (int(92 * shade), int(80 * shade), int(66 * shade)), 1)
    cv2.line(wall, (left + width // 2, top), (left + width // 2, top + height), (168, 176, 180), 1)


def _ground(height: int, width: int, rng: np.random.Generator) -> Image:
    """(height, width, 3) a pavement of slabs along the wall, then the road; joints converge as seen from above."""
    kerb = int(0.3 * height)
    light = 1 + 0.045 * grain(height, width, rng) + np.linspace(-0.04, 0.06, height, dtype=np.float32)[:, None]
    ground = tinted(ROAD, light)
    ground[:kerb] = tinted(PAVEMENT, light[:kerb])
    vanishing = (width // 2, -2 * height)
    for foot in np.linspace(-2 * width, 3 * width, 60):
        _line_to(ground[:kerb], vanishing, (int(foot), height), (112, 115, 117))
    for row in (0.08, 0.18):
        cv2.line(ground, (0, int(row * height)), (width, int(row * height)), (112, 115, 117), 1, cv2.LINE_AA)
    cv2.rectangle(ground, (0, kerb), (width, kerb + max(2, height // 50)), (170, 174, 176), -1)
    for left in np.arange(-0.2, 1.2, 0.22):
        _dash(ground, left * width, 0.62 * height, 0.1 * width, 0.03 * height)
    return ground


def _line_to(picture: Image, start: tuple[int, int], end: tuple[int, int], colour: tuple[int, int, int]) -> None:
    """A thin line, in place."""
    cv2.line(picture, start, end, colour, 1, cv2.LINE_AA)


def _dash(ground: Image, left: float, top: float, width: float, height: float) -> None:
    """A white mark on the road, in place, seen in perspective."""
    corners = np.array(
        [[left, top], [left + width, top], [left + 1.02 * width, top + height], [left - 0.02 * width, top + height]]
    )
    cv2.fillConvexPoly(ground, corners.astype(np.int32), (176, 180, 182), cv2.LINE_AA)


def _door(picture: Image, box: F8) -> None:
    """A dark doorway with a light frame, in place."""
    left, top, right, bottom = (round(float(v)) for v in box)
    edge = max(2, (right - left) // 10)
    cv2.rectangle(picture, (left - edge, top - edge), (right + edge, bottom), (150, 158, 164), -1)
    for row in range(max(top, 0), min(bottom, picture.shape[0])):
        shade = 30 + 40 * (row - top) // max(bottom - top, 1)
        cv2.line(picture, (left, row), (right, row), (shade, shade, shade + 4), 1)


def obstacle(box: F8, rng: np.random.Generator) -> Image:
    """The sprite of a standing thing that fills ``box`` (4,): a stone column, lit from the left."""
    width, height = max(round(float(box[2] - box[0])), 4), max(round(float(box[3] - box[1])), 4)
    across = np.linspace(-0.9, 1, width, dtype=np.float32)
    light = (1.05 - 0.35 * across**2 - 0.12 * across)[None, :] * (1 + 0.05 * grain(height, width, rng, 16))
    stone = tinted(STONE, light.astype(np.float32))
    for row in range(height // 12, height, max(height // 6, 4)):
        cv2.line(stone, (0, row), (width, row), (110, 118, 124), 1)
    stone[: max(2, height // 30)] = stone[: max(2, height // 30)] // 2 + 90
    return premultiplied(stone, np.full((height, width), 255, np.uint8))
