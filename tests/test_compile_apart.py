"""The process that helps to compile: it compiles what the tracker calls, with the same results."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phdtrack import Tracker
from phdtrack.compile_apart import SettingsReader
from programs import finished

BOXES = np.array([[100.0, 100, 140, 200], [300, 200, 350, 320], [600, 100, 640, 190]])

# Tracks boxes with no kernels kept, and reports the rows, the kernels of which some came from the
# second process, and what is left of it.
PROGRAM = """
import json, os
import numpy as np
from phdtrack import Tracker
from phdtrack.kernels import common_motion, detection_scores, label_table

os.sched_getaffinity = lambda process: {0, 1}
tracker = Tracker((1280, 720), fps=25)
boxes = np.array([[100.0, 100, 140, 200], [300, 200, 350, 320], [600, 100, 640, 190]])
rows = [tracker.update(boxes + 4.0 * k).xyxy.tolist() for k in range(8)]
kernels = (common_motion.motion_of_boxes, detection_scores.learned_frame, label_table.due_rows)
loaded = sum(sum(kernel.stats.cache_hits.values()) for kernel in kernels)
print(json.dumps({"rows": rows, "loaded": loaded}))
"""


def ran(folder: Path, **environment: str) -> dict[str, Any]:
    """What the program reports, in a process that keeps kernels in a folder."""
    temporary = folder / "temporary"
    temporary.mkdir(exist_ok=True)
    places = {"NUMBA_CACHE_DIR": str(folder / "kept"), "TMPDIR": str(temporary)}
    inherited = os.environ | places | environment
    inherited.pop("NUMBA_DISABLE_JIT", None)
    done = finished(PROGRAM, env=inherited, timeout=3000)
    # Nothing is left of the second process.
    assert list(temporary.iterdir()) == []
    found: dict[str, Any] = json.loads(done.stdout)
    return found | {"said": done.stderr.splitlines()}


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="TMPDIR is of POSIX systems")
def test_two_processes_compile_what_one_does(tmp_path: Path) -> None:
    first = ran(tmp_path)
    assert first["loaded"] >= 2
    # The one line on the compilation, and nothing of the second process.
    assert len(first["said"]) == 1
    again = ran(tmp_path)
    assert again["loaded"] == 3
    assert again["said"] == []
    tracker = Tracker((1280, 720), fps=25)
    rows = [tracker.update(BOXES + 4.0 * k).xyxy.tolist() for k in range(8)]
    assert first["rows"] == again["rows"] == rows


def helper(folder: Path, settings: bytes, **options: Any) -> subprocess.Popen[bytes]:
    """The process that helps, alone, with these settings."""
    for name in ("shared", "kept", "shared/finished"):
        (folder / name).mkdir(parents=True)
    (folder / "shared" / "settings").write_bytes(settings)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "shared")}
    environment.pop("NUMBA_DISABLE_JIT", None)
    words = [str(folder / "kept"), str(folder / "shared")]
    return subprocess.Popen(
        [sys.executable, "-m", "phdtrack.compile_apart", *words],
        env=environment | {"PHDTRACK_COMPILE_PROCESSES": "1"},
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **options,
    )


class Foreign:
    """A class that the process does not know."""


def test_modules_of_the_user_are_not_imported(tmp_path: Path) -> None:
    process = helper(tmp_path, pickle.dumps((Foreign(), 0)))
    assert process.stderr is not None
    said = process.stderr.read()
    assert process.wait(timeout=600) == 1
    assert b"UnpicklingError" in said
    process.communicate()


@pytest.mark.slow
def test_it_ends_without_error(tmp_path: Path) -> None:
    process = helper(tmp_path, pickle.dumps((Tracker((640, 480), filter="none").classes, 0)))
    assert process.wait(timeout=3000) == 0
    process.communicate()
    finished = list((tmp_path / "shared" / "finished").glob("*.nbi"))
    assert len(finished) > 10


@pytest.mark.slow
def test_it_ends_with_the_process_that_started_it(tmp_path: Path) -> None:
    settings = pickle.dumps((Tracker((640, 480)).classes, 0))
    process = helper(tmp_path, settings)
    process.communicate(timeout=600)
    assert process.returncode == 0
    assert not (tmp_path / "shared").exists()


@pytest.mark.parametrize("name", [b"builtins\neval", b"os\nsystem", b"subprocess\nPopen"])
def test_functions_are_no_settings(name: bytes) -> None:
    with pytest.raises(pickle.UnpicklingError, match="no class of settings"):
        SettingsReader(BytesIO(b"c" + name + b"\n.")).load()
