"""The charts of a report: count over time, track lifetimes, time per stage. Each gives a `Picture` (SVG).

All of them share the time axis in seconds, so that a dip in one can be looked up in the others. Long runs are thinned to
block means, which the axis label says: a report must stay small and a chart cannot show more points than pixels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from phdtrack.report.canvas import INK, Picture, block_size, chart_axes, legend, new_figure, thinned, to_svg
from phdtrack.report.palette import identity_colour
from phdtrack.report.record import RunRecord
from phdtrack.types import F8, I8, Bool, Tracks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_POINTS = 1200
_BARS = 200
_LABELLED_ROWS = 60
_OUTLINES = 3000
STAGE_COLOURS = ("#9aa5b8", "#3b6fd4", "#e08a1e", "#2a9d74", "#a45cc0", "#c0504d")


def count_chart(record: RunRecord) -> Picture:
    """Objects over time: annotated (where there is truth), detected, expected by the filter, tracked."""
    series = record.series
    figure = new_figure(8.2, 3.1)
    axes = chart_axes(figure, _time_label(len(series), _POINTS), "objects in the frame")
    time = thinned(series.times, _POINTS)

    def thin(values: F8 | I8) -> F8:
        return thinned(values.astype(np.float64), _POINTS)

    axes.plot(time, thin(series.n_detections), ".", color="#9aa5b8", markersize=3, alpha=0.7, label="detections")
    if len(series.truth_count):
        truth = thin(series.truth_count)
        axes.plot(time, truth, color="#2a9d74", linewidth=5, alpha=0.4, drawstyle="steps-mid", label="truth")
    tracks = thin(record.track_count)
    axes.plot(time, tracks, color="#e08a1e", linewidth=1.5, drawstyle="steps-mid", label="tracks")
    axes.plot(time, thin(series.mass), color="#3b6fd4", linewidth=1.2, label="expected count (mass of the filter)")
    axes.set_ylim(bottom=0)
    _whole_run(axes, series.times)
    legend(axes)
    return to_svg(figure)


def lifetime_chart(record: RunRecord) -> Picture:
    """One bar for each identity from its first to its last frame; lighter where predicted, white where missing."""
    tracks = record.by_identity()
    height = float(np.clip(0.8 + 0.17 * len(tracks), 1.6, 9.0))
    figure = new_figure(8.2, height)
    axes = chart_axes(figure, _time_label(1, 1), "identity")
    axes.grid(False, axis="y")
    _bars(axes, record, tracks)
    if len(tracks) <= _LABELLED_ROWS:
        axes.set_yticks(range(len(tracks)), [str(rows.identity[0]) for rows in tracks])
    else:
        axes.set_yticks([])
        axes.set_ylabel(f"{len(tracks)} identities, the lowest number on top", fontsize=10, color=INK)
    axes.set_ylim(max(len(tracks), 1) - 0.4, -0.6)
    _whole_run(axes, record.series.times)
    return to_svg(figure)


def _bars(axes: Axes, record: RunRecord, tracks: tuple[Tracks, ...]) -> None:
    """All bars as one collection, which stays quick with thousands; as pixels where outlines would swell the file."""
    from matplotlib.collections import PolyCollection

    corners: list[F8] = []
    colours: list[tuple[float, float, float, float]] = []
    for row, rows in enumerate(tracks):
        red, green, blue = (c / 255 for c in identity_colour(int(rows.identity[0])))
        for predicted, alpha in ((False, 1.0), (True, 0.35)):
            for start, end in _spans(record, rows, rows.predicted == predicted):
                bar = [(start, row - 0.4), (end, row - 0.4), (end, row + 0.4), (start, row + 0.4)]
                corners.append(np.array(bar))
                colours.append((red, green, blue, alpha))
    bars = PolyCollection(corners, facecolors=colours, linewidths=0, rasterized=len(corners) > _OUTLINES)
    axes.add_collection(bars, autolim=True)
    axes.autoscale_view(scaley=False)


def timing_chart(record: RunRecord) -> Picture:
    """Milliseconds of each stage over the run, stacked. The scale leaves out single spikes, such as a first compilation."""
    series = record.series
    figure = new_figure(8.2, 2.7)
    axes = chart_axes(figure, _time_label(len(series), _BARS), "milliseconds per frame")
    table = thinned(1000 * series.seconds, _BARS)
    if len(table):
        colours = [STAGE_COLOURS[k % len(STAGE_COLOURS)] for k in range(len(series.stages))]
        time = thinned(series.times, _BARS)
        if len(table) == 1:
            time, table = time + np.array([0.0, _interval(record)]), np.repeat(table, 2, axis=0)
        axes.stackplot(time, table.T, labels=series.stages, colors=colours, step="post", linewidth=0)
        ceiling = 1.25 * float(np.quantile(table.sum(axis=1), 0.97))
        axes.set_ylim(0, max(min(ceiling, 1.05 * float(table.sum(axis=1).max())), 1e-3))
    _whole_run(axes, series.times)
    legend(axes)
    return to_svg(figure)


def _spans(record: RunRecord, rows: Tracks, chosen: Bool) -> list[tuple[float, float]]:
    """(start, end) in seconds of the stretches of consecutive frames among the ``chosen`` rows of one identity."""
    frames = rows.frame[chosen]
    if not len(frames):
        return []
    cuts = np.flatnonzero(np.diff(frames) > 1) + 1
    first, last = frames[np.r_[0, cuts]], frames[np.r_[cuts - 1, len(frames) - 1]]
    start, end = _seconds_at(record, first), _seconds_at(record, last) + _interval(record)
    return [(float(a), float(b)) for a, b in zip(start, end, strict=True)]


def _seconds_at(record: RunRecord, frames: I8) -> F8:
    """Times of the frames; those beyond the series at the sequence's rate."""
    series, interval = record.series, _interval(record)
    if not len(series):
        return (frames - 1).astype(np.float64) * interval
    inside: F8 = np.interp(frames, series.numbers, series.times)
    before, beyond = np.minimum(frames - series.numbers[0], 0), np.maximum(frames - series.numbers[-1], 0)
    seconds: F8 = np.asarray(inside + (before + beyond) * interval, dtype=np.float64)
    return seconds


def _interval(record: RunRecord) -> float:
    """Seconds between frames: the median of the run, else by the stated rate."""
    steps = np.diff(record.series.times)
    steps = steps[steps > 0]
    if len(steps):
        return float(np.median(steps))
    return 1 / record.info.fps if record.info.fps > 0 else 1.0


def _time_label(frames: int, limit: int) -> str:
    block = block_size(frames, limit)
    return "time in seconds" if block == 1 else f"time in seconds (each point the mean of {block} frames)"


def _whole_run(axes: Axes, times: F8) -> None:
    if len(times) and times[-1] > times[0]:
        axes.set_xlim(float(times[0]), float(times[-1]))
