"""Outcomes that are kept: used again, and told when they may be old."""

from pathlib import Path

from experiments.common import in_parallel


def doubled(job: int) -> int:
    """Twice as much, and a line in a file for every time that it is done."""
    with Path("done.txt").open("a") as file:
        file.write(f"{job}\n")
    return 2 * job


def test_outcomes_are_kept_and_told_when_sources_have_changed(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "kept"
    assert in_parallel(doubled, [1, 2, 3], "doubling", folder) == [2, 4, 6]
    assert in_parallel(doubled, [1, 2, 3, 4], "doubling", folder) == [2, 4, 6, 8]
    assert sorted(Path("done.txt").read_text().split()) == ["1", "2", "3", "4"]
    assert "earlier phdtrack" not in capsys.readouterr().err
    (folder / "sources").write_text("other")
    in_parallel(doubled, [1], "doubling", folder)
    assert "may be kept there of an earlier phdtrack" in capsys.readouterr().err
