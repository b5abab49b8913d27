"""``phdtrack warm-up``: after it nothing is compiled."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from cli_runner import phdtrack, refused

COMPILES = "phdtrack compiles its kernels"


def test_warm_up_says_what_it_does_and_where() -> None:
    said = phdtrack("warm-up", "--json")
    found = said.object
    assert [f"{k} of 3: " in said.err for k in (1, 2, 3)] == [True] * 3
    assert found["seconds"] > 0
    assert found["left_out"] == []
    assert found["kept"] >= 50
    assert len(list(Path(found["folder"]).glob("*.nbc"))) == found["kept"]
    again = phdtrack("warm-up", "--quiet")
    assert (again.status, again.out, again.err) == (0, "", "")


def test_warm_up_is_refused_if_nothing_would_be_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    assert "kernels would not be kept" in refused("warm-up")


def test_warm_up_refuses_settings_that_do_not_exist() -> None:
    assert "sensor.noise" in refused("warm-up", "--set", "sensor.noise=1")


@pytest.mark.slow
def test_nothing_is_compiled_after_warm_up(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    environment.pop("NUMBA_DISABLE_JIT", None)

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "phdtrack", *words]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=500
        )
        assert done.returncode == 0, done.stderr
        return done

    first = run("warm-up", "--json")
    found = json.loads(first.stdout)
    assert COMPILES in first.stderr
    assert found["compiled"] == found["kept"] > 0
    assert str(tmp_path / "kept") in found["folder"]
    run("simulate", "street", "--out", "street", "--frames", "150")
    for words in (("street/scene.mp4",), ("--detections", "street/det/det.txt", "--out", "boxes")):
        assert COMPILES not in run("track", *words).stderr
    assert json.loads(run("warm-up", "--json").stdout)["compiled"] == 0
