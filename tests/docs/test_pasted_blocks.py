"""Shell blocks of README and how-to pages, pasted into interactive shells: each command gets the
words that the page means. Stand-ins take the place of the commands, which write down their words.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from test_shell_blocks import HOW_TO, SHELL, blocks, commands

# As a terminal starts them, without the user's own settings.
SHELLS = {"bash": ("--norc", "--noprofile", "-i"), "zsh": ("-f", "-i")}
BUILTIN = {"printf", "echo", "cd", "export"}
# What a shell does something with besides splitting words.
SPECIAL = re.compile(r"[|&;<>$`]")
STAND_IN = """#!/bin/sh
for word in "${0##*/}" "$@"; do printf '%s\\037' "$word"; done >> "$PASTED"
printf '\\036' >> "$PASTED"
"""


def words_of(line: str) -> list[str]:
    """The words of a command, without variables that are set for it."""
    words = shlex.split(line)
    while words and re.match(r"[A-Z_]+=", words[0]):
        words.pop(0)
    return words


def pasted(shell: str, text: str, folder: Path) -> tuple[list[list[str]], str]:
    """The words of each command that a shell runs for a text, and what it complains of."""
    program = shutil.which(shell)
    assert program is not None
    stand_ins = folder / "stand-ins"
    stand_ins.mkdir(parents=True)
    names = {words[0] for line in text.splitlines() if (words := words_of(line))}
    for name in {*names, "docker", "phdtrack"} - BUILTIN:
        if "/" not in name:
            (stand_ins / name).write_text(STAND_IN)
            (stand_ins / name).chmod(0o755)
    record = folder / "pasted"
    record.touch()
    home = folder / "home"
    home.mkdir()
    done = subprocess.run(
        [program, *SHELLS[shell]],
        input=text,
        cwd=home,
        env={"PATH": f"{stand_ins}:/usr/bin:/bin", "PASTED": str(record), "HOME": str(home)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    calls = [call.split("\037")[:-1] for call in record.read_text().split("\036")[:-1]]
    wrong = r"not found|no matches|bad pattern|parse error|syntax error|unexpected|unmatched"
    complaints = [line for line in done.stderr.splitlines() if re.search(wrong, line)]
    return calls, "\n".join(complaints)


@pytest.fixture(params=SHELLS)
def shell(request: pytest.FixtureRequest) -> str:
    """A shell that is installed."""
    name = str(request.param)
    if shutil.which(name) is None:
        pytest.skip(f"{name} is not installed: apt-get install {name}")
    return name


@pytest.mark.parametrize("page", HOW_TO, ids=lambda page: page.stem)
def test_blocks_give_commands_the_words_of_the_page(shell: str, page: Path, tmp_path: Path) -> None:
    for block in blocks(page.read_text(encoding="utf-8")):
        if block.language not in SHELL:
            continue
        calls, complaints = pasted(shell, block.text, tmp_path / str(block.line))
        assert complaints == "", f"line {block.line}"
        lines = [line for line in commands(block) if line]
        if any(SPECIAL.search(re.sub(r"'[^']*'|\"[^\"]*\"", "", line)) for line in lines):
            continue
        expected = [words for words in map(words_of, lines) if words[0] not in BUILTIN]
        assert calls == expected, f"line {block.line}"


def test_a_block_that_a_shell_misreads_is_found(shell: str, tmp_path: Path) -> None:
    """The first README had such blocks."""
    text = "pip install .[all]\nphdtrack demo   # half a minute\n"
    calls, complaints = pasted(shell, text, tmp_path)
    if shell == "zsh":
        assert "no matches found" in complaints
        assert calls == [["phdtrack", "demo", "#", "half", "a", "minute"]]
    else:
        assert calls == [["pip", "install", ".[all]"], ["phdtrack", "demo"]]
