"""Streams of boxes for the tests of what the tracker warns of."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from phdtrack import Tracker
from phdtrack.types import F8

SIZE = (1920, 1080)


def walkers(frames: int, count: int = 1, fps: float = 25.0, seed: int = 0) -> Iterator[F8]:
    """Boxes (count, 4) of things that move four pixels a second, some of them missed."""
    rng = np.random.default_rng(seed)
    column = np.arange(count) % 12
    left = 100 + 120.0 * column
    top = 60 + 200.0 * (np.arange(count) // 12)
    for k in range(frames):
        x = left + 4.0 * k / fps
        boxes = np.column_stack([x, top, x + 60, top + 160]) + rng.normal(0, 1.5, (count, 4))
        yield boxes[rng.random(count) < 0.95]


def scored(frames: Iterable[F8], score: float | None = None, label: int = 0) -> Iterator[F8]:
    """The boxes with scores, random ones or all the same, and with a class."""
    rng = np.random.default_rng(1)
    for boxes in frames:
        drawn = rng.uniform(0.6, 0.95, len(boxes))
        if score is not None:
            drawn = np.full(len(boxes), score)
        yield np.column_stack([boxes, drawn, np.full(len(boxes), label)])


def warnings(frames: Iterable[Any], fps: float = 25.0, **settings: Any) -> list[str]:
    """What a tracker warns of."""
    tracker = Tracker(SIZE, fps=fps, **settings)
    said = list[str]()
    tracker.on_warning = said.append
    for boxes in frames:
        tracker.update(boxes)
    assert tuple(said) == tracker.warnings
    return said
