"""Compiled kernels: said when they are compiled, kept on disk, also where the installation cannot
be written into.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import phdtrack
from programs import finished

pytestmark = pytest.mark.slow

SOURCES = Path(phdtrack.__file__).parent
FIRST = "phdtrack compiles its kernels"
EVERY = "so in every run"

# Two kernels of two files, the second calling the first, in a package whose `kernels` is a copy of
# ours.
LEAF = "from numba import njit\n\n\n@njit\ndef leaf(x):\n    return x + {}\n"
CALLER = (
    "from numba import njit\nfrom phdtrack.kernels.leaf import leaf\n\n\n"
    "@njit(cache=True)\ndef caller(x):\n    return 10 * leaf(x)\n"
)
PROGRAM = """
import json
from pathlib import Path
from phdtrack.cli.output import Output
from phdtrack.kernels.caller import caller
Output(quiet={quiet})
value = caller(1), caller(1.0)
folder = Path(caller.stats.cache_path)
loaded = sum(caller.stats.cache_hits.values())
found = {{"value": value[0], "loaded": loaded, "folder": str(folder)}}
print(json.dumps(found | {{"kept": len(list(folder.glob("*.nbi")))}}))
"""


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """A folder to put on the path: phdtrack with two kernels more. Everybody may read it."""
    folder = tmp_path / "site"
    shutil.copytree(SOURCES, folder / "phdtrack", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "phdtrack" / "kernels" / "leaf.py").write_text(LEAF.format(1))
    (folder / "phdtrack" / "kernels" / "caller.py").write_text(CALLER)
    return folder


def run(
    installed: Path, *, quiet: bool = False, **environment: str
) -> tuple[dict[str, object], str]:
    """The program in a fresh process: what it found, and what it said on stderr."""
    kept = {
        key: value
        for key, value in os.environ.items()
        if key not in ("NUMBA_CACHE_DIR", "NUMBA_DISABLE_JIT")
    }
    environment = (
        kept | {"PYTHONPATH": str(installed), "PYTHONDONTWRITEBYTECODE": "1"} | environment
    )
    program = PROGRAM.format(quiet=quiet)
    done = finished(program, env=environment, cwd=installed, timeout=120)
    return json.loads(done.stdout), done.stderr


def unwritable(kernels: Path) -> None:
    """Nobody can make files in ``kernels/__pycache__``, an administrator neither: it is no
    folder.
    """
    (kernels / "__pycache__").write_text("not a folder")


def test_the_line_comes_when_something_is_compiled_and_only_then(installed: Path) -> None:
    found, said = run(installed)
    assert (found["value"], found["loaded"], found["kept"]) == (20, 0, 1)
    assert (said.count(FIRST), said.count(EVERY)) == (1, 0)
    assert Path(str(found["folder"])) == installed / "phdtrack" / "kernels" / "__pycache__"
    found, said = run(installed)
    assert (found["loaded"], found["value"], said) == (2, 20, "")


def test_a_kernel_that_calls_a_changed_one_is_compiled_again(installed: Path) -> None:
    assert run(installed)[0]["value"] == 20
    (installed / "phdtrack" / "kernels" / "leaf.py").write_text(LEAF.format(2))
    found, said = run(installed, quiet=True)
    assert (found["value"], found["loaded"], said) == (30, 0, "")


TWO = """
import json
from phdtrack.kernels.caller import caller
from phdtrack.kernels.other import other
values = [caller(1), other(1)]
loaded = [sum(kernel.stats.cache_hits.values()) for kernel in (caller, other)]
print(json.dumps(values + loaded))
"""


def two_kernels(installed: Path) -> list[int]:
    """What `caller` and `other` of a fresh process give, and how often each was loaded."""
    environment = os.environ | {"PYTHONPATH": str(installed), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", TWO],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    found: list[int] = json.loads(done.stdout)
    return found


def test_a_changed_kernel_leaves_those_that_do_not_use_it(installed: Path) -> None:
    kernels = installed / "phdtrack" / "kernels"
    (kernels / "other.py").write_text(
        "from numba import njit\n\n\n@njit(cache=True)\ndef other(x):\n    return -x\n"
    )
    assert two_kernels(installed) == [20, -1, 0, 0]
    assert two_kernels(installed) == [20, -1, 1, 1]
    (kernels / "leaf.py").write_text(LEAF.format(2))
    assert two_kernels(installed) == [30, -1, 0, 1]
    # What all of them import.
    package = kernels / "__init__.py"
    package.write_text(package.read_text() + "\n# Changed\n")
    assert two_kernels(installed) == [30, -1, 0, 0]


def test_a_read_only_installation_uses_the_home_folder(installed: Path, tmp_path: Path) -> None:
    unwritable(installed / "phdtrack" / "kernels")
    home = tmp_path / "home"
    home.mkdir()
    places = {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache"), "LOCALAPPDATA": str(home)}
    found, said = run(installed, **places)
    assert home in Path(str(found["folder"])).parents
    assert (said.count(FIRST), said.count(EVERY)) == (1, 0)
    assert run(installed, **places)[0]["loaded"] == 2


@pytest.mark.skipif(os.name == "nt", reason="homes of POSIX systems")
def test_without_any_folder_it_runs_and_says_how_to_mend_it(
    installed: Path, tmp_path: Path
) -> None:
    unwritable(installed / "phdtrack" / "kernels")
    (tmp_path / "nothing").write_text("a file, under which no folder can be made")
    nowhere = str(tmp_path / "nothing" / "home")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    found, said = run(installed, HOME=nowhere, XDG_CACHE_HOME=nowhere, TMPDIR=str(temporary))
    assert found["value"] == 20
    assert said.count(EVERY) == 1
    assert len(said.strip().splitlines()) == 1
    assert "NUMBA_CACHE_DIR" in said
    # The folder lived as long as the process.
    assert list(temporary.iterdir()) == []


def test_kernels_are_kept_once_one_is_compiled(tmp_path: Path) -> None:
    program = (
        "from phdtrack.kernels.cache import are_kept\n"
        "from phdtrack.run.inputs import _load_first_kernel\n"
        "before = are_kept()\n"
        "_load_first_kernel()\n"
        "print(before, are_kept())\n"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    said = [
        subprocess.run(
            [sys.executable, "-c", program],
            env=environment | {"NUMBA_DISABLE_JIT": disabled},
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        ).stdout.split()
        for disabled in "001"
    ]
    assert said == [["False", "True"], ["True", "True"], ["False", "False"]]


RECORD = """
import sys
from typing import NamedTuple
from phdtrack.kernels.caller import first
from phdtrack.kernels.particle_models import kernel_for

