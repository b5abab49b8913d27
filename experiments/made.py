"""Provenance of the pages of results: command, commit, settings and code; and the pages that are
older than their code.

``docs/results/made.json`` has an entry for each page: the command, the commit that was checked out
(with a + where files had changed since), and a fingerprint of every module of phdtrack and of the
experiments that the command loaded, in its own process or in its workers, and of the files that
hold settings. A fingerprint is of what a file says to Python: comments, docstrings and layout do
not count. It is taken when the command begins: what is edited while it runs makes the page old.
"""

from __future__ import annotations

import ast
import hashlib
import json
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "src" / "phdtrack" / "config"
SETTINGS = tuple(sorted(one.relative_to(ROOT).as_posix() for one in CONFIG.rglob("*.toml")))
# Not part of what a page shows.
APART = ("experiments/made.py", "experiments/__main__.py")
# Pages whose words and figures are put together by hand, from what a command prints.
BY_HAND = {
    "speed": "python -m benchmarks",
    "reliability": "python -m experiments.fuzz and the like",
}


def fingerprint(path: Path) -> str:
    """The fingerprint of a module without comments, docstrings and layout, or of the values of a
    settings file.
    """
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".toml":
        said = json.dumps(tomllib.loads(text), sort_keys=True)
    else:
        tree = ast.parse(text)
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if (
                isinstance(body, list)
                and body
                and isinstance(body[0], ast.Expr)
                and isinstance(body[0].value, ast.Constant)
            ):
                body[0] = ast.Pass()
        said = ast.dump(tree)
    return hashlib.sha256(said.encode()).hexdigest()[:12]


@cache
def at_start() -> Mapping[str, str]:
    """Fingerprints of all modules and settings, by path, when this was first asked."""
    modules = [*(ROOT / "src" / "phdtrack").rglob("*.py"), *(ROOT / "experiments").glob("*.py")]
    paths = [*modules, *(ROOT / one for one in SETTINGS)]
    return {path.relative_to(ROOT).as_posix(): fingerprint(path) for path in sorted(paths)}


def loaded() -> set[str]:
    """Paths of the modules of phdtrack and of the experiments that this process has loaded."""
    files = (
        getattr(module, "__file__", None)
        for name, module in list(sys.modules.items())
        if _ours(name)
    )
    paths = (Path(file).resolve() for file in files if file)
    return {path.relative_to(ROOT).as_posix() for path in paths if path.is_relative_to(ROOT)} - set(
        APART
    )


def _ours(name: str) -> bool:
    return name.partition(".")[0] in ("phdtrack", "experiments")


def commit() -> str:
    """The commit that is checked out, with a + where files have changed since; ``unknown`` outside
    of a repository.
    """
    try:
        run = [
            subprocess.run(
                ["git", *what], cwd=ROOT, capture_output=True, text=True, check=True
            ).stdout.strip()
            for what in (
                ["rev-parse", "--short=10", "HEAD"],
                ["status", "--porcelain", "--", "src", "experiments"],
            )
        ]
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return run[0] + ("+" if run[1] else "")


def record(folder: Path, page: str, command: str, modules: Iterable[str]) -> str:
    """Write the entry of a page into ``folder``/made.json; the line for the page's end."""
    file = folder / "made.json"
    entries = _read(file)
    code = {path: at_start().get(path, "") for path in sorted({*modules, *SETTINGS})}
    entries[page] = {"command": command, "commit": commit(), "code": code}
    file.write_text(json.dumps(entries, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    settings = hashlib.sha256("".join(code[one] for one in SETTINGS).encode()).hexdigest()[:8]
    return (
        f"\nMade by `{command}` at commit {entries[page]['commit']}, presets and kinds of settings"
        f" {settings}.\n"
    )


def stale(folder: Path) -> dict[str, list[str]]:
    """The pages of ``folder`` older than what they show, and the modules that have changed since;
    none: never recorded.
    """
    entries = _read(folder / "made.json")
    found = dict[str, list[str]]()
    for page in sorted(path.stem for path in folder.glob("*.md") if path.stem not in BY_HAND):
        known = entries.get(page)
        changed = (
            [path for path, value in known["code"].items() if at_start().get(path) != value]
            if known
            else []
        )
        if changed or not known:
            found[page] = changed
    return found


def check(folder: Path) -> int:
    """Say which pages are old, why, and what makes them anew; the exit status: 0, or 1 where there
    are any.
    """
    old = stale(folder)
    entries = _read(folder / "made.json")
    for page, changed in old.items():
        if changed:
            few = ", ".join(changed[:3]) + (
                f" and {len(changed) - 3} more" if len(changed) > 3 else ""
            )
            print(f"{page}.md is older than {few}: {entries[page]['command']}")
        else:
            print(
                f"{page}.md does not say what it was made by: python -m experiments --list has the"
                " commands"
            )
    for page, command in BY_HAND.items():
        print(f"{page}.md is written by hand from what {command} prints, and not checked")
    if not old:
        print("all other pages are as new as what they show")
    return 1 if old else 0


def _read(file: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    return found
