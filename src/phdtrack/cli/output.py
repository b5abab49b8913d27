"""What the commands say, and where: results on stdout; progress, warnings and errors on stderr.

With ``--json`` stdout belongs to one JSON object, and every sentence moves to stderr.
"""

from __future__ import annotations

import json
import logging
import math
import platform
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import metadata
from typing import Any

from phdtrack import __version__
from phdtrack.cli.options import Json, Quiet
from phdtrack.files import json_value

Advance = Callable[..., None]
"""Takes the number of frames done so far; ``total`` and ``description`` where they are others than
before.
"""
_SHOWN = list[Any]()
# What is said of work under way, as that kernels are compiled: `Output.quiet` sets its level.
_WORK = logging.getLogger("phdtrack.kernels")
# Of what takes hours: the pace of the last half minute would tell nothing of its end.
PACE = 24 * 3600.0
_PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "opencv-python-headless",
    "av",
    "typer",
    "rich",
    "pydantic",
    "matplotlib",
    "pyarrow",
)


@dataclass(frozen=True, slots=True)
class Output:
    """Where a command's words go; ``json``: stdout is kept for one JSON object; ``quiet``: only
    warnings are said, and from when this is made also no `progress` is shown."""

    json: Json = False
    quiet: Quiet = False

    def __post_init__(self) -> None:
        _WORK.setLevel(logging.ERROR if self.quiet else logging.NOTSET)

    def say(self, *lines: str) -> None:
        """Lines for the user; an empty one without any."""
        if not self.quiet:
            print(*lines, sep="\n", file=sys.stderr if self.json else sys.stdout, flush=True)

    def warn(self, sentences: Iterable[str]) -> None:
        """Sentences about what is not as it should be, but does not stop the job."""
        for sentence in sentences:
            self.note(f"warning: {sentence}")

    def note(self, text: str) -> None:
        """A sentence about what is going on; on stderr, like progress."""
        print(f"phdtrack: {text}", file=sys.stderr, flush=True)

    def document(self, value: dict[str, Any]) -> None:
        """The one JSON object, where it was asked for. What JSON cannot write (NaN, infinities) is
        null.
        """
        if self.json:
            print(json.dumps(json_value(value), indent=2, allow_nan=False, ensure_ascii=False))

    def table(
        self, head: Sequence[str], rows: Sequence[Sequence[str]], *, words: Sequence[int] = (0,)
    ) -> None:
        """Columns under a head, which is left out where it is blank; ``words`` are the columns
        aligned left.
        """
        if any(head):
            lines = [head, *rows]
        else:
            lines = list(rows)
        widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
        for line in lines:
            pairs = zip(line, widths, strict=True)
            cells = [
                cell.ljust(width) if i in words else cell.rjust(width)
                for i, (cell, width) in enumerate(pairs)
            ]
            self.say("  ".join(cells).rstrip())


def number(value: float | None, digits: int = 3) -> str:
    """A number as people read it: whole ones without decimals, a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    if isinstance(value, int):
        return str(value)
    return f"{value:.{digits}f}"


def counted(count: int, noun: str) -> str:
    """ "no boxes", "1 box", "2 boxes"."""
    if noun.endswith("x"):
        many = f"{noun}es"
    else:
        many = f"{noun}s"
    return f"{count or 'no'} {noun if count == 1 else many}"


@contextmanager
def progress(title: str, total: int, pace: float = 30.0) -> Iterator[Advance]:
    """A bar on stderr when that is a terminal, nothing otherwise or if `Output.quiet`; ``total`` 0:
    the end is not known.

    Gives the function to call with the number of frames done so far. The end is estimated from the
    last ``pace`` seconds.
    """
    if not sys.stderr.isatty() or not _WORK.isEnabledFor(logging.WARNING):
        yield lambda done, **_: None
        return
    if _SHOWN:
        # One display for the whole: a bar within another one goes below it.
        bar = _SHOWN[0]
        task = bar.add_task(title, total=total or None)
        try:
            yield lambda done, **more: bar.update(task, completed=done, **more)
        finally:
            bar.remove_task(task)
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=Console(stderr=True), transient=True, speed_estimate_period=pace
    ) as bar:
        task = bar.add_task(title, total=total or None)
        _SHOWN.append(bar)
        try:
            yield lambda done, **more: bar.update(task, completed=done, **more)
        finally:
            _SHOWN.clear()


def versions() -> tuple[tuple[str, str], ...]:
    """Pairs of name and version: phdtrack, Python, the system, and the packages that it rests on
    and that are there.
    """
    found = [
        ("phdtrack", __version__),
        ("python", platform.python_version()),
        ("system", platform.platform()),
    ]
    for name in _PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found.append((name, metadata.version(name)))
    return tuple(found)
