"""A type checker finds the mistakes in programs that use phdtrack, and none in right ones."""

from __future__ import annotations

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


def test_each_mistake_is_found(errors: set[tuple[str, int, str]]) -> None:
    lines = (CASES / "mistakes.py").read_text(encoding="utf-8").splitlines()
    marks = [(number, MARK.search(line)) for number, line in enumerate(lines, start=1)]
    expected = {(number, mark[1]) for number, mark in marks if mark}
    assert len(expected) >= 30
    assert {(line, code) for name, line, code in errors if name == "mistakes.py"} == expected


def test_right_programs_have_no_errors(errors: set[tuple[str, int, str]]) -> None:
    assert [error for error in errors if error[0] != "mistakes.py"] == []
