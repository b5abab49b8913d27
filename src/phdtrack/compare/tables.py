"""The rows of a summary as text: for the terminal and the report, and as CSV for programs."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from phdtrack.compare.engine import Comparison
from phdtrack.compare.parallel import Failed
from phdtrack.compare.statistics import Interval
from phdtrack.compare.summary import OTHERS, SCORES, SHOWN, Row, Summary, values_of
from phdtrack.errors import InputError

CELLS, EACH = "compare.csv", "runs.csv"
_COUNTS = frozenset(
    ("id_switches", "misses", "false_positives", "fragments", "false_tracks", "mostly_tracked", "mostly_lost", "tracks")
)
_DIGITS = {"ms": 2, "boxes_per_frame": 2, "delay_mean": 1} | dict.fromkeys(_COUNTS, 1)
LABELS = {
    "id_switches": "switches",
    "false_tracks": "false tracks",
    "boxes_per_frame": "boxes per frame",
    "ms": "ms per frame",
}


def label(name: str) -> str:
    """A score's name as a table's head has it."""
    return LABELS.get(name, name.replace("_", " "))


def shown(found: Summary, wanted: Sequence[str]) -> tuple[str, ...]:
    """The scores to show: those wanted, or the usual ones where there is truth, and what the comparison has of them."""
    known = {name for row in found.rows for name in row.values}
    usual = (*SHOWN, "ms") if "MOTA" in known else OTHERS
    return tuple(name for name in (wanted or usual) if name in known) or OTHERS


def written(value: Interval | None, name: str, *, signed: bool = False) -> str:
    """``0.553 ± 0.018``; a dash where there is none."""
    if value is None or not math.isfinite(value.mean):
        return "–"
    digits = _DIGITS.get(name, 3)
    text = f"{value.mean:{'+' if signed else ''}.{digits}f}"
    return f"{text} ± {value.half:.{digits}f}" if math.isfinite(value.half) else text


def lines_of(rows: Sequence[Row], names: Sequence[str], *, ahead: bool = False) -> list[tuple[str, ...]]:
    """A line for each row: sequence, detections, clutter, filter, and the scores; with ``ahead`` their differences."""
    lines = []
    for row in rows:
        values = row.ahead if ahead else row.values
        cells = [written(values.get(name), name, signed=ahead) for name in names]
        if row.failed:
            cells = ["failed", *[""] * (len(names) - 1)]
        where = f"{row.sequence} ({row.cases})" if row.pooled else row.sequence
        lines.append((where, row.detections, f"{row.rate:g}", row.method, *cells))
    return lines


def sparse(lines: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The same with the first three cells left out where they are those of the line before."""
    out: list[tuple[str, ...]] = []
    before: tuple[str, ...] = ("", "", "")
    for line in lines:
        same = next((i for i in range(3) if line[i] != before[i]), 3)
        out.append((*([""] * same), *line[same:]))
        before = line[:3]
    return out


def head(names: Sequence[str]) -> tuple[str, ...]:
    """What stands above the lines."""
    return ("sequence", "detections", "clutter", "filter", *(label(name) for name in names))


def write_cells(path: Path, found: Summary) -> None:
    """One row for each cell and each pool: every score's mean, half its interval, the difference to the first method."""
    names = [name for name in (*SCORES, *OTHERS) if any(name in row.values for row in found.rows)]
    columns = [f"{name}{part}" for name in names for part in ("", "_half", "_ahead", "_ahead_half")]
    rows = []
    for row in found.rows:
        cells = [_numbers(row.values.get(name), row.ahead.get(name)) for name in names]
        where = (row.sequence, row.detections, row.cases, f"{row.rate:g}", row.method, _seeds(row), row.failed)
        rows.append([*where, *(cell for part in cells for cell in part)])
    _write(path, ["sequence", "detections", "cases", "clutter", "filter", "seeds", "failed", *columns], rows)


def write_runs(path: Path, comparison: Comparison) -> None:
    """One row for each run, and where it is kept."""
    each = [(run, {} if isinstance(result, Failed) else values_of([result]), result) for run, result in comparison.runs]
    names = [name for name in (*SCORES, *OTHERS) if any(name in values for _, values, _ in each)]
    rows = []
    for run, values, result in each:
        failed = result.reason if isinstance(result, Failed) else ""
        cell = run.cell
        where = (cell.case.footage.name, cell.case.seen.name, f"{cell.rate:g}", cell.method.name, run.seed, failed)
        rows.append([*where, *(_number(values.get(name, math.nan)) for name in names), run.place.as_posix()])
    _write(path, ["sequence", "detections", "clutter", "filter", "seed", "failed", *names, "folder"], rows)


def document_of(row: Row) -> dict[str, object]:
    """A row for programs."""
    return {
        "sequence": row.sequence,
        "detections": row.detections,
        "cases": row.cases,
        "clutter": row.rate,
        "filter": row.method,
        "random": row.random,
        "failed": row.failed,
        "scores": _document(row.values),
        "ahead": _document(row.ahead),
    }


def _document(values: Mapping[str, Interval]) -> dict[str, object]:
    return {name: {"mean": one.mean, "half": one.half, "seeds": one.count} for name, one in values.items()}


def _seeds(row: Row) -> int:
    return max((value.count for value in row.values.values()), default=0)


def _numbers(value: Interval | None, ahead: Interval | None) -> list[str]:
    return [_number(number) for one in (value, ahead) for number in ((one.mean, one.half) if one else (math.nan, math.nan))]


def _number(value: float) -> str:
    """Empty where there is none."""
    return f"{value:.9g}" if math.isfinite(value) else ""


def _write(path: Path, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    try:
        with path.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([columns, *rows])
    except OSError as error:
        raise InputError(f"could not be written: {error.strerror or error}", where=path) from error
