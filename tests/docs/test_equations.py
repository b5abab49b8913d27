"""docs/equations.md is up to date, and the script that writes it reads docstrings correctly."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from scripts_of_project import script_named


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return script_named("equations")


def test_the_committed_page_is_current(
    script: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    assert script.main(["--check"]) == 0, capsys.readouterr().err


def test_every_tag_names_a_known_paper(script: ModuleType) -> None:
    assert script.unknown(list(script.entries(script.SOURCES))) == []


def test_page_of_a_small_package(script: ModuleType, tmp_path: Path) -> None:
    folder = tmp_path / "src" / "phdtrack" / "part"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text('"""A part."""\n')
    (folder / "motion.py").write_text(
        '"""Motion."""\n\nclass Box:\n    """Boxes."""\n\n    def step(self):\n        """One step'
        " | of\n        boxes [M09 (11)].\n\n        More, with [M09 (9)] and [M09 (11)]"
        ' again."""\n'
    )
    found = list(script.entries(tmp_path / "src" / "phdtrack"))
    page = script.page_text(found, tmp_path, tmp_path / "docs" / "equations.md")
    lines = [line for line in page.splitlines() if line.startswith("| (")]
    link = "[`part.motion.Box.step`](../src/phdtrack/part/motion.py)"
    assert lines == [f"| {place} | {link} | One step \\| of boxes. |" for place in ("(9)", "(11)")]


def test_a_stale_page_fails_the_check(
    script: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(script, "PAGE", tmp_path / "equations.md")
    # A part of the sources, which are read five times.
    monkeypatch.setattr(script, "SOURCES", script.SOURCES / "filters")
    assert script.main(["--check"]) == 1
    assert "make docs" in capsys.readouterr().err
    assert script.main([]) == 0
    assert (tmp_path / "equations.md").read_text() == script.page_text(
        list(script.entries(script.SOURCES))
    )
    assert script.main(["--check"]) == 0
