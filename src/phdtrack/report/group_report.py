"""The part of a report that tells of groups: counts over time [E13 Fig. 2], the plan at some frames, events and warnings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from phdtrack.report.canvas import Picture, block_size, chart_axes, legend, new_figure, thinned, to_svg
from phdtrack.report.html import again, bare_header, page
from phdtrack.report.markup import NOTHING, Html, bullets, element, figure, join, paragraph, section, table, text
from phdtrack.report.record import About
from phdtrack.report.summary import counted
from phdtrack.types import F8, I8, Image

_POINTS = 1200
_MOST_ROWS = 40


@dataclass(frozen=True, slots=True, eq=False)
class GroupSeries:
    """Numbers per frame, F frames, and what happened.

    Attributes
    ----------
    times : (F,) seconds.                           people, deviation : (F,) expected number of people, and its deviation.
    groups : (F,) groups with an identity.          detections : (F,) raw detections; (0,) where there are none.
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


def group_sections(series: GroupSeries) -> Html:
    """Counts, plan, events and warnings; a sentence where no frame was processed."""
    if not len(series):
        return section("People and groups", paragraph("No frame was processed."))
    raw = "Grey dots: raw detections. " if len(series.detections) else ""
    caption = (
        f"{raw}Blue: people estimated, with one standard deviation on both sides. Orange: groups; who walks alone is a "
        "group of one."
    )
    alt = (
        f"Line chart over {counted(len(series), 'frame')}: {series.people.mean():.1f} people in "
        f"{series.groups.mean():.1f} groups on average, {series.people.max():.1f} people at most."
    )
    return join(
        part
        for part in (
            section("People and groups", figure(count_picture(series), alt, caption, "chart")),
            _stills(series),
            _events(series),
            _warnings(series),
        )
        if part
    )


def positions_page(about: About, source: str, lead: str, sections: Html, config: Mapping[str, object]) -> str:
    """The report of groups among people whose positions are known: a page around ``sections``."""
    title = text(about.title)
    notes = section("Good to know", bullets(about.notes))
    return page(title, join([bare_header(title, source, lead), sections, notes, again(about, config)]))


def count_picture(series: GroupSeries) -> Picture:
    """People, groups and raw detections over time [E13 Fig. 2]."""
    chart = new_figure(8.2, 3.1)
    block = block_size(len(series), _POINTS)
    label = "time in seconds" if block == 1 else f"time in seconds (each point the mean of {block} frames)"
    axes = chart_axes(chart, label, "number")
    time = thinned(series.times, _POINTS)
    people, deviation = thinned(series.people, _POINTS), thinned(series.deviation, _POINTS)
    if len(series.detections):
        raw = thinned(series.detections.astype(np.float64), _POINTS)
        axes.plot(time, raw, ".", color="#9aa5b8", markersize=3, alpha=0.7, label="detections")
    low, high = np.maximum(people - deviation, 0), people + deviation
    axes.fill_between(time, low, high, color="#3b6fd4", alpha=0.25, linewidth=0, label="one deviation")
    axes.plot(time, people, color="#3b6fd4", linewidth=1.3, label="people estimated")
    groups = thinned(series.groups.astype(np.float64), _POINTS)
    axes.plot(time, groups, color="#e08a1e", linewidth=1.5, drawstyle="steps-mid", label="groups")
    axes.set_ylim(bottom=0)
    if time[-1] > time[0]:
        axes.set_xlim(float(time[0]), float(time[-1]))
    legend(axes)
    return to_svg(chart)


def _stills(series: GroupSeries) -> Html:
    pictures = [
        figure(_encoded(image), f"The ground from above at frame {number}.", f"Frame {number}.", "photo")
        for number, image in series.stills
    ]
    if not pictures:
        return NOTHING
    intro = paragraph(
        "The ground from above, in metres. Crosses are detections, dots people with their identities; each group has its "
        "contour, its identity, its head count with deviation, and an arrow for the way of the next second. Light blue is "
        "what the camera sees."
    )
    return section("The ground plane", intro, element("div", join(pictures), "grid"))


def _encoded(image: Image) -> Picture:
    """A picture (H, W, 3) BGR as JPEG."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 87])
    return Picture("image/jpeg", data.tobytes(), image.shape[1], image.shape[0])


def _events(series: GroupSeries) -> Html:
    said = {"merge": "into", "split": "from"}
    rows = [
        (f"{time:.1f}", kind, str(group), f"{said.get(kind, '')} {other}" if other else "")
        for time, kind, group, other in series.events
    ]
    return _table("Events", ("seconds", "event", "group", "other"), rows, "events.csv")


def _warnings(series: GroupSeries) -> Html:
    """The first warning of each pair."""
    first: dict[tuple[int, int], tuple[str, ...]] = {}
    for time, a, b, seconds, probability in series.warnings:
        first.setdefault((a, b), (f"{time:.1f}", f"{a} and {b}", f"{seconds:.1f}", f"{probability:.2f}"))
    head = ("seconds", "groups", "seconds until they meet", "probability")
    return _table("First warnings of groups about to meet", head, list(first.values()), "warnings.csv")


def _table(title: str, head: tuple[str, ...], rows: Sequence[tuple[str, ...]], file: str) -> Html:
    more = len(rows) - _MOST_ROWS
    rest = paragraph(f"{counted(more, 'more row')} in {file}.") if more > 0 else NOTHING
    return section(title, table(head, rows[:_MOST_ROWS], "numbers"), rest) if rows else NOTHING
