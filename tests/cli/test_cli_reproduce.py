"""`phdtrack reproduce`: the list, the names, one experiment in its short form, and every way to use it wrongly."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_runner import phdtrack, refused

from experiments import common, count
from experiments.registry import EXPERIMENTS


def test_the_list_names_every_experiment_and_what_it_answers() -> None:
    for arguments in (["--list"], []):
        said = phdtrack("reproduce", *arguments)
        assert said.status == 0
        for name, experiment in EXPERIMENTS.items():
            assert any(line.split()[0] == name and experiment.about in line for line in said.out.splitlines())
    assert phdtrack("reproduce", "--list", "--json").object.keys() == EXPERIMENTS.keys()


def test_every_experiment_is_known_by_the_name_of_its_module() -> None:
    assert all(one.run.__module__ == f"experiments.{name}" for name, one in EXPERIMENTS.items())


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """The shortest form of the counting experiment, in this process."""

    def one_by_one(work, jobs, label, folder=None):
        return [(common.Kept(work, folder) if folder else work)(job) for job in jobs]

    monkeypatch.setattr(count, "in_parallel", one_by_one)
    monkeypatch.setattr(count, "P_DETECT", (0.9,))
    monkeypatch.setattr(count, "CLUTTER", (5.0,))
    monkeypatch.setattr(count, "FEW", (300,))


def test_the_page_is_printed_and_written_where_it_is_told_to(small, tmp_path: Path) -> None:
    out, kept = tmp_path / "pages", tmp_path / "kept"
    said = phdtrack("reproduce", "count", "--runs", 2, "--out", out, "--keep", kept, "--json").object
    assert said["page"] == str(out / "count.md")
    assert (out / "count.md").read_text(encoding="utf-8") == said["text"]
    assert "2 seeds" in said["text"]
    assert len(list(kept.glob("*.pickle"))) == 3
    printed = phdtrack("reproduce", "count", "--runs", 2, "--out", out, "--keep", kept)
    assert said["text"] in printed.out


def test_a_shortened_form_does_not_touch_the_committed_pages(small, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    said = phdtrack("reproduce", "count", "--quick", "--json").object
    assert (tmp_path / said["page"]).is_file()


def test_an_unknown_name_is_refused_with_the_nearest() -> None:
    sentence = refused("reproduce", "m077")
    assert "'m077'" in sentence
    assert "Did you mean m07?" in sentence


def test_missing_data_is_told_before_anything_runs(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("PHDTRACK_DATA", "kept by the fixture")
    sentence = refused("reproduce", "e13", "--data", tmp_path)
    assert str(tmp_path) in sentence
    assert "PHDTRACK_DATA" in sentence


def test_impossible_options() -> None:
    assert phdtrack("reproduce", "count", "--runs", -1).status == 2
