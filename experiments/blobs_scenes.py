"""Two people who meet, walk as one blob for a while and part: rendered, so that the truth is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from experiments.common import Case
from experiments.m09_scenes import detected
from phdtrack.simulate import DetectorModel, Look, build_scene, render
from phdtrack.simulate.scenario import clip, truth_rows, visible
from phdtrack.types import F8, Detections, DetectionTable, SequenceInfo, Truth

Parting = Literal["crossing", "turning back"]
PARTINGS: tuple[Parting, ...] = ("crossing", "turning back")
WIDTH, HEIGHT, FPS = 384, 288, 25.0
# Body heights (pixels), width over height, body heights per second.
TALL, ASPECT, SPEED = 84.0, 0.38, 0.75
# How long they walk as one, seconds; how far they are then from each other, in widths.
TOGETHER, APART = (1.0, 3.0), (0.25, 0.8)
# The part of a figure that must be in the frame to be in the truth.
_VISIBLE = 0.3


@dataclass(frozen=True, slots=True)
class Meeting:
    """Two who come from both sides, walk together, and go on to where they headed, or back.

    Attributes
    ----------
    parting : ``crossing``, each passes the other slowly and goes on, or ``turning back``, each stays on its side.
    together : seconds for which they walk as one.
    apart : distance of their axes while they do (of those who cross: when they meet and when they part), in widths.
    drift : common velocity while they do, along the picture, pixels per second.
    behind : by how many pixels the second's foot is higher in the picture.
    """

    parting: Parting
    together: float
    apart: float
    drift: float
    behind: float

    @property
    def info(self) -> SequenceInfo:
        """Size, rate and number of frames."""
        return SequenceInfo(WIDTH, HEIGHT, FPS, int(self._times[1] * FPS + 2.2 * FPS), f"meeting-{self.parting}")

    @property
    def _times(self) -> tuple[float, float]:
        """Seconds at which they meet and part. Before, each walks from outside the frame; they come in after a second."""
        way = WIDTH / 2 + ASPECT * TALL
        meets = 1.0 + way / (SPEED * TALL)
        return meets, meets + self.together

    @property
    def obstacles_px(self) -> F8:
        """Nothing stands in the way."""
        return np.zeros((0, 4))

    @property
    def doors_px(self) -> F8:
        """There are none."""
        return np.zeros((0, 4))

    def figures(self, rng: np.random.Generator) -> Truth:
        """Both of them; nothing is drawn by chance."""
        time = np.arange(self.info.frames) / FPS
        meets, parts = self._times
        pace, wide = SPEED * TALL, ASPECT * TALL
        walked = self.drift * (np.clip(time, meets, parts) - meets)
        onward = 1.0 if self.parting == "crossing" else -1.0
        far = self.apart * wide / 2
        passed = np.interp(time, [meets, parts], [far, -onward * far])
        half = passed - pace * (np.minimum(time - meets, 0.0) + onward * np.maximum(time - parts, 0.0))
        boxes = []
        for side, foot in ((-1.0, 0.82 * HEIGHT), (1.0, 0.82 * HEIGHT - self.behind)):
            centre = WIDTH / 2 + _smooth(walked + side * half)
            feet = np.full(len(time), foot)
            boxes.append(np.stack([centre - wide / 2, feet - TALL, centre + wide / 2, feet], axis=1))
        frame = np.tile(np.arange(1, len(time) + 1), 2)
        xyxy = np.concatenate(boxes)
        inside = visible(xyxy, self.info) > 0
        return truth_rows(frame[inside], np.repeat([1, 2], len(time))[inside], xyxy[inside])

    def truth(self, figures: Truth) -> Truth:
        """Those of whom enough is in the frame."""
        kept = np.flatnonzero(visible(figures.xyxy, self.info) >= _VISIBLE)
        return truth_rows(figures.frame[kept], figures.identity[kept], clip(figures.xyxy[kept], self.info))


def _smooth(way: F8) -> F8:
    """Without jerks: speeds change over half a second."""
    span = round(FPS / 2) | 1
    padded = np.pad(way, span // 2, mode="reflect", reflect_type="odd")
    out: F8 = np.convolve(padded, np.full(span, 1 / span), mode="valid")
    return out


def meeting(parting: Parting, seed: int) -> Meeting:
    """A meeting drawn by chance."""
    rng = np.random.default_rng([seed, PARTINGS.index(parting)])
    together, apart = rng.uniform(*TOGETHER), rng.uniform(*APART)
    return Meeting(parting, float(together), float(apart), float(rng.uniform(-15, 15)), float(rng.uniform(-6, 6)))


def filmed(job: tuple[Parting, int], *, detector: bool = True) -> Case:
    """A meeting rendered, and what the change detector, as shipped, finds in it; without it no detections."""
    parting, seed = job
    scene = build_scene(meeting(parting, seed), seed, DetectorModel())
    table = DetectionTable(np.zeros(0, np.int64), Detections.empty())
    if detector:
        table = detected(render(scene, np.random.default_rng(seed), Look(plants=0, lamps=0)))
    return Case(f"{parting} {seed}", scene.info, scene.truth, table)
