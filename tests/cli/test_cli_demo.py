"""`phdtrack demo`: both runs, both scores, and nobody's files replaced. Shortened: the real one has 300 frames."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_runner import phdtrack, refused

from phdtrack import rundir
from phdtrack.commands import demo
from phdtrack.video import open_source


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "FRAMES", 60)


def test_both_runs_and_where_to_look(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    said = phdtrack("demo", "--out", out)
    assert said.status == 0, said.err
    for folder in (out, out / demo.WITHOUT):
        assert set(rundir.FILES) <= {path.name for path in folder.iterdir()}
        assert str(folder) in said.out
    assert len(list(open_source(out / demo.VIDEO))) == 60
    head = next(line for line in said.out.splitlines() if "with filter" in line)
    assert head.split() == ["with", "filter", "without"]
    frames = next(line.split() for line in said.out.splitlines() if line.startswith("frames "))
    assert frames[1:3] == ["60", "60"]


def test_json_and_overwrite(tmp_path: Path) -> None:
    said = phdtrack("demo", "--out", tmp_path, "--json")
    assert said.status == 0, said.err
    assert set(said.object) == {"with_filter", "without_filter"}
    kinds = [said.object[name]["configuration"]["filter"]["kind"] for name in ("with_filter", "without_filter")]
    assert kinds == ["particle-phd", "none"]
    assert said.object["with_filter"]["detections"] == said.object["without_filter"]["detections"]
    assert "--overwrite" in refused("demo", "--out", tmp_path)
