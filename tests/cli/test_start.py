"""A quick start: which modules are not loaded before they are needed. Modules and not times, which depend on the machine."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from cli_runner import walkers

# Not pydantic: newer versions of typer load it themselves.
HEAVY = {"numpy", "scipy", "numba", "cv2", "av", "matplotlib", "rich", "pyarrow"}
# What nobody needs for tracking, whoever brought it along.
NEVER = {"scipy.optimize", "scipy.stats", "scipy.spatial", "scipy.ndimage", "sklearn", "torch", "pandas", "stonesoup", "PIL"}
TRACKING = """
from phdtrack.tracker import Tracker

update, loaded = Tracker.update, []

def first(self, *frame):
    rows = update(self, *frame)
    if not loaded:
        loaded.extend(sys.modules)
    return rows

Tracker.update = first
from phdtrack.cli.app import main
try:
    main()
finally:
    print(*loaded, "END", *sys.modules, sep="\\n")
"""


def modules(program: str, *arguments: object) -> list[str]:
    """What the program prints, line by line, in a fresh process in which ``sys`` is imported."""
    command = [sys.executable, "-c", f"import sys\n{program}", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_importing_phdtrack_loads_nothing_heavy() -> None:
    loaded = modules("import phdtrack\nprint(*sys.modules, sep='\\n')")
    assert "phdtrack" in loaded
    assert HEAVY.isdisjoint(loaded)


def test_tracking_detections_loads_what_it_needs(tmp_path: Path) -> None:
    table = walkers(tmp_path / "walkers", frames=8) / "det" / "det.txt"
    said = modules(TRACKING, "track", "--detections", table, "--out", tmp_path / "run", "--json")
    end = said.index("END")
    at_first_frame, at_the_end = said[:end], said[end:]
    assert "phdtrack.filters" in at_first_frame
    # Pictures come with the report, and scores where there is truth; neither is waited for before the first frame.
    assert {"matplotlib", "av", "rich", "phdtrack.metrics", "pyarrow"}.isdisjoint(at_first_frame)
    assert "phdtrack.report.pages" in at_the_end
    assert NEVER.isdisjoint(at_first_frame)
    assert {"phdtrack.metrics", *(NEVER - {"PIL"})}.isdisjoint(at_the_end)
