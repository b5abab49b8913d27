"""The results of a comparison as text, as CSV for programs, and as a page with charts."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phdtrack.compare.failures import WorstFrame
from phdtrack.compare.plans import Plan
from phdtrack.compare.runs import Comparison, Failed
from phdtrack.compare.statistics import OTHERS, SCORES, SHOWN, Interval, Row, Summary, values_of
from phdtrack.errors import InputError
from phdtrack.report.charts import MethodScores, Picture, jpeg, score_chart
from phdtrack.report.pages import lines, render
from phdtrack.report.record import About
from phdtrack.report.words import flattened, score_direction

_COUNTS = "id_switches misses false_positives fragments false_tracks mostly_tracked mostly_lost tracks"
_DIGITS = {"ms": 2, "boxes_per_frame": 2, "delay_mean": 1} | dict.fromkeys(_COUNTS.split(), 1)
_LABELS = {"id_switches": "switches", "ms": "ms per frame"}


class Table(NamedTuple):
    """Lines of text under a head: sequence, detections, clutter and filter, then scores."""

    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


class _Shown(NamedTuple):
    """A picture with its caption, which is its alternative text too."""

    picture: Picture
    caption: str


def shown(found: Summary, wanted: Sequence[str]) -> tuple[str, ...]:
    """The scores to show: those wanted, or the usual ones where there is truth, and what the comparison has of them."""
    known = {name for row in found.rows for name in row.values}
    usual = (*SHOWN, "ms") if "MOTA" in known else OTHERS
    return tuple(name for name in (wanted or usual) if name in known) or OTHERS


def written(value: Interval | None, name: str, *, signed: bool = False) -> str:
    """A score as ``0.553 ± 0.018``; a dash where there is none.

    Parameters
    ----------
    value : mean and interval.
    name : of the score; decides the digits.
    signed : whether a plus sign is written.

    Returns
    -------
    Text for people.
    """
    if value is None or not math.isfinite(value.mean):
        return "–"
    digits = _DIGITS.get(name, 3)
    text = f"{value.mean:{'+' if signed else ''}.{digits}f}"
    return f"{text} ± {value.half:.{digits}f}" if math.isfinite(value.half) else text


def table(rows: Sequence[Row], names: Sequence[str], *, ahead: bool = False) -> Table:
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
        values = row.ahead if ahead else row.values
        cells = [written(values.get(name), name, signed=ahead) for name in names]
        if row.failed:
            cells = ["failed", *[""] * (len(names) - 1)]
        where = (f"{row.sequence} ({row.cases})" if row.pooled else row.sequence, row.detections, f"{row.rate:g}")
        same = next((i for i in range(3) if where[i] != before[i]), 3)
        out.append((*([""] * same), *where[same:], row.method, *cells))
        before = where
    return Table(("sequence", "detections", "clutter", "filter", *(_label(name) for name in names)), out)


def write_cells(path: Path, found: Summary) -> None:
    """One row for each cell and each pool: every score's mean, half its interval, the difference to the first method."""
    names = [name for name in (*SCORES, *OTHERS) if any(name in row.values for row in found.rows)]
    columns = [f"{name}{part}" for name in names for part in ("", "_half", "_ahead", "_ahead_half")]
    rows = []
    for row in found.rows:
        seeds = max((value.count for value in row.values.values()), default=0)
        intervals = [part.get(name) for name in names for part in (row.values, row.ahead)]
        numbers = [number for one in intervals for number in ((one.mean, one.half) if one else (math.nan, math.nan))]
        where = (row.sequence, row.detections, row.cases, f"{row.rate:g}", row.method, seeds, row.failed)
        rows.append([*where, *map(_number, numbers)])
    _write(path, ["sequence", "detections", "cases", "clutter", "filter", "seeds", "failed", *columns], rows)


def write_runs(path: Path, comparison: Comparison) -> None:
    """One row for each run, and where it is kept."""
    each = [(run, {} if isinstance(result, Failed) else values_of([result]), result) for run, result in comparison.runs]
    names = [name for name in (*SCORES, *OTHERS) if any(name in values for _, values, _ in each)]
    rows = []
    for run, values, result in each:
        failed = result.reason if isinstance(result, Failed) else ""
        cell = run.cell
        where = (cell.case.sequence.name, cell.case.detections.name, f"{cell.rate:g}", cell.method.name, run.seed, failed)
        rows.append([*where, *(_number(values.get(name, math.nan)) for name in names), run.place.as_posix()])
    _write(path, ["sequence", "detections", "clutter", "filter", "seed", "failed", *names, "folder"], rows)


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
    sequences = len({case.sequence.name for case in plan.cases})
    return lines("comparison_plan.txt", plan=plan, sequences=sequences)[0]


