"""``report.html``: one file that tells a run, readable without network, on a phone, on paper and in the dark.

Everything is inside: pictures as ``data:`` addresses, the style sheet inline, no script. A content security policy in the
head forbids the browser to fetch anything else, so that the promise is kept by the browser and not only by us.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

import numpy as np

from phdtrack.report.charts import count_chart, lifetime_chart, timing_chart
from phdtrack.report.markup import (
    NOTHING,
    Html,
    bullets,
    details,
    element,
    figure,
    join,
    paragraph,
    section,
    table,
    text,
)
from phdtrack.report.record import About, RunRecord
from phdtrack.report.run_json import flattened, write_text
from phdtrack.report.scenes import heat_picture, trajectory_picture
from phdtrack.report.senses import sense
from phdtrack.report.summary import counted, duration, grouped, percent, sentences, stage_times
from phdtrack.types import F8

_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_MEANING = (
    ("MODA", "detection: 1 − (misses + false positives) / objects, mean over frames; 1 is perfect"),
    ("N_MODA", "the same over the whole sequence at once"),
    ("MODP", "mean overlap of matched boxes in the detection mapping; 1 is perfect"),
    ("MOTA", "tracking: misses, false positives and identity switches; 1 is perfect"),
    ("MOTA_log", "the same, switches counted by their logarithm"),
    ("MOTP", "mean overlap of matched boxes in the tracking mapping; 1 is perfect"),
    ("IDF1", "share of boxes that carry the right identity over the whole run; 1 is perfect"),
    ("HOTA", "geometric mean of detection and association accuracy; 1 is perfect"),
    ("OSPA", "distance between the sets of boxes per frame; 0 is perfect, 1 the worst"),
    ("GOSPA", "distance of boxes plus a penalty for each missed and false one; 0 is perfect"),
    ("OSPA2", "distance between the sets of whole tracks; 0 is perfect, 1 the worst"),
    ("SFDA", "overlap of boxes, with misses and false ones as 0, mean over frames; 1 is perfect"),
    ("ATA", "overlap of whole tracks, with misses and false ones as 0; 1 is perfect"),
    ("id_switches", "times an object changed its identity"),
    ("misses", "annotated boxes without a track"),
    ("false_positives", "track boxes without an object"),
    ("fragments", "times a track of an object was interrupted"),
    ("frames", "frames that were compared"),
    ("DetA", "detection accuracy within HOTA"),
    ("AssA", "association accuracy within HOTA"),
    ("IDP", "share of track boxes with the right identity"),
    ("IDR", "share of annotated boxes with the right identity"),
    ("N_MODA_detection", "N_MODA with every frame matched for itself"),
    ("ATA_matched", "ATA with overlaps above the threshold as 1 and others as 0"),
    ("truth_boxes", "annotated boxes"),
    ("output_boxes", "track boxes"),
    ("matches", "track boxes on an annotated one"),
    ("truth_objects", "annotated objects"),
    ("output_identities", "tracks"),
    ("false_tracks", "tracks that follow nobody in any frame"),
    ("mostly_tracked", "objects tracked in more than 80 % of their frames"),
    ("mostly_lost", "objects tracked in less than 20 % of their frames"),
    ("objects_found", "objects tracked in at least one frame"),
    ("delay_mean", "frames from an object's appearance to its first track box, of those found"),
    ("count_error_mean", "track boxes minus annotated ones, mean over frames; 0 is perfect"),
    ("count_error_rms", "the same, root of the mean square"),
)


def write_report(path: Path, record: RunRecord, config: Mapping[str, object] | None = None, more: Html = NOTHING) -> None:
    """Write the report; ``config`` is listed in it. Raises `InputError` where the file cannot be written."""
    write_text(path, report_html(record, config or {}, more))


def report_html(record: RunRecord, config: Mapping[str, object], more: Html = NOTHING) -> str:
    """The whole page as text; ``more`` are sections of whoever has more to tell."""
    title = text(record.about.title or record.info.name or "Tracking run")
    body = join(
        [
            _header(record, title),
            _warnings(record),
            more,
            _scores(record),
            _count(record),
            _trajectories(record),
            _lifetimes(record),
            _heat_maps(record),
            _timings(record),
            section("Good to know", bullets(record.about.notes)),
            again(record.about, config),
        ]
    )
    return page(title, body)


def page(title: Html, body: Html) -> str:
    """The whole page as text around what it holds."""
    style = resources.files("phdtrack.report").joinpath("style.css").read_text(encoding="utf-8")
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="color-scheme" content="light dark">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        f"<title>{title} – phdtrack report</title>\n<style>\n{style}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def bare_header(title: Html, source: str, lead: str) -> Html:
    """Title, where it comes from, and what happened in words."""
    return element("header", join([element("h1", title), paragraph(source, "source"), paragraph(lead, "lead")]))


def _header(record: RunRecord, title: Html) -> Html:
    """Title, tiles with the key figures, and the run in words."""
    series, tracks = record.series, record.tracks
    speed = f"{record.frames_per_second:.1f}" if math.isfinite(record.frames_per_second) else "–"
    tiles = (
        (grouped(record.n_objects), "objects tracked"),
        (grouped(len(series)), "frames"),
        (grouped(int(series.n_detections.sum())), "detections"),
        (grouped(record.false_alarms), "of them false alarms (expected)"),
        (percent(float(tracks.predicted.sum()), len(tracks)), "of track boxes predicted"),
        (speed, "frames per second"),
    )
    cells = [element("div", join([element("b", text(value)), element("span", text(name))]), "tile") for value, name in tiles]
    source = f"{record.info.width} × {record.info.height} pixels, {record.info.fps:.4g} frames per second"
    started = f", run {record.about.started}" if record.about.started else ""
    return element(
        "header",
        join(
            [
                element("h1", title),
                paragraph(source + started, "source"),
                element("div", join(cells), "tiles"),
                paragraph(" ".join(sentences(record)), "lead"),
            ]
        ),
    )


def _warnings(record: RunRecord) -> Html:
    entries = bullets(record.about.warnings)
    return element("section", join([element("h2", text("Warnings")), entries]), "warnings") if entries else NOTHING


def _scores(record: RunRecord) -> Html:
    meanings = dict(_MEANING)
    rows = [(name, _score(value), meanings.get(name, "") + sense(name)) for name, value in record.about.scores]
    return section("Scores against the truth", table(("score", "value", "what it says"), rows, "scores"))


def _score(value: float) -> str:
    if not math.isfinite(value):
        return "undefined"
    return grouped(value) if isinstance(value, int | np.integer) else f"{value:.3f}"


def _count(record: RunRecord) -> Html:
    if not len(record.series):
        return section("Count over time", paragraph("No frame was processed."))
    series = record.series
    alt = (
        f"Line chart over {counted(len(series), 'frame')}: {_expectation(series.mass)}"
        f"{record.track_count.mean():.1f} tracks and {series.n_detections.mean():.1f} detections in a frame on average."
    )
    truth = " Broad green: annotated objects." if len(series.truth_count) else ""
    band = " Blue band: where their number lies with 90 % probability." if len(series.count_range) else ""
    caption = (
        f"Grey dots: what the detector reported. Blue: how many objects the filter expects.{band} Orange: tracks.{truth}"
    )
    return section("Count over time", figure(count_chart(record), alt, caption, "chart"))


def _expectation(mass: F8) -> str:
    """The filter's expectation for the alternative text; nothing where it gives no mass."""
    known = mass[np.isfinite(mass)]
    return f"{known.mean():.1f} objects expected on average and {known.max():.1f} at most, " if len(known) else ""


