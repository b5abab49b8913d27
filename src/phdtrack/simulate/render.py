"""The renderer: from a scene to a video with the usual difficulties of change detection.

Each frame is painted from back to front: the backdrop, lights on it, shadows, then figures,
obstacles and plants by the row of the foot; finally the camera adds flicker and noise. Gusts scale
the bending of a plant: a change detector fires there often, not always, with varying boxes. A leaf
that the wind blows past the camera is in one frame only: to a detector it is Poisson clutter.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate

import numpy as np

from phdtrack.opencv_package import cv2
from phdtrack.simulate.backdrop import backdrop
from phdtrack.simulate.detector import place_boxes
from phdtrack.simulate.scenes import Look, Scene
from phdtrack.simulate.sprites import (
    PHASES,
    Placed,
    blown_leaf,
    grow_plant,
    lamp,
    obstacle,
    put,
    pyramid,
    scaled,
    shadow,
    walking_person,
)
from phdtrack.types import F8, I8, Bool, Frame, Image, SequenceInfo, Truth

# Body heights walked in one cycle of two steps.
_STRIDE = 0.85
_GUST_SECONDS = 1.2
# The grey level of zero noise.
_MIDDLE = 64
# The noise image is larger than a frame by this many pixels; every frame uses another part of it.
_SHIFT = 48


class Rendered:
    """The video of a scene: a `Source` that paints its frames on demand, reproducibly.

    ``rng`` draws one number, the seed of everything random in the video. ``look`` None means
    `Look()`. ``plant_boxes`` (P, 4) are the plants: at the scene's persistent places, or at random
    places with the sizes of the figures.

    Parameters
    ----------
    scene : what is painted.
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
        # The sprites of each person, drawn when they first appear.
        self._people: dict[int, tuple[tuple[Image, ...], ...]] = {}
        # The wall meets the ground a little above the uppermost foot.
        highest = figures[:, 3].min() if len(figures) else 0.5 * info.height
        base = int(np.clip(highest - 0.01 * info.height, 0.15 * info.height, 0.6 * info.height))
        self._backdrop = backdrop(info, base, scene.doors, backdrop_rng)
        places = place_boxes(info, look.plants, figures[:, 2:] - figures[:, :2], places_rng)
        boxes = scene.places if len(scene.places) else places
        self.plant_boxes = boxes
        self._plants = [
            grow_plant(box, own)
            for box, own in zip(boxes, plants_rng.spawn(len(boxes)), strict=True)
        ]
        # Displacements (frames, P) by the wind, pixels: often near 0, sometimes twice the average.
        force = _wandering((frames, len(boxes)), _GUST_SECONDS * info.fps, gusts_rng)
        self._gusts = (
            look.wave * (boxes[:, 3] - boxes[:, 1]) * np.clip(0.5 + 0.8 * force, 0.05, 2.0)
        )
        stones = zip(scene.obstacles, things_rng.spawn(len(scene.obstacles)), strict=True)
        self._things = [obstacle(box, own) for box, own in stones]
        self._lamps = [lamp(info, light_rng) for _ in range(look.lamps)]
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
        self._shadow = pyramid(shadow(look.shadow))

    def __iter__(self) -> Iterator[Frame]:
        """The frames, numbered from 1; ``image`` is (H, W, 3) BGR."""
        for number in range(1, self.info.frames + 1):
            yield Frame(number, (number - 1) / self.info.fps, self.paint(number))

    def paint(self, number: int) -> Image:
        """(H, W, 3) the image of frame ``number``, from 1."""
        canvas = self._backdrop.copy()
        for (glow, left, top), level in zip(
            self._lamps, self._levels[number - 1].tolist(), strict=True
        ):
            room = canvas[top : top + glow.shape[0], left : left + glow.shape[1]]
            cv2.addWeighted(room, 1.0, glow, level, 0, dst=room)
        figures = self.scene.figures
        info = self.info
        here = np.arange(*np.searchsorted(figures.frame, [number, number + 1]))
        for left, _, right, bottom in figures.xyxy[here]:
            # A shadow a little to the right of the feet.
            wide = right - left
            deep = 0.16 * (right - left)
            place = np.array([left + 0.1 * wide, bottom - deep, right + 0.25 * wide, bottom + deep])
            put(canvas, scaled(self._shadow, place))
        standing = [(float(figures.xyxy[row, 3]), self._figure(int(row))) for row in here]
        standing += zip(self.scene.obstacles[:, 3].tolist(), self._things, strict=True)
        gusts = zip(self._plants, self._gusts[number - 1].tolist(), strict=True)
        standing += [(plant.foot, plant.waving(number / info.fps, gust)) for plant, gust in gusts]
        for _, placed in sorted(standing, key=lambda pair: pair[0]):
            put(canvas, placed)
        for leaf in self._leaves[slice(*np.searchsorted(self._blown, [number, number + 1]))]:
            put(canvas, leaf)
        top, left = self._corners[number - 1]
        noise = self._noise[top : top + info.height, left : left + info.width]
        return np.asarray(
            cv2.addWeighted(canvas, float(self._gain[number - 1]), noise, 1.0, -_MIDDLE)
        )

    def _figure(self, row: int) -> Placed:
        """The figure in this row, in its phase of the step."""
        box = self.scene.figures.xyxy[row]
        identity = int(self.scene.figures.identity[row])
        if identity not in self._people:
            aspect = float((box[2] - box[0]) / (box[3] - box[1]))
            self._people[identity] = walking_person(
                np.random.default_rng([self.seed, identity]), aspect
            )
        return scaled(
            self._people[identity][self._phase[row]], box, mirrored=bool(self._leftward[row])
        )


