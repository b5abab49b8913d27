"""The pages and sections of reports, from the Jinja2 templates in ``report/templates``.

A report is one file that can be read without network, on a phone, on paper and in the dark: pictures are ``data:``
addresses, the style sheet is inline, there is no script, and a content security policy forbids to fetch anything. Whatever a
template prints is escaped, unless it is `markupsafe.Markup`. Control characters and lone surrogates, which no browser
shows, become �.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING

from markupsafe import Markup

from phdtrack.files import json_value
from phdtrack.report import charts, words
from phdtrack.report.record import STAGES, RunRecord

if TYPE_CHECKING:
    from jinja2 import Environment

_NOT_SHOWN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff]")


@cache
def environment() -> Environment:
    """Where the templates are, and the functions that they can call. Jinja2 is imported here, on first use."""
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
    for function in (words.grouped, words.counted, words.duration, words.percent, words.score, words.score_direction):
        made.filters[function.__name__] = function
    return made


def render(template: str, **context: object) -> Markup:
    """The text of a template in ``report/templates``."""
    return Markup(environment().get_template(template).render(context))


def lines(template: str, **context: object) -> tuple[str, ...]:
    """The sentences of a text template, which has one on each line."""
    return tuple(str(line).strip() for line in render(template, **context).split("\n") if line.strip())


def score_meanings() -> dict[str, str]:
    """What each score says, and which way it is better, by its name."""
    found: dict[str, str] = vars(environment().get_template("scores.html").module)["meanings"]
    return {name: meaning + words.score_direction(name) for name, meaning in found.items()}


def sentences(record: RunRecord) -> tuple[str, ...]:
    """What happened in a run, in a few sentences for the report, the terminal and ``run.json``."""
    return lines("summary.txt", record=record)


def report_html(record: RunRecord, config: Mapping[str, object], more: str = "") -> str:
    """The report of a run.

    Parameters
    ----------
    record : what is shown.
    config : the settings, listed at the end.
    more : sections, as markup, that come after the key figures.

    Returns
    -------
    The whole page.
    """
    title, lead = record.about.title or record.info.name or "Tracking run", " ".join(sentences(record))
    known = {"record": record, "more": Markup(more), "settings": words.flattened(config)}
    return str(render("run.html", title=title, lead=lead, **known))


def run_document(record: RunRecord, config: Mapping[str, object]) -> dict[str, object]:
    """The run as JSON values: ``config`` is the whole configuration as nested mappings.

    Times are seconds. ``frames_per_second`` is that of detection and tracking, without drawing and without the
    ``frames_left_out`` in which kernels were compiled or loaded; ``stages`` are milliseconds per frame, whose sum may
    exceed a frame's share of the time because stages overlap. ``chain`` is null but for MCMC filters.
    """
    about, info = record.about, record.info
    document = {
        "command": about.command,
        "title": about.title,
        "summary": sentences(record),
        "versions": dict(about.versions),
        "seed": about.seed,
        "started": about.started,
        "seconds": about.seconds,
        "source": {"name": info.name, "width": info.width, "height": info.height, "fps": info.fps},
        "frames": len(record),
        "frames_per_second": record.frames_per_second,
        "stages": {
            name: dict(zip(("mean", "median", "p95", "share"), record.stage_times[name], strict=True))
            for name in (STAGES if len(record) else ())
        },
        "tracks": len(record.lifetimes),
        "track_rows": len(record.tracks),
        "predicted_rows": int(record.tracks.predicted.sum()),
        "detections": int(record.n_detections.sum()),
        "expected_false_alarms": record.false_alarms,
        "expected_count_mean": record.mean_mass,
        "scores": dict(about.scores),
        "warnings": about.warnings,
        "notes": about.notes,
        "configuration": config,
        "frames_left_out": about.left_out,
        "chain": record.chain,
    }
    return {key: json_value(value) for key, value in document.items()}