def _trajectories(record: RunRecord) -> Html:
    if not len(record.tracks):
        return section("Trajectories", paragraph("No object was tracked."))
    alt = f"Map of the frame with the paths of {counted(record.n_objects, 'object')}, each in a colour of its own."
    caption = (
        "The foot point of every object. A ring marks where it appeared, its number where it was last seen; "
        "thin stretches are predicted."
    )
    return section("Trajectories", figure(trajectory_picture(record), alt, caption, "photo"))


def _lifetimes(record: RunRecord) -> Html:
    if not len(record.tracks):
        return NOTHING
    lengths = np.unique(record.tracks.identity, return_counts=True)[1]
    alt = (
        f"Bar chart of {counted(len(lengths), 'track')}: the shortest has {counted(int(lengths.min()), 'box', 'boxes')}"
        f", the median {np.median(lengths):.0f}, the longest {lengths.max()}."
    )
    caption = "One bar for each identity. Light: predicted while the detector missed it. Gaps: no track."
    return section("Track lifetimes", figure(lifetime_chart(record), alt, caption, "chart"))


def _heat_maps(record: RunRecord) -> Html:
    pictures = [
        figure(
            heat_picture(heat, record.info),
            f"Heat map of the intensity over frame {heat.number}: {heat.mass:.1f} objects expected.",
            f"Frame {heat.number}: {heat.mass:.1f} objects expected, {counted(len(heat.detections), 'detection')}, "
            f"{counted(len(heat.estimates), 'extracted state')}.",
            "photo",
        )
        for heat in record.heat_maps
    ]
    if not pictures:
        return NOTHING
    intro = paragraph(
        "The probability hypothesis density over the image: where the filter expects objects, and how many. "
        "White crosses are detections, rings the states extracted from the density: a cross without light around it "
        "was taken for a false alarm."
    )
    return section("What the filter believes", intro, element("div", join(pictures), "grid"))


def _timings(record: RunRecord) -> Html:
    stages = stage_times(record)
    if not stages:
        return NOTHING
    rows = [(s.name, f"{s.mean:.2f}", f"{s.median:.2f}", f"{s.high:.2f}", percent(s.share), _rate(s.mean)) for s in stages]
    total = 1000 * record.series.seconds.sum(axis=1)
    mean = float(total.mean())
    rows.append(
        ("together", f"{mean:.2f}", f"{np.median(total):.2f}", f"{np.quantile(total, 0.95):.2f}", percent(1), _rate(mean))
    )
    head = ("stage", "mean ms", "median ms", "95 % below, ms", "share", "frames per second")
    alt = f"Stacked chart of the time per frame, {mean:.1f} milliseconds on average."
    caption = "Time per frame and stage. Single spikes, such as a first compilation, may reach beyond the scale."
    whole = f"Everything together, with decoding, drawing and writing, took {duration(record.about.seconds)}."
    return section(
        "Time per stage",
        figure(timing_chart(record), alt, caption, "chart"),
        table(head, rows, "numbers"),
        paragraph(whole) if record.about.seconds > 0 else NOTHING,
    )


def _rate(milliseconds: float) -> str:
    return f"{1000 / milliseconds:.1f}" if milliseconds > 0 else "–"


def again(about: About, config: Mapping[str, object], seeds: int = 1) -> Html:
    """Command, seed (the first of ``seeds``), versions and settings."""
    which = f"Seed {about.seed}" if seeds == 1 else f"Seeds {about.seed} to {about.seed + seeds - 1}"
    command = element("pre", element("code", text(about.command))) if about.command else NOTHING
    versions = ", ".join(f"{name} {version}" for name, version in about.versions)
    return section(
        "How to get this again",
        command,
        paragraph(f"{which}. {versions}"),
        details("All settings", table(("setting", "value"), flattened(config), "settings")),
    )
