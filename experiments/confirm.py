"""Old pages whose figures the code of today still gives: ``python -m experiments --confirm NAME``.

A page is old as soon as a module that it loaded has changed, though most changes concern no figure
of it. Its short form tells them apart within minutes: it runs with the code of today, and with the
code that made the page, which git has. If both give the same figures the page counts as new, and
``made.json`` keeps a fingerprint of them: the next time the code of today is enough. This is
evidence, not proof: a short form has fewer cases than a page.
"""

from __future__ import annotations

import difflib
import hashlib
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from experiments import made
from experiments.common import data_place
from phdtrack.errors import InputError

# Lines of a difference that are printed.
_SHOWN = 6
# Sections, columns and lines that tell how long something took; a line that is missed here leaves a
# page old.
_SECTION_OF_TIMES = re.compile(r"#+ Time( per frame)?$")
_COLUMN_OF_TIMES = re.compile(r"\bms\b")
_LINE_OF_TIMES = re.compile(r"\b(ms|filter time|less time)\b|\| time:")
_DIGITS = re.compile(r"\d+")
# Commits that changed a file, the newest first, among which its state is looked for.
_SEARCHED = 60


def confirm(folder: Path, names: Sequence[str]) -> int:
    """Run the short forms of old pages, of all without ``names``, and note in ``folder``/made.json
    which ones the code of today still gives; return the exit status, 1 if any stays old.
    """
    old = made.stale(folder)
    chosen = [*names] or [*old]
    unknown = [name for name in chosen if name not in made.entries(folder)]
    if unknown:
        known = ", ".join(made.entries(folder))
        raise InputError(f"expected a page of {known}; got {unknown[0]!r}", where="--confirm")
    left = 0
    for name in chosen:
        if name not in old and "short" in made.entries(folder)[name]:
            print(f"{name}.md is as new as what it shows")
            continue
        reason = _reason(folder, name, is_old=name in old)
        print(f"{name}.md stays old: {reason}" if reason else f"{name}.md is confirmed", flush=True)
        left += bool(reason)
    return 1 if left else 0


def _reason(folder: Path, name: str, *, is_old: bool) -> str:
    """Why the page stays old; empty if its short form gives the figures that it gave before, which
    is noted then.
    """
    entry = made.entries(folder)[name]
    with TemporaryDirectory(prefix="experiments-") as place:
        now = Path(place) / "now"
        failure = _short_form(made.ROOT, entry["command"], now)
        if failure:
            return failure
        figures = _figures(now / f"{name}.md")
        value = hashlib.sha256("\n".join(figures).encode()).hexdigest()[:12]
        if is_old and entry.get("short") != value:
            reason = _difference(name, entry, figures, Path(place))
            if reason:
                return reason
        made.renew(folder, name, made.entries(now)[name]["code"], value)
    return ""


def _difference(name: str, entry: Mapping[str, Any], now: Sequence[str], place: Path) -> str:
    """Why these figures are not those of the code that made a page; empty if they are."""
    commit = _commit_of(name, entry)
    if not commit:
        return "git has no commit that made it"
    out = place / "before"
    with _checked_out(commit, place / "code") as code:
        absent = _restored(code, entry["code"])
        if absent:
            return f"git does not have {absent} as it was when the page was made"
        failure = _short_form(code, entry["command"], out)
    if failure:
        return failure
    before = _figures(out / f"{name}.md")
    if before == now:
        return ""
    lines = [*difflib.unified_diff(before, now, "before", "now", lineterm="", n=0)]
    more = len(lines) - _SHOWN
    shown = lines[:_SHOWN] + ([f"and {more} more lines"] if more > 0 else [])
    return "\n".join(["its short form gives other figures", *shown])


def _commit_of(name: str, entry: Mapping[str, Any]) -> str:
    """The recorded commit of a page, or one that wrote the page, where that is gone because commits
    were moved; empty if there is none.
    """
    wrote = _git("log", "-1", "--format=%H", "--", f"docs/results/{name}.md").strip()
    for commit in (str(entry["commit"]).rstrip("+"), wrote):
        if commit and _git("cat-file", "-t", commit).strip() == "commit":
            return commit
    return ""


def _restored(code: Path, known: Mapping[str, str]) -> str:
    """Bring the files of ``code`` into the states that have these fingerprints, which commits
    around it have; the first path of which there is none, or empty.

    Somebody may have committed other files while a page was being made.
    """
    for path, value in known.items():
        file = code / path
        if file.is_file() and made.fingerprint(file) == value:
            continue
        for commit in _git("log", f"-{_SEARCHED}", "--all", "--format=%H", "--", path).split():
            text = _git("show", f"{commit}:{path}")
            if made.fingerprint_of(text, file.suffix) == value:
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(text, encoding="utf-8")
                break
        else:
            return path
    return ""


def _git(*words: str) -> str:
    """The output of git; empty if it fails."""
    done = subprocess.run(
        ["git", *words], cwd=made.ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout if done.returncode == 0 else ""


@contextmanager
def _checked_out(commit: str, place: Path) -> Iterator[Path]:
    """The files of a commit, in a folder that is removed afterwards."""
    command = ["git", "worktree"]
    add = [*command, "add", "--quiet", "--detach", str(place), commit]
    subprocess.run(add, cwd=made.ROOT, check=True)
    try:
        yield place
    finally:
        remove = [*command, "remove", "--force", str(place)]
        subprocess.run(remove, cwd=made.ROOT, check=True)


def _short_form(root: Path, command: str, out: Path) -> str:
    """Run the short form of a page's command with the code in ``root``; a sentence with the last
    line of its error, if it fails.
    """
    path = os.pathsep.join([str(root / "src"), str(root)])
    environment = {**os.environ, "PYTHONPATH": path, "PHDTRACK_DATA": str(data_place())}
    words = [sys.executable, *shlex.split(command)[1:], "--quick", "--out", str(out)]
    done = subprocess.run(
        words, cwd=root, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode == 0:
        return ""
    message = (done.stderr.strip().splitlines() or ["no message"])[-1]
    return f"its short form ended with an error ({out.name}): {message}"


def _figures(page: Path) -> list[str]:
    """The lines of a page, without those that say what made it, and without measured times, which
    differ from run to run.
    """
    figures = list[str]()
    timed = frozenset[int]()
    skipped = in_table = False
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            skipped = bool(_SECTION_OF_TIMES.match(line))
        if skipped or line.startswith("Made by `"):
            continue
        cells = line.split("|")
        if len(cells) > 1 and not in_table:
            timed = frozenset(k for k, cell in enumerate(cells) if _COLUMN_OF_TIMES.search(cell))
        in_table = len(cells) > 1
        kept = ["" if in_table and k in timed else cell for k, cell in enumerate(cells)]
        figure = "|".join(kept)
        figures.append(_DIGITS.sub("", figure) if _LINE_OF_TIMES.search(figure) else figure)
    return figures
