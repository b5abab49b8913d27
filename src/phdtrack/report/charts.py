"""The charts of a report: count over time, track lifetimes, time per stage. Each gives a `Picture` (SVG).

All of them share the time axis in seconds, so that a dip in one can be looked up in the others. Long runs are thinned to
block means, which the axis label says: a report must stay small and a chart cannot show more points than pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
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
_SLOWEST = 1e-3
"""Frames per second below which a stated rate is no rate."""
STAGE_COLOURS = ("#9aa5b8", "#3b6fd4", "#e08a1e", "#2a9d74", "#a45cc0", "#c0504d")


def count_chart(record: RunRecord) -> Picture:
    """Objects over time: annotated (where there is truth), detected, expected by the filter, tracked.

    Where the filter carries the distribution of the number, a band shows between which numbers it lies with 90 %.
    """
    series = record.series
    figure = new_figure(8.2, 3.1)
    axes = chart_axes(figure, _time_label(len(series), _POINTS), "objects in the frame")
    time = thinned(series.times, _POINTS)

    def thin(values: F8 | I8) -> F8:
        return thinned(values.astype(np.float64), _POINTS)

    if len(series.count_range):
        # Halves to either side: a number that is certain has a band too.
        low, high = thin(series.count_range[:, 0]) - 0.5, thin(series.count_range[:, 1]) + 0.5
        axes.fill_between(
            time, np.maximum(low, 0), high, step="mid", color="#3b6fd4", alpha=0.18, linewidth=0, label="number, 90 %"
        )
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

    clock = _Clock.of(record)
    corners: list[list[tuple[float, float]]] = []
    colours: list[tuple[float, float, float, float]] = []
    for row, rows in enumerate(tracks):
        red, green, blue = (c / 255 for c in identity_colour(int(rows.identity[0])))
        for predicted, alpha in ((False, 1.0), (True, 0.35)):
            for start, end in clock.spans(rows, rows.predicted == predicted):
                corners.append([(start, row - 0.4), (end, row - 0.4), (end, row + 0.4), (start, row + 0.4)])
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
            time, table = time + np.array([0.0, _Clock.of(record).interval]), np.repeat(table, 2, axis=0)
        axes.stackplot(time, table.T, labels=series.stages, colors=colours, step="post", linewidth=0)
        ceiling = 1.25 * float(np.quantile(table.sum(axis=1), 0.97))
        axes.set_ylim(0, max(min(ceiling, 1.05 * float(table.sum(axis=1).max())), 1e-3))
    _whole_run(axes, series.times)
    legend(axes)
    return to_svg(figure)


@dataclass(frozen=True, slots=True, eq=False)
class _Clock:
    """From frame numbers to seconds; ``interval`` is the time between frames."""

    numbers: I8
    times: F8
    interval: float

    @classmethod
    def of(cls, record: RunRecord) -> _Clock:
        """With the median interval of the run, else that of the stated rate."""
        steps = np.diff(record.series.times)
        steps = steps[steps > 0]
        stated = 1 / record.info.fps if record.info.fps > _SLOWEST else 1.0
        return cls(record.series.numbers, record.series.times, float(np.median(steps)) if len(steps) else stated)

    def seconds(self, frames: I8) -> F8:
        """Times of the frames; those beyond the run follow at the interval."""
        if not len(self.numbers):
            return (frames - 1).astype(np.float64) * self.interval
        beyond = np.minimum(frames - self.numbers[0], 0) + np.maximum(frames - self.numbers[-1], 0)
        seconds: F8 = np.interp(frames, self.numbers, self.times) + beyond * self.interval
        return seconds

    def spans(self, rows: Tracks, chosen: Bool) -> list[tuple[float, float]]:
        """(start, end) in seconds of the stretches of consecutive frames among the ``chosen`` rows of one identity."""
        frames = rows.frame[chosen]
        if not len(frames):
            return []
        cuts = np.flatnonzero(np.diff(frames) > 1) + 1
        first, last = frames[np.r_[0, cuts]], frames[np.r_[cuts - 1, len(frames) - 1]]
        return list(zip(self.seconds(first).tolist(), (self.seconds(last) + self.interval).tolist(), strict=True))


def _time_label(frames: int, limit: int) -> str:
    block = block_size(frames, limit)
    return "time in seconds" if block == 1 else f"time in seconds (each point the mean of {block} frames)"


def _whole_run(axes: Axes, times: F8) -> None:
    if len(times) and times[-1] > times[0]:
        axes.set_xlim(float(times[0]), float(times[-1]))
