"""Run the notebooks of the documentation, and write what their cells print and plot into them.

Readers see the results without running anything. ``--check`` writes nothing and fails if what a
cell prints is not what its notebook shows.
"""

from __future__ import annotations

import base64
import contextlib
import copy
import io
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = ROOT / "docs" / "notebooks"
# Dots per inch of plots: small files, which a repository keeps for ever.
_DPI = 72


def executed(notebook: Mapping[str, Any]) -> dict[str, Any]:
    """The notebook with the outputs of its cells, run in order in one namespace and an empty
    folder.
    """
    import matplotlib

    matplotlib.use("agg")
    made = copy.deepcopy(dict(notebook))
    names: dict[str, Any] = {"__name__": "__main__"}
    count = 0
    with _empty_folder():
        for cell in made["cells"]:
            if cell["cell_type"] == "code":
                count += 1
                cell["outputs"] = _outputs("".join(cell["source"]), names)
                cell["execution_count"] = count
    return made


@contextlib.contextmanager
def _empty_folder() -> Iterator[None]:
    """Work in a folder that is removed afterwards."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            yield
        finally:
            os.chdir(before)


def _outputs(source: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    """What a cell prints, then its plots."""
    import matplotlib.pyplot as plt

    said = io.StringIO()
    plots: list[str] = []

    def show() -> None:
        for number in plt.get_fignums():
            picture = io.BytesIO()
            # Without metadata: they hold the version.
            plt.figure(number).savefig(picture, dpi=_DPI, metadata={"Software": None})
            plots.append(base64.b64encode(picture.getvalue()).decode() + "\n")
        plt.close("all")

    shown = plt.show
    plt.show = show
    try:
        with contextlib.redirect_stdout(said):
            exec(compile(source, "cell", "exec"), names)
    finally:
        plt.show = shown
    outputs: list[dict[str, Any]] = []
    if said.getvalue():
        lines = said.getvalue().splitlines(keepends=True)
        outputs.append({"name": "stdout", "output_type": "stream", "text": lines})
    for plot in plots:
        data = {"image/png": plot, "text/plain": ["<Figure>"]}
        outputs.append({"data": data, "metadata": {}, "output_type": "display_data"})
    return outputs


def printed(notebook: Mapping[str, Any]) -> list[str]:
    """What each code cell prints."""
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    return [
        "".join(line for one in cell["outputs"] for line in one.get("text", ())) for cell in cells
    ]


def main() -> None:
    """Write the outputs, or check them."""
    stale = []
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        notebook = json.loads(path.read_text(encoding="utf-8"))
        new = executed(notebook)
        if printed(new) != printed(notebook):
            stale.append(path.name)
        if "--check" not in sys.argv[1:]:
            path.write_text(json.dumps(new, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    if stale and "--check" in sys.argv[1:]:
        sys.exit(f"out of date, run make docs: {', '.join(stale)}")


if __name__ == "__main__":
    main()
