"""The notebooks run from their first cell to the last, without a warning, and show what comes of
it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from scripts_of_project import script_named

DOCS = Path(__file__).resolve().parents[2] / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path) -> None:
    """Its cells in order in one namespace, in a process and a folder of their own."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in notebook["cells"]}) == len(notebook["cells"])
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert code
    assert [cell["execution_count"] for cell in code] == list(range(1, 1 + len(code)))
    assert "image/png" in json.dumps(notebook)
    made = tmp_path / "notebook.json"
    program = "import json, notebooks; from pathlib import Path; names = json.loads"
    program += f"(Path({str(path)!r}).read_text(encoding='utf-8')); Path({str(made)!r})"
    program += ".write_text(json.dumps(notebooks.executed(names)))"
    command = [sys.executable, "-W", "error", "-c", program]
    known = os.environ.get("PYTHONPATH", "")
    environment = {**os.environ, "PYTHONPATH": f"{DOCS.parent / 'scripts'}{os.pathsep}{known}"}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    printed = script_named("notebooks").printed
    # What the page shows is what the cells print now: otherwise run make docs.
    assert printed(json.loads(made.read_text())) == printed(notebook)
    assert any(printed(notebook))


def test_notebooks_are_listed() -> None:
    page = (DOCS / "how-to" / "README.md").read_text(encoding="utf-8")
    assert NOTEBOOKS
    assert all(f"(../notebooks/{path.name})" in page for path in NOTEBOOKS)
