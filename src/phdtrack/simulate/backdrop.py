"""The empty scene: a wall with doors and windows, pavement and road."""

from __future__ import annotations

import numpy as np

from phdtrack.opencv_package import cv2
from phdtrack.simulate.sprites import Colour, Spot, grain, surface
from phdtrack.types import F8, Image, SequenceInfo


def backdrop(info: SequenceInfo, base: int, doors: F8, rng: np.random.Generator) -> Image:
    """(H, W, 3) the empty scene; the wall meets the ground in row ``base``, and ``doors`` (D, 4)
    are in pixels.

    Parameters
    ----------
    info : size of the frame.
    base : the row in which the wall meets the ground.
    doors : (D, 4) xyxy, pixels.
    rng : the random generator.
    """
    wall_rng, ground_rng = rng.spawn(2)
    image = np.concatenate(
        [_wall(base, info.width, wall_rng), _ground(info.height - base, info.width, ground_rng)]
    )
    for left, top, right, bottom in np.round(doors).astype(int).tolist():
        edge = max(2, (right - left) // 10)
        cv2.rectangle(image, (left - edge, top - edge), (right + edge, bottom), (150, 158, 164), -1)
        _shade(image, (left, top, right, bottom), (30, 30, 34), (70, 70, 74))
    image[base : base + 2] //= 2
    return np.ascontiguousarray(cv2.GaussianBlur(image, (0, 0), 0.6))


def _shade(
    image: Image, box: tuple[int, int, int, int], above: Spot | Colour, below: Spot | Colour
) -> None:
    """Fill a box of the image in place with a gradient from the colour ``above`` to ``below``,
    clipped to the image.
    """
    left, top, right, bottom = box
    tones = np.linspace(above, below, max(bottom - top, 1))[max(-top, 0) : image.shape[0] - top]
    image[max(top, 0) : max(top, 0) + len(tones), max(left, 0) : right] = tones[:, None]


def _wall(height: int, width: int, rng: np.random.Generator) -> Image:
    """(height, width, 3) bricks, and windows with panes that are brighter at the top."""
    light = 1 + 0.05 * grain(height, width, rng)
    brick = max(6, width // 60)
    for course, row in enumerate(range(0, height, brick // 2)):
        light[row] *= 0.85
        light[row : row + brick // 2, (course % 2) * brick // 2 :: brick] *= 0.88
    wall = surface((118, 128, 142), light)
    storey = max(width // 6, 24)
    bay = max(width // 8, 20)
    frame = (168, 176, 180)
    wide = bay // 2
    high = storey // 2
    for top in range(height - int(0.75 * storey), -storey, -storey):
        for left in range(bay // 3, width, bay):
            cv2.rectangle(wall, (left - 2, top - 2), (left + wide + 2, top + high + 2), frame, -1)
            glass = np.array([92.0, 80.0, 66.0]) * rng.uniform(0.6, 1.3)
            if top + high > 0:
                _shade(
                    wall,
                    (left, top, left + wide + 1, top + high),
                    tuple(1.2 * glass),
                    tuple(0.7 * glass),
                )
            cv2.line(wall, (left + wide // 2, top), (left + wide // 2, top + high), frame, 1)
    return wall


def _ground(height: int, width: int, rng: np.random.Generator) -> Image:
    """(height, width, 3) a pavement of slabs along the wall, then the road; joints converge towards
    the horizon.
    """
    kerb = int(0.3 * height)
    light = 1 + 0.045 * grain(height, width, rng) + np.linspace(-0.04, 0.06, height)[:, None]
    ground = surface((98, 97, 95), light)
    ground[:kerb] = surface((136, 140, 142), light[:kerb])
    joint = (112, 115, 117)
    for foot in np.linspace(-2 * width, 3 * width, 60):
        cv2.line(
            ground[:kerb], (width // 2, -2 * height), (int(foot), height), joint, 1, cv2.LINE_AA
        )
    for row in (0.08, 0.18):
        cv2.line(ground, (0, int(row * height)), (width, int(row * height)), joint, 1, cv2.LINE_AA)
    cv2.rectangle(ground, (0, kerb), (width, kerb + max(2, height // 50)), (170, 174, 176), -1)
    for left in np.arange(-0.2, 1.2, 0.22):
        corners = [[left, 0.62], [left + 0.1, 0.62], [left + 0.102, 0.65], [left - 0.002, 0.65]]
        mark = (np.array(corners) * [width, height]).astype(np.int32)
        cv2.fillConvexPoly(ground, mark, (176, 180, 182), cv2.LINE_AA)
    return ground
