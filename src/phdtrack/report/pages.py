"""The pages and sections of reports, from the templates in ``report/templates``.

A report is one file that can be read without network, on a phone, on paper and in the dark: pictures are ``data:``
addresses, the style sheet is inline, there is no script, and a content security policy forbids to fetch anything.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup

from phdtrack.report import charts, scenes
from phdtrack.report.charts import GroupSeries
from phdtrack.report.record import About, RunRecord, sentences
from phdtrack.report.rendering import render
from phdtrack.report.run_json import flattened, write_text
from phdtrack.scene import Scene
from phdtrack.scene.online import SceneUpdate
from phdtrack.scene.rates import Rates, RatesLearning
from phdtrack.types import Image


def write_report(path: Path, record: RunRecord, config: Mapping[str, object] | None = None, more: str = "") -> None:
    """Write the report of a run.

    Parameters
    ----------
    path : of the file.
    record : what is shown.
    config : the settings, listed at the end.
    more : sections, as markup, that come after the key figures.

    Raises
    ------
    InputError : the file cannot be written.
    """
    write_text(path, report_html(record, config or {}, more))


def report_html(record: RunRecord, config: Mapping[str, object], more: str = "") -> str:
    """The whole page as text.

    Parameters
    ----------
    record, config, more : as in `write_report`.

    Returns
    -------
    HTML.
    """
    about, speed = record.about, record.frames_per_second
    return render(
        "run.html",
        title=about.title or record.info.name or "Tracking run",
        lead=" ".join(sentences(record)),
        record=record,
        median=float(np.median(record.lifetimes)) if len(record.tracks) else 0.0,
        speed=f"{speed:.1f}" if math.isfinite(speed) else "–",
        more=Markup(more),
        settings=flattened(config),
        charts=charts,
        scenes=scenes,
    )


def group_sections(series: GroupSeries) -> str:
    """Counts, plan, events and the first warning of each pair of groups."""
    words = {"merge": "into ", "split": "from "}
    events = [
        (f"{time:.1f}", kind, group, f"{words.get(kind, '')}{other}" if other else "")
        for time, kind, group, other in series.events
    ]
    first: dict[tuple[int, int], tuple[str, ...]] = {}
    for time, a, b, seconds, probability in series.warnings:
        first.setdefault((a, b), (f"{time:.1f}", f"{a} and {b}", f"{seconds:.1f}", f"{probability:.2f}"))
    return render("groups.html", series=series, events=events, warnings=list(first.values()), charts=charts)


def positions_page(about: About, source: str, lead: str, sections: str, config: Mapping[str, object]) -> str:
    """The page of groups among people whose positions are known.

    Parameters
    ----------
    about : title, notes, command.
    source, lead : where the positions come from, what happened.
    sections : of `group_sections`.
    config : the settings, listed at the end.

    Returns
    -------
    HTML.
    """
    given = {"title": about.title, "about": about, "source": source, "lead": lead, "sections": Markup(sections)}
    return render("positions.html", settings=flattened(config), **given)


def camera_section(told: Sequence[str]) -> str:
    """How far the camera went, from sentences without a capital letter and full stop."""
    return render("camera_motion.html", sentences=[sentence.capitalize() for sentence in told])


def learning_section(course: Sequence[SceneUpdate], memory: float, rate: float) -> str:
    """What was learned of the scene while it was tracked; nothing where nothing was learned.

    Parameters
    ----------
    course : what was known after each frame that taught something.
    memory : time after which what was seen counts for 37 %, minutes.
    rate : time units of the model a second.

    Returns
    -------
    HTML.
    """
    if not course:
        return ""
    changes = [(f"{one.time:.1f}", one.regime, sentence) for one in course for sentence in one.changes]
    return render("learning.html", chart=charts.learning_chart(course, rate), memory=memory, changes=changes)


def rates_section(course: Sequence[Rates], rule: RatesLearning) -> str:
    """What was learned of p_D, false alarms, births and scores; nothing where nothing was learned."""
    if not course:
        return ""
    return render("rates.html", chart=charts.rates_chart(course, rule), last=course[-1], rule=rule)


@dataclass(frozen=True, slots=True, eq=False)
class SceneTraining:
    """A learned scene and what is known of its training.

    Attributes
    ----------
    scene : what was learned.
    image : (H, W, 3) BGR frame, or (0, 0, 3).
    births_gain, clutter_gain : nats per sample that was left out, above a uniform density; NaN where unknown.
    births_from, clutter_from : the samples in words.
    """

    scene: Scene
    image: Image
    births_gain: float = math.nan
    clutter_gain: float = math.nan
    births_from: str = ""
    clutter_from: str = ""


def scene_page(training: SceneTraining, lead: str, command: str) -> str:
    """The page of a learned scene: where births and false alarms are expected, and how well that predicts.

    Parameters
    ----------
    training : what was learned.
    lead : the same in words.
    command : how to use it.

    Returns
    -------
    HTML.
    """

    def drawn(births: bool) -> charts.Picture | None:
        learned = training.scene.births if births else training.scene.clutter
        return None if learned is None else scenes.map_picture(learned, training.scene, training.image, births=births)

    return render("scene.html", title="Learned scene", training=training, lead=lead, command=command, drawn=drawn)
