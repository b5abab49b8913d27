"""Provenance of the pages of results: command, commit, settings and code; and the pages that are
older than their code.

``docs/results/made.json`` has an entry for each page: the command, the commit that was checked out
(with a + if files had changed since), and a fingerprint of every module of phdtrack and of the
experiments that the command loaded, in its own process or in its workers, and of the files that
hold settings. Comments, docstrings and layout do not count for a fingerprint. It is taken when the
command starts: editing a file during the run makes the page old. `experiments.confirm` tells
whether the figures of an old page have changed.
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
# Modules that do not affect a page.
APART = ("experiments/made.py", "experiments/confirm.py", "experiments/__main__.py")
# Pages that are written by hand from the output of a command.
BY_HAND = {
    "speed": "python -m benchmarks",
    "reliability": "python -m experiments.fuzz and the like",
}


def fingerprint(path: Path) -> str:
    """The fingerprint of a module without comments, docstrings and layout, or of the values of a
    settings file.
    """
    return fingerprint_of(path.read_text(encoding="utf-8"), path.suffix)


def fingerprint_of(text: str, suffix: str) -> str:
    """The `fingerprint` of a file with this text and suffix."""
    if suffix == ".toml":
        content = json.dumps(tomllib.loads(text), sort_keys=True)
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
        content = ast.dump(tree)
    return hashlib.sha256(content.encode()).hexdigest()[:12]


@cache
def at_start() -> Mapping[str, str]:
    """Fingerprints of all modules and settings, by path, at the first call."""
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
    """The commit that is checked out, with a + if files have changed since; ``unknown`` outside a
    repository.
    """
    try:
        run = [
            subprocess.run(
                ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True
            ).stdout.strip()
            for arguments in (
                ["rev-parse", "--short=10", "HEAD"],
                ["status", "--porcelain", "--", "src", "experiments"],
            )
        ]
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return run[0] + ("+" if run[1] else "")


def record(folder: Path, page: str, command: str, modules: Iterable[str]) -> str:
    """Write the entry of a page into ``folder``/made.json; return the line for the page's end."""
    pages = entries(folder)
    code = {path: at_start().get(path, "") for path in sorted({*modules, *SETTINGS})}
    pages[page] = {"command": command, "commit": commit(), "code": code}
    _write(folder, pages)
    settings = hashlib.sha256("".join(code[one] for one in SETTINGS).encode()).hexdigest()[:8]
    return (
        f"\nMade by `{command}` at commit {pages[page]['commit']}, presets and kinds of settings"
        f" {settings}.\n"
    )


def record_part(folder: Path, page: str, part: str, command: str, modules: Iterable[str]) -> str:
    """Write the entry of a part of a page into ``folder``/made.json; return the line for its end.

    The code of the page is that of all its parts; a module that they were made with different
    states of is old.
    """
    before = entries(folder).get(page, {}).get("parts", {})
    line = record(folder, page, command, modules)
    pages = entries(folder)
    new = pages[page]
    parts = {**before, part: {"commit": new["commit"], "code": new["code"]}}
    states: dict[str, set[str]] = {}
    for each in parts.values():
        for path, value in each["code"].items():
            states.setdefault(path, set()).add(value)
    pages[page] = {
        "command": f"python -m experiments {page}",
        "commit": new["commit"],
        "code": {path: those.pop() if len(those) == 1 else "" for path, those in states.items()},
        "parts": parts,
    }
    _write(folder, pages)
    return line


def renew(folder: Path, page: str, modules: Iterable[str], short: str) -> None:
    """Note that the code of today gives the figures of a page, which loads these modules now.

    ``short``: the fingerprint of the figures of its short form.
    """
    pages = entries(folder)
    entry = pages[page]
    for one in (entry, *entry.get("parts", {}).values()):
        paths = {*one["code"], *modules} & at_start().keys()
        one["code"] = {path: at_start()[path] for path in sorted(paths)}
    entry["confirmed"] = commit()
    entry["short"] = short
    _write(folder, pages)


def stale(folder: Path) -> dict[str, list[str]]:
    """The pages of ``folder`` that are older than their code, and the modules that have changed
    since; an empty list if the page was never recorded.
    """
    recorded = entries(folder)
    found = dict[str, list[str]]()
    for page in sorted(path.stem for path in folder.glob("*.md") if path.stem not in BY_HAND):
        known = recorded.get(page)
        changed = (
            [path for path, value in known["code"].items() if at_start().get(path) != value]
            if known
            else []
        )
        if changed or not known:
            found[page] = changed
    return found


def check(folder: Path) -> int:
    """Print the old pages, the reasons, and the commands that make them again; return the exit
    status, 1 if there are any.
    """
    old = stale(folder)
    recorded = entries(folder)
    for page, changed in old.items():
        if changed:
            few = ", ".join(changed[:3]) + (
                f" and {len(changed) - 3} more" if len(changed) > 3 else ""
            )
            print(f"{page}.md is older than {few}: {recorded[page]['command']}")
        else:
            print(
                f"{page}.md does not say what it was made by: python -m experiments --list has the"
                " commands"
            )
    for page, command in BY_HAND.items():
        print(f"{page}.md is written by hand from what {command} prints, and not checked")
    if old:
        print("python -m experiments --confirm NAME tells whether the figures have changed")
    else:
        print("all other pages are as new as what they show")
    return 1 if old else 0


def entries(folder: Path) -> dict[str, Any]:
    """The entries of ``folder``/made.json by page; none if there is no such file."""
    file = folder / "made.json"
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    return found


def _write(folder: Path, pages: Mapping[str, Any]) -> None:
    text = json.dumps(pages, indent=1, sort_keys=True) + "\n"
    (folder / "made.json").write_text(text, encoding="utf-8")
