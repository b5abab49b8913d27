"""What the stream told of its own rates: p_D, false alarms, births, the worth of scores, over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from phdtrack.report.canvas import Picture, chart_axes, legend, new_figure, thinned, to_svg
from phdtrack.report.markup import NOTHING, Html, figure, paragraph, section, table
from phdtrack.scene.rates import Following, Noise, Rates

_POINTS = 600


def rates_section(told: Sequence[Rates], rule: Following) -> Html:
    """A section; nothing where nothing was learned."""
    if not told:
        return NOTHING
    intro = paragraph(
        "What the filter otherwise takes for granted was estimated from the run itself, beginning with the settings. It "
        "uses an estimate where it is told to, as with --set rates.detection=true, and else what is set."
    )
    caption = "Estimates. Left: probabilities and shares; right: what the best and the worst score are worth."
    chart = figure(rates_picture(told, rule), "Estimated rates over time.", caption, "chart")
    return section(
        "Rates learned from the stream",
        intro,
        chart,
        table(("", "set", "estimated at the end", "used"), _rows(told[-1], rule)),
    )


def _rows(last: Rates, rule: Following) -> list[tuple[str, ...]]:
    """What was set and what is known at the end."""
    priors, learns = rule.priors, rule.learns
    units, alarms = rule.rate, "false alarms a frame"
    if priors.clutter_each:
        alarms = "false alarms around each detection"
    each = " around each detection" if priors.births_each else ""
    return [
        ("probability of detection", f"{priors.detection:.2f}", f"{last.detection:.2f}", _used(learns.detection)),
        (alarms, f"{priors.clutter:.3g}", f"{last.clutter:.3g}", _used(learns.clutter)),
        (f"births a second{each}", f"{priors.births * units:.3g}", f"{last.births * units:.3g}", _used(learns.births)),
        *_noises(priors.noise, last.noise, _used(learns.noise)),
        ("odds of the worst score", "1", f"{last.lowest:.2g}", _used(learns.scores)),
        ("odds of the best score", "1", f"{last.highest:.3g}", _used(learns.scores)),
    ]


def _noises(before: Noise, found: Noise, used: str) -> list[tuple[str, ...]]:
    """Rows of the noises, where there are any."""
    if before.spread <= 0:
        return []
    return [
        ("noise of the width, in widths", f"{before.spread:.3f}", f"{found.spread:.3f}", used),
        ("acceleration, in widths per time unit²", f"{before.acceleration:.4f}", f"{found.acceleration:.4f}", used),
        ("change of the width, in widths", f"{before.resize:.3f}", f"{found.resize:.3f}", used),
    ]


def _used(yes: bool) -> str:
    return "yes" if yes else "no"


def rates_picture(told: Sequence[Rates], rule: Following) -> Picture:
    """The estimates over time."""
    chart = new_figure(8.2, 2.6)
    time = thinned(np.array([one.time for one in told]), _POINTS)
    left = chart_axes(chart, "time in seconds", "rate", position=121)
    clutter = "false alarms, share" if rule.priors.clutter_each else "false alarms a frame"
    for name, label, colour in (("detection", "p_D", "#2b6cb0"), ("clutter", clutter, "#c0504d")):
        left.plot(time, thinned(np.array([getattr(one, name) for one in told]), _POINTS), color=colour, label=label)
    left.set_ylim(bottom=0)
    legend(left)
    right = chart_axes(chart, "time in seconds", "odds of a score", position=122)
    right.plot(time, thinned(np.array([one.highest for one in told]), _POINTS), color="#2a9d74", label="best")
    right.plot(time, thinned(np.array([one.lowest for one in told]), _POINTS), color="#8a6d3b", label="worst")
    right.set_ylim(bottom=0)
    legend(right)
    return to_svg(chart)
