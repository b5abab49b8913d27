"""Charts of a comparison: a score by the rate of clutter, and by sequence, with confidence intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phdtrack.report.canvas import Picture, chart_axes, legend, new_figure, to_svg
from phdtrack.types import F8

COLOURS = ("#3b6fd4", "#e08a1e", "#2a9d74", "#a45cc0", "#c0504d", "#7a8599")
_MARKERS = "osD^vP"


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A method's line: ``mean``, ``low`` and ``high`` (n,) ends of the interval, NaN where nothing is known."""

    label: str
    mean: F8
    low: F8
    high: F8


def lines(x: F8, x_label: str, y_label: str, series: Sequence[Series]) -> Picture:
    """A line for each of the series over ``x`` (n,), the interval as a band and as bars."""
    figure = new_figure(8.2, 3.3)
    axes = chart_axes(figure, x_label, y_label)
    for i, one in enumerate(series):
        colour, marker = COLOURS[i % len(COLOURS)], _MARKERS[i % len(_MARKERS)]
        axes.fill_between(x, one.low, one.high, color=colour, alpha=0.15, linewidth=0)
        error = np.abs(np.vstack([one.mean - one.low, one.high - one.mean]))
        axes.errorbar(
            x, one.mean, error, color=colour, marker=marker, markersize=5, capsize=3, linewidth=1.6, label=one.label
        )
    axes.set_xticks(x)
    axes.set_xticklabels([f"{value:g}" for value in x])
    legend(axes)
    return to_svg(figure)


def bars(groups: Sequence[str], y_label: str, series: Sequence[Series]) -> Picture:
    """For each of the groups a bar of each of the series, which have a value for each group, with its interval."""
    figure = new_figure(8.2, 3.3)
    axes = chart_axes(figure, "", y_label)
    axes.grid(False, axis="x")
    place, width = np.arange(len(groups), dtype=np.float64), 0.8 / max(len(series), 1)
    for i, one in enumerate(series):
        error = np.abs(np.vstack([one.mean - one.low, one.high - one.mean]))
        at = place + (i - (len(series) - 1) / 2) * width
        axes.bar(at, one.mean, 0.92 * width, yerr=error, color=COLOURS[i % len(COLOURS)], ecolor="#3a4250", label=one.label)
    axes.axhline(0, color="#3a4250", linewidth=0.8)
    axes.set_xticks(place)
    longest = max((len(group) for group in groups), default=0)
    crowded = longest * len(groups) > 90
    axes.set_xticklabels(groups, rotation=25 if crowded else 0, ha="right" if crowded else "center")
    legend(axes)
    return to_svg(figure)
