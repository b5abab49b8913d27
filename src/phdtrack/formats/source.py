"""Saying where in a file that a user named something is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from phdtrack.files import AnyPath, load
from phdtrack.types import I8

__all__ = ["AnyPath", "Origin", "load"]


@dataclass(frozen=True, slots=True, eq=False)
class Origin:
    """Where rows came from: ``path``, and for each row the 1-based ``number`` (M,) of its ``unit`` ("line", "row") there."""

    path: Path
    unit: str
    number: I8

    def at(self, row: int) -> str:
        """The place of row ``row`` in words: "det.txt, line 12"."""
        return f"{self.path}, {self.unit} {self.number[row]}"
