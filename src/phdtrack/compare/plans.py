"""What is compared with what, and how a plan is made of what a user names.

A folder is laid out as MOTChallenge does it: ``seqinfo.ini``, maybe ``gt/gt.txt``, and detections
in ``det/det.txt`` or, where there are several sets, ``det_NAME/det.txt``. One video in it, or
images in ``img1/``, are its pictures. `phdtrack simulate` writes such folders.
"""

from __future__ import annotations

import math
import re
from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from phdtrack import config
from phdtrack.config import Settings
from phdtrack.config.registry import SECTIONS
from phdtrack.detect import detector_parameters, make_detector
from phdtrack.detect.convert import within_frame
from phdtrack.detect.detectors import working_width
from phdtrack.errors import InputError, did_you_mean
from phdtrack.formats import find_seqinfo, read_detections, read_truth
from phdtrack.metrics.matching import check_threshold
from phdtrack.types import SequenceInfo
from phdtrack.video import open_source

VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".mpg", ".mpeg", ".webm", ".m4v")
DEFAULT_DETECTOR = "change"
# Sections whose settings belong to one kind of filter; those of others hold for all.
_OF_FILTERS = ("filter", "extract", "associate")
_NEXT_SETTING = re.compile(r",(?=\s*(?:preset|[a-z]+\.[a-z_]+)\s*=)")


@dataclass(frozen=True, slots=True)
class Case:
    """A sequence and one set of detections of it, by the names of both.

    Attributes
    ----------
    info : size and rate; ``frames`` is 0 where the frames are counted by decoding.
    truth : annotated objects, None without.
    source : video or images, empty where there are none.
    file : the detections; None where the detector called ``detections`` finds them.
    parameters, max_width : the detector's settings, and the width to which frames are shrunk for it
        (0: as they are).
    """

    sequence: str
    detections: str
    info: SequenceInfo
    truth: Path | None = None
    source: str = ""
    file: Path | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    max_width: int = 0

    @property
    def name(self) -> str:
        """Of both, for people."""
        return f"{self.sequence} {self.detections}"

    @property
    def place(self) -> Path:
        """A folder's name for the sequence, and one within it for the detections."""
        return Path(_file_name(self.sequence), _file_name(self.detections))


class Method(NamedTuple):
    """Settings under a name: a filter's, or that of a variant."""

    name: str
    settings: Settings


@dataclass(frozen=True, slots=True)
class Run:
    """One sequence through one method.

    ``rate`` is that of the added clutter in boxes per frame; ``seed`` decides that clutter and
    whatever the method draws.
    """

    case: Case
    rate: float
    method: Method
    seed: int

    @property
    def place(self) -> Path:
        """Where in the folder of a comparison it is kept; no other run of a plan has the same."""
        return (
            Path("runs")
            / self.case.place
            / f"clutter-{self.rate:g}"
            / _file_name(self.method.name)
            / f"seed-{self.seed}"
        )

    def __str__(self) -> str:
        """For people."""
        if self.rate:
            clutter = f", clutter {self.rate:g}"
        else:
            clutter = ""
        return f"{self.method.name} on {self.case.name}{clutter}, seed {self.seed}"


