"""Shell blocks of README and docs can be pasted: no comments in them, and files that are there."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from phdtrack.cli.app import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
HOW_TO = [ROOT / "README.md", *sorted((ROOT / "docs" / "how-to").glob("*.md"))]
SHELL = ("", "console", "sh", "bash", "shell", "zsh")
FENCED = re.compile(
    r"^```(\w*)\n(.*?)^```$|((?<=\n\n)(?:^ {4}\S[^\n]*\n)+)", re.MULTILINE | re.DOTALL
)
FILE = re.compile(r"[\w./{}*-]+\.(?:mp4|txt|csv|jsonl?|toml|onnx|npy|sqlite|png|xml|parquet)\b")
# Commands that read what their first word names.
READERS = set(COMMANDS) - {"simulate", "demo", "settings", "warm-up"}


class Block(NamedTuple):
    language: str
    text: str
    line: int


def blocks(text: str) -> Iterator[Block]:
    """The fenced and the indented blocks of a page."""
    for found in FENCED.finditer(text):
        yield Block(found[1] or "", found[2] or found[3], text.count("\n", 0, found.start()) + 1)


def comments(text: str) -> list[str]:
    """Lines of shell blocks with a comment."""
    return [line for line in shell_lines(text) if re.search(r"(?:^|\s)#", line)]


def expanded(text: str) -> list[str]:
    """Lines of shell blocks with a word that a shell would expand, or zsh refuse: a pattern."""
    return [
        line
        for line in shell_lines(text)
        if line.startswith(("phdtrack", "pip", "python"))
        and re.search(r"[\[*?]", re.sub(r"'[^']*'|\"[^\"]*\"", "", line))
    ]


def prompts(text: str) -> list[str]:
    """Lines of shell blocks that begin with a prompt, which no shell takes for a command."""
    return [line for line in shell_lines(text) if line.startswith("$ ")]


def shell_lines(text: str) -> list[str]:
    """The lines of all shell blocks."""
    return [line for block in blocks(text) if block.language in SHELL for line in commands(block)]


def commands(block: Block) -> list[str]:
    """The lines of a block."""
    return [line.strip() for line in block.text.splitlines()]


def made_by(words: list[str]) -> list[str]:
    """Files and folders that a command makes."""
    writing = ["--out", "--export"]
    if words[:2] == ["phdtrack", "label"]:
        writing.append("--labels")
    made = [words[k + 1] for k, word in enumerate(words[:-1]) if word in writing]
    if words[:2] == ["yolo", "export"]:
        made += [f"{name}.onnx" for name in re.findall(r"model=(\w+)\.pt", " ".join(words))]
    if words[:2] == ["phdtrack", "track"] and "--out" not in words:
        made.append(f"runs/{Path(words[2]).stem}")
    return made


def read_by(words: list[str]) -> list[str]:
    """Files and folders that a command of ours reads."""
    if words[0] != "phdtrack":
        return []
    read = [name.replace("{}", "street") for word in words[2:] for name in FILE.findall(word)]
    if words[1] in READERS and len(words) > 2 and re.fullmatch(r"[\w./-]+", words[2]):
        read += [words[2]] * (not words[2].startswith("-"))
    return list(dict.fromkeys(read))


def strange_files(text: str) -> list[str]:
    """Files in shell blocks that no earlier block of the page makes, and that are no placeholders:
    the name of one begins with capitals.
    """
    made: list[str] = []
    strange = []
    for block in blocks(text):
        if block.language == "python":
            made += FILE.findall(block.text)
        if block.language == "toml":
            made += FILE.findall(block.text.split("\n")[0])
        if block.language not in SHELL:
            continue
        for line in commands(block):
            words = shlex.split(line)
            new = made_by(words)
            for name in read_by(words):
                known = any(name == one or name.startswith(f"{one}/") for one in [*made, *new])
                if not (known or re.match(r"[A-Z]{2}", Path(name).name)):
                    strange.append(f"line {block.line}: {name}")
            made += new
    return strange


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_shell_blocks_can_be_pasted(page: Path) -> None:
    """An interactive zsh takes # and what follows for words of the command, and [ for a pattern."""
    text = page.read_text(encoding="utf-8")
    assert comments(text) == []
    assert expanded(text) == []
    assert prompts(text) == []


@pytest.mark.parametrize("page", HOW_TO, ids=lambda page: page.stem)
def test_files_of_a_page_are_made_on_it(page: Path) -> None:
    assert strange_files(page.read_text(encoding="utf-8")) == []


def test_comments_and_strange_files_are_found() -> None:
    page = """Text.

    phdtrack demo   # first
    phdtrack track --set 'a=[1]' --set b=[2]

```console
phdtrack track nobody.mp4 --detector onnx:net.onnx
phdtrack simulate street --out street
phdtrack track street/scene.mp4 --config mine.toml --detector onnx:NET.onnx
phdtrack count runs/scene --places PLACES.toml
phdtrack export runs/else --to coco
```

```toml
# mine.toml
```

```
# phdtrack
$ phdtrack settings
phdtrack track VIDEO --config mine.toml
```
"""
    assert comments(page) == ["phdtrack demo   # first", "# phdtrack"]
    assert prompts(page) == ["$ phdtrack settings"]
    assert expanded(page) == ["phdtrack track --set 'a=[1]' --set b=[2]"]
    assert [one.partition(": ")[2] for one in strange_files(page)] == [
        "nobody.mp4",
        "net.onnx",
        "mine.toml",
        "runs/else",
    ]
