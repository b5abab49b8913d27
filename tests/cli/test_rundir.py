"""The directory of a run: nobody's work is destroyed."""

from __future__ import annotations

from pathlib import Path

import pytest

from phdtrack.cli import run_directory as rundir
from phdtrack.errors import InputError


def test_an_earlier_run_is_not_replaced_unasked(tmp_path: Path) -> None:
    (tmp_path / "tracks.csv").write_text("precious")
    for function in (rundir.check, rundir.claim):
        with pytest.raises(InputError, match=r"tracks\.csv.*--overwrite"):
            function(tmp_path, False)
    assert (tmp_path / "tracks.csv").read_text() == "precious"


def test_overwrite_removes_the_runs_files_and_no_others(tmp_path: Path) -> None:
    for name in (*rundir.RUN_FILES, "notes.txt", "tracks.csv.bak"):
        (tmp_path / name).write_text("x")
    (tmp_path / "folder").mkdir()
    rundir.claim(tmp_path, overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "notes.txt", "tracks.csv.bak"]


def test_check_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "tracks.csv").write_text("x")
    rundir.check(tmp_path, overwrite=True)
    rundir.check(tmp_path / "new", overwrite=False)
    assert [path.name for path in tmp_path.iterdir()] == ["tracks.csv"]


def test_a_directory_in_the_place_of_a_file_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "report.html").mkdir()
    with pytest.raises(InputError, match=r"report\.html is a directory"):
        rundir.claim(tmp_path, overwrite=True)
    assert (tmp_path / "report.html").is_dir()


def test_clear_takes_back_what_was_written(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("x")
    directory = rundir.claim(tmp_path, overwrite=False)
    directory.file(rundir.STATES).write_text("")
    assert directory.written() == [tmp_path / "states.csv"]
    directory.clear()
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
