"""The cost of appearance, for `experiments.appearance`: a step of 20 boxes without and with
embeddings, and the colours of 20 boxes.
"""

from __future__ import annotations

import time

import numpy as np

from experiments.common import Options, filled
from phdtrack import Tracker
from phdtrack.detect.colours import Colours
from phdtrack.types import F4, F8, Detections

BOXES = 20
LENGTH = 64
SIZE = (1920, 1080)
FRAMES = 1500
# Frames before the clock counts, in which kernels are loaded and lessons begin.
BEFORE = 200


def scene(frames: int, rng: np.random.Generator) -> tuple[F8, F4]:
    """(frames, BOXES, 4) boxes of people who walk up and down in lanes that overlap, and
    (frames, BOXES, LENGTH) their embeddings.
    """
    turn = np.abs((np.linspace(0, 1, BOXES) + np.arange(frames)[:, None] * 0.002) % 2 - 1)
    left = 50 + 1700 * turn
    top = np.broadcast_to(np.linspace(50, 850, BOXES), left.shape)
    boxes = np.stack([left, top, left + 60, top + 150], axis=2)
    boxes = boxes + rng.normal(0, 2, boxes.shape)
    own = rng.normal(size=(BOXES, LENGTH))
    looks = own + rng.normal(size=(frames, BOXES, LENGTH))
    return boxes, looks.astype(np.float32)


def steps(frames: int) -> tuple[F8, F8]:
    """(frames,) milliseconds of each update without and with embeddings, in turn, in one run."""
    boxes, looks = scene(frames, np.random.default_rng(1))
    trackers = (Tracker(SIZE), Tracker(SIZE))
    spent = np.zeros((2, frames))
    for k in range(frames):
        without = Detections.of(boxes[k])
        for place, found in enumerate((without, Detections.of(boxes[k], None, None, looks[k]))):
            began = time.perf_counter()
            trackers[place].update(found)
            spent[place, k] = time.perf_counter() - began
    return 1e3 * spent[0], 1e3 * spent[1]


def colours_time(repeats: int) -> F8:
    """(repeats,) milliseconds for the colours of the boxes of a picture."""
    rng = np.random.default_rng(2)
    picture = rng.integers(0, 256, (SIZE[1], SIZE[0], 3)).astype(np.uint8)
    boxes, _ = scene(repeats + 1, rng)
    colours = Colours()
    colours.describe(picture, boxes[0])
    spent = np.zeros(repeats)
    for k in range(repeats):
        began = time.perf_counter()
        colours.describe(picture, boxes[k + 1])
        spent[k] = time.perf_counter() - began
    return 1e3 * spent


def section(options: Options) -> str:
    """The part of the page."""
    frames = 400 if options.quick else FRAMES
    without, with_looks = (each[BEFORE:] for each in steps(frames))
    colours = colours_time(50 if options.quick else 500)
    ratio = float(np.median(with_looks) / np.median(without))
    cost = float(np.median(colours))
    return filled(
        "appearance_cost",
        boxes=BOXES,
        length=LENGTH,
        frames=frames - BEFORE,
        without=f"{np.median(without):.3f}",
        with_looks=f"{np.median(with_looks):.3f}",
        ratio=f"{ratio:.2f}",
        ratio_goal="reached" if ratio <= 1.25 else "missed",
        colours=f"{cost:.2f}",
        colours_goal="reached" if cost <= 0.4 else "missed",
    )