class Mine(NamedTuple):
    x: float

Mine.__module__ = "a_program"
sys.modules["a_program"] = sys.modules["__main__"]
assert kernel_for(first, Mine(2.0))(Mine(2.0)) == 2.0
assert first((3.0,)) == 3.0
"""


def test_a_kernel_of_a_users_record_is_not_cached(installed: Path) -> None:
    """Another program could not read the list of kept kernels."""
    first = "\n\n@njit(cache=True)\ndef first(record):\n    return record[0]\n"
    own = CALLER.replace("from numba import njit", "from phdtrack.kernels.cache import njit")
    (installed / "phdtrack" / "kernels" / "caller.py").write_text(own + first)
    environment = os.environ | {"PYTHONPATH": str(installed), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)
    for program in (
        RECORD,
        "from phdtrack.kernels.caller import first\nassert first((4.0,)) == 4.0",
    ):
        finished(program, env=environment, timeout=120)


TWICE = """
import numpy as np
from phdtrack import Tracker

for chosen in ({"filter": "particle-phd"}, {"preset": "m07"}, {"preset": "m09"}):
    tracker = Tracker((640, 480), **chosen)
    rng = np.random.default_rng(0)
    for k in range(20):
        corner = np.arange(3)[:, None] * 80.0 + [100 + 5 * k, 100] + rng.normal(size=(3, 2))
        rows = tracker.update(np.hstack([corner, corner + [24, 60]]))
        print(rows.xyxy.tobytes().hex(), rows.confidence.tobytes().hex())
"""


def test_compiled_and_loaded_kernels_give_the_same_digits(
    tmp_path: Path,
) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    first, later = (
        subprocess.run(
            [sys.executable, "-c", TWICE],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
            timeout=300,
        )
        for _ in range(2)
    )
    assert first.stdout == later.stdout != ""
