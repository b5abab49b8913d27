"""A long measurement in its short form: a few runs that are ended and resumed."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.fuzz import ROOT

pytestmark = pytest.mark.slow


def run(module: str, out: Path, *words: str) -> str:
    """An experiment as it is started; what it says."""
    command = [sys.executable, "-m", f"experiments.{module}", *words, "--out", out]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_runs_that_are_ended_and_resumed_give_the_same_files(tmp_path: Path) -> None:
    said = run("kills", tmp_path, "--kills", "2", "--stops", "2")
    for came in json.loads((tmp_path / "kills.json").read_text()).values():
        assert came.keys() <= {"seconds of a run", "seconds", "SIGKILL", "SIGTERM"}, said


def test_damaged_saved_states_are_refused(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    run("fuzz_states", report, "--inputs", "60")
    came = json.loads(report.read_text())
    assert came["accepted"] == 0
    assert came["refused"] > 60 * 14
