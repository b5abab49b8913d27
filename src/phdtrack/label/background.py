"""Suggestions that are made while somebody labels already, and kept in a file for the next time."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from phdtrack.label.suggest import Suggestions

_COLUMNS = ("frame", "box", "reason", "score", "place")


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """How far it is: the ``share`` that is done, the suggestions when they are there, and why there will be none."""

    share: float
    suggestions: Suggestions | None = None
    problem: str = ""


class Suggester(Protocol):
    """Where a session has its suggestions from."""

    def answer(self) -> Answer:
        """What is known by now."""


@dataclass(frozen=True, slots=True, eq=False)
class Ready:
    """Suggestions that are there."""

    suggestions: Suggestions

    def answer(self) -> Answer:
        """They are there."""
        return Answer(1.0, self.suggestions)


class Background:
    """Does ``work`` in a thread of its own; that is told how to report its share, and raises where it fails."""

    def __init__(self, work: Callable[[Callable[[float], None]], Suggestions]) -> None:
        self._work, self._answer = work, Answer(0.0)
        # A daemon: who closes the page does not wait for suggestions.
        threading.Thread(target=self._run, name="suggestions", daemon=True).start()

    def answer(self) -> Answer:
        """What is known by now."""
        return self._answer

    def _run(self) -> None:
        try:
            self._answer = Answer(1.0, self._work(self._told))
        except Exception as error:
            self._answer = Answer(1.0, problem=str(error) or type(error).__name__)

    def _told(self, share: float) -> None:
        self._answer = Answer(share)


def kept(path: Path, key: str, make: Callable[[], Suggestions]) -> Suggestions:
    """The suggestions in the file if they were made for ``key``; else those that ``make`` makes, kept there."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["key"] == key:
            frame, box, reason, score, place = (np.array(document[name]) for name in _COLUMNS)
            return Suggestions(
                frame.astype(np.int64),
                box.astype(np.int64),
                reason.astype(np.int64),
                score.astype(np.float64),
                place.astype(np.int64),
            )
    except (OSError, ValueError, KeyError, TypeError):
        pass  # There is none yet, or another program's: made anew.
    found = make()
    columns = dict(zip(_COLUMNS, (found.frame, found.box, found.reason, found.score, found.place), strict=True))
    document = {"key": key} | {name: column.tolist() for name, column in columns.items()}
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(document) + "\n", encoding="utf-8")
    part.replace(path)
    return found