def _gait(figures: Truth) -> tuple[I8, Bool]:
    """(M,) the phase of the step in each row, and (M,) True for walking to the left.

    The phase follows the distance walked, in body heights, so that feet do not slide; a standing
    figure keeps its phase.
    """
    phase = np.zeros(len(figures), np.int64)
    leftward = np.zeros(len(figures), np.bool_)
    for identity in np.unique(figures.identity):
        rows = np.flatnonzero(figures.identity == identity)
        box = figures.xyxy[rows]
        across = np.diff((box[:, 0] + box[:, 2]) / 2, prepend=(box[0, 0] + box[0, 2]) / 2)
        way = np.hypot(across, np.diff(box[:, 3], prepend=box[0, 3])) / (box[:, 3] - box[:, 1])
        phase[rows] = np.floor(np.cumsum(way) / _STRIDE * PHASES).astype(np.int64) % PHASES
        moving = np.flatnonzero(np.abs(across) > 0.02)
        if len(moving):
            # The direction of the latest step across the image, at the beginning of the next one.
            latest = np.searchsorted(moving, np.arange(len(rows)), side="right") - 1
            leftward[rows] = across[moving[np.maximum(latest, 0)]] < 0
    return phase, leftward


def _leaves(info: SequenceInfo, number: int, rng: np.random.Generator) -> list[Placed]:
    """Leaves at random positions in the frame."""
    centre = rng.random((number, 2)) * np.array([info.width, info.height])
    sprites = [blown_leaf(info.height, rng) for _ in range(40)] if number else []
    leaves = [sprites[k] for k in rng.integers(max(len(sprites), 1), size=number)]
    corner = centre - np.array([leaf.shape[1::-1] for leaf in leaves]).reshape(-1, 2) / 2
    return [
        Placed(leaf, round(x), round(y))
        for leaf, (x, y) in zip(leaves, corner.tolist(), strict=True)
    ]


def _blinking(frames: int, fps: float, number: int, rng: np.random.Generator) -> F8:
    """(frames, number) levels of lamps: even ones switch randomly about every second, odd ones
    shimmer.
    """
    switches = rng.random((frames, number)) < 1 / fps
    levels = ((np.cumsum(switches, axis=0) + rng.integers(0, 2, number)) % 2).astype(np.float64)
    shimmer = [
        np.clip(0.4 + 0.4 * _wandering((frames,), 0.15 * fps, rng), 0, 1) for _ in range(number)
    ]
    levels[:, 1::2] = np.array(shimmer).reshape(number, frames)[1::2].T
    return levels


def _wandering(shape: tuple[int, ...], memory: float, rng: np.random.Generator) -> F8:
    """A stationary autoregressive process of unit variance along the first axis, with correlation
    1/e after ``memory`` frames.
    """
    keep = np.exp(-1 / memory)
    before = rng.normal(size=shape[1:])
    noise = rng.normal(size=shape) * np.sqrt(1 - keep**2)
    process = accumulate(noise, lambda value, step: keep * value + step, initial=before)
    return np.array([*process])[1:]
