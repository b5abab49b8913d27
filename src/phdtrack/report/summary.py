"""A run in plain words and a few single numbers: for the head of the report and for the terminal.

Sentences are true also where nothing happened: an empty run, no detections, no tracks, a filter that keeps no mass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.report.record import RunRecord

NBSP = "\u00a0"
"""A space that does not break; unlike the narrow ones every legacy terminal encoding has it."""


@dataclass(frozen=True, slots=True)
class StageTime:
    """Milliseconds per frame of one stage: mean, median and 95th percentile; ``share`` of the whole (0–1)."""

    name: str
    mean: float
    median: float
    high: float
    share: float


def grouped(number: float) -> str:
    """A whole number with spaces between groups of three digits."""
    return f"{round(number):,}".replace(",", NBSP)


def counted(number: int, noun: str, plural: str = "") -> str:
    """Such as "1 frame" and "2 frames"; ``plural`` where an s does not make it."""
    return f"{grouped(number)} {noun if number == 1 else plural or noun + 's'}"


def duration(seconds: float) -> str:
    """Such as "8.2 s", "1 min 54 s", "2 h 5 min"."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    if seconds < 3600:
        return f"{int(seconds // 60)} min {int(seconds % 60)} s"
    return f"{int(seconds // 3600)} h {int(seconds % 3600 // 60)} min"


def sentences(record: RunRecord) -> tuple[str, ...]:
    """What happened, in a few sentences without markup."""
    series, tracks = record.series, record.tracks
    said = [f"{counted(record.n_objects, 'object')} in {counted(len(series), 'frame')}{_length(record)}."]
    detections, clutter = int(series.n_detections.sum()), record.false_alarms
    if detections and not clutter:
        said.append(f"{counted(detections, 'detection')}, none of them judged a false alarm.")
    elif detections:
        said.append(
            f"The filter took about {grouped(clutter)} of {counted(detections, 'detection')} "
            f"({percent(clutter, detections)}) for false alarms."
        )
    elif len(series):
        said.append("The detector found nothing.")
    if len(tracks):
        predicted = int(tracks.predicted.sum())
        said.append(
            f"{percent(predicted, len(tracks))} of the track boxes bridge frames in which the detector missed the object."
        )
    if math.isfinite(record.frames_per_second):
        without = record.about.left_out
        aside = f", {counted(without, 'frame')} in which kernels were compiled or loaded left aside" if without else ""
        said.append(f"Detection and tracking ran at {record.frames_per_second:.1f} frames per second{aside}.")
    return tuple(said)


def stage_times(record: RunRecord) -> tuple[StageTime, ...]:
    """One row for each stage; empty where there are no frames."""
    milliseconds = 1000 * record.series.seconds
    if not len(milliseconds):
        return ()
    whole = max(float(milliseconds.sum()), 1e-12)
    return tuple(
        StageTime(
            name,
            float(column.mean()),
            float(np.median(column)),
            float(np.quantile(column, 0.95)),
            float(column.sum()) / whole,
        )
        for name, column in zip(record.series.stages, milliseconds.T, strict=True)
    )


def _length(record: RunRecord) -> str:
    times = record.series.times
    return f" ({duration(float(times[-1] - times[0]))} of video)" if len(times) > 1 else ""


def percent(part: float, whole: float = 1.0) -> str:
    """The share in per cent, with a decimal where it is small; a dash where there is no whole."""
    if not whole > 0:
        return "–"
    share = 100 * part / whole
    return f"{share:.1f}{NBSP}%" if 0 < share < 10 else f"{share:.0f}{NBSP}%"
