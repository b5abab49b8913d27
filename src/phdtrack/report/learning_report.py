"""What was learned of the scene while it was tracked: rates over time, what was in use, what changed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from phdtrack.report.canvas import Picture, chart_axes, legend, new_figure, thinned, to_svg
from phdtrack.report.markup import NOTHING, Html, figure, paragraph, section, table
from phdtrack.scene.online import Relearned

_POINTS, _ROWS = 600, 40


def learning_section(told: Sequence[Relearned], memory: float, rate: float) -> Html:
    """A section; nothing where nothing was learned. ``memory`` in minutes, ``rate`` time units a second."""
    if not told:
        return NOTHING
    intro = paragraph(
        f"Where false alarms come and where people enter was learned from the run itself; what is {memory:g} minutes old "
        "counts for 37 %. False alarms are in use while new ones are likelier under what was learned than under a uniform "
        "density, births while new ones are likelier as births than as any detection of an object."
    )
    caption = "Estimated rates. Bars below: when what was learned was in use."
    chart = figure(rate_picture(told, rate), "False alarms a frame and births a minute over time.", caption, "chart")
    said = [(f"{one.time:.1f}", one.mode, sentence) for one in told for sentence in one.said]
    return section("What was learned of the scene", intro, chart, table(("seconds", "mode", "what changed"), said[:_ROWS]))


def rate_picture(told: Sequence[Relearned], rate: float) -> Picture:
    """False alarms a frame and births a minute over time."""
    chart = new_figure(8.2, 2.8)
    axes = chart_axes(chart, "time in seconds", "rate")
    time = np.array([one.time for one in told])
    births, clutter = np.array([one.births for one in told]) * rate * 60, np.array([one.clutter for one in told])
    axes.plot(thinned(time, _POINTS), thinned(clutter, _POINTS), color="#c0504d", label="false alarms a frame")
    axes.plot(thinned(time, _POINTS), thinned(births, _POINTS), color="#2a9d74", label="births a minute")
    highest = float(max(clutter.max(), births.max(), 1e-3))
    for height, colour, used in ((0.03, "#c0504d", "clutter_used"), (0.07, "#2a9d74", "births_used")):
        known = np.array([float(one.clutter_used if used == "clutter_used" else one.births_used) for one in told])
        axes.fill_between(
            time, -(height + 0.02) * highest, -height * highest, where=known > 0, color=colour, linewidth=0, step="post"
        )
    legend(axes)
    return to_svg(chart)
