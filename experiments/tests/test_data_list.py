"""The list of the real sequences: what is missing, what differs, and where it is from."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments import data as listed_data


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("mot15/A/gt/gt.txt", "more/MOT17-09/gt/gt.txt", "video/x/video.mp4"):
        file = tmp_path / "data" / name
        file.parent.mkdir(parents=True)
        file.write_text(name)
    (tmp_path / "data" / "mot15" / "README.md").write_text("not listed")
    return tmp_path / "data"


def test_missing_and_changed_files_are_listed_with_their_source(folder: Path) -> None:
    listed = folder.parent / "files.csv"
    listed_data.write_list(folder, listed)
    lines = listed_data.compared(folder, listed)
    assert not any(line.startswith("  ") for line in lines)
    assert len(lines) == len(listed_data.SOURCES)
    (folder / "mot15/A/gt/gt.txt").unlink()
    (folder / "more/MOT17-09/gt/gt.txt").write_text("another")
    text = "\n".join(listed_data.compared(folder, listed))
    assert f"missing: {folder / 'mot15/A/gt/gt.txt'}" in text
    assert "from https://motchallenge.net/data/MOT15/" in text
    assert f"not the file that the pages were made with: {folder / 'more/MOT17-09'}" in text
    assert "from https://motchallenge.net/data/MOT17/" in text
    assert "video: 1 of 1 files" in text


def test_every_file_of_the_list_has_a_source() -> None:
    names = [line.split(",")[0] for line in listed_data.LIST.read_text().splitlines()[1:]]
    assert len(names) > 100
    assert [name for name in names if listed_data.source_of(name) is None] == []
    assert {listed_data.source_of(name) for name in names} == set(listed_data.SOURCES)


def test_a_folder_that_is_not_there_misses_everything(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("PHDTRACK_DATA", str(tmp_path / "nowhere"))
    assert listed_data.main([]) == 1
    said = capsys.readouterr().out
    count = len(listed_data.LIST.read_text().splitlines()) - 1
    assert said.count("  missing: ") == count


@pytest.mark.data
def test_the_data_here_are_those_of_the_pages(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert listed_data.main([]) == 0, capsys.readouterr().out
