"""The renderer: from a scene to a video with what makes change detection hard.

Painted from back to front: the backdrop, lights on it, shadows, then figures, obstacles and plants
by the row of the foot; at last the camera adds flicker and noise. Gusts scale how far a plant
bends: a change detector fires there often, not always, with ever different boxes. A leaf that the
wind blows past the camera is in one frame only: to a detector it is Poisson clutter.

A sprite is (h, w, 4) uint8: blue, green, red multiplied by the opacity, and the opacity.
Premultiplied, it can be scaled and moved by parts of pixels without seams. Sprites are drawn a few
times larger, then reduced. A person is drawn once per phase of the step, in units of the height,
from the side, walking to the right: y = 0 at the crown, y = 1 at the ground. A plant is drawn once
and then bent: its picture is sampled at x − d, with d growing from the foot to the top.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phdtrack.simulate.detector import place_boxes
from phdtrack.simulate.scenes import Look, Scene
from phdtrack.types import F8, I8, Bool, Frame, Image, SequenceInfo, Truth

F4 = NDArray[np.float32]
Colour = tuple[int, ...]
Spot = tuple[float, float]

_PHASES = 12
# Body heights walked in one cycle of two steps.
_STRIDE = 0.85
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


class _Placed(NamedTuple):
    """A picture (h, w, 3 or 4) and the pixel of its upper left corner."""

    picture: Image
    left: int
    top: int


def _put(canvas: Image, placed: _Placed) -> None:
    """Put a sprite on the canvas (H, W, 3), in place; what lies outside is cut."""
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


def _pyramid(sprite: Image) -> tuple[Image, ...]:
    """The sprite at full, half, quarter … size, at least 12 pixels high."""
    levels = [sprite]
    while levels[-1].shape[0] // 2 >= 12 and levels[-1].shape[1] >= 4:
        levels.append(_smaller(levels[-1], 2))
    return tuple(levels)


def _scaled(levels: tuple[Image, ...], box: F8, *, mirrored: bool = False) -> _Placed:
    """A sprite in the sizes of `_pyramid` that fills ``box`` (4,) exactly, parts of pixels
    included.
    """
    left, top, right, bottom = box.tolist()
    fitting = [level for level in levels if level.shape[0] >= bottom - top]
    if fitting:
        sprite = fitting[-1]
    else:
        sprite = levels[0]
    x0 = int(np.floor(left))
    y0 = int(np.floor(top))
    size = (int(np.ceil(right)) - x0, int(np.ceil(bottom)) - y0)
    across = (right - left) / sprite.shape[1]
    down = (bottom - top) / sprite.shape[0]
    start = (right - across / 2 if mirrored else left + across / 2) - x0 - 0.5
    move = np.array(
        [[-across if mirrored else across, 0, start], [0, down, top + down / 2 - y0 - 0.5]]
    )
    return _Placed(cv2.warpAffine(sprite, move, size, flags=cv2.INTER_LINEAR), x0, y0)


def _walking(rng: np.random.Generator, aspect: float) -> tuple[tuple[Image, ...], ...]:
    """For each of the `_PHASES` the sprites of a person with looks drawn by chance; ``aspect`` is
    width over height.
    """
    colours = [each[int(rng.integers(len(each)))] for each in (_SKIN, _HAIR, _COATS, _TROUSERS)]
    return tuple(_pyramid(_phase(colours, aspect, 2 * np.pi * k / _PHASES)) for k in range(_PHASES))


def _phase(colours: Sequence[Colour], aspect: float, angle: float) -> Image:
    """The sprite of one phase of the step; ``angle`` in radians, 0 where the legs pass each
    other.
    """
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
    """The canvas, reduced by the factor."""
    size = canvas.shape[1] // factor, canvas.shape[0] // factor
    return np.asarray(cv2.resize(canvas, size, interpolation=cv2.INTER_AREA))


def _bones(joint: Spot, lengths: Spot, angles: Spot) -> list[Spot]:
    """The ends of two bones that hang at ``joint``; angles in radians, forward positive."""
    spots = [joint]
    for length, angle in zip(lengths, angles, strict=True):
        spots.append((spots[-1][0] + length * np.sin(angle), spots[-1][1] + length * np.cos(angle)))
    return spots


class _Plant(NamedTuple):
    """A plant at rest; the row where it stands; ``bend`` (h, 1) from foot to top; ``phase`` (h, w)
    of its trembling.
    """

    rest: _Placed
    foot: float
    bend: F4
    phase: F4

    def waving(self, time: float, gust: float) -> _Placed:
        """The plant at a time in seconds, its top displaced by ``gust`` pixels."""
        sway = gust * (
            0.7 * np.sin(2 * np.pi * 0.9 * time + self.foot) + 0.3 * np.sin(2 * np.pi * 2.3 * time)
        )
        tremble = np.sin(self.phase + np.float32(2 * np.pi * 3.1 * time))
        y, x = np.ogrid[: self.phase.shape[0], : self.phase.shape[1]]
        across = x - self.bend * (np.float32(sway) + np.float32(0.6 * gust) * tremble)
        down = y - self.bend * np.float32(0.35 * gust) * tremble
        bent = cv2.remap(
            self.rest.picture, across.astype(np.float32), down.astype(np.float32), cv2.INTER_LINEAR
        )
        return self.rest._replace(picture=bent)


def _grow(box: F8, rng: np.random.Generator) -> _Plant:
    """A plant that fills ``box`` (4,), pixels, at rest: a stem and leaves in all shades of green,
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
    rest = _Placed(_smaller(canvas), round(float(box[0])) - margin, round(float(box[1])) - margin)
    return _Plant(rest, float(box[3]), bend.astype(np.float32), phase.astype(np.float32))


