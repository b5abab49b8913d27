"""Write src/phdtrack/commands/kernels.json: which kernels a run of each filter calls, with which types, in which order.

A small made-up sequence is tracked with each filter, first with an empty cache, which tells order and seconds, then with a
full one, which tells what Python itself calls. ``--check`` writes nothing, uses the cache that there is, and fails where
a run calls what the table lacks, or the table has what no run calls.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks.compile import detections  # noqa: E402
from phdtrack.cli.precompile import TABLE, table  # noqa: E402

FILTERS = ("pmb", "particle-phd", "gm-phd", "none", "gm-cphd", "mht", "mcmc")
# `precompile` is set aside: the table is to say what a run calls, not what an older table said.
PROGRAM = """
import json, sys
from phdtrack.cli import first_use, precompile
from phdtrack.cli.compiling import watched

first_use.precompile = lambda filter_name: None
report = sys.argv.pop(1)
from phdtrack.cli.app import main
with watched(lambda: None) as compiled:
    try:
        main()
    finally:
        found = {"own": compiled.kernels, "whole": compiled.whole, "called": list(precompile.called())}
        json.dump(found, open(report, "w"))
"""


def run(folder: Path, filter_name: str, environment: dict[str, str]) -> dict[str, Any]:
    """One run: ``called`` as `precompile.called` gives it; ``own``, ``whole`` as `compiling.Compiled` has them."""
    options = ["track", "--detections", str(folder / "det.txt"), "--frame-size", "640x480", "--fps", "25"]
    options += ["--filter", filter_name, "--out", str(folder / "run"), "--overwrite"]
    command = [sys.executable, "-c", PROGRAM, str(folder / "report.json"), *options]
    subprocess.run(command, check=True, env=os.environ | environment, stdout=subprocess.DEVNULL)
    found: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return found


@contextmanager
def scene() -> Iterator[Path]:
    """A folder with the sequence."""
    with tempfile.TemporaryDirectory() as name:
        detections(Path(name) / "det.txt")
        yield Path(name)


def called(folder: Path, filter_name: str, environment: dict[str, str]) -> set[tuple[str, str]]:
    """What Python calls in a run. A first one fills the cache, unless it is full."""
    run(folder, filter_name, environment)
    return {(name, types) for name, types in run(folder, filter_name, environment)["called"]}


def measured() -> list[dict[str, object]]:
    """The table's rows."""
    seconds: dict[str, float] = {}
    own: dict[str, float] = {}
    users: dict[tuple[str, str], list[str]] = {}
    with scene() as folder:
        environment = {"NUMBA_CACHE_DIR": str(folder / "cache")}
        for filter_name in FILTERS:
            spent = run(folder, filter_name, environment)
            for found, times in ((own, spent["own"]), (seconds, spent["whole"])):
                for name, passed in times.items():
                    found.setdefault(name, passed)
            for row in called(folder, filter_name, environment):
                users.setdefault(row, []).append(filter_name)
    # A kernel that Python calls may have been compiled for another that had called it before: that has only its own seconds.
    order = list(own)
    rows = sorted(users, key=lambda row: (order.index(_function(row[0])), row))
    taken = {name: seconds.get(name, own[_function(name)]) for name, _ in rows}
    return [{"name": row[0], "types": row[1], "seconds": round(taken[row[0]], 1), "filters": users[row]} for row in rows]


def _function(name: str) -> str:
    """The function of ``module.function``."""
    return name.rpartition(".")[2]


def stale() -> list[str]:
    """Where the table and the runs differ, in words."""
    said = []
    with scene() as folder:
        for filter_name in FILTERS:
            listed = {(row.name, row.types) for row in table() if filter_name in row.filters}
            for name, types in sorted(listed ^ called(folder, filter_name, {})):
                said.append(
                    f"{filter_name}: {name}{types}: {'no longer called' if (name, types) in listed else 'not listed'}"
                )
    return said


def main() -> None:
    """Write the table, or compare."""
    if "--check" in sys.argv[1:]:
        differences = stale()
        print(*differences, sep="\n")
        sys.exit(f"{TABLE.name} is not what a run calls: python scripts/called_kernels.py" if differences else 0)
    # One row a line, so that a change shows which.
    lines = ",\n".join("  " + json.dumps(row) for row in measured())
    TABLE.write_text(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    main()
