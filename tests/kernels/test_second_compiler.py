"""The second process that compiles kernels: what it finishes is taken over, and it may fail."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from phdtrack.kernels.second_compiler import PROCESSES, SecondCompiler

pytestmark = pytest.mark.skipif(os.name == "nt", reason="the process is a script of a shell")

# What a script is started with: -P -m MODULE FOLDER SHARED.
FINISHES = """
for name in a b c; do echo "code $name" > "$5/finished/$name-1.py3.1.nbc"; done
for name in a b; do echo "list $name" > "$5/finished/$name-1.py3.nbi"; done
cp "$5/settings" "$5/now" "$4"/..
touch "$4/../ready"
"""
WAITS = "read line\n"


class Compiler:
    """A compiler whose second process is a script, and the folder that keeps kernels."""

    def __init__(self, folder: Path, script: str, monkeypatch: pytest.MonkeyPatch) -> None:
        self.around = folder
        self.kept = folder / "kept"
        self.kept.mkdir()
        temporary = folder / "temporary"
        temporary.mkdir()
        self.temporary = temporary
        executable = folder / "python"
        executable.write_text(f"#!/bin/sh\n{script}")
        executable.chmod(0o755)
        monkeypatch.setattr(sys, "executable", str(executable))
        monkeypatch.setattr("tempfile.tempdir", str(temporary))
        monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1}, raising=False)
        monkeypatch.delenv(PROCESSES, raising=False)
        self.second = SecondCompiler()

    def start(self, settings: Callable[[], bytes] = lambda: b"settings") -> None:
        self.second.prepare(self.kept)
        self.second.offer(settings)
        self.second.compiling("file.kernel")

    @property
    def started(self) -> bool:
        return any(self.temporary.iterdir())


def until(reached: Callable[[], bool]) -> None:
    end = time.monotonic() + 30
    while not reached():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_finished_kernels_are_taken_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = Compiler(tmp_path, FINISHES + WAITS, monkeypatch)
    own = compiler.kept / "b-1.py3.nbi"
    own.write_text("own list")
    compiler.start()
    until((tmp_path / "ready").exists)
    assert (tmp_path / "settings").read_bytes() == b"settings"
    compiler.second.compiled()
    found = {file.name: file.read_text() for file in compiler.kept.iterdir()}
    # A kernel without its list is not finished, and one that this process has made is its own.
    expected = {"a-1.py3.1.nbc": "code a\n", "a-1.py3.nbi": "list a\n", "b-1.py3.nbi": "own list"}
    assert found == expected


def test_kernel_in_progress_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = 'while ! grep -q other "$5/now"; do sleep 0.01; done\n' + FINISHES
    compiler = Compiler(tmp_path, script, monkeypatch)
    compiler.start()
    compiler.second.compiling("file.other")
    until((tmp_path / "ready").exists)
    assert (tmp_path / "now").read_text() == "file.other"


def test_the_rest_is_taken_over_at_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = Compiler(tmp_path, FINISHES, monkeypatch)
    compiler.start()
    until(lambda: not compiler.started)
    assert {file.name[0] for file in compiler.kept.iterdir()} == {"a", "b"}


@pytest.mark.parametrize("script", ["exit 3\n", "kill -9 $$\n"])
def test_failing_process_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str
) -> None:
    compiler = Compiler(tmp_path, script, monkeypatch)
    compiler.start()
    until(lambda: not compiler.started)
    compiler.second.compiling("file.other")
    compiler.second.compiled()
    assert list(compiler.kept.iterdir()) == []


def test_settings_that_cannot_be_sent_start_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler = Compiler(tmp_path, WAITS, monkeypatch)
    compiler.start(lambda: [][0])
    assert not compiler.started


def test_without_temporary_folder_none_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler = Compiler(tmp_path, WAITS, monkeypatch)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nothing"))
    compiler.start()
    assert not compiler.started


def chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PROCESSES, "1")


def one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0}, raising=False)


def frozen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "frozen", True, raising=False)


def embedded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/usr/bin/blender")


def pooled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("multiprocessing.parent_process", lambda: "a process")


@pytest.mark.parametrize("alone", [chosen, one_core, frozen, embedded, pooled])
def test_no_process_is_started_if(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    alone: Callable[[pytest.MonkeyPatch], None],
) -> None:
    compiler = Compiler(tmp_path, WAITS, monkeypatch)
    alone(monkeypatch)
    compiler.start()
    assert not compiler.started


def test_many_kept_kernels_need_no_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = Compiler(tmp_path, WAITS, monkeypatch)
    for k in range(30):
        (compiler.kept / f"kernel{k}-1.py3.nbi").touch()
    compiler.start()
    assert not compiler.started
