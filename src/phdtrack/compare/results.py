"""The results of a comparison as text, as CSV for programs, and as a page with charts."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phdtrack.compare.failures import WorstFrame
from phdtrack.compare.plans import Plan
from phdtrack.compare.runs import Comparison, Failed
from phdtrack.compare.statistics import OTHERS, SCORES, Interval, Row, values_of, widest
from phdtrack.report.charts import MethodScores, Picture, jpeg, score_chart
from phdtrack.report.pages import lines, render
from phdtrack.report.record import About
from phdtrack.report.words import flattened, score_direction, write_text
from phdtrack.types import F8

_SHOWN = ("MODA", "MOTA", "IDF1", "HOTA", "id_switches", "ms")
_COUNTS = "id_switches misses false_positives fragments false_tracks mostly_tracked mostly_lost tracks"
_DIGITS = {"ms": 2, "boxes_per_frame": 2, "delay_mean": 1} | dict.fromkeys(_COUNTS.split(), 1)
_UNKNOWN = Interval(math.nan, math.nan, 0)


class Table(NamedTuple):
    """Lines of text under a head: sequence, detections, clutter and filter, then scores."""

    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def shown(rows: Sequence[Row], wanted: Sequence[str]) -> tuple[str, ...]:
    """The scores to show: those wanted, or the usual ones where there is truth, and what the comparison has of them."""
    known = {name for row in rows for name in row.values}
    usual = _SHOWN if "MOTA" in known else OTHERS
    return tuple(name for name in (wanted or usual) if name in known) or OTHERS


def written(value: Interval | None, name: str, sign: str = "") -> str:
    """A score ``name``, which decides the digits, as ``0.553 ± 0.018``, or with a plus ``sign``; a dash where there is none.

    Parameters
    ----------
    value : mean and interval.
    name : of the score.
    sign : ``+`` where a plus sign is written.

    Returns
    -------
    Text for people.
    """
    if value is None or not math.isfinite(value.mean):
        return "–"
    digits = _DIGITS.get(name, 3)
    text = f"{value.mean:{sign}.{digits}f}"
    return f"{text} ± {value.half:.{digits}f}" if math.isfinite(value.half) else text


def table(rows: Iterable[Row], names: Sequence[str], *, ahead: bool = False) -> Table:
    """A line for each row; its first cells are left out where they are those of the line before.

    Parameters
    ----------
    rows : of a summary.
    names : the scores to show.
    ahead : whether to show the differences to the first method instead.

    Returns
    -------
    The table.
    """
    out: list[tuple[str, ...]] = []
    before: tuple[str, ...] = ("", "", "")
    for row in rows:
        values, sign = (row.ahead, "+") if ahead else (row.values, "")
        cells = [written(values.get(name), name, sign) for name in names]
        if row.failed:
            cells = ["failed", *[""] * (len(names) - 1)]
        where = (f"{row.sequence} ({row.cases})" if row.pooled else row.sequence, row.detections, f"{row.rate:g}")
        same = next((i for i in range(3) if where[i] != before[i]), 3)
        out.append((*([""] * same), *where[same:], row.method, *cells))
        before = where
    return Table(("sequence", "detections", "clutter", "filter", *map(_label, names)), out)


def write_cells(path: Path, rows: Sequence[Row]) -> None:
    """One line for each row: every score's mean, half its interval, the difference to the first method."""
    names = [name for name in (*SCORES, *OTHERS) if any(name in row.values for row in rows)]
    lines: list[Sequence[object]] = [
        ["sequence", "detections", "cases", "clutter", "filter", "seeds", "failed"]
        + [f"{name}{part}" for name in names for part in ("", "_half", "_ahead", "_ahead_half")]
    ]
    for row in rows:
        seeds = max((value.count for value in row.values.values()), default=0)
        intervals = [part.get(name, _UNKNOWN) for name in names for part in (row.values, row.ahead)]
        where = (row.sequence, row.detections, row.cases, f"{row.rate:g}", row.method, seeds, row.failed)
        lines.append([*where, *(_number(number) for one in intervals for number in (one.mean, one.half))])
    _write(path, lines)


def write_runs(path: Path, comparison: Comparison) -> None:
    """One line for each run, and where it is kept."""
    each = [(run, {} if isinstance(result, Failed) else values_of([result]), result) for run, result in comparison.runs]
    names = [name for name in (*SCORES, *OTHERS) if any(name in values for _, values, _ in each)]
    lines: list[Sequence[object]] = [["sequence", "detections", "clutter", "filter", "seed", "failed", *names, "folder"]]
    for run, values, result in each:
        failed = result.reason if isinstance(result, Failed) else ""
        where = (run.case.sequence, run.case.detections, f"{run.rate:g}", run.method.name, run.seed, failed)
        lines.append([*where, *(_number(values.get(name, math.nan)) for name in names), run.place.as_posix()])
    _write(path, lines)


def document_of(row: Row) -> dict[str, object]:
    """A row for programs."""
    scores, ahead = (
        {name: {"mean": one.mean, "half": one.half, "seeds": one.count} for name, one in part.items()}
        for part in (row.values, row.ahead)
    )
    where = {"sequence": row.sequence, "detections": row.detections, "cases": row.cases, "clutter": row.rate}
    run = {"filter": row.method, "random": row.random, "failed": row.failed}
    return {**where, **run, "scores": scores, "ahead": ahead}


