"""The pages, sections and sentences of reports, from the Jinja2 templates in ``report/templates``,
and ``run.json``.

A report is one file that can be read offline, on a phone, on paper and in dark mode: pictures are
``data:`` addresses, the style sheet is inline, there is no script, and a content security policy
forbids loading anything. Templates escape everything except `markupsafe.Markup`. Control characters
and lone surrogates, which browsers do not show, become �.

``run.json`` and similar files are plain JSON: NaN and infinity become null, arrays lists, paths
strings. Keys keep their names and order; new ones are added at the end.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from phdtrack.detect.moving_regions import MOVING_REGIONS
from phdtrack.files import json_value, write_text
from phdtrack.report import charts
from phdtrack.report.object_list import BAR_UNITS
from phdtrack.report.record import STAGES, RunRecord, known_mean

if TYPE_CHECKING:
    from jinja2 import Environment

# A non-breaking space; unlike narrow ones, every legacy terminal encoding has it.
_NBSP = "\u00a0"
_NOT_SHOWN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff]")
# Seconds below which a track is short; the share of short tracks above which tracks are doubtful
# (good runs have up to .2), and the number of tracks that this needs.
_SHORT_TRACK = 0.5
_MAX_SHORT = 0.3
_MIN_COUNT = 5
_STAGE_TIMES = ("mean", "median", "p95", "share")


@cache
def environment() -> Environment:
    """The templates, and the functions that they can call. Jinja2 is imported on first use."""
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

    made = Environment(
        loader=PackageLoader("phdtrack.report"),
        autoescape=select_autoescape(("html",)),
        finalize=lambda value: _NOT_SHOWN.sub("\ufffd", value) if type(value) is str else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals["charts"] = charts
    made.globals["bar_units"] = BAR_UNITS
    made.filters |= {
        function.__name__: function
        for function in (
            *(clock, grouped, counted, duration, seconds, nats, odds, percent, rate, score, spread),
            known_mean,
        )
    }
    return made


def render(template: str, **context: object) -> Markup:
    """The text of a template in ``report/templates``."""
    return Markup(environment().get_template(template).render(context))


def lines(template: str, **context: object) -> tuple[str, ...]:
    """The sentences of a text template, one per line."""
    return tuple(
        str(line).strip() for line in render(template, **context).split("\n") if line.strip()
    )


def score_meanings() -> dict[str, str]:
    """A short description of each score, by its name."""
    found: dict[str, str] = vars(environment().get_template("scores.html").module)["meanings"]
    return found


def sentences(record: RunRecord) -> tuple[str, ...]:
    """A summary of a run in a few sentences, for the report, the terminal and ``run.json``.

    Parameters
    ----------
    record : the run.

    Returns
    -------
    One sentence each.
    """
    return lines("summary.txt", record=record, moving_regions=MOVING_REGIONS)


def doubts(record: RunRecord) -> tuple[str, ...]:
    """A warning if the tracks of a run are probably wrong, with cause and cure; else empty.

    Tracks of moving regions are judged by `doubtful_tracks`, others by how many are short.
    """
    if record.doubtful is not None:
        return lines("doubts.txt", doubtful=record.doubtful) if record.doubtful.warn else ()
    lengths = record.lifetimes
    if len(lengths) >= _MIN_COUNT:
        short = float((lengths < _SHORT_TRACK * record.info.fps).mean())
        if short > _MAX_SHORT:
            return lines("doubts.txt", doubtful=None, short=short, count=len(lengths))
    return ()


def report_html(record: RunRecord, config: Mapping[str, object]) -> str:
    """The whole page of a run's report; ``config`` holds the settings, listed at the end.

    Parameters
    ----------
    record : the run.
    config : its settings, by section.

    Returns
    -------
    The page, complete in itself.
    """
    title = record.about.title or record.info.name or "Tracking run"
    lead = " ".join(sentences(record))
    return str(
        render("run.html", title=title, lead=lead, record=record, settings=flattened(config))
    )


def run_document(record: RunRecord, config: Mapping[str, object]) -> dict[str, object]:
    """The run as JSON values; ``config`` is the whole configuration as nested mappings.

    Times are seconds. ``frames_per_second`` covers everything up to the report (detection,
    tracking, drawing), except the ``frames_left_out`` in which kernels were compiled or loaded; it
    means the same in the report and on the terminal. ``stages`` are milliseconds per frame; their
    sum may exceed the time per frame because stages overlap. ``log_evidence`` has one value per
    frame, null if the filter has none. ``doubtful_boxes`` holds shares from 0 to 1, see
    `DoubtfulTracks`; null if the detector reports objects, not moving regions.

    Parameters
    ----------
    record : the run.
    config : its settings, by section.

    Returns
    -------
    The content of run.json.
    """
    about = record.about
    info = record.info
    times = record.stage_times
    document = {
        "command": about.command,
        "title": about.title,
        "summary": sentences(record),
        "versions": dict(about.versions),
        "seed": about.seed,
        "started": about.started,
        "seconds": about.seconds,
        "source": {"name": info.name, "width": info.width, "height": info.height, "fps": info.fps},
        "frames": record.whole.frames,
        "frames_per_second": record.frames_per_second,
        "stages": {
            name: dict(zip(_STAGE_TIMES, times[name], strict=True))
            for name in STAGES
            if name in times
        },
        "tracks": record.whole.objects,
        "track_rows": record.whole.rows,
        "predicted_rows": record.whole.predicted,
        "detection_rate": record.whole.detection_rate,
        "detections": record.whole.detections,
        "expected_false_alarms": record.whole.false_alarms,
        "expected_count_mean": known_mean(record.mass),
        "scores": dict(about.scores),
        "warnings": about.warnings,
        "notes": about.notes,
        "configuration": config,
        "frames_left_out": about.left_out,
        "log_evidence_mean": known_mean(record.log_evidence),
        "log_evidence": record.log_evidence,
        "doubtful_boxes": record.doubtful,
    }
    return {key: json_value(value) for key, value in document.items()}


def grouped(number: float) -> str:
    """A whole number with commas between groups of three digits."""
    return f"{round(number):,}"


def counted(number: int, *noun: str) -> str:
    """A number with its noun, such as "1 frame" and "2 frames"; an irregular plural is the second
    noun.
    """
    if number == 1:
        word = noun[0]
    elif len(noun) > 1:
        word = noun[1]
    else:
        word = f"{noun[0]}s"
    return f"{grouped(number)} {word}"


def duration(seconds: float) -> str:
    """A time such as "8.2 s", "1 min 54 s", "2 h 5 min"."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    if seconds < 3600:
        return f"{int(seconds // 60)} min {int(seconds % 60)} s"
    return f"{int(seconds // 3600)} h {int(seconds % 3600 // 60)} min"


