"""Type checkers find the mistakes in programs that use phdtrack, and none in right ones."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CASES = ROOT / "tests" / "typed"
MARK = re.compile(r"# wrong: ([a-z-]+)$")
ERROR = re.compile(r"^(.+?):(\d+): error: .*\[([a-z-]+)\]$", re.MULTILINE)


@pytest.fixture(scope="module")
def errors() -> set[tuple[str, int, str]]:
    """Name, line and code of each error of mypy in the programs, as strict as for the package.

    With what mypy keeps of `make lint` this takes a second, without it half a minute.
    """
    programs = sorted(map(str, CASES.glob("*.py")))
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--no-color-output", *programs],
        cwd=ROOT,
        env={**os.environ, "MYPYPATH": str(ROOT / "src")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    found = [(Path(path), int(line), code) for path, line, code in ERROR.findall(done.stdout)]
    assert {path.parent.name for path, *_ in found} == {"typed"}, done.stdout
    return {(path.name, line, code) for path, line, code in found}


def marked() -> set[tuple[int, str]]:
    """Number and code of each line with a mark."""
    lines = (CASES / "mistakes.py").read_text(encoding="utf-8").splitlines()
    marks = [(number, MARK.search(line)) for number, line in enumerate(lines, start=1)]
    return {(number, mark[1]) for number, mark in marks if mark}


def test_each_mistake_is_found(errors: set[tuple[str, int, str]]) -> None:
    expected = marked()
    assert len(expected) >= 30
    assert {(line, code) for name, line, code in errors if name == "mistakes.py"} == expected


def test_right_programs_have_no_errors(errors: set[tuple[str, int, str]]) -> None:
    assert [error for error in errors if error[0] != "mistakes.py"] == []


@pytest.mark.slow
def test_pyright_finds_the_mistakes_and_no_others(tmp_path: Path) -> None:
    """As basedpyright, a fork that fetches nothing when it runs, with the rules of pyright."""
    project = {
        "include": [str(CASES)],
        "extraPaths": [str(ROOT / "src")],
        "typeCheckingMode": "standard",
    }
    settings = tmp_path / "pyrightconfig.json"
    settings.write_text(json.dumps(project), encoding="utf-8")
    words = ["--project", str(settings), "--pythonpath", sys.executable, "--outputjson"]
    done = subprocess.run(
        [sys.executable, "-m", "basedpyright", *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done.stdout + done.stderr
    report = json.loads(done.stdout)
    assert report["summary"]["filesAnalyzed"] == len(list(CASES.glob("*.py")))
    found = {
        (Path(one["file"]).name, one["range"]["start"]["line"] + 1)
        for one in report["generalDiagnostics"]
        if one["severity"] == "error"
    }
    assert found == {("mistakes.py", number) for number, _ in marked()}