def described(plan: Plan) -> str:
    """What was compared, in numbers."""
    return lines("comparison_plan.txt", plan=plan, sequences=len({case.sequence for case in plan.cases}))[0]


def sentences(plan: Plan, found: Sequence[Row]) -> tuple[str, ...]:
    """Which method has the highest MOTA over everything, for each rate of clutter, where that is more than chance."""
    out: list[str] = []
    for rate in plan.rates:
        rows = [row for row in widest(found) if row.rate == rate and "MOTA" in row.values]
        if len(rows) < 2:
            continue
        best, *others = sorted(rows, key=lambda row: -row.values["MOTA"].mean)
        name = {row.method: f"{row.method} {written(row.values['MOTA'], 'MOTA')}" for row in rows}
        alike = [name[row.method] for row in others if not row.differs(best, "MOTA")]
        behind = [name[row.method] for row in others if row.differs(best, "MOTA")]
        highest = best.method, written(best.values["MOTA"], "MOTA")
        out += lines("comparison_rate.txt", rate=rate, best=highest, alike=[name[best.method], *alike], behind=behind)
    return tuple(out)


def notes(rows: Sequence[Row], comparison: Comparison, *, in_turn: bool) -> tuple[str, ...]:
    """What a reader should know of the numbers.

    Parameters
    ----------
    rows, comparison : the summary, and what was run.
    in_turn : whether the runs of this time ran one after the other.

    Returns
    -------
    Sentences.
    """
    many = len(comparison.plan.seeds) > 1
    still = dict.fromkeys(row.method for row in rows if many and not row.random and not row.failed)
    return lines("comparison_notes.txt", still=list(still), in_turn=in_turn, kept=comparison.reused > 0)


def comparison_page(
    comparison: Comparison, rows: Sequence[Row], names: Sequence[str], frames: Sequence[WorstFrame], about: About
) -> str:
    """The report of a comparison.

    Parameters
    ----------
    comparison, rows : what was run, and its summary.
    names : the scores to show.
    frames : the worst ones.
    about : title, command, warnings, notes.

    Returns
    -------
    The whole page.
    """
    plan = comparison.plan
    given = [{"sequence": case.sequence, "detections": case.detections, "truth": str(case.truth)} for case in plan.cases]
    settings = {method.name: method.settings.as_dict() for method in plan.methods}
    more = {"input": given, "clutter": list(plan.rates), "seeds": list(plan.seeds), "iou": plan.iou}
    return render(
        "comparison.html",
        title=about.title,
        source=described(plan),
        lead=" ".join(sentences(plan, rows)),
        about=about,
        first=plan.methods[0].name,
        pooled=table((row for row in rows if row.pooled), names),
        charts=[(title, list(_charts(x, x_label, own, names))) for title, x, x_label, own in _sections(plan, rows)],
        each=table((row for row in rows if not row.pooled), names),
        differences=table((row for row in rows if row.ahead), names, ahead=True),
        frames=[(jpeg(frame.image), frame.caption) for frame in frames],
        settings=flattened(settings | more),
        seeds=len(plan.seeds),
    )


def _sections(plan: Plan, found: Sequence[Row]) -> Iterator[tuple[str, F8 | Sequence[str], str, list[list[Row]]]]:
    """Title, places, their label, and for each method its rows at these places."""
    methods = [method.name for method in plan.methods]
    if len(plan.rates) > 1:
        rates, by_rate = sorted(plan.rates), {(row.method, row.rate): row for row in widest(found)}
        over = ", pooled over everything" if widest(found)[0].pooled else ""
        rows = [[by_rate[method, rate] for rate in rates] for method in methods]
        yield f"By added clutter{over}", np.array(rates), "added clutter, boxes per frame", rows
    for rate in plan.rates:
        single = [row for row in found if row.rate == rate and not row.pooled]
        rows = [[row for row in single if row.method == method] for method in methods]
        places = [f"{row.sequence} {row.detections}" for row in rows[0]]
        yield f"By sequence, {rate:g} added boxes per frame" if rate else "By sequence, as detected", places, "", rows


def _charts(
    x: F8 | Sequence[str], x_label: str, rows: list[list[Row]], names: Sequence[str]
) -> Iterator[tuple[Picture, str]]:
    """A chart of each score, and its caption, which is its alternative text too."""
    for name in names:
        series = []
        for own in rows:
            each = [row.values.get(name, _UNKNOWN) for row in own]
            mean, half = np.array([(one.mean, one.half) for one in each]).T
            series.append(MethodScores(own[0].method, mean, half))
        about = f"{_label(name)}, mean over the seeds with 95 % confidence intervals{score_direction(name)}."
        yield score_chart(x, x_label, _label(name), series), about


def _label(name: str) -> str:
    """A score's name as a table's head has it."""
    return {"id_switches": "switches", "ms": "ms per frame"}.get(name, name.replace("_", " "))


def _number(value: float) -> str:
    """Empty where it is undefined."""
    return f"{value:.9g}" if math.isfinite(value) else ""


def _write(path: Path, rows: Sequence[Sequence[object]]) -> None:
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerows(rows)
    write_text(path, file.getvalue())
