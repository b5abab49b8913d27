"""The renderer: from a scene to a video with what makes change detection hard.

Painted from back to front: the backdrop, lights on it, shadows, then figures, obstacles and plants by the row of the foot;
at last the camera adds flicker and noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from phdtrack.simulate import paint_scenery as scenery
from phdtrack.simulate.detector import place_boxes
from phdtrack.simulate.paint_figures import PHASES, STRIDE, draw_clothes, put, put_scaled, pyramid, walking
from phdtrack.simulate.scenes import Look, Scene
from phdtrack.types import F8, I8, Bool, Frame, Image, SequenceInfo, Truth


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """The video of a scene: a `Source` whose frames are painted when they are asked for, the same ones every time.

    Every iteration starts its random streams anew from ``seed``.
    """

    scene: Scene
    look: Look
    seed: int

    @property
    def info(self) -> SequenceInfo:
        """Size, rate, number of frames and name."""
        return self.scene.info

    def __iter__(self) -> Iterator[Frame]:
        """The frames, numbered from 1; ``image`` is (H, W, 3) BGR."""
        stage = Stage(self.scene, self.look, self.seed)
        for number in range(1, self.info.frames + 1):
            yield Frame(number, (number - 1) / self.info.fps, stage.paint(number))


def render(scene: Scene, rng: np.random.Generator, look: Look | None = None) -> Rendered:
    """The video of ``scene``, whose frames are painted when they are asked for.

    Parameters
    ----------
    scene : what to draw.
    rng : draws one number, which decides everything that is random in the video.
    look : noise, plants and lights; None for the usual ones.
    """
    return Rendered(scene, look or Look(), int(rng.integers(2**62)))


class Stage:
    """Paints the frames of a scene, in any order. Figures are drawn when they first appear."""

    def __init__(self, scene: Scene, look: Look, seed: int) -> None:
        _, backdrop_rng, things_rng, plants_rng, gusts_rng, light_rng, noise_rng, blown_rng = _streams(seed)
        info, frames = scene.info, scene.info.frames
        self._scene, self._seed = scene, seed
        self._phase, self._leftward = gait(scene.figures)
        self._wardrobe: dict[int, tuple[tuple[Image, ...], ...]] = {}
        # The wall meets the ground a little above the uppermost foot.
        highest = float(scene.figures.xyxy[:, 3].min()) if len(scene.figures) else 0.5 * info.height
        base = int(np.clip(highest - 0.01 * info.height, 0.15 * info.height, 0.6 * info.height))
        self._backdrop = scenery.backdrop(info, base, scene.doors, backdrop_rng)
        boxes = plant_boxes(scene, look.plants, seed)
        self._plants = [scenery.grow(box, rng) for box, rng in zip(boxes, plants_rng.spawn(len(boxes)), strict=True)]
        self._gusts = scenery.gusts(frames, info.fps, look.wave * (boxes[:, 3] - boxes[:, 1]), gusts_rng)
        streams = things_rng.spawn(len(scene.obstacles))
        self._things = [scenery.obstacle(box, rng) for box, rng in zip(scene.obstacles, streams, strict=True)]
        self._lamps = scenery.lamps(info, look.lamps, light_rng)
        self._levels = scenery.blinking(frames, info.fps, look.lamps, light_rng)
        self._gain = scenery.flicker(frames, info.fps, look.flicker, light_rng)
        self._noise = scenery.camera_noise(info, look.noise, noise_rng)
        self._blown, self._leaves = scenery.blown(info, look.blown, blown_rng)
        self._shadow = pyramid(scenery.shadow(look.shadow))

    def paint(self, number: int) -> Image:
        """(H, W, 3) the picture of frame ``number``, from 1."""
        canvas = self._backdrop.copy()
        for (glow, left, top), level in zip(self._lamps, self._levels[number - 1].tolist(), strict=True):
            room = canvas[top : top + glow.shape[0], left : left + glow.shape[1]]
            cv2.addWeighted(room, 1.0, glow, level, 0, dst=room)
        figures = self._scene.figures
        here = np.arange(*np.searchsorted(figures.frame, [number, number + 1]))
        for left, _, right, bottom in figures.xyxy[here]:  # a shadow a little to the right of the feet
            wide, deep = right - left, 0.16 * (right - left)
            place = np.array([left + 0.1 * wide, bottom - deep, right + 0.25 * wide, bottom + deep])
            put_scaled(canvas, self._shadow, place)
        strokes = [(float(figures.xyxy[row, 3]), partial(self._figure, canvas, int(row))) for row in here]
        for foot, thing in zip(self._scene.obstacles[:, 3].tolist(), self._things, strict=True):
            strokes.append((foot, partial(put, canvas, *thing)))
        for plant, gust in zip(self._plants, self._gusts[number - 1], strict=True):
            strokes.append((plant.foot, partial(plant.wave, canvas, number / self._scene.info.fps, float(gust))))
        for _, stroke in sorted(strokes, key=lambda pair: pair[0]):
            stroke()
        for leaf in self._leaves[slice(*np.searchsorted(self._blown, [number, number + 1]))]:
            put(canvas, *leaf)
        picture: Image = cv2.addWeighted(
            canvas, float(self._gain[number - 1]), self._noise[number - 1], 1.0, -scenery.MIDDLE
        )
        return picture

    def _figure(self, canvas: Image, row: int) -> None:
        """Draw one figure."""
        box, identity = self._scene.figures.xyxy[row], int(self._scene.figures.identity[row])
        if identity not in self._wardrobe:
            aspect = float((box[2] - box[0]) / (box[3] - box[1]))
            clothes = draw_clothes(np.random.default_rng([self._seed, identity]))
            self._wardrobe[identity] = walking(clothes, aspect)
        sprite = self._wardrobe[identity][self._phase[row]]
        put_scaled(canvas, sprite, box, mirrored=bool(self._leftward[row]))


def plant_boxes(scene: Scene, number: int, seed: int) -> F8:
    """(P, 4) where plants grow: at the scene's persistent places, or at ``number`` random ones of the figures' sizes."""
    if len(scene.places):
        return scene.places
    box = scene.figures.xyxy
    sizes = np.stack([box[:, 2] - box[:, 0], box[:, 3] - box[:, 1]], axis=1)
    return place_boxes(scene.info, number, sizes, _streams(seed)[0])


def gait(figures: Truth) -> tuple[I8, Bool]:
    """(M,) the phase of the step that each row shows, and whether it walks to the left.

    The phase follows the way walked, in body heights, so that feet do not slide; a standing figure keeps it.
    """
    order = np.lexsort((figures.frame, figures.identity))
    identity, box = figures.identity[order], figures.xyxy[order]
    first = np.diff(identity, prepend=-1) != 0
    centre, foot = (box[:, 0] + box[:, 2]) / 2, box[:, 3]
    across = np.where(first, 0, np.diff(centre, prepend=0))
    way = np.hypot(across, np.where(first, 0, np.diff(foot, prepend=0))) / (box[:, 3] - box[:, 1])
    phase = np.empty(len(order), np.int64)
    phase[order] = np.floor(np.cumsum(way) / STRIDE * PHASES).astype(np.int64) % PHASES
    moving = np.flatnonzero(np.abs(across) > 0.02)
    leftward = np.zeros(len(order), np.bool_)
    if len(moving):
        latest = np.searchsorted(moving, np.arange(len(order)), side="right") - 1
        person = np.cumsum(first)
        of_other = (latest < 0) | (person[moving[np.maximum(latest, 0)]] != person)
        nearest = np.where(of_other, np.minimum(latest + 1, len(moving) - 1), latest)
        leftward[order] = across[moving[nearest]] < 0
    return phase, leftward


def _streams(seed: int) -> list[np.random.Generator]:
    """Random streams: plants' places, backdrop, things, plants, gusts, light, noise, blown leaves."""
    return np.random.default_rng(seed).spawn(8)
