"""What is compared with what: sequences, their detections, methods, added clutter, seeds; and one run of all these."""

from __future__ import annotations

import math
import re
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from phdtrack.config import Settings, load
from phdtrack.errors import InputError
from phdtrack.metrics.matching import check_threshold
from phdtrack.types import SequenceInfo

# Sections whose settings belong to one kind of filter; those of others hold for all.
_OF_FILTERS = ("filter", "extract", "associate")
_NEXT_SETTING = re.compile(r",(?=\s*(?:preset|[a-z]+\.[a-z_]+)\s*=)")


@dataclass(frozen=True, slots=True)
class SequenceFiles:
    """A sequence by name; ``truth`` None without annotation, ``source`` (video, images) empty where there is none."""

    name: str
    truth: Path | None = None
    source: str = ""


@dataclass(frozen=True, slots=True)
class DetectionFile:
    """Detections from a file, under the name by which sequences have such files in common."""

    name: str
    file: Path


@dataclass(frozen=True, slots=True)
class DetectorRun:
    """Detections by a detector, on frames shrunk to ``max_width`` (0: as they are); ``parameters`` are its settings."""

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    max_width: int = 0


@dataclass(frozen=True, slots=True)
class Case:
    """A sequence and one set of detections of it. ``info.frames`` is 0 where the frames are counted by decoding."""

    sequence: SequenceFiles
    detections: DetectionFile | DetectorRun
    info: SequenceInfo

    @property
    def name(self) -> str:
        """Of both, for people."""
        return f"{self.sequence.name} {self.detections.name}"

    @property
    def place(self) -> Path:
        """A folder's name for the sequence, and one within it for the detections."""
        return Path(_file_name(self.sequence.name), _file_name(self.detections.name))


@dataclass(frozen=True, slots=True)
class Method:
    """Settings under a name: a filter's, or that of a variant."""

    name: str
    settings: Settings

    @property
    def filter_name(self) -> str:
        """``filter.kind``."""
        return str(self.settings.as_dict()["filter"]["kind"])


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
        method = _file_name(self.cell.method.name)
        return Path("runs") / self.cell.case.place / f"clutter-{self.cell.rate:g}" / method / f"seed-{self.seed}"

    def __str__(self) -> str:
        """For people."""
        clutter = f", clutter {self.cell.rate:g}" if self.cell.rate else ""
        return f"{self.cell.method.name} on {self.cell.case.name}{clutter}, seed {self.seed}"


@dataclass(frozen=True, slots=True)
class Plan:
    """Every case with every rate of clutter, every method and every seed; other methods are compared to the first.

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
        _check_once(
            (case.place for case in self.cases), "sequence with these detections", "Rename a folder, or name it once."
        )
        _check_once((_file_name(method.name) for method in self.methods), "filter", "Give each variant a name of its own.")
        _check_once((f"{rate:g}" for rate in self.rates), "rate of clutter", "")
        _check_once(self.seeds, "seed", "")
        check_threshold(self.iou)

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Every combination but for the seeds, sequence by sequence."""
        return tuple(Cell(case, rate, method) for case in self.cases for rate in self.rates for method in self.methods)

    @property
    def runs(self) -> tuple[Run, ...]:
        """Every combination, cell by cell."""
        return tuple(Run(cell, seed) for cell in self.cells for seed in self.seeds)


@dataclass(frozen=True, slots=True)
class SettingsSource:
    """Where settings come from: a preset by name, a file, texts ``section.name=value``."""

    preset: str = ""
    file: Path | None = None
    sets: tuple[str, ...] = ()

    def load(self, sets: Iterable[str] | None = None, preset: str = "") -> Settings:
        """The settings, with other texts and another preset where given."""
        return load(self.file, tuple(self.sets if sets is None else sets), preset or self.preset)