@dataclass(frozen=True, slots=True)
class Plan:
    """Every case with every rate of clutter, every method and every seed; other methods are
    compared to the first.
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
                "Rename a folder, or name it and its detections once.",
            ),
            (
                "filter",
                [_file_name(method.name) for method in self.methods],
                "Give each variant a name of its own.",
            ),
            ("rate", [f"{rate:g}" for rate in self.rates], ""),
            ("seed", self.seeds, ""),
        )
        for what, names, cure in parts:
            if not names:
                raise InputError(f"expected at least one {what} to compare, got none")
            for name in names:
                if names.count(name) > 1:
                    raise InputError(f"{name}: the same {what} twice", cure=cure)
        for rate in self.rates:
            if not 0 <= rate < math.inf:
                raise InputError(
                    f"expected boxes per frame, 0 or more, got {rate:g}", where="--clutter"
                )
        check_threshold(self.iou)

    @property
    def runs(self) -> tuple[Run, ...]:
        """Every combination, sequence by sequence."""
        return tuple(
            Run(*each) for each in product(self.cases, self.rates, self.methods, self.seeds)
        )


@dataclass(frozen=True, slots=True)
class Request:
    """What a user wants to compare, by names.

    Attributes
    ----------
    sequences : folders as MOTChallenge lays them out, or videos.
    filters : the others are compared to the first. Without any, that of the settings, and none.
    detections : sets that the folders have, or files; ``{}`` in a file's name stands for the
        sequence's name.
    detectors, max_width : what looks at the videos, in frames of at most so many pixels (0: as they
        are, None: as `working_width` has it). Without detections and detectors: whatever a sequence
        has.
    truth : a file, named as those of detections; empty for that of the folder.
    clutter : rates of added clutter, boxes per frame.
    seeds : how many, from 1.
    variants : ``NAME=section.name=value,…`` over the first filter's settings, each a further
        method.
    preset, file, sets : the settings; one of a filter, its extraction or its association holds for
        the filters that have it.
    iou : overlap from which boxes match.
    """

    sequences: Sequence[str]
    filters: Sequence[str] = ()
    detections: Sequence[str] = ()
    detectors: Sequence[str] = ()
    max_width: int | None = None
    truth: str = ""
    clutter: Sequence[float] = (0.0,)
    seeds: int = 5
    variants: Sequence[str] = ()
    preset: str = ""
    file: Path | None = None
    sets: Sequence[str] = ()
    iou: float = 0.5

    def load(self, sets: Sequence[str], preset: str = "") -> Settings:
        """The settings with these texts, and with another preset where one is given."""
        return config.load(self.file, sets, preset or self.preset)


def plan(wanted: Request) -> Plan:
    """What `phdtrack compare` compares; every input has been opened and every setting checked.

    Raises `InputError` for anything that cannot be read, or that does not go together.
    """
    if not wanted.sequences:
        raise InputError(
            "nothing to compare on", where="SEQUENCE", cure="Name folders of sequences, or videos."
        )
    for option, names in (("--detections", wanted.detections), ("--truth", (wanted.truth,))):
        for name in names:
            if len(wanted.sequences) > 1 and _is_file(name) and "{}" not in name:
                cure = "Write {} where the name of the sequence stands in the names of the files."
                raise InputError(
                    f"{name} cannot belong to {len(wanted.sequences)} sequences",
                    where=option,
                    cure=cure,
                )
    methods = _methods(wanted)
    parameters = wanted.load([text for text in wanted.sets if _section(text) == "detector"]).values(
        "detector"
    )
    _detector_parameters(wanted.detectors, parameters)  # raises where one does not exist
    cases = tuple(case for word in wanted.sequences for case in _cases(word, wanted, parameters))
    for case in cases:
        for method in methods:
            config.build(method.settings, case.info)
    return Plan(
        cases, methods, tuple(wanted.clutter), tuple(range(1, wanted.seeds + 1)), wanted.iou
    )


def _section(text: str) -> str:
    """The section of ``section.name=value``."""
    return text.strip().split(".")[0]


def _methods(wanted: Request) -> tuple[Method, ...]:
    """One method for each filter, then one for each variant."""
    kind = [text for text in wanted.sets if text.replace(" ", "").startswith("filter.kind=")]
    if kind and wanted.filters:
        raise InputError(
            "--filters says which filters there are",
            where=f"--set {kind[0]}",
            cure="Leave one of them out.",
        )
    shared = [text for text in wanted.sets if _section(text) not in _OF_FILTERS]
    own = [text for text in wanted.sets if text not in (*shared, *kind)]
    names = tuple(wanted.filters) or tuple(
        dict.fromkeys((wanted.load([*shared, *kind]).kind("filter"), "none"))
    )
    for name in names:
        if name not in SECTIONS["filter"]:
            cure = did_you_mean(name, SECTIONS["filter"])
            raise InputError(f"unknown kind of filter: {name}", where="--filters", cure=cure)
    chosen = [_under_filter([*shared, f"filter.kind={name}"], own, wanted) for name in names]
    for text in own:
        if not any(text in used for used in chosen):
            wanted.load((f"filter.kind={names[0]}", text))  # raises, and says which name is near
    filters = (Method(name, wanted.load(used)) for name, used in zip(names, chosen, strict=True))
    return (*filters, *(_variant(text, chosen[0], shared, wanted) for text in wanted.variants))


def _under_filter(used: list[str], own: list[str], wanted: Request) -> list[str]:
    """The texts ``used``, which name a filter, and those of ``own`` that it has."""
    # First of what kind the extraction and the association are.
    for text in sorted(own, key=lambda text: ".kind" not in text.partition("=")[0]):
        with suppress(InputError):
            wanted.load([*used, text])
            used = [*used, text]
    return used


def _variant(text: str, first: list[str], shared: list[str], wanted: Request) -> Method:
    """A method like the ``first``; like what all filters share where the text names a preset or
    another filter.
    """
    name, equals, rest = text.partition("=")
    if not name or not equals or "=" not in rest:
        cure = "For example: --variant few=filter.particles_per_target=100"
        raise InputError("expected NAME=section.name=value", where=f"--variant {text}", cure=cure)
    parts = [part.strip() for part in _NEXT_SETTING.split(rest)]
    presets = [part.partition("=")[2].strip() for part in parts if part.startswith("preset")]
    other = presets or any(part.startswith("filter.kind") for part in parts)
    try:
        sets = [
            *(shared if other else first),
            *(part for part in parts if not part.startswith("preset")),
        ]
        return Method(name, wanted.load(sets, presets[-1] if presets else ""))
    except InputError as error:
        raise InputError(error.problem, where=f"--variant {name}", cure=error.cure) from None


def _cases(word: str, wanted: Request, parameters: Mapping[str, Any]) -> list[Case]:
    """The cases of a folder or a video, every file of them read once to see that it can be."""
    path = Path(word)
    if not path.exists():
        open_source(word)  # says which name is near
        raise InputError("expected a folder or a video file", where=word)
    if path.is_dir():
        name = path.absolute().name
    else:
        name = path.stem
    source = word
    sets = dict[str, Path]()
    if wanted.truth:
        truth = Path(wanted.truth.replace("{}", name))
    else:
        truth = None
    if path.is_dir():
        annotated = path / "gt" / "gt.txt"
        images = path / "img1"
        if truth is None and annotated.is_file():
            truth = annotated
        else:
            truth = truth
        folders = [
            folder
            for folder in sorted(path.glob("det*"))
            if folder.name == "det" or folder.name.startswith("det_")
        ]
        sets = {
            folder.name.removeprefix("det_"): folder / "det.txt"
            for folder in folders
            if (folder / "det.txt").is_file()
        }
        videos = [file for file in path.iterdir() if file.suffix.lower() in VIDEOS]
        if images.is_dir():
            pictures = [images]
        else:
            pictures = videos
        if len(pictures) == 1:
            source = str(pictures[0])
        else:
            source = ""
    files = [_detection_file(text, name, sets) for text in wanted.detections]
    detectors = wanted.detectors
    if not wanted.detections and not detectors:
        files = list(sets.items())
        if sets:
            detectors = ()
        else:
            detectors = (DEFAULT_DETECTOR,)
    if detectors and not source:
        cure = (
            "Name detections with --detections, or put one video, or images in img1, into the"
            " folder."
        )
        raise InputError("there are no pictures for a detector to look at", where=word, cure=cure)
    known = find_seqinfo(word)
    if truth is None:
        last = 0
    else:
        last = int(read_truth(truth).frame.max(initial=0))
    if source and (detectors or known is None):
        seen = open_source(source).info
    else:
        seen = None
    found = [
        Case(name, label, _info(word, file, known or seen, last), truth, source, file)
        for label, file in files
    ]
    if seen is not None and detectors:
        own = _detector_parameters(detectors, parameters)
        info = replace(seen, frames=0, name=name)
        widths = {each: working_width(each, wanted.max_width, seen) for each in own}
        found += [
            Case(name, each, info, truth, source, None, values, widths[each])
            for each, values in own.items()
        ]
    return found


def _detection_file(text: str, sequence: str, sets: Mapping[str, Path]) -> tuple[str, Path]:
    """Name and file of one of the sequence's sets, or of ``[NAME=]FILE``."""
    if not _is_file(text):
        if text not in sets:
            if sets:
                cure = f"There are {', '.join(sets)}."
            else:
                cure = "Name a file, or say --detectors for a video."
            raise InputError(f"there are no detections called {text}", where=sequence, cure=cure)
        return text, sets[text]
    label, equals, pattern = text.partition("=")
    if equals and not Path(text).exists():  # a file of that very name may have the sign in it
        return label, Path(pattern.replace("{}", sequence))
    return Path(text).stem.strip("{}") or "file", Path(text.replace("{}", sequence))


