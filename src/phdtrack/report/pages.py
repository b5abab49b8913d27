"""The pages and sections of reports, from the templates in ``report/templates``.

A report is one file that can be read without network, on a phone, on paper and in the dark: pictures are ``data:``
addresses, the style sheet is inline, there is no script, and a content security policy in the head forbids the browser to
fetch anything.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup

from phdtrack.report import charts, scenes
from phdtrack.report.charts import GroupSeries, Picture
from phdtrack.report.record import About, RunRecord, sentences
from phdtrack.report.rendering import page, render
from phdtrack.report.run_json import flattened, write_text
from phdtrack.scene import LearnedDensity, Scene
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
    """The whole page of `write_report` as text."""
    info, about = record.info, record.about
    source = f"{info.width} × {info.height} pixels, {info.fps:.4g} frames per second"
    speed = record.frames_per_second
    return page(
        "run.html",
        title=about.title or info.name or "Tracking run",
        source=source + (f", run {about.started}" if about.started else ""),
        lead=" ".join(sentences(record)),
        record=record,
        median=float(np.median(record.lifetimes)) if len(record.tracks) else 0.0,
        speed=f"{speed:.1f}" if math.isfinite(speed) else "–",
        more=Markup(more),
        settings=flattened(config),
        charts=charts,
        scenes=scenes,
    )


def group_sections(series: GroupSeries) -> Markup:
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


def positions_page(about: About, source: str, lead: str, sections: Markup, config: Mapping[str, object]) -> str:
    """The report of groups among people whose positions are known.

    Parameters
    ----------
    about : title, notes, command.
    source, lead : where the positions come from, what happened.
    sections : of `group_sections`.
    config : the settings, listed at the end.

    Returns
    -------
    The whole page.
    """
    settings = flattened(config)
    return page(
        "positions.html", title=about.title, about=about, source=source, lead=lead, sections=sections, settings=settings
    )


def camera_section(told: Sequence[str]) -> Markup:
    """How far the camera went, from sentences without a capital letter and full stop."""
    return render("camera_motion.html", sentences=[sentence.capitalize() for sentence in told])


def learning_section(course: Sequence[SceneUpdate], memory: float, rate: float) -> Markup:
    """What was learned of the scene while it was tracked.

    Parameters
    ----------
    course : what was known after each frame that taught something.
    memory : time after which what was seen counts for 37 %, minutes.
    rate : time units of the model a second.

    Returns
    -------
    A section; nothing where nothing was learned.
    """
    if not course:
        return Markup()
    changes = [(f"{one.time:.1f}", one.regime, sentence) for one in course for sentence in one.changes]
    return render("learning.html", chart=charts.learning_chart(course, rate), memory=memory, changes=changes)


def rates_section(course: Sequence[Rates], rule: RatesLearning) -> Markup:
    """What was learned of p_D, false alarms, births and scores; nothing where nothing was learned."""
    if not course:
        return Markup()
    last, priors, used, units = course[-1], rule.priors, rule.settings, rule.rate
    alarms = "false alarms around each detection" if priors.clutter_each else "false alarms a frame"
    each = " around each detection" if priors.births_each else ""
    rows = (
        ("probability of detection", ".2f", priors.detection, last.detection, used.detection),
        (alarms, ".3g", priors.clutter, last.clutter, used.clutter),
        (f"births a second{each}", ".3g", priors.births * units, last.births * units, used.birth),
        ("odds of the worst score", ".2g", 1.0, last.lowest, used.scores),
        ("odds of the best score", ".3g", 1.0, last.highest, used.scores),
    )
    table = [
        (name, f"{set_:{form}}", f"{found:{form}}", "yes" if is_used else "no") for name, form, set_, found, is_used in rows
    ]
    return render("rates.html", chart=charts.rates_chart(course, rule), rows=table)


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
    The whole page.
    """
    scene, followed = training.scene, training.scene.followed
    rows = []
    if followed is not None and followed.share:
        rows = [
            ("false alarms that the tracker follows although it knows them", f"{100 * followed.share:.2g} %"),
            ("detections of objects a frame", f"{followed.objects.rate:.3g}"),
        ]
    parts = (
        _scene_part("Births", training, scene.births, births=True),
        _scene_part("False alarms", training, scene.clutter, births=False),
    )
    return page(
        "scene.html",
        title="Learned scene",
        source=scene.source,
        lead=lead,
        command=command,
        parts=parts,
        followed=rows,
        clutter_known=scene.clutter is not None,
    )


@dataclass(frozen=True, slots=True)
class _ScenePart:
    title: str
    births: bool
    origin: str = ""
    rows: tuple[tuple[str, str], ...] = ()
    picture: Picture | None = None


def _scene_part(title: str, training: SceneTraining, learned: LearnedDensity | None, *, births: bool) -> _ScenePart:
    if learned is None:
        return _ScenePart(title, births)
    scene, density = training.scene, learned.density
    gain = training.births_gain if births else training.clutter_gain
    origin = training.births_from if births else training.clutter_from
    rate = ("expected births per second", scene.rate) if births else ("expected false alarms per frame", 1.0)
    rows = (
        ("samples", str(learned.samples)),
        (rate[0], f"{learned.rate * rate[1]:.3g}"),
        ("Gaussians that were left", str(len(density))),
        ("share that may be anywhere", f"{100 * density.uniform:.1f} %"),
        (
            "log-likelihood of samples not learned from, above uniform",
            f"{gain:+.2f} nats each" if math.isfinite(gain) else "too few samples to leave any out",
        ),
    )
    picture = scenes.map_picture(learned, scene, training.image, births=births)
    return _ScenePart(title, births, origin[:1].upper() + origin[1:], rows, picture)
