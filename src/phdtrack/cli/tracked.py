"""What a tracker makes of a stretch of detections: tracks to learn births from, and what may be false."""

from __future__ import annotations

import numpy as np

from phdtrack import pipeline
from phdtrack.cli.output import Advance
from phdtrack.label.suggest import Evidence
from phdtrack.protocols import AnyStages
from phdtrack.types import DetectionTable


def tracked(table: DetectionTable, fps: float, stages: AnyStages, frames: range, seed: int, advance: Advance) -> Evidence:
    """Track the detections of ``frames``; ``advance`` is told how many are done.

    A filter that says nothing of false alarms (`filters.none`) leaves all probabilities at 0.
    """
    rows = np.arange(*np.searchsorted(table.frame, [frames.start, frames.stop]))
    rng, clutter = np.random.default_rng(seed), []
    state = pipeline.start(stages, rng)
    for count, number in enumerate(frames, start=1):
        seen = table.at(number)
        state, step = pipeline.advance(stages, state, seen, number, (number - 1) / fps, rng)
        told = step.info.clutter_probability
        clutter.append(told if len(told) == len(seen) else np.zeros(len(seen)))
        advance(count)
    stretch = DetectionTable(table.frame[rows], table.detections.take(rows))
    said = np.concatenate([np.zeros(0), *clutter])
    return Evidence(stretch, frames.start, frames.stop - 1, said, pipeline.finish(stages, state))
