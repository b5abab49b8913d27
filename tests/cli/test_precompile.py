"""Compiling by several processes: all is shared out, nothing is compiled twice, and what goes wrong only costs time."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import phdtrack
from benchmarks.compile import detections
from phdtrack.cli.precompile import shares, table

SOURCES = Path(phdtrack.__file__).parent
KERNEL = "from numba import njit\n\n\n@njit(cache=True)\ndef {0}(x):\n    return x.sum() + {1}\n"
ROWS = [
    {"name": "one.one", "types": "(float64[::1],)", "seconds": 5.0, "filters": ["none"]},
    {"name": "gone.gone", "types": "(float64,)", "seconds": 0.1, "filters": ["none"]},
    {"name": "two.two", "types": "(int64[::1,:],)", "seconds": 5.0, "filters": ["none"]},
    {"name": "other.other", "types": "(float64,)", "seconds": 50.0, "filters": ["gm-phd"]},
]
PROGRAM = """
import json, sys
import numpy as np
from phdtrack.cli import precompile
from phdtrack.cli.compiling import watched
from phdtrack.kernels.one import one
from phdtrack.kernels.two import two
precompile._cores = lambda: {cores}
sys.executable = {executable!r}
with watched(lambda: None) as before:
    precompile.precompile("none")
own = [len(one.signatures), len(two.signatures)]
with watched(lambda: None) as after:
    values = [one(np.ones(3)), int(two(np.ones((2, 2), np.int64, order="F")))]
ours = lambda compiled: sorted(set(compiled.kernels))
print(json.dumps({{"own": own, "before": ours(before), "after": ours(after), "values": values}}))
"""


def within(seconds: float, condition: Callable[[], bool]) -> bool:
    """Whether the condition comes true in time."""
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    return condition()


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """A folder to put on the path: phdtrack with two kernels more, and a table of these."""
    folder = tmp_path / "site"
    shutil.copytree(SOURCES, folder / "phdtrack", ignore=shutil.ignore_patterns("__pycache__"))
    for number, name in enumerate(("one", "two")):
        (folder / "phdtrack" / "kernels" / f"{name}.py").write_text(KERNEL.format(name, number + 1))
    (folder / "phdtrack" / "commands" / "kernels.json").write_text(json.dumps(ROWS))
    return folder


def command(installed: Path, cores: int = 2, executable: str = sys.executable, **environment: str) -> dict[str, Any]:
    """The program in a fresh process, as `subprocess.Popen` is told."""
    kept = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", "NUMBA_DISABLE_JIT")}
    environment = kept | {"PYTHONPATH": str(installed), "PYTHONDONTWRITEBYTECODE": "1"} | environment
    arguments = [sys.executable, "-c", PROGRAM.format(cores=cores, executable=executable)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return {"args": arguments, "env": environment, "cwd": installed} | pipes


def run(installed: Path, cores: int = 2, executable: str = sys.executable, **environment: str) -> dict[str, object]:
    """The program in a fresh process, to its end."""
    with subprocess.Popen(**command(installed, cores, executable, **environment)) as running:
        out, said = running.communicate(timeout=300)
    assert (running.returncode, said) == (0, "")
    found: dict[str, object] = json.loads(out)
    assert found["values"] == [4.0, 6]
    return found


def test_two_processes_compile_half_each_and_nothing_is_left_to_do(installed: Path) -> None:
    found = run(installed)
    assert (found["own"], found["before"], found["after"]) == ([1, 0], ["one"], [])
    assert run(installed) == found | {"own": [0, 0], "before": []}


@pytest.mark.parametrize(("cores", "executable"), [(1, sys.executable), (2, "")])
def test_where_no_process_can_help_one_compiles_all(installed: Path, cores: int, executable: str) -> None:
    found = run(installed, cores=cores, executable=executable)
    assert (found["own"], found["before"], found["after"]) == ([1, 1], ["one", "two"], [])


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX systems")
def test_an_interrupted_run_leaves_no_process_behind(installed: Path, tmp_path: Path) -> None:
    helper, number = tmp_path / "helper", tmp_path / "number"
    helper.write_text(f"#!/bin/sh\necho $$ > {number}.part\nmv {number}.part {number}\nexec sleep 300\n")
    helper.chmod(0o755)
    running = subprocess.Popen(**command(installed, executable=str(helper)))
    assert within(120, number.exists), "the helping process has started"
    pid = int(number.read_text())
    os.kill(pid, 0)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=60)
    assert running.returncode != 0
    assert "KeyboardInterrupt" in said
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_process_that_fails_leaves_its_share_to_the_run(installed: Path) -> None:
    found = run(installed, executable=shutil.which("false") or "false")
    assert (found["own"], found["before"], found["after"]) == ([1, 0], ["one"], ["two"])


@pytest.mark.skipif(os.name == "nt", reason="homes of POSIX systems")
def test_processes_share_a_folder_that_lives_as_long_as_the_run(installed: Path, tmp_path: Path) -> None:
    (installed / "phdtrack" / "kernels" / "__pycache__").write_text("not a folder")
    (tmp_path / "nothing").write_text("a file, under which no folder can be made")
    nowhere = str(tmp_path / "nothing" / "home")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    found = run(installed, HOME=nowhere, XDG_CACHE_HOME=nowhere, TMPDIR=str(temporary))
    assert (found["own"], found["before"], found["after"]) == ([1, 0], ["one"], [])
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_shares_are_stretches_of_about_equal_cost(count: int) -> None:
    cost = [float(1 + number % 5) for number in range(40)]
    stretches = shares(range(40), cost, count)
    assert len(stretches) == count
    assert [item for stretch in stretches for item in stretch] == list(range(40))
    assert max(abs(sum(cost[item] for item in stretch) - sum(cost) / count) for stretch in stretches) <= max(cost)


def test_the_table_has_what_a_run_calls(tmp_path: Path) -> None:
    detections(tmp_path / "det.txt")
    program = (
        "import json, sys\nfrom phdtrack.cli.app import main\nfrom phdtrack.cli import first_use, precompile\n"
        "first_use.precompile = lambda filter_name: None\n"
        "try:\n    main()\nfinally:\n    print(json.dumps(list(precompile.called())))\n"
    )
    options = ["track", "--detections", str(tmp_path / "det.txt"), "--frame-size", "640x480", "--fps", "25"]
    options += ["--no-video", "--out", str(tmp_path / "run"), "--overwrite"]
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_DISABLE_JIT"}
    # The first run compiles what is not on disk yet, with all that kernels call; the second loads what Python calls.
    for _ in range(2):
        arguments = [sys.executable, "-c", program, *options]
        done = subprocess.run(arguments, env=environment, capture_output=True, text=True, timeout=600, check=True)
    called = {(name, types) for name, types in json.loads(done.stdout.splitlines()[-1])}
    listed = {(row.name, row.types) for row in table() if "pmb" in row.filters}
    assert called - listed == set(), "python scripts/called_kernels.py writes the table anew"
    assert listed - called == set(), "python scripts/called_kernels.py writes the table anew"
