"""How a run reports progress and sentences: the caller hands in a `Reporter`, and nothing is
printed without one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

Advance = Callable[..., None]
"""Takes the number of frames done so far, and ``total`` and ``description`` if they change."""


class Reporter(Protocol):
    """Receives what a run reports while it goes on."""

    @property
    def signal(self) -> str:
        """The name of the signal that interrupted the program last."""
        ...

    def note(self, text: str) -> None:
        """Report a sentence about the work under way.

        Parameters
        ----------
        text : one line.
        """
        ...

    def warn(self, sentences: Iterable[str]) -> None:
        """Report what is not as it should be but does not stop the run.

        Parameters
        ----------
        sentences : each with its cure.
        """
        ...

    def progress(self, title: str, total: int = 0) -> AbstractContextManager[Advance]:
        """Show the progress of ``total`` steps while the block runs; 0 if the end is unknown.

        Parameters
        ----------
        title : what goes on.
        total : number of steps.
        """
        ...

    def stopping(self, sentence: str) -> None:
        """Report that a signal stopped the run, which now completes its files.

        Parameters
        ----------
        sentence : why it stops.
        """
        ...


class Silent:
    """A `Reporter` that shows nothing."""

    signal = "Ctrl-C"

    def note(self, text: str) -> None:
        """Drop the sentence."""

    def warn(self, sentences: Iterable[str]) -> None:
        """Drop the sentences."""

    def progress(self, title: str, total: int = 0) -> AbstractContextManager[Advance]:
        """Ignore the progress."""
        return nullcontext(_ignore)

    def stopping(self, sentence: str) -> None:
        """Drop the sentence."""


def _ignore(done: int, **more: object) -> None:
    """Show no progress."""


SILENT = Silent()
