"""The results of a comparison as text, as CSV for programs, and as a page."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from phdtrack.compare.runs import Comparison
from phdtrack.compare.statistics import (
    OTHERS,
    SCORES,
    UNKNOWN,
    Row,
    leading,
    summary,
    values_of,
    widest,
)
from phdtrack.files import write_text
from phdtrack.metrics.causes import SUMS
from phdtrack.parallel import Failed
from phdtrack.report.pages import flattened, lines, render, score_meanings
from phdtrack.report.record import About

_SHOWN = ("MODA", "MOTA", "IDF1", "HOTA", "id_switches", "log_evidence", "ms")
_COUNTS = (
    "id_switches misses false_positives fragments false_tracks mostly_tracked mostly_lost tracks"
)
_DIGITS = {"ms": 2, "boxes_per_frame": 2, "log_evidence": 1, "delay_mean": 1} | dict.fromkeys(
    (*_COUNTS.split(), *SUMS), 1
)
# Of these neither more nor less is better, or not between filters.
_NEUTRAL = (
    "frames truth_boxes output_boxes truth_objects output_identities count_error_mean log_evidence"
    " tracks boxes_per_frame"
)


class Table(NamedTuple):
    """Lines of text under a head: sequence, detections, clutter and filter, then scores."""

    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Results:
    """A comparison, the rows of its summary, and the names of the scores to show."""

    comparison: Comparison
    rows: Sequence[Row]
    names: tuple[str, ...]

    @classmethod
    def of(cls, comparison: Comparison, wanted: Sequence[str]) -> Results:
        """With the scores wanted, or the usual ones where there is truth, as far as the comparison
        has them.
        """
        rows = summary(comparison)
        known = {name for row in rows for name in row.scores}
        names = tuple(
            name for name in wanted or (_SHOWN if "MOTA" in known else OTHERS) if name in known
        )
        return cls(comparison, rows, names or OTHERS)

    def errors(self) -> Table:
        """The numbers of misses and false boxes by cause, where there is truth."""
        rows = [row for row in self.rows if "MOTA" in row.scores]
        return replace(self, names=SUMS).table(rows)

    def table(self, rows: Iterable[Row], *, ahead: bool = False) -> Table:
        """A line for each row, ``ahead`` with the differences to the first method; cells as in the
        line before are empty.

        A star stands before the best of a score on the same input, and before what is not told
        apart from it.
        """
        out: list[tuple[str, ...]] = []
        before: tuple[str, ...] = ("", "", "")
        for (sequence, cases, *rest), each in groupby(
            rows, lambda r: (r.sequence, r.cases, r.detections, f"{r.clutter:g}")
        ):
            own = list(each)
            where = (f"{sequence} ({cases})" if cases > 1 else sequence, *rest)
            columns = [self._column(own, name, ahead=ahead) for name in self.names]
            for k, row in enumerate(own):
                if row.failed:
                    cells = ["failed", *[""] * (len(columns) - 1)]
                else:
                    cells = [column[k] for column in columns]
                same = next((i for i in range(3) if where[i] != before[i]), 3)
                out.append((*([""] * same), *where[same:], row.filter, *cells))
                before = where
        heads = {"id_switches": "switches", "ms": "ms per frame"}
        scores = (heads.get(name, name.replace("_", " ")) for name in self.names)
        return Table(("sequence", "detections", "clutter", "filter", *scores), out)

    def _column(self, rows: Sequence[Row], name: str, *, ahead: bool) -> list[str]:
        """A score, or its difference, of each of the rows, which are those of one input."""
        values = [row.ahead if ahead else row.scores for row in rows]
        sign = "+" if ahead else ""
        texts = [f"{each.get(name, UNKNOWN):{sign}.{_DIGITS.get(name, 3)}f}" for each in values]
        lower = score_meanings().get(name, "").endswith("; lower is better")
        best = (
            ()
            if ahead or name in _NEUTRAL.split() or len(rows) < 2
            else leading(rows, name, lower=lower)
        )
        # What looks the same is no worse; where all are best none is.
        same = {text for text, row in zip(texts, rows, strict=True) if row in best[:1]}
        stars = [row in best or text in same for text, row in zip(texts, rows, strict=True)]
        return [
            "*" * (star and not all(stars)) + text for star, text in zip(stars, texts, strict=True)
        ]

    def write_cells(self, path: Path) -> None:
        """One line for each row: every score's mean, half its interval, the difference to the first
        method.
        """
        names = [
            name for name in (*SCORES, *OTHERS) if any(name in row.scores for row in self.rows)
        ]
        head = ["sequence", "detections", "cases", "clutter", "filter", "seeds", "failed"]
        table = [
            [
                *head,
                *(
                    f"{name}{part}"
                    for name in names
                    for part in ("", "_half", "_ahead", "_ahead_half")
                ),
            ]
        ]
        for row in self.rows:
            seeds = max((value.seeds for value in row.scores.values()), default=0)
            where = (
                row.sequence,
                row.detections,
                row.cases,
                f"{row.clutter:g}",
                row.filter,
                seeds,
                row.failed,
            )
            intervals = [
                part.get(name, UNKNOWN) for name in names for part in (row.scores, row.ahead)
            ]
            table.append(
                [
                    *map(str, where),
                    *(_number(number) for one in intervals for number in (one.mean, one.half)),
                ]
            )
        _write(path, table)

    def write_runs(self, path: Path) -> None:
        """One line for each run, and where it is kept."""
        runs = self.comparison.runs
        each = [{} if isinstance(result, Failed) else values_of([result]) for _, result in runs]
        names = [name for name in (*SCORES, *OTHERS) if any(name in values for values in each)]
        table = [
            ["sequence", "detections", "clutter", "filter", "seed", "failed", *names, "folder"]
        ]
        for (run, result), values in zip(runs, each, strict=True):
            if isinstance(result, Failed):
                failed = result.reason
            else:
                failed = ""
            where = (
                run.case.sequence,
                run.case.detections,
                f"{run.rate:g}",
                run.method.name,
                str(run.seed),
                failed,
            )
            table.append(
                [
                    *where,
                    *(_number(values.get(name, math.nan)) for name in names),
                    run.place.as_posix(),
                ]
            )
        _write(path, table)

    def described(self) -> str:
        """What was compared, in numbers."""
        plan = self.comparison.plan
        return lines(
            "comparison_plan.txt", plan=plan, sequences=len({case.sequence for case in plan.cases})
        )[0]

    def sentences(self) -> tuple[str, ...]:
        """Which method has the highest MOTA over everything, for each rate of clutter, where that
        is more than chance.
        """
        out: list[str] = []
        for rate in self.comparison.plan.rates:
            rows = [
                row for row in widest(self.rows) if row.clutter == rate and "MOTA" in row.scores
            ]
            if len(rows) < 2:
                continue
            rows.sort(key=lambda row: -row.scores["MOTA"].mean)
            named = {row.filter: f"{row.scores['MOTA']:.3f}" for row in rows}
            alike = [
                f"{row.filter} {named.pop(row.filter)}"
                for row in leading(rows, "MOTA", lower=False)
            ]
            behind = [f"{name} {score}" for name, score in named.items()]
            out += lines("comparison_rate.txt", rate=rate, alike=alike, behind=behind)
        return tuple(out)

    def notes(self, *, in_turn: bool) -> tuple[str, ...]:
        """What a reader should know of the numbers; ``in_turn``: the runs of this time ran one
        after the other.
        """
        many = len(self.comparison.plan.seeds) > 1
        still = dict.fromkeys(
            row.filter for row in self.rows if many and not row.random and not row.failed
        )
        return lines(
            "comparison_notes.txt",
            still=list(still),
            in_turn=in_turn,
            kept=self.comparison.reused > 0,
        )

    def page(self, about: About) -> str:
        """The report, with the title, command, warnings and notes of ``about``."""
        plan = self.comparison.plan
        rows = self.rows
        given = [
            {"sequence": case.sequence, "detections": case.detections, "truth": str(case.truth)}
            for case in plan.cases
        ]
        settings = {method.name: method.settings.as_dict() for method in plan.methods}
        more = {
            "input": given,
            "clutter": list(plan.rates),
            "seeds": list(plan.seeds),
            "iou": plan.iou,
        }
        return render(
            "comparison.html",
            title=about.title,
            source=self.described(),
            lead=" ".join(self.sentences()),
            about=about,
            first=plan.methods[0].name,
            pooled=self.table(row for row in rows if row.cases > 1),
            each=self.table(row for row in rows if row.cases == 1),
            differences=self.table((row for row in rows if row.ahead), ahead=True),
            errors=self.errors(),
            settings=flattened(settings | more),
            seeds=len(plan.seeds),
        )


def _number(value: float) -> str:
    """Empty where it is undefined."""
    if math.isfinite(value):
        return f"{value:.9g}"
    return ""


def _write(path: Path, rows: Sequence[Sequence[str]]) -> None:
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerows(rows)
    write_text(path, file.getvalue())
