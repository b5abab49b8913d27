"""Provenance of pages: fingerprints, entries, and stale pages."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments import made


def test_a_fingerprint_is_of_what_a_file_says(tmp_path: Path) -> None:
    """Comments, docstrings and layout do not count; a constant does, and a value in a settings
    file.
    """
    file = tmp_path / "one.py"
    found = []
    for text in (
        'def f(x):\n    """Double."""\n    return 2 * x\n',
        "def f( x ):\n    # Twice as much.\n    'Twice.'\n    return 2*x\n",
        'def f(x):\n    """Double."""\n    return 3 * x\n',
    ):
        file.write_text(text, encoding="utf-8")
        found.append(made.fingerprint(file))
    assert found[0] == found[1] != found[2]
    values = tmp_path / "one.toml"
    values.write_text("# a\n[a]\nb = 1\n", encoding="utf-8")
    before = made.fingerprint(values)
    values.write_text("a = { b = 1 }\n", encoding="utf-8")
    assert made.fingerprint(values) == before
    values.write_text("a = { b = 2 }\n", encoding="utf-8")
    assert made.fingerprint(values) != before


def test_a_page_is_old_when_a_module_that_it_loaded_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "new.md").write_text("", encoding="utf-8")
    assert made.stale(tmp_path) == {"new": []}
    modules = made.loaded()
    assert "src/phdtrack/errors.py" in modules
    line = made.record(tmp_path, "new", "python -m experiments new", modules)
    assert "python -m experiments new" in line
    assert json.loads((tmp_path / "made.json").read_text(encoding="utf-8"))["new"]["commit"] in line
    assert made.check(tmp_path) == 0
    now = {
        **made.at_start(),
        "src/phdtrack/errors.py": "changed",
        "src/phdtrack/not_loaded.py": "changed",
    }
    monkeypatch.setattr(made, "at_start", lambda: now)
    assert made.stale(tmp_path) == {"new": ["src/phdtrack/errors.py"]}
    assert made.check(tmp_path) == 1
    assert (
        "new.md is older than src/phdtrack/errors.py: python -m experiments new"
        in capsys.readouterr().out
    )


def test_what_is_recorded_is_a_page_of_results() -> None:
    folder = made.ROOT / "docs" / "results"
    recorded = json.loads((folder / "made.json").read_text(encoding="utf-8"))
    assert set(recorded) <= {path.stem for path in folder.glob("*.md")}
    assert not set(recorded) & set(made.BY_HAND)
    assert all(entry["command"].startswith("python -m experiments ") for entry in recorded.values())


def test_code_is_old_if_parts_were_made_with_different_states(tmp_path: Path) -> None:
    """Until each part is made anew, the page is older than a module that has changed between."""
    file = "src/phdtrack/errors.py"

    def changed(value: str) -> None:
        entries = json.loads((tmp_path / "made.json").read_text(encoding="utf-8"))
        entries["new"]["parts"]["a"]["code"][file] = value
        (tmp_path / "made.json").write_text(json.dumps(entries), encoding="utf-8")

    (tmp_path / "new.md").write_text("", encoding="utf-8")
    made.record_part(tmp_path, "new", "a", "python -m experiments new --only a", [file])
    changed("another state")
    line = made.record_part(tmp_path, "new", "b", "python -m experiments new --only b", [file])
    assert "--only b" in line
    assert made.stale(tmp_path) == {"new": [file]}
    made.record_part(tmp_path, "new", "a", "python -m experiments new --only a", [file])
    assert made.stale(tmp_path) == {}
    entry = json.loads((tmp_path / "made.json").read_text(encoding="utf-8"))["new"]
    assert entry["command"] == "python -m experiments new"
