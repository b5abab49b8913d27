"""The pages of docs/how-to do what they say: their commands and programs are run, in order, on a small simulated scene."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from typer.testing import CliRunner

from experiments import __main__ as experiments
from phdtrack.cli.app import application

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "how-to"
NAMES = sorted(page.name for page in PAGES.glob("*.md"))
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    language: str
    text: str
    line: int


def blocks(page: str) -> list[Block]:
    text = (PAGES / page).read_text(encoding="utf-8")
    return [Block(m[1], m[2], text.count("\n", 0, m.start()) + 1) for m in BLOCK.finditer(text)]


def command(line: str) -> None:
    words = shlex.split(line)
    if words[:3] == ["python", "-m", "experiments"]:
        assert experiments.main(words[3:]) == 0, line
        return
    assert words[0] == "phdtrack", line
    result = CliRunner().invoke(application(words[1]), words[1:])
    assert result.exit_code == 0, (line, result.stderr, result.exception)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """street.mp4, and beside it street/ with detections and truth."""
    folder = tmp_path_factory.mktemp("scene")
    command(f"phdtrack simulate street --out {folder / 'street'} --seed 1 --frames 30 --set lead_in=-6")
    shutil.move(folder / "street" / "scene.mp4", folder / "street.mp4")
    return folder


@pytest.mark.parametrize("page", NAMES)
def test_what_the_page_says_runs(page: str, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    work = tmp_path / "work"
    shutil.copytree(scene, work)
    monkeypatch.chdir(work)
    names: dict[str, Any] = {"__name__": "page"}
    for block in blocks(page):
        match block.language:
            case "toml":
                (work / "mine.toml").write_text(block.text, encoding="utf-8")
            case "console":
                for line in block.text.splitlines():
                    assert line.startswith("$ "), line
                    command(line[2:])
            case "python":
                exec(compile("\n" * block.line + block.text, str(PAGES / page), "exec"), names)
            case other:
                pytest.fail(f"{page}, line {block.line}: blocks of {other} are not run")


def test_pages_have_something_to_run_and_are_listed() -> None:
    index = (PAGES / "README.md").read_text(encoding="utf-8")
    for name in NAMES:
        if name != "README.md":
            assert f"({name})" in index
            assert any(block.language in ("console", "python") for block in blocks(name)), name
    links = re.findall(r"\]\(([^):]+\.md)\)", index)
    assert all((PAGES / link).is_file() for link in links)


@pytest.mark.parametrize("page", ["README.md", "docs/architecture.md"])
def test_programs_of_the_front_pages_run(page: str) -> None:
    text, names = (ROOT / page).read_text(encoding="utf-8"), {"__name__": "__main__"}
    programs = [m[2] for m in BLOCK.finditer(text) if m[1] == "python"]
    assert programs
    for program in programs:
        exec(compile(program, page, "exec"), names)


@pytest.mark.parametrize(("page", "most"), [("README.md", 110), ("docs/architecture.md", 150), ("docs/security.md", 80)])
def test_the_front_pages_stay_short_and_their_links_lead_somewhere(page: str, most: int) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    assert len(text.splitlines()) <= most
    for link in re.findall(r"\]\(([^):#]+)\)", text):
        assert ((ROOT / page).parent / link).exists(), link


def test_the_architecture_names_every_package() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    packages = {path.parent.name for path in (ROOT / "src" / "phdtrack").glob("*/__init__.py")}
    assert {name for name in packages if f"| `{name}` |" not in text} == set()
