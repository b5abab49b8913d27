"""``python -m experiments``: the list, the names, progress, and every way to use it wrongly."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from experiments import common, count
from experiments.__main__ import EXPERIMENTS, main
from experiments.common import Options, in_parallel
from phdtrack.errors import InputError


def test_the_list_names_every_experiment_and_what_it_answers(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for arguments in (["--list"], []):
        assert main(arguments) == 0
        lines = capsys.readouterr().out.splitlines()
        for name, one in EXPERIMENTS.items():
            assert any(line.split()[0] == name and one.about in line for line in lines)


def test_every_experiment_is_a_module_with_a_page() -> None:
    for name in EXPERIMENTS:
        assert (Path(common.__file__).parent / f"{name}.py").is_file()
        assert (common.PAGES / f"{name}.md").is_file()


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """The shortest form of the counting experiment, in this process."""
    monkeypatch.setattr(
        count, "in_parallel", lambda work, jobs, label, options: [work(job) for job in jobs]
    )
    monkeypatch.setattr(count, "P_DETECT", (0.9,))
    monkeypatch.setattr(count, "CLUTTER", (5.0,))
    monkeypatch.setattr(count, "FEW", (300,))


@pytest.mark.slow
@pytest.mark.usefixtures("small")
def test_the_page_is_written_where_it_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["count", "--runs", "2", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "count.md").read_text(encoding="utf-8")
    assert "2 seeds of" in text
    assert "{" not in text
    assert "no results" not in text
    assert EXPERIMENTS["count"].about in capsys.readouterr().err


@pytest.mark.usefixtures("small")
def test_a_short_form_leaves_the_committed_pages_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(common, "QUICK_RESULTS", tmp_path / "quick")
    before = (common.RESULTS / "count.md").read_bytes()
    assert main(["count", "--quick"]) == 0
    assert "no results" in (tmp_path / "quick" / "count.md").read_text(encoding="utf-8")
    assert (common.RESULTS / "count.md").read_bytes() == before


def test_an_unknown_name_is_refused_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["m077"]) == 2
    assert "got 'm077'. Did you mean m07?" in capsys.readouterr().err


def test_an_unknown_part_is_refused_with_the_known_ones() -> None:
    known = {"one": 1, "two": 2, "long": 3}
    assert Options().parts(known, ("long",)) == ["one", "two"]
    assert Options(only=("long", "one")).parts(known, ("long",)) == ["one", "long"]
    with pytest.raises(InputError, match="expected one of one, two, long, got 'three'"):
        Options(only=("three",)).parts(known)


def test_a_new_part_leaves_the_others_of_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(common, "PAGES", tmp_path)
    (tmp_path / "new.md").write_text("# New\n", encoding="utf-8")
    options = Options(out=tmp_path / "out")
    order = ("first", "second")
    common.write_parts("new", options, order, {"second": "## Second\n\nold\n"})
    common.write_parts("new", options, order, {"first": "## First\n"})
    path = common.write_parts("new", options, order, {"second": "## Second\n\nyoung\n"})
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# New\n")
    assert text.index("## First") < text.index("--only first") < text.index("## Second")
    assert text.count("## Second") == text.count("--only second") == 1
    assert "young" in text
    assert "old" not in text


def test_missing_data_is_reported_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PHDTRACK_DATA", str(tmp_path))
    assert main(["count", "e13"]) == 2
    said = capsys.readouterr().err
    assert str(tmp_path) in said
    assert "Set PHDTRACK_DATA" in said


def halved(job: int) -> float:
    return job / 2 if job else 1 / job


@pytest.mark.slow
def test_work_in_processes_keeps_the_order_and_says_what_it_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said = io.StringIO()
    monkeypatch.setattr(sys, "stderr", said)
    assert in_parallel(halved, [4, 2, 8], "halving", Options(jobs=2)) == [2, 1, 4]
    assert said.getvalue().splitlines()[0] == "halving: 3 runs, 2 at a time"
    assert "halving: 3 of 3" in said.getvalue()
    assert "\r" not in said.getvalue()
    with pytest.raises(ZeroDivisionError):
        in_parallel(halved, [0, 2], "halving", Options(jobs=1))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(k, marks=[pytest.mark.data] * bool(one.data))
        for k, one in EXPERIMENTS.items()
        if k != "videos"
    ],
)
def test_every_short_form_runs(
    name: str,
    tmp_path: Path,
    request: pytest.FixtureRequest,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The pages have all their figures; the pictures that they show are there. The papers' claims
    are printed.
    """
    if EXPERIMENTS[name].data:
        request.getfixturevalue("data")
    assert main([name, "--quick", "--runs", "1", "--jobs", "1", "--out", str(tmp_path)]) == 0
    text = (tmp_path / f"{name}.md").read_text(encoding="utf-8")
    said = capsys.readouterr().out
    if name in ("m07", "m09", "e13", "d14"):
        assert "    word by word" in said
        assert "(printed: " in said
        assert "| **" in text
    assert "no results" in text
    pictures = [
        line.split("](")[1].rstrip(")") for line in text.splitlines() if line.startswith("![")
    ]
    assert all((tmp_path / picture).stat().st_size > 5000 for picture in pictures)
