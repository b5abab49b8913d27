"""The table on the terminal and the document in benchmarks/out/bench.json."""

from __future__ import annotations

import json
import math
import os
import platform
import tempfile
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from benchmarks.parts import Row

OUT = Path(__file__).resolve().parent / "out"


def machine() -> dict[str, Any]:
    """The machine, and how busy it was."""
    load = os.getloadavg()[0] if os.name == "posix" else None
    return {
        "processor": _processor(),
        "architecture": platform.machine(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "load_at_start": load,
        "threads": {
            name: os.environ.get(name)
            for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        },
    }


def _processor() -> str:
    """The processor's name, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.machine()


def write(document: dict[str, Any], path: Path) -> None:
    """The document as JSON, NaN as null; all of it or nothing is at ``path``."""
    text = json.dumps(_plain(document), indent=2, allow_nan=False) + "\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".json", delete=False) as file:
        file.write(text)
    Path(file.name).replace(path)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.item() if type(value).__module__ == "numpy" else value


class Paper:
    """The one table: a section for each part, printed at the end."""

    def __init__(self, console: Console | None = None) -> None:
        # A pipe has no width of its own.
        self.console = console or Console(width=None if Console().is_terminal else 160)
        self.table = Table(expand=False)
        self.table.add_column("what")
        for name in ("value", "cpu", "quartiles", "limit"):
            self.table.add_column(name, justify="right", no_wrap=True)
        self.table.add_column("kept", no_wrap=True)
        self.table.add_column("note")

    def part(self, title: str, rows: tuple[Row, ...], remark: str = "") -> None:
        """The lines of a part, or why there are none."""
        self.table.add_section()
        self.table.add_row(f"[bold]{title}[/bold]", "", "", "", "", "", escape(remark))
        for row in rows:
            self.table.add_row(*(escape(cell) for cell in _cells(row)))

    def show(self) -> None:
        """Print it."""
        self.console.print(self.table)


def _cells(row: Row) -> tuple[str, ...]:
    spread = f"{_number(row.spread.low)} … {_number(row.spread.high)}" if row.spread else ""
    limit = (
        f"≤ {row.most:g}"
        if row.most is not None
        else f"≥ {row.least:g}"
        if row.least is not None
        else ""
    )
    kept = {True: "yes", False: "NO", None: ""}[row.kept]
    cpu = "" if row.cpu is None else _number(row.cpu)
    return row.what, f"{_number(row.value)} {row.unit}".rstrip(), cpu, spread, limit, kept, row.note


def _number(value: float) -> str:
    """Three digits."""
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}"