def percent(part: float, whole: float = 1.0) -> str:
    """The share in per cent, with a decimal if it is below 10 %; a dash if the whole is 0."""
    if not whole > 0:
        return "–"
    share = 100 * part / whole
    decimals = 1 if 0 < share < 10 else 0
    return f"{share:.{decimals}f}{_NBSP}%"


def clock(time: float) -> str:
    """A time of the video as minutes and seconds, 1:05.2, with hours from one on."""
    tenths = round(10 * time)
    hours, rest = divmod(tenths, 36000)
    text = f"{rest % 600 / 10:04.1f}"
    return f"{hours}:{rest // 600:02d}:{text}" if hours else f"{rest // 600}:{text}"


def seconds(time: float) -> str:
    """A time such as "0.5 s", "2 s", and as `duration` from a minute on."""
    if time < 59.5:
        return f"{time:.2g}{_NBSP}s"
    return duration(time)


def nats(value: float) -> str:
    """A log-likelihood ratio with its sign; a dash if it is not known."""
    if not math.isfinite(value):
        return "–"
    return f"{value:+.2f}{_NBSP}nats".replace("-", "−")


def spread(values: tuple[float, float]) -> str:
    """A mean and a standard deviation such as "0.85 ± 0.17"."""
    mean, deviation = values
    return f"{mean:.2f}{_NBSP}±{_NBSP}{deviation:.2f}".replace("-", "−")


def odds(number: float) -> str:
    """Odds such as "12:1", with a decimal below 10."""
    return f"{number:.1f}:1" if number < 9.95 else f"{grouped(min(number, 1e6))}:1"


def rate(number: float) -> str:
    """A number with two digits below 10, and as `grouped` from there on."""
    if number < 9.95:
        return f"{number:.2g}"
    return grouped(number)


def score(value: float) -> str:
    """A score with three decimals, a count without decimals."""
    if not math.isfinite(value):
        return "undefined"
    if isinstance(value, int | np.integer):
        return grouped(value)
    return f"{value:.3f}"


def flattened(config: Mapping[str, object], prefix: str = "") -> tuple[tuple[str, str], ...]:
    """Pairs (dotted name, text) of a nested configuration, in its order, as ``--set`` takes
    them.
    """
    pairs: list[tuple[str, str]] = []
    for key, value in config.items():
        if isinstance(value, Mapping):
            pairs += flattened(value, f"{prefix}{key}.")
        else:
            pairs.append((f"{prefix}{key}", json.dumps(json_value(value), ensure_ascii=False)))
    return tuple(pairs)


def write_run(path: Path, document: Mapping[str, object]) -> None:
    """Write the document as indented UTF-8. Raises `InputError` if the file cannot be written.

    Parameters
    ----------
    path : the file.
    document : the result of `run_document`.
    """
    text = json.dumps(json_value(document), indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")
