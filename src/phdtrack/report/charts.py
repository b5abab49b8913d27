"""The charts of reports as SVG, and the style that they share. Each function gives a `Picture`.

`Figure` objects are made directly: neither pyplot nor a display is needed and no rcParams change. matplotlib takes half a
second to import: it is imported where a figure is made. Long runs are thinned to block means, as the time axis says.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
from markupsafe import Markup

from phdtrack.report.drawing import identity_colour
from phdtrack.report.record import STAGES, RunRecord, shrunk
from phdtrack.scene.online import SceneUpdate
from phdtrack.scene.rates import Rates, RatesLearning
from phdtrack.types import F8, I8, Image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, _GRID = "#3a4250", "#dfe3ea"
_BLUE, _ORANGE, _GREEN, _RED, _GREY = "#3b6fd4", "#e08a1e", "#2a9d74", "#c0504d", "#9aa5b8"
_STAGES = (_GREY, _BLUE, _ORANGE, _GREEN)
_METHODS = ((_BLUE, "o"), (_ORANGE, "s"), (_GREEN, "D"), ("#a45cc0", "^"), (_RED, "v"), ("#7a8599", "P"))
_WIDTH = 8.2
_POINTS, _BARS = 1200, 200
_LABELLED_ROWS, _OUTLINES = 60, 3000
# Characters of all labels together that fit beside each other.
_LABEL_ROOM = 45


@dataclass(frozen=True, slots=True)
class Picture:
    """An encoded figure: ``data`` of type ``mime``, ``width`` × ``height`` in CSS pixels."""

    mime: str
    data: bytes
    width: int
    height: int

    @property
    def address(self) -> Markup:
        """The picture as a ``data:`` address."""
        return Markup(f"data:{self.mime};base64,{base64.b64encode(self.data).decode('ascii')}")


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of ``width`` × ``height`` inches that lays itself out."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def chart_axes(figure: Figure, x_label: str, y_label: str, position: int = 111) -> Axes:
    """New axes in the style of all charts: a light grid behind, no frame at the top and right.

    Parameters
    ----------
    figure : gets the axes.
    x_label, y_label : what the axes show, with units.
    position : rows, columns and number of the axes, as matplotlib's ``add_subplot`` takes them.

    Returns
    -------
    The axes.
    """
    axes = figure.add_subplot(position)
    axes.set_xlabel(x_label, fontsize=10, color=INK)
    axes.set_ylabel(y_label, fontsize=10, color=INK)
    axes.tick_params(labelsize=9, colors=INK)
    axes.grid(True, color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(INK)
    return axes


def to_jpeg(figure: Figure) -> Picture:
    """The figure as JPEG on white, for photographs."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="jpg", dpi=144, facecolor="white", pil_kwargs={"quality": 87})
    return _picture("image/jpeg", buffer.getvalue(), figure)


def jpeg(image: Image, max_width: int = 1400) -> Picture:
    """A picture (H, W, 3) BGR as JPEG, shrunk to ``max_width`` pixels where it is wider."""
    image = shrunk(image, max_width)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 87])
    return Picture("image/jpeg", data.tobytes(), image.shape[1], image.shape[0])


def thinned(values: F8 | I8, limit: int) -> F8:
    """(n, …) means over consecutive blocks of ``values`` (N, …), so that n ≤ ``limit``; unchanged where N ≤ ``limit``."""
    values = values.astype(np.float64)
    starts = np.arange(0, len(values), _block(len(values), limit))
    counts = np.diff([*starts, len(values)]).reshape(-1, *[1] * (values.ndim - 1))
    means: F8 = np.add.reduceat(values, starts, axis=0) / counts if len(starts) else values
    return means