def _is_file(name: str) -> bool:
    """Whether ``--detections`` means a file and not a set that sequences have."""
    return "=" in name or "/" in name or "{}" in name or bool(Path(name).suffix)


def _info(word: str, file: Path, known: SequenceInfo | None, last: int) -> SequenceInfo:
    """Size, rate and length: up to the last frame of what is known, detected or annotated."""
    table = read_detections(file)
    if known is None:
        cure = (
            "Put a seqinfo.ini into the folder, with frameRate, imWidth, imHeight under [Sequence]."
        )
        raise InputError("size and rate of the frames are not known", where=word, cure=cure)
    info = replace(known, frames=max(known.frames, table.last, last))
    if not info.frames:
        raise InputError(
            "the number of frames is not known", where=word, cure="Say seqLength in seqinfo.ini."
        )
    within_frame(table, info, file)
    return info


def _detector_parameters(
    names: Sequence[str], parameters: Mapping[str, Any]
) -> dict[str, Mapping[str, Any]]:
    """By the name of a detector those of the settings that it has."""
    out: dict[str, Mapping[str, Any]] = {}
    for name in names:
        if name == "file":
            cure = "For detections in a file say --detections."
            raise InputError(f"{name} does not look at a video", where="--detectors", cure=cure)
        known = detector_parameters(name)
        out[name] = {key: value for key, value in parameters.items() if key in known}
        make_detector(name, **out[name])
    if names and parameters.keys() - {key for values in out.values() for key in values}:
        make_detector(names[0], **parameters)  # raises, and says which name is near
    return out


def _file_name(name: str) -> str:
    """``name`` with only those characters that every file system has."""
    return re.sub(r"[^\w.+-]", "_", name).strip(".") or "_"
