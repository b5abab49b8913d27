"""`phdtrack track --filter gm-phd`: from detections to tracks, and a report without particles to draw."""

from __future__ import annotations

from pathlib import Path

from cli_runner import phdtrack, refused, walkers

from phdtrack.cli import run_directory as rundir


def test_the_gaussian_mixture_filter_by_name(tmp_path: Path) -> None:
    sequence, out = walkers(tmp_path / "walkers", clutter=1), tmp_path / "run"
    truth, found = sequence / "gt" / "gt.txt", sequence / "det" / "det.txt"
    said = phdtrack("track", "--detections", found, "--truth", truth, "--out", out, "--filter", "gm-phd", "--json")
    assert said.status == 0, said.err
    assert said.object["scores"]["MOTA"] > 0.85
    assert said.object["configuration"]["filter"]["kind"] == "gm-phd"
    assert said.object["configuration"]["extract"]["kind"] == "components"
    assert (out / rundir.REPORT).stat().st_size > 0


def test_kinds_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    found = walkers(tmp_path / "walkers") / "det" / "det.txt"
    sets = ("--set", "birth.kind=uniform", "--out", tmp_path / "run")
    assert "birth.kind=measurement" in refused("track", "--detections", found, "--filter", "gm-phd", *sets)
