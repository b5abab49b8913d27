"""``report.html`` of a comparison: pooled scores, scores over clutter and by sequence, every cell, the worst frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from phdtrack.compare.engine import Comparison
from phdtrack.compare.records import Plan
from phdtrack.compare.statistics import Interval
from phdtrack.compare.summary import Row, Summary
from phdtrack.compare.tables import head, label, lines_of, sparse, written
from phdtrack.compare.worst import WorstFrame
from phdtrack.report.charts import MethodScores, Picture, jpeg, score_bars, score_lines
from phdtrack.report.record import About
from phdtrack.report.rendering import counted, page, score_direction
from phdtrack.report.run_json import flattened


@dataclass(frozen=True, slots=True)
class Table:
    """A table of scores."""

    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Shown:
    """A picture with its caption, which is its alternative text too."""

    picture: Picture
    caption: str


def comparison_page(
    comparison: Comparison, found: Summary, names: Sequence[str], frames: Sequence[WorstFrame], about: About
) -> str:
    """The report as text.

    Parameters
    ----------
    comparison, found : what was run, and its summary.
    names : the scores to show.
    frames : the worst ones.
    about : title, command, warnings, notes.

    Returns
    -------
    The whole page.
    """
    plan = comparison.plan
    pooled = [row for row in found.rows if row.pooled]
    single = [row for row in found.rows if not row.pooled]
    ahead = [row for row in found.rows if row.ahead]
    return page(
        "comparison.html",
        title=about.title,
        source=described(plan),
        lead=" ".join(sentences(plan, found)),
        about=about,
        first=plan.methods[0].name,
        pooled=Table(head(names), sparse(lines_of(pooled, names))),
        charts=_charts(plan, found, single, names),
        each=Table(head(names), sparse(lines_of(single, names))),
        differences=Table(head(names), sparse(lines_of(ahead, names, ahead=True))),
        frames=[Shown(jpeg(frame.image), frame.caption) for frame in frames],
        settings=flattened(_config(plan)),
        seeds=len(plan.seeds),
    )


def described(plan: Plan) -> str:
    """What was compared, in numbers."""
    footages = len({case.footage.name for case in plan.cases})
    parts = [
        counted(len(plan.methods), "filter"),
        counted(footages, "sequence"),
        f"{len(plan.cases)} with detections" if len(plan.cases) != footages else "",
        counted(len(plan.rates), "rate of added clutter", "rates of added clutter"),
        counted(len(plan.seeds), "seed"),
    ]
    return ", ".join(part for part in parts if part)


def sentences(plan: Plan, found: Summary) -> list[str]:
    """Who is ahead in MOTA over everything, for each rate of clutter, where that is more than chance between seeds."""
    said = []
    for rate in plan.rates:
        rows = [row for row in found.widest if row.rate == rate and "MOTA" in row.values]
        if len(rows) < 2:
            continue
        rows.sort(key=lambda row: -row.values["MOTA"].mean)
        alike = [row for row in rows[1:] if not rows[0].told_apart(row, "MOTA")]
        behind = [_with_mota(row) for row in rows[1:] if row not in alike]
        clutter = f"With {rate:g} added boxes per frame" if rate else "Without added clutter"
        if alike:
            names = _listed([_with_mota(row) for row in (rows[0], *alike)])
            lead = f"the highest MOTA is not told apart between {names}"
        else:
            lead = f"{rows[0].method} has the highest MOTA, {written(rows[0].values['MOTA'], 'MOTA')}"
        said.append("; ".join([f"{clutter} {lead}", ", ".join(behind)] if behind else [f"{clutter} {lead}"]) + ".")
    return said


def _with_mota(row: Row) -> str:
    return f"{row.method} {written(row.values['MOTA'], 'MOTA')}"


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"


def notes(found: Summary, seeds: Sequence[int], *, alone: bool, kept: bool) -> tuple[str, ...]:
    """What a reader should know of the numbers; ``alone``: the runs of this time ran one after the other; ``kept``: some
    are of an earlier time."""
    still = list(dict.fromkeys(row.method for row in found.rows if not row.random and not row.failed))
    out = [f"ms per frame is the median over a run's frames of filter, extraction and association{_shared(alone, kept)}."]
    if still and len(seeds) > 1:
        out.append(f"{', '.join(still)}: nothing is random without added clutter, so one run stands for all seeds.")
    return tuple(out)


def _shared(alone: bool, kept: bool) -> str:
    if not alone:
        return ", taken while other runs share the machine: compare ratios, or say --jobs 1"
    return "; runs kept from before may have shared the machine: --overwrite takes all times anew" if kept else ""


def _charts(plan: Plan, found: Summary, single: Sequence[Row], names: Sequence[str]) -> list[tuple[str, list[Shown]]]:
    methods = [method.name for method in plan.methods]
    charts = []
    if len(plan.rates) > 1:
        over = [_over_clutter(plan, found, methods, name) for name in names]
        charts.append(("By added clutter", over))
    for rate in plan.rates:
        rows = [row for row in single if row.rate == rate]
        title = f"By sequence, {rate:g} added boxes per frame" if rate else "By sequence, as detected"
        charts.append((title, [_by_case(rows, methods, name) for name in names]))
    return charts


def _over_clutter(plan: Plan, found: Summary, methods: Sequence[str], name: str) -> Shown:
    rates = np.array(sorted(plan.rates))
    rows = {(row.method, row.rate): row for row in found.widest}
    series = [_series(method, [rows[method, rate].values.get(name) for rate in rates]) for method in methods]
    over = "pooled over everything" if any(row.pooled for row in found.widest) else "of the sequence"
    picture = score_lines(rates, "added clutter, boxes per frame", label(name), series)
    return Shown(
        picture, f"{label(name)} {over}, mean over the seeds with 95 % confidence intervals{score_direction(name)}."
    )


def _by_case(rows: Sequence[Row], methods: Sequence[str], name: str) -> Shown:
    places = list(dict.fromkeys((row.sequence, row.detections) for row in rows))
    by = {(row.sequence, row.detections, row.method): row for row in rows}
    series = [_series(method, [by[*place, method].values.get(name) for place in places]) for method in methods]
    picture = score_bars([" ".join(place) for place in places], label(name), series)
    return Shown(picture, f"{label(name)}, mean over the seeds with 95 % confidence intervals{score_direction(name)}.")


def _series(method: str, values: Sequence[Interval | None]) -> MethodScores:
    none = Interval(np.nan, np.nan, 0)
    each = [value or none for value in values]
    mean, low, high = (np.array([getattr(one, part) for one in each], np.float64) for part in ("mean", "low", "high"))
    return MethodScores(method, mean, low, high)


def _config(plan: Plan) -> Mapping[str, object]:
    """Every method's settings, and what they were compared on."""
    read = [
        {"sequence": case.footage.name, "detections": case.seen.name, "truth": str(case.footage.truth)}
        for case in plan.cases
    ]
    methods: dict[str, object] = {method.name: method.settings.as_dict() for method in plan.methods}
    return {**methods, "input": read, "clutter": list(plan.rates), "seeds": list(plan.seeds), "iou": plan.iou}
