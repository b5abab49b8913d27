"""The notebooks run from their first cell to the last, without a warning, and hold no outputs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

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
    assert not [cell for cell in code if cell["outputs"] or cell["execution_count"] is not None]
    program = "import matplotlib; matplotlib.use('agg'); names = {'__name__': '__main__'}\n"
    # `plt.show` of a backend without a window would warn.
    program += "import matplotlib.pyplot as plt; plt.show = lambda: None\n"
    program += "".join(f"exec({''.join(cell['source'])!r}, names)\n" for cell in code)
    command = [sys.executable, "-W", "error", "-c", program]
    done = subprocess.run(
        command, cwd=tmp_path, env=dict(os.environ), capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_notebooks_are_listed() -> None:
    page = (DOCS / "how-to" / "README.md").read_text(encoding="utf-8")
    assert NOTEBOOKS
    assert all(f"(../notebooks/{path.name})" in page for path in NOTEBOOKS)