def sentences(plan: Plan, found: Summary) -> tuple[str, ...]:
    """Which method has the highest MOTA over everything, for each rate of clutter, where that is more than chance."""
    out: list[str] = []
    for rate in plan.rates:
        rows = [row for row in found.widest if row.rate == rate and "MOTA" in row.values]
        rows.sort(key=lambda row: -row.values["MOTA"].mean)
        names = [f"{row.method} {written(row.values['MOTA'], 'MOTA')}" for row in rows]
        differs = [row.differs(rows[0], "MOTA") for row in rows]
        alike = [name for name, other in zip(names[1:], differs[1:], strict=True) if not other]
        behind = [name for name, other in zip(names[1:], differs[1:], strict=True) if other]
        if len(rows) > 1:
            best = rows[0].method, written(rows[0].values["MOTA"], "MOTA")
            out += lines("comparison_rate.txt", rate=rate, best=best, alike=[names[0], *alike], behind=behind)
    return tuple(out)


def notes(found: Summary, comparison: Comparison, *, in_turn: bool) -> tuple[str, ...]:
    """What a reader should know of the numbers.

    Parameters
    ----------
    found, comparison : the rows, and what was run.
    in_turn : whether the runs of this time ran one after the other.

    Returns
    -------
    Sentences.
    """
    many = len(comparison.plan.seeds) > 1
    still = dict.fromkeys(row.method for row in found.rows if many and not row.random and not row.failed)
    return lines("comparison_notes.txt", still=list(still), in_turn=in_turn, kept=comparison.reused > 0)


def comparison_page(
    comparison: Comparison, found: Summary, names: Sequence[str], frames: Sequence[WorstFrame], about: About
) -> str:
    """The report of a comparison.

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
    single = [row for row in found.rows if not row.pooled]
    given = [
        {"sequence": case.sequence.name, "detections": case.detections.name, "truth": str(case.sequence.truth)}
        for case in plan.cases
    ]
    settings = {method.name: method.settings.as_dict() for method in plan.methods}
    more = {"input": given, "clutter": list(plan.rates), "seeds": list(plan.seeds), "iou": plan.iou}
    return render(
        "comparison.html",
        title=about.title,
        source=described(plan),
        lead=" ".join(sentences(plan, found)),
        about=about,
        first=plan.methods[0].name,
        pooled=table([row for row in found.rows if row.pooled], names),
        charts=_charts(plan, found, single, names),
        each=table(single, names),
        differences=table([row for row in found.rows if row.ahead], names, ahead=True),
        frames=[_Shown(jpeg(frame.image), frame.caption) for frame in frames],
        settings=flattened(settings | more),
        seeds=len(plan.seeds),
    )


def _charts(plan: Plan, found: Summary, single: Sequence[Row], names: Sequence[str]) -> list[tuple[str, list[_Shown]]]:
    charts = []
    methods = [method.name for method in plan.methods]
    if len(plan.rates) > 1:
        rates = np.array(sorted(plan.rates))
        by_rate = {(row.method, row.rate): row for row in found.widest}
        over = "pooled over everything" if any(row.pooled for row in found.widest) else "of the sequence"
        shown = []
        for name in names:
            series = [_series(method, [by_rate[method, rate] for rate in rates], name) for method in methods]
            picture = score_chart(rates, "added clutter, boxes per frame", _label(name), series)
            shown.append(_Shown(picture, _caption(f"{_label(name)} {over}", name)))
        charts.append(("By added clutter", shown))
    for rate in plan.rates:
        rows = {(row.sequence, row.detections, row.method): row for row in single if row.rate == rate}
        places = list(dict.fromkeys(key[:2] for key in rows))
        shown = []
        for name in names:
            series = [_series(method, [rows[*place, method] for place in places], name) for method in methods]
            picture = score_chart([" ".join(place) for place in places], "", _label(name), series)
            shown.append(_Shown(picture, _caption(_label(name), name)))
        charts.append((f"By sequence, {rate:g} added boxes per frame" if rate else "By sequence, as detected", shown))
    return charts


def _caption(start: str, name: str) -> str:
    return f"{start}, mean over the seeds with 95 % confidence intervals{score_direction(name)}."


def _series(method: str, rows: Sequence[Row], name: str) -> MethodScores:
    each = [row.values.get(name, Interval(np.nan, np.nan, 0)) for row in rows]
    mean, low, high = np.array([(one.mean, one.low, one.high) for one in each], np.float64).reshape(-1, 3).T
    return MethodScores(method, mean, low, high)


def _label(name: str) -> str:
    """A score's name as a table's head has it."""
    return _LABELS.get(name, name.replace("_", " "))


def _number(value: float) -> str:
    """Empty where it is undefined."""
    return f"{value:.9g}" if math.isfinite(value) else ""


def _write(path: Path, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    try:
        with path.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([columns, *rows])
    except OSError as error:
        raise InputError(f"could not be written: {error.strerror or error}", where=path) from error
