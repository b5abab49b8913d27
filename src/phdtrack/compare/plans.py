"""Contents of a comparison: cases, methods, runs, and the plan that combines them."""

from __future__ import annotations

import math
import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from phdtrack import config
from phdtrack.config import Settings
from phdtrack.conventions import Conventions
from phdtrack.errors import InputError
from phdtrack.metrics.matching import check_threshold
from phdtrack.run.requests import ReadingRequest
from phdtrack.types import SequenceInfo


@dataclass(frozen=True, slots=True)
class Case:
    """A sequence with one set of detections, by the names of both.

    Attributes
    ----------
    info : size and rate; ``frames`` is 0 if frames are counted by decoding.
    truth : file of annotated objects, None without.
    source : video or images, empty without.
    file : the detections; None if the detector called ``detections`` finds them.
    parameters, max_width : the detector's settings, and the width to which frames are shrunk for it
        (0: not shrunk).
    reading : how the truth, and the file of detections, are to be read.
    labelled : frames that are scored, as `run.scored_files.ScoringRequest.labelled`.
    appearance, embedding : what describes the boxes by the pictures, as
        `TrackingRequest.appearance` names it, empty for nothing; and the settings of a network.
    """

    sequence: str
    detections: str
    info: SequenceInfo
    truth: Path | None = None
    source: str = ""
    file: Path | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    max_width: int = 0
    reading: tuple[Conventions, Conventions] = (Conventions(), Conventions())
    labelled: str = ""
    appearance: str = ""
    embedding: Mapping[str, Any] = field(default_factory=dict)

    @property
    def looked_at(self) -> bool:
        """True if the pictures are looked at before anything is tracked."""
        return self.file is None or bool(self.appearance)

    @property
    def name(self) -> str:
        """The names of sequence and detections, for messages."""
        return f"{self.sequence} {self.detections}"

    @property
    def place(self) -> Path:
        """A folder for the sequence, and one in it for the detections."""
        return Path(_file_name(self.sequence), _file_name(self.detections))


class Method(NamedTuple):
    """Settings with the name of a filter or a variant."""

    name: str
    settings: Settings


@dataclass(frozen=True, slots=True)
class Run:
    """One case with one method.

    ``rate`` is that of the added clutter in boxes per frame; ``seed`` determines this clutter, and
    the random numbers of the method.
    """

    case: Case
    rate: float
    method: Method
    seed: int

    @property
    def settings(self) -> Settings:
        """The method's settings for the boxes of the case, as `phdtrack track` chooses them."""
        detector = "" if self.case.file else self.case.detections
        return config.for_run(replace(self.method.settings, detector=detector), endless=False)

    @property
    def place(self) -> Path:
        """The run's own folder in the folder of a comparison."""
        return (
            Path("runs")
            / self.case.place
            / f"clutter-{self.rate:g}"
            / _file_name(self.method.name)
            / f"seed-{self.seed}"
        )

    def __str__(self) -> str:
        """A description for messages."""
        clutter = f", clutter {self.rate:g}" if self.rate else ""
        return f"{self.method.name} on {self.case.name}{clutter}, seed {self.seed}"


@dataclass(frozen=True, slots=True)
class Plan:
    """Every combination of case, rate of clutter, method and seed; all methods are compared with
    the first.

    Attributes
    ----------
    cases : sequences with their detections.
    methods : how they are tracked; the first is compared with the others.
    rates : false alarms per frame that are mixed in.
    seeds : of all random draws.
    iou : the overlap from which a pair of boxes may match, in (0, 1].
    """

    cases: tuple[Case, ...]
    methods: tuple[Method, ...]
    rates: tuple[float, ...] = (0.0,)
    seeds: tuple[int, ...] = (1, 2, 3, 4, 5)
    iou: float = 0.5

    def __post_init__(self) -> None:
        parts: tuple[tuple[str, Sequence[Hashable], str], ...] = (
            (
                "sequence",
                [case.place for case in self.cases],
                "Rename a folder, or give it and its detections only once.",
            ),
            (
                "filter",
                [_file_name(method.name) for method in self.methods],
                "Give each variant its own name.",
            ),
            ("rate", [f"{rate:g}" for rate in self.rates], ""),
            ("seed", self.seeds, ""),
        )
        for noun, names, cure in parts:
            if not names:
                raise InputError(f"expected at least one {noun} to compare, got none")
            for name in names:
                if names.count(name) > 1:
                    raise InputError(f"{name}: the same {noun} twice", cure=cure)
        for rate in self.rates:
            if not 0 <= rate < math.inf:
                raise InputError(
                    f"expected boxes per frame, 0 or more, got {rate:g}", where="--clutter"
                )
        check_threshold(self.iou)

    @property
    def runs(self) -> tuple[Run, ...]:
        """Every combination, case by case."""
        return tuple(
            Run(*combination)
            for combination in product(self.cases, self.rates, self.methods, self.seeds)
        )


@dataclass(frozen=True, slots=True)
class Request:
    """A comparison as a user requests it, by names.

    Attributes
    ----------
    sequences : folders in the layout of MOTChallenge, or videos.
    filters : all are compared with the first; empty: that of the settings, and none.
    detections : names of sets in the folders, or files; ``{}`` in a file's name stands for the name
        of the sequence.
    detectors, max_width : detectors to run on the videos, on frames of at most so many pixels in
        width (0: not shrunk, None: `working_width`). Without detections and detectors the sets of
        each folder are used.
    truth : a file, with ``{}`` as in ``detections``; empty: that of the folder.
    reading : how truth and files of detections are to be read.
    labelled : frames that are scored, as `run.scored_files.ScoringRequest.labelled`.
    appearance : ``colours``, ``onnx:FILE`` or ``none``; empty: the default of `phdtrack track`.
    clutter : rates of added clutter, boxes per frame.
    seeds : number of seeds, from 1.
    variants : ``NAME=section.name=value,…``: further methods with changed settings of the first
        filter.
    preset, file, sets : the settings; those of a filter, its extraction or its association apply to
        the filters that have them.
    iou : minimum overlap of matching boxes.
    pairs : more sequences: a file of truth with a file of detections, or with a video, for each.
    frame_size, fps : ``WxH`` in pixels, and the rate, of ``pairs`` without a ``seqinfo.ini``.
    """

    sequences: Sequence[str]
    filters: Sequence[str] = ()
    detections: Sequence[str] = ()
    detectors: Sequence[str] = ()
    max_width: int | None = None
    truth: str = ""
    reading: ReadingRequest = field(default_factory=ReadingRequest)
    labelled: str = ""
    appearance: str = ""
    clutter: Sequence[float] = (0.0,)
    seeds: int = 5
    variants: Sequence[str] = ()
    preset: str = ""
    file: Path | None = None
    sets: Sequence[str] = ()
    iou: float = 0.5
    pairs: Sequence[tuple[Path, Path]] = ()
    frame_size: str = ""
    fps: float = 0.0

    def load(self, sets: Sequence[str], preset: str = "") -> Settings:
        """The settings with these ``--set`` texts, and with another ``preset`` if one is given."""
        return config.load(self.file, sets, preset or self.preset)


def _file_name(name: str) -> str:
    """``name`` with only the characters that every file system allows."""
    return re.sub(r"[^\w.+-]", "_", name).strip(".") or "_"
