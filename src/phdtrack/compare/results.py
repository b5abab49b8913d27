"""The results of a comparison as text, as CSV for programs, and as a page."""

from __future__ import annotations

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
    over_sequences,
    summary,
    values_of,
    widest,
)
from phdtrack.files import csv_text, write_text
from phdtrack.metrics.causes import SUMS
from phdtrack.parallel import Failed
from phdtrack.report.pages import flattened, lines, render, score_meanings
from phdtrack.report.record import About

_SHOWN = ("MODA", "MOTA", "IDF1", "HOTA", "id_switches", "log_evidence", "ms")
_COUNTS = (
    "id_switches",
    "misses",
    "false_positives",
    "fragments",
    "false_tracks",
    "mostly_tracked",
    "mostly_lost",
    "tracks",
    *SUMS,
)
# Decimals of scores that have another number than three.
_DECIMALS = {"ms": 2, "boxes_per_frame": 2, "log_evidence": 1, "delay_mean": 1}
_DECIMALS |= dict.fromkeys(_COUNTS, 1)
# Scores of which neither more nor less is better, or not between filters.
_NEUTRAL = (
    "frames",
    "truth_boxes",
    "output_boxes",
    "truth_objects",
    "output_identities",
    "count_error_mean",
    "log_evidence",
    "tracks",
    "boxes_per_frame",
)


class Table(NamedTuple):
    """Rows of text under a head: sequence, detections, clutter and filter, then scores."""

    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Results:
    """A comparison, the rows of its summary, and the names of the scores to show."""

    comparison: Comparison
    rows: Sequence[Row]
    names: tuple[str, ...]

    @classmethod
    def of(cls, comparison: Comparison, scores: Sequence[str]) -> Results:
        """The results with those of these scores that the comparison has; empty: the usual
        ones.
        """
        rows = summary(comparison)
        known = {name for row in rows for name in row.scores}
        if not scores:
            scores = _SHOWN if "MOTA" in known else OTHERS
        names = tuple(name for name in scores if name in known)
        return cls(comparison, rows, names or OTHERS)

    @property
    def means(self) -> tuple[Row, ...]:
        """The rows of means over the sequences, with intervals over these."""
        return over_sequences(self.rows)

    def errors(self) -> Table:
        """The numbers of misses and false boxes by cause, for cases with truth."""
        rows = [row for row in self.rows if "MOTA" in row.scores]
        return replace(self, names=SUMS).table(rows)

    def table(self, rows: Iterable[Row], *, ahead: bool = False) -> Table:
        """One line per row, with differences to the first method if ``ahead``; cells equal to those
        in the line before are empty.

        A star marks the best of a score on the same input, and values not significantly different
        from it.
        """
        out: list[tuple[str, ...]] = []
        before: tuple[str, ...] = ("", "", "")
        for (sequence, cases, *rest), each in groupby(
            rows, lambda r: (r.sequence, r.cases, r.detections, f"{r.clutter:g}")
        ):
            group = list(each)
            where = (f"{sequence} ({cases})" if cases > 1 else sequence, *rest)
            columns = [self._column(group, name, ahead=ahead) for name in self.names]
            for k, row in enumerate(group):
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
        """A score, or its difference, for each of the rows of one input."""
        values = [row.ahead if ahead else row.scores for row in rows]
        sign = "+" if ahead else ""
        decimals = _DECIMALS.get(name, 3)
        texts = [f"{each.get(name, UNKNOWN):{sign}.{decimals}f}" for each in values]
        if ahead or name in _NEUTRAL or len(rows) < 2:
            return texts
        lower = score_meanings().get(name, "").endswith("; lower is better")
        best = leading(rows, name, lower=lower)
        # Equal texts get equal stars. If all are best, none gets one.
        best_texts = {text for text, row in zip(texts, rows, strict=True) if row in best[:1]}
        stars = [row in best or text in best_texts for text, row in zip(texts, rows, strict=True)]
        if all(stars):
            return texts
        return [f"*{text}" if star else text for star, text in zip(stars, texts, strict=True)]

    def write_cells(self, path: Path) -> None:
        """Write one line per row: the mean and half the interval of every score, and of its
        difference to the first method.
        """
        names = [
            name for name in (*SCORES, *OTHERS) if any(name in row.scores for row in self.rows)
        ]
        head = ["sequence", "detections", "cases", "clutter", "filter", "seeds", "failed"]
        for name in names:
            head += [name, f"{name}_half", f"{name}_ahead", f"{name}_ahead_half"]
        table = [head]
        for row in self.rows:
            seeds = max((value.seeds for value in row.scores.values()), default=0)
            line = [
                row.sequence,
                row.detections,
                str(row.cases),
                f"{row.clutter:g}",
                row.filter,
                str(seeds),
                row.failed,
            ]
            for name in names:
                for values in (row.scores, row.ahead):
                    interval = values.get(name, UNKNOWN)
                    line += [_number(interval.mean), _number(interval.half)]
            table.append(line)
        _write(path, table)

    def write_runs(self, path: Path) -> None:
        """Write one line per run, with its scores and its folder."""
        runs = self.comparison.runs
        each = [{} if isinstance(result, Failed) else values_of([result]) for _, result in runs]
        names = [name for name in (*SCORES, *OTHERS) if any(name in values for values in each)]
        table = [
            ["sequence", "detections", "clutter", "filter", "seed", "failed", *names, "folder"]
        ]
        for (run, result), values in zip(runs, each, strict=True):
            table.append(
                [
                    run.case.sequence,
                    run.case.detections,
                    f"{run.rate:g}",
                    run.method.name,
                    str(run.seed),
                    result.reason if isinstance(result, Failed) else "",
                    *(_number(values.get(name, math.nan)) for name in names),
                    run.place.as_posix(),
                ]
            )
        _write(path, table)

    def described(self) -> str:
        """The numbers of filters, sequences, rates and seeds in a sentence."""
        plan = self.comparison.plan
        return lines(
            "comparison_plan.txt", plan=plan, sequences=len({case.sequence for case in plan.cases})
        )[0]

    def sentences(self) -> tuple[str, ...]:
        """A sentence for each rate of clutter: the method with the highest MOTA over all cases, and
        those not significantly below.
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
        """Notes on the numbers; ``in_turn``: the runs of this time ran one after the other."""
        many = len(self.comparison.plan.seeds) > 1
        still = dict.fromkeys(
            row.filter for row in self.rows if many and not row.random and not row.failed
        )
        return lines(
            "comparison_notes.txt",
            still=list(still),
            alone=not self.means,
            in_turn=in_turn,
            kept=self.comparison.reused > 0,
        )

    def page(self, about: About) -> str:
        """The report, with the title, command, warnings and notes of ``about``."""
        plan = self.comparison.plan
        rows = self.rows
        inputs = [
            {"sequence": case.sequence, "detections": case.detections, "truth": str(case.truth)}
            for case in plan.cases
        ]
        settings = {method.name: method.settings.as_dict() for method in plan.methods}
        more = {
            "input": inputs,
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
            means=self.table(self.means),
            mean_differences=self.table((row for row in self.means if row.ahead), ahead=True),
            errors=self.errors(),
            settings=flattened(settings | more),
            seeds=len(plan.seeds),
        )


def _number(value: float) -> str:
    """A number with nine digits; empty if it is undefined."""
    return f"{value:.9g}" if math.isfinite(value) else ""


def _write(path: Path, rows: Sequence[Sequence[str]]) -> None:
    """Write rows as CSV."""
    write_text(path, csv_text(rows))
