"""How quickly the filter believes: after how many coherent detections of an unknown object it reports one.

What decides it is the ratio of the densities of births and of clutter, which nobody can see in the settings. So it is
tried: an object of the size that was usual in this run stands still in the middle of the frame and is detected once a frame.
"""

from __future__ import annotations

import numpy as np

from phdtrack import pipeline
from phdtrack.protocols import AnyStages
from phdtrack.types import F8, Detections, SequenceInfo

TRIED = 25
SLOW = 5
"""More detections than this, and short appearances are lost: worth a warning."""


def detections_needed(stages: AnyStages, info: SequenceInfo, size: tuple[float, float]) -> int:
    """Coherent detections of an object of ``size`` (width, height in pixels) up to its first state; 0: more than `TRIED`."""
    rng = np.random.default_rng(0)
    box = _middle(info, size)
    state = pipeline.start(stages, rng)
    for number in range(1, TRIED + 1):
        state, step = pipeline.advance(stages, state, Detections.of(box), number, number / info.fps, rng)
        if len(step.estimates):
            return number
    return 0


def sentence(needed: int) -> str:
    """What `detections_needed` found, in words."""
    if needed == 0:
        return f"With these settings an object is not believed within {TRIED} coherent detections."
    return f"With these settings an object is believed after {needed} coherent detection{'' if needed == 1 else 's'}."


def warning(needed: int) -> str:
    """A warning where it takes long; empty where not."""
    if 1 <= needed <= SLOW:
        return ""
    after = f"only after {needed} coherent detections" if needed else f"not within {TRIED} coherent detections"
    return (
        f"an object is believed {after}: raise birth.births_per_second, "
        "lower clutter.clutter_per_frame, or widen both volumes (birth.volume=image)"
    )


def _middle(info: SequenceInfo, size: tuple[float, float]) -> F8:
    centre, half = np.array([info.width, info.height]) / 2, np.array(size) / 2
    return np.concatenate([centre - half, centre + half])[None, :]
