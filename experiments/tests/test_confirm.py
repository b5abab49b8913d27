"""Old pages that their short forms confirm, in a small repository with one page."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from experiments import made
from experiments.confirm import _figures, confirm
from phdtrack.errors import InputError

# What the repository has in place of the experiments: it writes a page with one figure.
PROGRAM = """
import json
import sys
from pathlib import Path
from experiments.value import FIGURE
out = Path(sys.argv[sys.argv.index("--out") + 1])
out.mkdir()
assert "--quick" in sys.argv
assert FIGURE, "there is no figure"
(out / "new.md").write_text(f"The figure is {FIGURE}.\\n\\nMade by `{__file__}` at commit x.\\n")
(out / "made.json").write_text(json.dumps({"new": {"code": {"experiments/value.py": "short"}}}))
"""
VALUE = "experiments/value.py"


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The results of the repository, whose page was made by its first commit."""
    root = tmp_path / "repository"
    folder = root / "docs" / "results"
    folder.mkdir(parents=True)
    (root / "experiments").mkdir()
    (root / "experiments" / "__init__.py").touch()
    (root / "experiments" / "__main__.py").write_text(PROGRAM, encoding="utf-8")
    (root / VALUE).write_text("FIGURE = 3\n", encoding="utf-8")
    who = ["-c", "user.name=n", "-c", "user.email=n@example.org"]
    for words in (["init", "-q"], ["add", "."], [*who, "commit", "-qm", "first"]):
        subprocess.run(["git", *words], cwd=root, check=True)
    monkeypatch.setattr(made, "ROOT", root)
    monkeypatch.setattr(made, "SETTINGS", ())
    monkeypatch.setattr(made, "at_start", lambda: {VALUE: made.fingerprint(root / VALUE)})
    (folder / "new.md").write_text("The figure is 3.\n", encoding="utf-8")
    made.record(folder, "new", "python -m experiments new", [VALUE])
    return folder


def changed(results: Path, text: str) -> None:
    """Change the module that the page depends on."""
    (results.parents[1] / VALUE).write_text(text, encoding="utf-8")
    assert made.stale(results) == {"new": [VALUE]}


def test_a_change_that_alters_no_figure_leaves_a_page_new(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed(results, "FIGURE = 1 + 2\n")
    assert confirm(results, []) == 0
    assert made.stale(results) == {}
    assert confirm(results, ["new"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "new.md is confirmed",
        "new.md is as new as what it shows",
    ]


def test_kept_figures_confirm_without_the_former_code(
    results: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new page whose figures are asked for keeps those of its short form."""
    assert confirm(results, ["new"]) == 0
    monkeypatch.setattr("experiments.confirm._commit_of", lambda name, entry: "")
    changed(results, "FIGURE = 1 + 2\n")
    assert confirm(results, []) == 0
    changed(results, "FIGURE = 4\n")
    assert confirm(results, []) == 1
    assert made.stale(results) == {"new": [VALUE]}
    assert capsys.readouterr().out.splitlines() == [
        "new.md is confirmed",
        "new.md is confirmed",
        "new.md stays old: git has no commit that made it",
    ]


def test_measured_times_are_no_figures(tmp_path: Path) -> None:
    page = """# Page
The filter takes {0} ms.

| case | MOTA | ms |
|---|---|---|
| a | {1} | {0} |

Costs are {1} times those of before.

## Time per frame

| case | over |
|---|---|
| a | {0} |

## Groups over time

The first time {1} are found.
"""
    shown = []
    for name, numbers in {"one": (1, 2), "slow": (9, 2), "other": (1, 3)}.items():
        (tmp_path / name).write_text(page.format(*numbers), encoding="utf-8")
        shown.append(_figures(tmp_path / name))
    assert shown[0] == shown[1]
    differing = [
        k for k, (one, other) in enumerate(zip(shown[0], shown[2], strict=True)) if one != other
    ]
    assert len(differing) == 3


def test_other_figures_leave_a_page_old(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    changed(results, "FIGURE = 4\n")
    assert confirm(results, ["new"]) == 1
    assert made.stale(results) == {"new": [VALUE]}
    assert "-The figure is 3.\n+The figure is 4." in capsys.readouterr().out


def test_a_short_form_that_fails_confirms_nothing(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed(results, "FIGURE = 0\n")
    assert confirm(results, ["new"]) == 1
    assert "(now): AssertionError: there is no figure" in capsys.readouterr().out


def test_a_page_whose_code_git_does_not_have_stays_old(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pages = json.loads((results / "made.json").read_text(encoding="utf-8"))
    pages["new"]["code"][VALUE] = "never committed"
    (results / "made.json").write_text(json.dumps(pages), encoding="utf-8")
    assert confirm(results, ["new"]) == 1
    assert f"git does not have {VALUE} as it was" in capsys.readouterr().out


def test_a_file_that_was_committed_later_is_found(results: Path) -> None:
    """Somebody committed another state of the module while the page was being made."""
    changed(results, "FIGURE = 2 + 1\n")
    root = results.parents[1]
    who = ["-c", "user.name=n", "-c", "user.email=n@example.org"]
    subprocess.run(["git", *who, "commit", "-qam", "second"], cwd=root, check=True)
    entry = made.entries(results)["new"]
    later = {"new": {**entry, "commit": made.commit()}}
    (results / "made.json").write_text(json.dumps(later), encoding="utf-8")
    changed(results, "FIGURE = 4\n")
    assert confirm(results, ["new"]) == 1
    changed(results, "FIGURE = 1 + 1 + 1\n")
    assert confirm(results, ["new"]) == 0


def test_an_unknown_page_is_refused(results: Path) -> None:
    with pytest.raises(InputError, match="expected a page of new; got 'old'"):
        confirm(results, ["old"])
