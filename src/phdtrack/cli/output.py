"""The output of commands: results on stdout; progress, warnings and errors on stderr.

With ``--json`` stdout belongs to one JSON object, and every sentence moves to stderr.
"""

from __future__ import annotations

import json
import logging
import math
import re
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import TextIOWrapper
from typing import Any

from phdtrack.addresses import shown
from phdtrack.cli import signals
from phdtrack.cli.options import Json, Quiet
from phdtrack.files import json_value
from phdtrack.run.reporter import Advance

_SHOWN = list[Any]()
# The time at which the next line of progress is due, where stderr is no terminal; of the outermost
# progress that goes on.
_DUE = list[float]()
_LINE_EVERY = 30.0
# Messages about work under way, as the compilation of kernels: `Output.quiet` sets its level.
_WORK = logging.getLogger("phdtrack.kernels")
# For hours of work: the pace of the last half minute would not predict its end.
PACE = 24 * 3600.0


@dataclass(frozen=True, slots=True)
class Output:
    """The output of a command, which is the `Reporter` of its runs.

    Attributes
    ----------
    json : keep stdout for one JSON object.
    quiet : print only warnings and errors.
    """

    json: Json = False
    quiet: Quiet = False

    def __post_init__(self) -> None:
        _WORK.setLevel(logging.ERROR if self.quiet else logging.NOTSET)

    def say(self, *lines: str) -> None:
        """Print lines for the user; without any an empty line."""
        if not self.quiet:
            print(*lines, sep="\n", file=sys.stderr if self.json else sys.stdout, flush=True)

    def page(self, url: str) -> None:
        """Print the address of a page, also if `quiet`: its token stands nowhere else."""
        stream = sys.stderr if self.json or self.quiet else sys.stdout
        print(f"the page: {url}   (Ctrl-C ends)", file=stream, flush=True)

    def warn(self, sentences: Iterable[str]) -> None:
        """Print what is not as it should be but does not stop the job."""
        for sentence in sentences:
            self.note(f"warning: {sentence}")

    def note(self, text: str) -> None:
        """Print a sentence about the work under way on stderr, like progress; without secrets."""
        print(f"phdtrack: {shown(text)}", file=sys.stderr, flush=True)

    @property
    def signal(self) -> str:
        """The name of the last signal."""
        return signals.which()

    def stopping(self, sentence: str) -> None:
        """Print that a signal stopped the run; the next one ends the process at once."""
        signals.last_chance(sentence)

    @contextmanager
    def progress(self, title: str, total: int = 0, pace: float = 30.0) -> Iterator[Advance]:
        """Show a bar on stderr if that is a terminal, and a line in half a minute at most
        otherwise; nothing if `quiet`.

        Parameters
        ----------
        title : of the bar.
        total : steps; 0 if the end is not known.
        pace : the end is estimated from the last so many seconds.

        Returns
        -------
        The function to call with the number of steps done so far.
        """
        if self.quiet:
            yield lambda done, **_: None
            return
        if not sys.stderr.isatty():
            outermost = not _DUE
            if outermost:
                _DUE.append(time.monotonic() + _LINE_EVERY)
            try:
                yield _Lines(self, title, total)
            finally:
                if outermost:
                    _DUE.clear()
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
        with _bar(pace) as bar:
            task = bar.add_task(title, total=total or None)
            _SHOWN.append(bar)
            try:
                yield lambda done, **more: bar.update(task, completed=done, **more)
            finally:
                _SHOWN.clear()

    def document(self, value: dict[str, Any]) -> None:
        """Print the one JSON object if `json` is set; NaN and infinities become null."""
        if self.json:
            print(json_text(value, indent=2))

    def table(
        self, head: Sequence[str], rows: Sequence[Sequence[str]], *, words: Sequence[int] = (0,)
    ) -> None:
        """Print columns under a head, unless that is blank; ``words`` are the columns aligned
        left.
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


class _Lines:
    """Prints now and then how far it got."""

    def __init__(self, output: Output, title: str, total: int) -> None:
        self._output = output
        self._title = title
        self._total: int | None = total

    def __call__(
        self, done: int, *, total: int | None = -1, description: str = "", **more: object
    ) -> None:
        """Take in the number of steps done so far, and ``total`` and ``description`` if they
        change.
        """
        self._title = description or self._title
        if total is None or total >= 0:
            self._total = total
        now = time.monotonic()
        if _DUE and now >= _DUE[0]:
            _DUE[0] = now + _LINE_EVERY
            end = f"/{self._total}" if self._total else ""
            self._output.note(f"{self._title} {done}{end}")


def use_replacements() -> None:
    """Let stdout and stderr print ? in place of characters that their encoding does not have, as on
    a terminal or in a file that is not UTF-8.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")


def json_text(value: Mapping[str, Any], indent: int | None = None) -> str:
    """The JSON of a value; NaN and infinities become null. Characters that stdout cannot print are
    escaped, so that nothing is lost.
    """
    plain = json_value(value)
    text = json.dumps(plain, indent=indent, allow_nan=False, ensure_ascii=False)
    try:
        text.encode(getattr(sys.stdout, "encoding", None) or "utf-8")
    except UnicodeEncodeError:
        return json.dumps(plain, indent=indent, allow_nan=False)
    return text


def number(value: float | None, digits: int = 3) -> str:
    """A number as people read it: whole ones without decimals, a dash for none."""
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


def without_numbers(sentence: str) -> str:
    """The sentence with # in place of each number: what it says, whatever it counts."""
    return re.sub(r"\d+([.,]\d+)*", "#", sentence)


def _bar(pace: float) -> Any:
    """A display of bars."""
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
    return Progress(
        *columns, console=Console(stderr=True), transient=True, speed_estimate_period=pace
    )
