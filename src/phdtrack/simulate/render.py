"""The renderer: from a scene to a video with what makes change detection hard.

Painted from back to front: the backdrop, lights on it, shadows, then figures, obstacles and plants by the row of the foot;
at last the camera adds flicker and noise. Gusts scale how far a plant bends: a change detector fires there often, not
always, with ever different boxes. A leaf that the wind blows past the camera is in one frame only: to a detector it is
Poisson clutter.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from phdtrack.simulate import paint
from phdtrack.simulate.detector import place_boxes
from phdtrack.simulate.paint import Placed
from phdtrack.simulate.scenes import Look, Scene
from phdtrack.types import F8, I8, Bool, Frame, Image, SequenceInfo, Truth

_GUST_SECONDS = 1.2
# The grey level that stands for no noise.
_MIDDLE = 64
# The noise is drawn this much larger than a frame; every frame takes another part of it.
_SHIFT = 48


def render(scene: Scene, rng: np.random.Generator, look: Look | None = None) -> Rendered:
    """The video of ``scene``.

    Parameters
    ----------
    scene : what to draw.
    rng : draws one number, which decides everything that is random in the video.
    look : noise, plants and lights; None for the usual ones.

    Returns
    -------
    A source of frames.
    """
    return Rendered(scene, look or Look(), int(rng.integers(2**62)))


class Rendered:
    """The video of a scene: a `Source` whose frames are painted when they are asked for, the same ones every time.

    ``plant_boxes`` (P, 4) are where plants grow: at the scene's persistent places, or at random ones of the figures' sizes.
    """

    def __init__(self, scene: Scene, look: Look, seed: int) -> None:
        streams = np.random.default_rng(seed).spawn(8)
        places_rng, backdrop_rng, things_rng, plants_rng, gusts_rng, light_rng, noise_rng, blown_rng = streams
        info, frames, figures = scene.info, scene.info.frames, scene.figures.xyxy
        self.scene, self.info, self.seed = scene, info, seed
        self._phase, self._leftward = _gait(scene.figures)
        self._wardrobe: dict[int, tuple[tuple[Image, ...], ...]] = {}  # figures are drawn when they first appear
        # The wall meets the ground a little above the uppermost foot.
        highest = figures[:, 3].min() if len(figures) else 0.5 * info.height
        base = int(np.clip(highest - 0.01 * info.height, 0.15 * info.height, 0.6 * info.height))
        self._backdrop = paint.backdrop(info, base, scene.doors, backdrop_rng)
        places = place_boxes(info, look.plants, figures[:, 2:] - figures[:, :2], places_rng)
        self.plant_boxes = boxes = scene.places if len(scene.places) else places
        self._plants = [paint.grow(box, rng) for box, rng in zip(boxes, plants_rng.spawn(len(boxes)), strict=True)]
        # Displacements (frames, P) by the wind, pixels: often near 0, at times twice the usual.
        force = _wandering((frames, len(boxes)), _GUST_SECONDS * info.fps, gusts_rng)
        self._gusts = look.wave * (boxes[:, 3] - boxes[:, 1]) * np.clip(0.5 + 0.8 * force, 0.05, 2.0)
        stones = zip(scene.obstacles, things_rng.spawn(len(scene.obstacles)), strict=True)
        self._things = [paint.obstacle(box, rng) for box, rng in stones]
        self._lamps = [paint.lamp(info, light_rng) for _ in range(look.lamps)]
        self._levels = _blinking(frames, info.fps, look.lamps, light_rng)
        # Brightness (frames,): flickering lamps and slow clouds.
        fast, slow = (_wandering((frames,), seconds * info.fps, light_rng) for seconds in (0.06, 3.0))
        self._gain = np.clip(1 + look.flicker * (0.8 * fast + 0.6 * slow), 0.5, 1.5)
        larger = (info.height + _SHIFT, info.width + _SHIFT, 3)
        noise = noise_rng.normal(_MIDDLE, max(look.noise, 1e-9), size=larger)
        self._noise = np.clip(np.rint(noise), 0, 255).astype(np.uint8)
        self._corners = noise_rng.integers(0, _SHIFT, (frames, 2)).tolist()
        # Leaves in frames (M,), ascending, uniform over the frame.
        self._blown = np.repeat(np.arange(1, frames + 1), blown_rng.poisson(look.blown, frames))
        self._leaves = _leaves(info, len(self._blown), blown_rng)
        self._shadow = paint.pyramid(paint.shadow(look.shadow))

    def __iter__(self) -> Iterator[Frame]:
        """The frames, numbered from 1; ``image`` is (H, W, 3) BGR."""
        for number in range(1, self.info.frames + 1):
            yield Frame(number, (number - 1) / self.info.fps, self.paint(number))

    def paint(self, number: int) -> Image:
        """(H, W, 3) the picture of frame ``number``, from 1."""
        canvas = self._backdrop.copy()
        for (glow, left, top), level in zip(self._lamps, self._levels[number - 1].tolist(), strict=True):
            room = canvas[top : top + glow.shape[0], left : left + glow.shape[1]]
            cv2.addWeighted(room, 1.0, glow, level, 0, dst=room)
        figures, info = self.scene.figures, self.info
        here = np.arange(*np.searchsorted(figures.frame, [number, number + 1]))
        for left, _, right, bottom in figures.xyxy[here]:  # a shadow a little to the right of the feet
            wide, deep = right - left, 0.16 * (right - left)
            place = np.array([left + 0.1 * wide, bottom - deep, right + 0.25 * wide, bottom + deep])
            paint.put(canvas, paint.scaled(self._shadow, place))
        standing = [(float(figures.xyxy[row, 3]), self._figure(int(row))) for row in here]
        standing += zip(self.scene.obstacles[:, 3].tolist(), self._things, strict=True)
        gusts = zip(self._plants, self._gusts[number - 1].tolist(), strict=True)
        standing += [(plant.foot, plant.waving(number / info.fps, gust)) for plant, gust in gusts]
        for _, placed in sorted(standing, key=lambda pair: pair[0]):
            paint.put(canvas, placed)
        for leaf in self._leaves[slice(*np.searchsorted(self._blown, [number, number + 1]))]:
            paint.put(canvas, leaf)
        top, left = self._corners[number - 1]
        noise = self._noise[top : top + info.height, left : left + info.width]
        picture: Image = cv2.addWeighted(canvas, float(self._gain[number - 1]), noise, 1.0, -_MIDDLE)
        return picture

    def _figure(self, row: int) -> Placed:
        """One figure, at this phase of its step."""
        box, identity = self.scene.figures.xyxy[row], int(self.scene.figures.identity[row])
        if identity not in self._wardrobe:
            aspect = float((box[2] - box[0]) / (box[3] - box[1]))
            self._wardrobe[identity] = paint.walking(np.random.default_rng([self.seed, identity]), aspect)
        return paint.scaled(self._wardrobe[identity][self._phase[row]], box, mirrored=bool(self._leftward[row]))


def _gait(figures: Truth) -> tuple[I8, Bool]:
    """(M,) the phase of the step that each row shows, and whether it walks to the left.

    The phase follows the way walked, in body heights, so that feet do not slide; a standing figure keeps it.
    """
    phase, leftward = np.zeros(len(figures), np.int64), np.zeros(len(figures), np.bool_)
    for identity in np.unique(figures.identity):
        rows = np.flatnonzero(figures.identity == identity)
        box = figures.xyxy[rows]
        across = np.diff((box[:, 0] + box[:, 2]) / 2, prepend=(box[0, 0] + box[0, 2]) / 2)
        way = np.hypot(across, np.diff(box[:, 3], prepend=box[0, 3])) / (box[:, 3] - box[:, 1])
        phase[rows] = np.floor(np.cumsum(way) / paint.STRIDE * paint.PHASES).astype(np.int64) % paint.PHASES
        moving = np.flatnonzero(np.abs(across) > 0.02)
        if len(moving):  # as in the last step with a direction, at first the one to come
            latest = np.searchsorted(moving, np.arange(len(rows)), side="right") - 1
            leftward[rows] = across[moving[np.maximum(latest, 0)]] < 0
    return phase, leftward


def _leaves(info: SequenceInfo, number: int, rng: np.random.Generator) -> list[Placed]:
    """Blown leaves anywhere in the frame."""
    centre = rng.random((number, 2)) * np.array([info.width, info.height])
    sprites = [paint.blown_leaf(info.height, rng) for _ in range(40)] if number else []
    leaves = [sprites[k] for k in rng.integers(max(len(sprites), 1), size=number)]
    corner = centre - np.array([leaf.shape[1::-1] for leaf in leaves]).reshape(-1, 2) / 2
    return [Placed(leaf, round(x), round(y)) for leaf, (x, y) in zip(leaves, corner.tolist(), strict=True)]


def _blinking(frames: int, fps: float, number: int, rng: np.random.Generator) -> F8:
    """(frames, number) levels 0 or 1 that change by chance about every second; the odd ones shimmer in between instead."""
    switches = rng.random((frames, number)) < 1 / fps
    on = (np.cumsum(switches, axis=0) + rng.integers(0, 2, number)) % 2
    shimmer = np.array([_wandering((frames,), 0.15 * fps, rng) for _ in range(number)]).reshape(number, frames).T
    odd = np.arange(number) % 2 == 1
    return np.where(odd, np.clip(0.4 + 0.4 * shimmer, 0, 1), on.astype(np.float64))


def _wandering(shape: tuple[int, ...], memory: float, rng: np.random.Generator) -> F8:
    """A stationary process of unit variance over the first axis, whose correlation falls to 1/e in ``memory`` frames."""
    keep = np.exp(-1 / memory)
    value = rng.normal(size=shape[1:])
    out = np.empty(shape)
    for k, kick in enumerate(rng.normal(size=shape) * np.sqrt(1 - keep**2)):
        value = keep * value + kick
        out[k] = value
    return out
