"""What is compared with what: sequences, their detections, methods, added clutter, seeds; and one run of all these."""

from __future__ import annotations

import math
import re
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from phdtrack.config import Settings
from phdtrack.errors import InputError
from phdtrack.metrics.lifetimes import check_threshold
from phdtrack.types import SequenceInfo

RUNS = "runs"


@dataclass(frozen=True, slots=True)
class Footage:
    """A sequence by name; ``truth`` None where nobody annotated it, ``source`` (video, images) empty where there is none."""

    name: str
    truth: Path | None = None
    source: str = ""


@dataclass(frozen=True, slots=True)
class Given:
    """Detections from a file, under the name by which sequences have such files in common."""

    name: str
    file: Path


@dataclass(frozen=True, slots=True)
class Detecting:
    """Detections by a detector, on frames shrunk to ``max_width`` (0: as they are); ``parameters`` are its settings."""

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    max_width: int = 0


@dataclass(frozen=True, slots=True)
class Case:
    """A sequence and one set of detections of it. ``info.frames`` is 0 where the frames are counted by decoding."""

    footage: Footage
    seen: Given | Detecting
    info: SequenceInfo

    @property
    def name(self) -> str:
        """Of both, for people."""
        return f"{self.footage.name} {self.seen.name}"

    @property
    def place(self) -> Path:
        """A folder's name for the sequence, and one within it for the detections."""
        return Path(_as_file(self.footage.name), _as_file(self.seen.name))


@dataclass(frozen=True, slots=True)
class Method:
    """Settings under a name: a filter's own, or that of a variant."""

    name: str
    settings: Settings

    @property
    def filter_name(self) -> str:
        """``filter.kind``."""
        return self.settings.kind("filter")


@dataclass(frozen=True, slots=True)
class Cell:
    """What the seeds of a comparison have in common; ``rate`` is that of the added clutter in boxes per frame."""

    case: Case
    rate: float
    method: Method


@dataclass(frozen=True, slots=True)
class Run:
    """One sequence through one method: ``seed`` decides the added clutter and whatever the method draws."""

    cell: Cell
    seed: int

    @property
    def place(self) -> Path:
        """Where in the folder of a comparison it is kept; no other run of a plan has the same."""
        method = _as_file(self.cell.method.name)
        return Path(RUNS) / self.cell.case.place / f"clutter-{self.cell.rate:g}" / method / f"seed-{self.seed}"

    def __str__(self) -> str:
        """For people."""
        clutter = f", clutter {self.cell.rate:g}" if self.cell.rate else ""
        return f"{self.cell.method.name} on {self.cell.case.name}{clutter}, seed {self.seed}"


@dataclass(frozen=True, slots=True)
class Plan:
    """Every case with every rate of clutter, every method and every seed; the first method is what others are compared to.

    Raises
    ------
    InputError : nothing to do, a name or number twice, a rate or an overlap that is none.
    """

    cases: tuple[Case, ...]
    methods: tuple[Method, ...]
    rates: tuple[float, ...] = (0.0,)
    seeds: tuple[int, ...] = (1, 2, 3, 4, 5)
    iou: float = 0.5

    def __post_init__(self) -> None:
        for what, parts in (("sequence", self.cases), ("filter", self.methods), ("rate", self.rates), ("seed", self.seeds)):
            if not parts:
                raise InputError(f"expected at least one {what} to compare, got none")
        for rate in self.rates:
            if not 0 <= rate < math.inf:
                raise InputError(f"expected boxes per frame, 0 or more, got {rate:g}", where="--clutter")
        _once((case.place for case in self.cases), "sequence with these detections", "Rename a folder, or name it once.")
        _once((_as_file(method.name) for method in self.methods), "filter", "Give each variant a name of its own.")
        _once((f"{rate:g}" for rate in self.rates), "rate of clutter", "")
        _once(self.seeds, "seed", "")
        check_threshold(self.iou)

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Every combination but for the seeds, sequence by sequence."""
        return tuple(Cell(case, rate, method) for case in self.cases for rate in self.rates for method in self.methods)

    @property
    def runs(self) -> tuple[Run, ...]:
        """Every combination, cell by cell."""
        return tuple(Run(cell, seed) for cell in self.cells for seed in self.seeds)


def _as_file(name: str) -> str:
    """``name`` with only those characters that every file system has."""
    return re.sub(r"[^\w.+-]", "_", name).strip(".") or "_"


def _once(names: Iterable[Hashable], what: str, cure: str) -> None:
    seen = set()
    for name in names:
        if name in seen:
            raise InputError(f"{name}: the same {what} twice", cure=cure)
        seen.add(name)