def methods(filters: Sequence[str], variants: Sequence[str], given: SettingsSource) -> tuple[Method, ...]:
    """One method for each filter and each variant.

    A setting of a filter, its extraction or its association holds for those filters that have it.

    Parameters
    ----------
    filters : names; without any, that of the settings, and none.
    variants : ``NAME=section.name=value,…`` over the first filter's settings.
    given : settings for all.

    Returns
    -------
    The methods, filters first.

    Raises
    ------
    InputError : an unknown name, a value out of range, a setting that none of the filters has.
    """
    kind = [text for text in given.sets if text.replace(" ", "").startswith("filter.kind=")]
    if kind and filters:
        raise InputError("--filters says which filters there are", where=f"--set {kind[0]}", cure="Leave one of them out.")
    sets = [text for text in given.sets if text not in kind]
    names = tuple(filters)
    if not names:
        names = tuple(dict.fromkeys((Method("", given.load([*_for_all(sets), *kind])).filter_name, "none")))
    chosen = [_under_filter(name, sets, given) for name in names]
    for text in sets:
        if not any(text in used for _, used in chosen):
            given.load((f"filter.kind={names[0]}", text))  # raises, and says which name is near
    out = [Method(name, settings) for name, (settings, _) in zip(names, chosen, strict=True)]
    return (*out, *(_variant(text, names[0], chosen[0][1], given) for text in variants))


def _under_filter(name: str, sets: Sequence[str], given: SettingsSource) -> tuple[Settings, tuple[str, ...]]:
    """The settings under this filter, and which of ``sets`` have a place in them."""
    of_filters = [text for text in sets if text not in _for_all(sets)]
    kinds = [text for text in of_filters if ".kind" in text.partition("=")[0] and not text.startswith("filter.")]
    start = (*_for_all(sets), f"filter.kind={name}", *kinds)
    try:
        known = given.load(start).as_dict()
    except InputError as error:
        cure = error.cure if error.where.endswith(f"filter.kind={name}") else ""
        raise InputError(error.problem, where="--filters" if cure else error.where, cure=cure or error.cure) from None
    used = [text for text in of_filters if text not in kinds and _has(known, text)]
    return given.load((*start, *used)), (*_for_all(sets), *kinds, *used)


def _variant(text: str, first: str, sets: Sequence[str], given: SettingsSource) -> Method:
    name, equals, rest = text.partition("=")
    if not name or not equals or "=" not in rest:
        cure = "For example: --variant few=filter.particles_per_target=100"
        raise InputError("expected NAME=section.name=value", where=f"--variant {text}", cure=cure)
    parts = [part.strip() for part in _NEXT_SETTING.split(rest)]
    presets = [part.partition("=")[2].strip() for part in parts if part.startswith("preset")]
    kinds = [part for part in parts if part.startswith("filter.kind")]
    others = [part for part in parts if not part.startswith("preset") and part not in kinds]
    if presets or kinds:
        # Another filter has other settings: only what all filters share goes along.
        sets = _for_all(sets)
    base = kinds or ([] if presets else [f"filter.kind={first}"])
    try:
        return Method(name, given.load((*sets, *base, *others), presets[-1] if presets else ""))
    except InputError as error:
        raise InputError(error.problem, where=f"--variant {name}", cure=error.cure) from None


def _has(known: Mapping[str, Any], text: str) -> bool:
    section, _, name = text.partition("=")[0].strip().partition(".")
    values = known.get(section)
    return isinstance(values, dict) and (name in values or name == "initial")


def _for_all(sets: Sequence[str]) -> list[str]:
    return [text for text in sets if text.strip().split(".")[0] not in _OF_FILTERS]


def _file_name(name: str) -> str:
    """``name`` with only those characters that every file system has."""
    return re.sub(r"[^\w.+-]", "_", name).strip(".") or "_"


def _check_once(names: Iterable[Hashable], what: str, cure: str) -> None:
    seen = set()
    for name in names:
        if name in seen:
            raise InputError(f"{name}: the same {what} twice", cure=cure)
        seen.add(name)