def _blown_leaf(height: int, rng: np.random.Generator) -> Image:
    """A leaf in the wind before the camera, smeared along its way; mostly it falls. ``height`` is
    the frame's, pixels.
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


def _lamp(info: SequenceInfo, rng: np.random.Generator) -> _Placed:
    """A lamp or reflection at a random place, a fiftieth to a twentieth of the frame wide, as it
    looks when it is on.
    """
    radius = float(rng.uniform(0.012, 0.025)) * info.width
    flat = float(rng.uniform(0.4, 1.0))
    half = (max(3, round(1.6 * radius)), max(3, round(1.6 * radius * flat)))
    y, x = np.mgrid[-half[1] : half[1] + 1, -half[0] : half[0] + 1]
    shape = np.exp(-(((x / radius) ** 2 + (y / (radius * flat)) ** 2) ** 2))
    colour = np.array([rng.uniform(60, 170), rng.uniform(120, 190), 200])
    left = int(rng.integers(0, max(info.width - 2 * half[0] - 1, 1)))
    top = int(rng.integers(0, max(info.height - 2 * half[1] - 1, 1)))
    return _Placed((shape[:, :, None] * colour).astype(np.uint8), left, top)


def _shadow(darkness: float) -> Image:
    """(24, 64, 4) the sprite of a soft shadow on the ground; ``darkness`` 0 to 1."""
    y, x = np.mgrid[-1:1:24j, -1:1:64j]
    sprite = np.zeros((24, 64, 4), np.uint8)
    sprite[:, :, 3] = darkness * 255 * np.clip(1.2 * (1 - (x**2 + y**2)), 0, 1)
    return sprite


def _surface(colour: tuple[float, float, float], light: F8) -> Image:
    """(h, w, 3) a surface of ``colour`` (blue, green, red) under the brightness factors ``light``
    (h, w).
    """
    return np.clip(np.array(colour) * light[:, :, None], 0, 255).astype(np.uint8)


def _grain(height: int, width: int, rng: np.random.Generator) -> F8:
    """(height, width) noise of about unit variance with structure at all scales from 1 to 64
    pixels.
    """
    total = np.zeros((height, width))
    for step in (64, 32, 16, 8, 4, 2, 1):
        small = rng.normal(size=(height // step + 2, width // step + 2))
        total += cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
    total /= total.std() + 1e-6
    return total


def _obstacle(box: F8, rng: np.random.Generator) -> _Placed:
    """A stone column that fills ``box`` (4,), lit from the left."""
    width = max(round(float(box[2] - box[0])), 4)
    height = max(round(float(box[3] - box[1])), 4)
    across = np.linspace(-0.9, 1, width)
    stone = _surface(
        (150, 160, 166),
        (1.05 - 0.35 * across**2 - 0.12 * across) * (1 + 0.05 * _grain(height, width, rng)),
    )
    stone[height // 12 :: max(height // 6, 4)] = (110, 118, 124)
    opaque = np.full((height, width, 1), 255, np.uint8)
    return _Placed(
        np.concatenate([stone, opaque], axis=2), round(float(box[0])), round(float(box[1]))
    )


def _backdrop(info: SequenceInfo, base: int, doors: F8, rng: np.random.Generator) -> Image:
    """(H, W, 3) the empty scene; the wall meets the ground in the row ``base``, ``doors`` (D, 4)
    are in pixels.
    """
    wall_rng, ground_rng = rng.spawn(2)
    picture = np.concatenate(
        [_wall(base, info.width, wall_rng), _ground(info.height - base, info.width, ground_rng)]
    )
    for left, top, right, bottom in np.round(doors).astype(int).tolist():
        edge = max(2, (right - left) // 10)
        cv2.rectangle(
            picture, (left - edge, top - edge), (right + edge, bottom), (150, 158, 164), -1
        )
        _shade(picture, (left, top, right, bottom), (30, 30, 34), (70, 70, 74))
    picture[base : base + 2] //= 2
    return np.ascontiguousarray(cv2.GaussianBlur(picture, (0, 0), 0.6))


def _shade(
    picture: Image, box: tuple[int, int, int, int], above: Spot | Colour, below: Spot | Colour
) -> None:
    """Fill a box of the picture, in place, from one colour at its top to another at its bottom;
    what lies outside is cut.
    """
    left, top, right, bottom = box
    tones = np.linspace(above, below, max(bottom - top, 1))[max(-top, 0) : picture.shape[0] - top]
    picture[max(top, 0) : max(top, 0) + len(tones), max(left, 0) : right] = tones[:, None]


def _wall(height: int, width: int, rng: np.random.Generator) -> Image:
    """(height, width, 3) bricks, and windows whose panes are brighter towards the sky."""
    light = 1 + 0.05 * _grain(height, width, rng)
    brick = max(6, width // 60)
    for course, row in enumerate(range(0, height, brick // 2)):
        light[row] *= 0.85
        light[row : row + brick // 2, (course % 2) * brick // 2 :: brick] *= 0.88
    wall = _surface((118, 128, 142), light)
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
    """(height, width, 3) a pavement of slabs along the wall, then the road; joints converge as seen
    from above.
    """
    kerb = int(0.3 * height)
    light = 1 + 0.045 * _grain(height, width, rng) + np.linspace(-0.04, 0.06, height)[:, None]
    ground = _surface((98, 97, 95), light)
    ground[:kerb] = _surface((136, 140, 142), light[:kerb])
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


_GUST_SECONDS = 1.2
# The grey level that stands for no noise.
_MIDDLE = 64
# The noise is drawn this much larger than a frame; every frame takes another part of it.
_SHIFT = 48


class Rendered:
    """The video of a scene: a `Source` whose frames are painted when they are asked for, the same
    ones every time.

    ``rng`` draws one number, which decides all that is random in the video. ``look``: None for the
    usual one. ``plant_boxes`` (P, 4) are where plants grow: at the scene's persistent places, or at
    random ones of the figures' sizes.
    """

    def __init__(self, scene: Scene, rng: np.random.Generator, look: Look | None = None) -> None:
        look = look or Look()
        self.seed = int(rng.integers(2**62))
        streams = np.random.default_rng(self.seed).spawn(8)
        (
            places_rng,
            backdrop_rng,
            things_rng,
            plants_rng,
            gusts_rng,
            light_rng,
            noise_rng,
            blown_rng,
        ) = streams
        frames = scene.info.frames
        info = scene.info
        figures = scene.figures.xyxy
        self.scene = scene
        self.info = info
        self._phase, self._leftward = _gait(scene.figures)
        self._wardrobe: dict[
            int, tuple[tuple[Image, ...], ...]
        ] = {}  # figures are drawn when they first appear
        # The wall meets the ground a little above the uppermost foot.
        if len(figures):
            highest = figures[:, 3].min()
        else:
            highest = 0.5 * info.height
        base = int(np.clip(highest - 0.01 * info.height, 0.15 * info.height, 0.6 * info.height))
        self._backdrop = _backdrop(info, base, scene.doors, backdrop_rng)
        places = place_boxes(info, look.plants, figures[:, 2:] - figures[:, :2], places_rng)
        self.plant_boxes = boxes = scene.places if len(scene.places) else places
        self._plants = [
            _grow(box, own) for box, own in zip(boxes, plants_rng.spawn(len(boxes)), strict=True)
        ]
        # Displacements (frames, P) by the wind, pixels: often near 0, at times twice the usual.
        force = _wandering((frames, len(boxes)), _GUST_SECONDS * info.fps, gusts_rng)
        self._gusts = (
            look.wave * (boxes[:, 3] - boxes[:, 1]) * np.clip(0.5 + 0.8 * force, 0.05, 2.0)
        )
        stones = zip(scene.obstacles, things_rng.spawn(len(scene.obstacles)), strict=True)
        self._things = [_obstacle(box, own) for box, own in stones]
        self._lamps = [_lamp(info, light_rng) for _ in range(look.lamps)]
        self._levels = _blinking(frames, info.fps, look.lamps, light_rng)
        # Brightness (frames,): flickering lamps and slow clouds.
        fast, slow = (
            _wandering((frames,), seconds * info.fps, light_rng) for seconds in (0.06, 3.0)
        )
        self._gain = np.clip(1 + look.flicker * (0.8 * fast + 0.6 * slow), 0.5, 1.5)
        larger = (info.height + _SHIFT, info.width + _SHIFT, 3)
        noise = noise_rng.normal(_MIDDLE, max(look.noise, 1e-9), size=larger)
        self._noise = np.clip(np.rint(noise), 0, 255).astype(np.uint8)
        self._corners = noise_rng.integers(0, _SHIFT, (frames, 2)).tolist()
        # Leaves in frames (M,), ascending, uniform over the frame.
        self._blown = np.repeat(np.arange(1, frames + 1), blown_rng.poisson(look.blown, frames))
        self._leaves = _leaves(info, len(self._blown), blown_rng)
        self._shadow = _pyramid(_shadow(look.shadow))

    def __iter__(self) -> Iterator[Frame]:
        """The frames, numbered from 1; ``image`` is (H, W, 3) BGR."""
        for number in range(1, self.info.frames + 1):
            yield Frame(number, (number - 1) / self.info.fps, self.paint(number))

    def paint(self, number: int) -> Image:
        """(H, W, 3) the picture of frame ``number``, from 1."""
        canvas = self._backdrop.copy()
        for (glow, left, top), level in zip(
            self._lamps, self._levels[number - 1].tolist(), strict=True
        ):
            room = canvas[top : top + glow.shape[0], left : left + glow.shape[1]]
            cv2.addWeighted(room, 1.0, glow, level, 0, dst=room)
        figures = self.scene.figures
        info = self.info
        here = np.arange(*np.searchsorted(figures.frame, [number, number + 1]))
        for left, _, right, bottom in figures.xyxy[
            here
        ]:  # a shadow a little to the right of the feet
            wide = right - left
            deep = 0.16 * (right - left)
            place = np.array([left + 0.1 * wide, bottom - deep, right + 0.25 * wide, bottom + deep])
            _put(canvas, _scaled(self._shadow, place))
        standing = [(float(figures.xyxy[row, 3]), self._figure(int(row))) for row in here]
        standing += zip(self.scene.obstacles[:, 3].tolist(), self._things, strict=True)
        gusts = zip(self._plants, self._gusts[number - 1].tolist(), strict=True)
        standing += [(plant.foot, plant.waving(number / info.fps, gust)) for plant, gust in gusts]
        for _, placed in sorted(standing, key=lambda pair: pair[0]):
            _put(canvas, placed)
        for leaf in self._leaves[slice(*np.searchsorted(self._blown, [number, number + 1]))]:
            _put(canvas, leaf)
        top, left = self._corners[number - 1]
        noise = self._noise[top : top + info.height, left : left + info.width]
        return np.asarray(
            cv2.addWeighted(canvas, float(self._gain[number - 1]), noise, 1.0, -_MIDDLE)
        )

    def _figure(self, row: int) -> _Placed:
        """One figure, at this phase of its step."""
        box = self.scene.figures.xyxy[row]
        identity = int(self.scene.figures.identity[row])
        if identity not in self._wardrobe:
            aspect = float((box[2] - box[0]) / (box[3] - box[1]))
            self._wardrobe[identity] = _walking(
                np.random.default_rng([self.seed, identity]), aspect
            )
        return _scaled(
            self._wardrobe[identity][self._phase[row]], box, mirrored=bool(self._leftward[row])
        )


def _gait(figures: Truth) -> tuple[I8, Bool]:
    """(M,) the phase of the step that each row shows, and whether it walks to the left.

    The phase follows the way walked, in body heights, so that feet do not slide; a standing figure
    keeps it.
    """
    phase = np.zeros(len(figures), np.int64)
    leftward = np.zeros(len(figures), np.bool_)
    for identity in np.unique(figures.identity):
        rows = np.flatnonzero(figures.identity == identity)
        box = figures.xyxy[rows]
        across = np.diff((box[:, 0] + box[:, 2]) / 2, prepend=(box[0, 0] + box[0, 2]) / 2)
        way = np.hypot(across, np.diff(box[:, 3], prepend=box[0, 3])) / (box[:, 3] - box[:, 1])
        phase[rows] = np.floor(np.cumsum(way) / _STRIDE * _PHASES).astype(np.int64) % _PHASES
        moving = np.flatnonzero(np.abs(across) > 0.02)
        if len(moving):  # as in the last step with a direction, at first the one to come
            latest = np.searchsorted(moving, np.arange(len(rows)), side="right") - 1
            leftward[rows] = across[moving[np.maximum(latest, 0)]] < 0
    return phase, leftward


def _leaves(info: SequenceInfo, number: int, rng: np.random.Generator) -> list[_Placed]:
    """Blown leaves anywhere in the frame."""
    centre = rng.random((number, 2)) * np.array([info.width, info.height])
    if number:
        sprites = [_blown_leaf(info.height, rng) for _ in range(40)]
    else:
        sprites = []
    leaves = [sprites[k] for k in rng.integers(max(len(sprites), 1), size=number)]
    corner = centre - np.array([leaf.shape[1::-1] for leaf in leaves]).reshape(-1, 2) / 2
    return [
        _Placed(leaf, round(x), round(y))
        for leaf, (x, y) in zip(leaves, corner.tolist(), strict=True)
    ]


def _blinking(frames: int, fps: float, number: int, rng: np.random.Generator) -> F8:
    """(frames, number) levels 0 or 1 that change by chance about every second; the odd ones shimmer
    in between instead.
    """
    switches = rng.random((frames, number)) < 1 / fps
    levels = ((np.cumsum(switches, axis=0) + rng.integers(0, 2, number)) % 2).astype(np.float64)
    shimmer = [
        np.clip(0.4 + 0.4 * _wandering((frames,), 0.15 * fps, rng), 0, 1) for _ in range(number)
    ]
    levels[:, 1::2] = np.array(shimmer).reshape(number, frames)[1::2].T
    return levels


def _wandering(shape: tuple[int, ...], memory: float, rng: np.random.Generator) -> F8:
    """A stationary process of unit variance over the first axis, whose correlation falls to 1/e in
    ``memory`` frames.
    """
    keep = np.exp(-1 / memory)
    before = rng.normal(size=shape[1:])
    kicks = rng.normal(size=shape) * np.sqrt(1 - keep**2)
    return np.array([*accumulate(kicks, lambda value, kick: keep * value + kick, initial=before)])[
        1:
    ]