def count_chart(record: RunRecord) -> Picture:
    """Objects over time: annotated (where there is truth), detected, expected by the filter, tracked.

    Where the filter carries the distribution of the number, a band shows between which numbers it lies with 90 %.
    """
    series = record.series
    figure, axes = _time_axes(series.times, "objects in the frame", 3.1)
    if len(series.count_range):
        # Half an object to either side: a number that is certain has a band too.
        low, high = thinned(series.count_range, _POINTS).T
        low, high = np.maximum(low - 0.5, 0), high + 0.5
        time = thinned(series.times, _POINTS)
        axes.fill_between(time, low, high, step="mid", color=_BLUE, alpha=0.18, linewidth=0, label="number, 90 %")
    _detections(axes, series.times, series.n_detections)
    if len(series.truth_count):
        _steps(axes, series.times, series.truth_count, color=_GREEN, linewidth=5, alpha=0.4, label="truth")
    _steps(axes, series.times, record.track_count, color=_ORANGE, linewidth=1.5, label="tracks")
    _plot(axes, series.times, series.mass, color=_BLUE, linewidth=1.2, label="expected count (mass of the filter)")
    axes.set_ylim(bottom=0)
    return _to_svg(figure)


def lifetime_chart(record: RunRecord) -> Picture:
    """One bar for each identity from its first to its last frame; lighter where predicted, white where missing."""
    from matplotlib.collections import PolyCollection

    names, row = np.unique(record.tracks.identity, return_inverse=True)
    figure, axes = _time_axes(record.series.times, "identity", float(np.clip(0.8 + 0.17 * len(names), 1.6, 9.0)), limit=0)
    axes.grid(False, axis="y")
    # A bar is a stretch of consecutive frames, all seen or all predicted. All bars are one collection, which is fast with
    # thousands, and become pixels where outlines would swell the file.
    order = np.lexsort((record.tracks.frame, record.tracks.predicted, row))
    row, frame, predicted = row[order], record.tracks.frame[order], record.tracks.predicted[order]
    cut = (np.diff(row) != 0) | np.diff(predicted) | (np.diff(frame) > 1)
    edges = np.r_[len(row) > 0, cut, len(row) > 0].astype(np.bool_)[: len(row) + 1]
    first, last = np.flatnonzero(edges[:-1]), np.flatnonzero(edges[1:])
    seconds = np.interp(frame, record.series.numbers, record.series.times)
    y, start, end = row[first], seconds[first], seconds[last] + _interval(record)
    corners = np.stack([np.stack([start, end, end, start], axis=1), y[:, None] + [-0.4, -0.4, 0.4, 0.4]], axis=2)
    alpha = np.where(predicted[first], 0.35, 1.0).tolist()
    colours = [(*(part / 255 for part in identity_colour(int(names[k]))), a) for k, a in zip(y, alpha, strict=True)]
    bars = PolyCollection(list(corners), facecolors=colours, linewidths=0, rasterized=len(y) > _OUTLINES)
    axes.add_collection(bars, autolim=False)
    if len(names) <= _LABELLED_ROWS:
        axes.set_yticks(range(len(names)), names.astype(str))
    else:
        axes.set_yticks([])
        axes.set_ylabel(f"{len(names)} identities, the lowest number on top", fontsize=10, color=INK)
    axes.set_ylim(max(len(names), 1) - 0.4, -0.6)
    return _to_svg(figure)


def timing_chart(record: RunRecord) -> Picture:
    """Milliseconds of each stage over the run, stacked. The scale leaves out single spikes, such as a first compilation."""
    series = record.series
    figure, axes = _time_axes(series.times, "milliseconds per frame", 2.7, limit=_BARS)
    time, table = thinned(series.times, _BARS), thinned(1000 * series.seconds, _BARS)
    if len(table) == 1:
        time, table = time + np.array([0.0, _interval(record)]), np.repeat(table, 2, axis=0)
    if len(table):
        axes.stackplot(time, table.T, labels=STAGES, colors=_STAGES, step="post", linewidth=0)
        total = table.sum(axis=1)
        axes.set_ylim(0, max(min(1.25 * float(np.quantile(total, 0.97)), 1.05 * float(total.max())), 1e-3))
    return _to_svg(figure)


