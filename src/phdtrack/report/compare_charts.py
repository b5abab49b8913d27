"""Charts of a comparison: a score by the rate of clutter, and by sequence, with confidence intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phdtrack.report.canvas import INK, Picture, chart_axes, legend, new_figure, to_svg
from phdtrack.types import F8

COLOURS = ("#3b6fd4", "#e08a1e", "#2a9d74", "#a45cc0", "#c0504d", "#7a8599")
_MARKERS = "osD^vP"
_SIZE = (5.4, 3.0)
_ASIDE = 0.012
_ROOM = 45


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A method's line: ``mean``, ``low`` and ``high`` (n,) ends of the interval, NaN where nothing is known."""

    label: str
    mean: F8
    low: F8
    high: F8


def lines(x: F8, x_label: str, y_label: str, series: Sequence[Series]) -> Picture:
    """A line for each of the series over ``x`` (n,), with intervals; a little beside each other, so that all can be seen."""
    figure = new_figure(*_SIZE)
    axes = chart_axes(figure, x_label, y_label)
    aside = _ASIDE * float(np.ptp(x)) * (np.arange(len(series)) - (len(series) - 1) / 2)
    for i, one in enumerate(series):
        bars = axes.errorbar(x + aside[i], one.mean, _ends(one), color=COLOURS[i % len(COLOURS)], capsize=3, linewidth=1.6)
        bars.set_label(one.label)
        bars.lines[0].set_marker(_MARKERS[i % len(_MARKERS)])
    axes.set_xticks(x)
    axes.set_xticklabels([f"{value:g}" for value in x])
    legend(axes)
    return to_svg(figure)


def bars(groups: Sequence[str], y_label: str, series: Sequence[Series]) -> Picture:
    """For each of the groups a bar of each of the series, which have a value for each group, with its interval."""
    figure = new_figure(*_SIZE)
    axes = chart_axes(figure, "", y_label)
    axes.grid(False, axis="x")
    place, width = np.arange(len(groups), dtype=np.float64), 0.8 / max(len(series), 1)
    for i, one in enumerate(series):
        at, colour = place + (i - (len(series) - 1) / 2) * width, COLOURS[i % len(COLOURS)]
        axes.bar(at, one.mean, 0.92 * width, yerr=_ends(one), color=colour, ecolor=INK, label=one.label)
    axes.axhline(0, color=INK, linewidth=0.8)
    axes.set_xticks(place)
    crowded = max(map(len, groups), default=0) * len(groups) > _ROOM
    axes.set_xticklabels(groups, rotation=25 if crowded else 0, ha="right" if crowded else "center")
    legend(axes)
    return to_svg(figure)


def _ends(one: Series) -> F8:
    """(2, n) how far the interval reaches below and above."""
    ends: F8 = np.abs(np.vstack([one.mean - one.low, one.high - one.mean]))
    return ends