@dataclass(frozen=True, slots=True, eq=False)
class GroupSeries:
    """Groups over F frames, and what happened.

    Attributes
    ----------
    times : (F,) seconds.
    people, deviation : (F,) expected number of people, and its standard deviation.
    groups : (F,) groups with an identity.
    detections : (F,) raw detections; (0,) where there are none.
    events : time, kind, group and other group (0: none) of each.
    warnings : time, first and second group, seconds until they meet, probability of each.
    stills : pictures of the plan, each with its frame number.
    """

    times: F8
    people: F8
    deviation: F8
    groups: I8
    detections: I8
    events: Sequence[tuple[float, str, int, int]]
    warnings: Sequence[tuple[float, int, int, float, float]]
    stills: Sequence[tuple[int, Image]] = ()

    def __len__(self) -> int:
        return len(self.times)


def group_chart(series: GroupSeries) -> Picture:
    """People, groups and raw detections over time [E13 Fig. 2]."""
    figure, axes = _time_axes(series.times, "number", 3.1)
    time, people, deviation = (thinned(each, _POINTS) for each in (series.times, series.people, series.deviation))
    if len(series.detections):
        _detections(axes, series.times, series.detections)
    low = np.maximum(people - deviation, 0)
    axes.fill_between(time, low, people + deviation, color=_BLUE, alpha=0.25, linewidth=0, label="one deviation")
    axes.plot(time, people, color=_BLUE, linewidth=1.3, label="people estimated")
    _steps(axes, series.times, series.groups, color=_ORANGE, linewidth=1.5, label="groups")
    axes.set_ylim(bottom=0)
    return _to_svg(figure)


def learning_chart(course: Sequence[SceneUpdate], rate: float) -> Picture:
    """What was learned of a scene over time: false alarms a frame, births a minute; bars below show when it was in use.

    ``course`` is what was known after each frame that taught something, ``rate`` the model's time units a second.
    """
    axes = chart_axes(figure := new_figure(_WIDTH, 2.8), "time in seconds", "rate")
    time = np.array([one.time for one in course])
    clutter, births = np.array([one.clutter for one in course]), np.array([one.births for one in course]) * rate * 60
    _plot(axes, time, clutter, color=_RED, label="false alarms a frame")
    _plot(axes, time, births, color=_GREEN, label="births a minute")
    unit = 0.01 * float(max(clutter.max(), births.max(), 1e-3))
    used = ((3, _RED, [one.clutter_used for one in course]), (7, _GREEN, [one.births_used for one in course]))
    for place, colour, known in used:
        low, high = -(place + 2) * unit, -place * unit
        axes.fill_between(time, low, high, where=np.array(known) > 0, color=colour, linewidth=0, step="post")
    return _to_svg(figure)


def rates_chart(course: Sequence[Rates], rule: RatesLearning) -> Picture:
    """Estimates of p_D and of false alarms over time, and at the right the odds of the best and the worst score."""
    figure = new_figure(_WIDTH, 2.6)
    clutter = "false alarms, share" if rule.priors.clutter_each else "false alarms a frame"
    time, detection, alarms, best, worst = np.array(
        [(one.time, one.detection, one.clutter, one.highest, one.lowest) for one in course]
    ).T
    left = chart_axes(figure, "time in seconds", "rate", 121)
    _plot(left, time, detection, color="#2b6cb0", label="p_D")
    _plot(left, time, alarms, color=_RED, label=clutter)
    right = chart_axes(figure, "time in seconds", "odds of a score", 122)
    _plot(right, time, best, color=_GREEN, label="best")
    _plot(right, time, worst, color="#8a6d3b", label="worst")
    for axes in (left, right):
        axes.set_ylim(bottom=0)
    return _to_svg(figure)


class MethodScores(NamedTuple):
    """A method's score at n places: ``mean``, and ``low`` and ``high`` (n,) ends of the interval; NaN where unknown."""

    label: str
    mean: F8
    low: F8
    high: F8

    @property
    def reach(self) -> F8:
        """(2, n) how far the interval reaches below and above the mean."""
        return np.abs(np.vstack([self.mean - self.low, self.high - self.mean]))


def score_lines(x: F8, x_label: str, y_label: str, methods: Sequence[MethodScores]) -> Picture:
    """A line with intervals for each method, moved a little to the side so that all can be seen.

    Parameters
    ----------
    x : (n,) where the scores were taken.
    x_label, y_label : what the axes show.
    methods : n scores each.

    Returns
    -------
    The chart.
    """
    axes = chart_axes(figure := new_figure(5.4, 3.0), x_label, y_label)
    offset = 0.012 * float(np.ptp(x)) * (np.arange(len(methods)) - (len(methods) - 1) / 2)
    for i, one in enumerate(methods):
        colour, marker = _METHODS[i % len(_METHODS)]
        bars = axes.errorbar(x + offset[i], one.mean, one.reach, color=colour, capsize=3, linewidth=1.6, marker=marker)
        bars.set_label(one.label)
    axes.set_xticks(x, [f"{value:g}" for value in x])
    return _to_svg(figure)


def score_bars(groups: Sequence[str], y_label: str, methods: Sequence[MethodScores]) -> Picture:
    """For each group a bar with its interval of each method.

    Parameters
    ----------
    groups : n names.
    y_label : what the axis shows.
    methods : n scores each.

    Returns
    -------
    The chart.
    """
    axes = chart_axes(figure := new_figure(5.4, 3.0), "", y_label)
    axes.grid(False, axis="x")
    place, width = np.arange(len(groups), dtype=np.float64), 0.8 / max(len(methods), 1)
    for i, one in enumerate(methods):
        at, (colour, _) = place + (i - (len(methods) - 1) / 2) * width, _METHODS[i % len(_METHODS)]
        axes.bar(at, one.mean, 0.92 * width, yerr=one.reach, color=colour, ecolor=INK, label=one.label)
    axes.axhline(0, color=INK, linewidth=0.8)
    crowded = max(map(len, groups), default=0) * len(groups) > _LABEL_ROOM
    axes.set_xticks(place, groups, rotation=25 if crowded else 0, ha="right" if crowded else "center")
    return _to_svg(figure)


def _interval(record: RunRecord) -> float:
    """The median time between frames in seconds, else that of the stated rate."""
    steps = np.diff(record.series.times)
    steps = steps[steps > 0]
    stated = 1 / record.info.fps if record.info.fps > 1e-3 else 1.0
    return float(np.median(steps)) if len(steps) else stated


def _plot(axes: Axes, times: F8, values: F8 | I8, *style: str, **look: Any) -> None:
    axes.plot(thinned(times, _POINTS), thinned(values, _POINTS), *style, **look)


def _steps(axes: Axes, times: F8, values: I8, **look: Any) -> None:
    _plot(axes, times, values, drawstyle="steps-mid", **look)


def _detections(axes: Axes, times: F8, counts: I8) -> None:
    _plot(axes, times, counts, ".", color=_GREY, markersize=3, alpha=0.7, label="detections")


def _time_axes(times: F8, y_label: str, height: float, limit: int = _POINTS) -> tuple[Figure, Axes]:
    """Axes over the whole run, whose label says how many of the ``times`` (F,) are in one of at most ``limit`` points."""
    block = _block(len(times), limit or len(times))
    label = "time in seconds" if block == 1 else f"time in seconds (each point the mean of {block} frames)"
    axes = chart_axes(figure := new_figure(_WIDTH, height), label, y_label)
    if len(times) and times[-1] > times[0]:
        axes.set_xlim(float(times[0]), float(times[-1]))
    return figure, axes


def _block(length: int, limit: int) -> int:
    """Frames that `thinned` puts into one point."""
    return max(1, -(-length // max(limit, 1)))


def _to_svg(figure: Figure) -> Picture:
    """The figure with legends above its axes, as SVG on a transparent ground: text as outlines, no date."""
    for axes in figure.axes:
        handles, _ = axes.get_legend_handles_labels()
        if handles:
            look = {"ncols": len(handles), "frameon": False, "fontsize": 9.0, "labelcolor": INK}
            axes.legend(loc="lower left", bbox_to_anchor=(0, 1), **look)
    buffer = io.BytesIO()
    nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
    figure.savefig(buffer, format="svg", transparent=True, metadata=nothing)
    text = buffer.getvalue()
    return _picture("image/svg+xml", text[text.index(b"<svg") :], figure)


def _picture(mime: str, data: bytes, figure: Figure) -> Picture:
    wide, high = figure.get_size_inches()
    return Picture(mime, data, round(96 * float(wide)), round(96 * float(high)))
