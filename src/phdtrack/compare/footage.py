"""From what a user names to sequences with detections: folders as MOTChallenge lays them out, and videos.

A folder has ``seqinfo.ini``, maybe ``gt/gt.txt``, and detections in ``det/det.txt`` or, where there are several sets,
``det_NAME/det.txt``. One video in it, or images in ``img1/``, are its pictures. `phdtrack simulate` writes such folders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from phdtrack.compare.records import Case, Detecting, Footage, Given
from phdtrack.detect import DETECTORS, detector_names, detector_parameters, make_detector, typed
from phdtrack.detect.convert import within_frame
from phdtrack.errors import InputError
from phdtrack.formats import find_seqinfo, read_detections, read_truth
from phdtrack.types import SequenceInfo
from phdtrack.video import open_source

VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".mpg", ".mpeg", ".webm", ".m4v")
DEFAULT_DETECTOR = "change"


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the options say of detections: names of sets or files, detectors with their settings, a file of truth.

    ``{}`` in a file's name stands for the name of the sequence. Empty: whatever a sequence has.
    """

    detections: tuple[str, ...] = ()
    detectors: tuple[str, ...] = ()
    parameters: tuple[tuple[str, Any], ...] = ()
    max_width: int = 0
    truth: str = ""


def cases(words: Sequence[str], wanted: Wanted) -> tuple[Case, ...]:
    """The cases of all sequences, every file of them read once to see that it can be.

    Raises
    ------
    InputError : a sequence or a file that is missing or malformed, options that do not go together.
    """
    if not words:
        raise InputError("nothing to compare on", where="SEQUENCE", cure="Name folders of sequences, or videos.")
    single = len(words) == 1
    for option, names in (("--detections", wanted.detections), ("--truth", (wanted.truth,))):
        for name in names:
            if not single and _is_file(name) and "{}" not in name:
                cure = "Write {} where the name of the sequence stands in the names of the files."
                raise InputError(f"{name} cannot belong to {len(words)} sequences", where=option, cure=cure)
    detectors = _detectors(wanted)
    return tuple(case for word in words for case in _cases_of(word, wanted, detectors))


def _cases_of(word: str, wanted: Wanted, detectors: tuple[Detecting, ...]) -> list[Case]:
    footage, sets = _opened(word, wanted.truth)
    given = [_given(name, footage, sets) for name in wanted.detections]
    if not wanted.detections and not detectors:
        given = [Given(name, file) for name, file in sets.items()]
        detectors = () if given else _detectors(replace(wanted, detectors=(DEFAULT_DETECTOR,)))
    if detectors and not footage.source:
        cure = "Name detections with --detections, or put one video, or images in img1, into the folder."
        raise InputError("there are no pictures for a detector to look at", where=word, cure=cure)
    last = 0 if footage.truth is None else int(read_truth(footage.truth).frame.max(initial=0))
    known = find_seqinfo(word)
    pictures = open_source(footage.source).info if footage.source and (detectors or known is None) else None
    found = [Case(footage, seen, _sequence(word, seen, known or pictures, last)) for seen in given]
    if pictures is not None:
        found += [Case(footage, seen, replace(pictures, frames=0, name=footage.name)) for seen in detectors]
    return found


def _opened(word: str, truth: str) -> tuple[Footage, dict[str, Path]]:
    """The sequence, and its sets of detections by name."""
    path = Path(word)
    if not path.exists():
        open_source(word)  # says which name is near
        raise InputError("expected a folder or a video file", where=word)
    name = path.absolute().name if path.is_dir() else path.stem
    named = Path(truth.replace("{}", name)) if truth else None
    if not path.is_dir():
        return Footage(name, named, word), {}
    annotated = path / "gt" / "gt.txt"
    if named is None and annotated.is_file():
        named = annotated
    sets = {
        file.parent.name.removeprefix("det_"): file
        for file in sorted(path.glob("det*/det.txt"))
        if file.parent.name == "det" or file.parent.name.startswith("det_")
    }
    return Footage(name, named, _pictures(path)), sets


def _pictures(folder: Path) -> str:
    """The one video in a folder, its images, or nothing."""
    if (folder / "img1").is_dir():
        return str(folder / "img1")
    videos = [file for file in folder.iterdir() if file.suffix.lower() in VIDEOS]
    return str(videos[0]) if len(videos) == 1 else ""


def _given(name: str, footage: Footage, sets: dict[str, Path]) -> Given:
    """A set of the sequence's own, or ``[NAME=]FILE``."""
    if not _is_file(name):
        if name not in sets:
            cure = f"There are {', '.join(sets)}." if sets else "Name a file, or say --detectors for a video."
            raise InputError(f"there are no detections called {name}", where=footage.name, cure=cure)
        return Given(name, sets[name])
    label, equals, pattern = name.partition("=")
    file = Path((pattern if equals else name).replace("{}", footage.name))
    # A file of that very name may have the sign in it.
    return Given(label, file) if equals and not Path(name).exists() else Given(Path(name).stem.strip("{}") or "file", file)


def _is_file(name: str) -> bool:
    """Whether ``--detections`` means a file and not a set that sequences have."""
    return "=" in name or "/" in name or "{}" in name or bool(Path(name).suffix)


def _sequence(word: str, seen: Given, known: SequenceInfo | None, last: int) -> SequenceInfo:
    """Size, rate and length; as long as whatever tells of it."""
    table = read_detections(seen.file)
    if known is None:
        cure = "Put a seqinfo.ini into the folder, with frameRate, imWidth, imHeight under [Sequence]."
        raise InputError("size and rate of the frames are not known", where=word, cure=cure)
    info = replace(known, frames=max(known.frames, table.last, last))
    if not info.frames:
        raise InputError("the number of frames is not known", where=word, cure="Say seqLength in seqinfo.ini.")
    within_frame(table, info, seen.file)
    return info


def _detectors(wanted: Wanted) -> tuple[Detecting, ...]:
    """The detectors, each with those of the settings that it has."""
    for name in wanted.detectors:
        if name in DETECTORS and name not in dict(detector_names()):
            cure = "For detections in a file say --detections."
            raise InputError(f"{name} does not look at a video", where="--detectors", cure=cure)
    known = {name: {entry.name for entry in detector_parameters(name)} for name in wanted.detectors}
    made = []
    for name in wanted.detectors:
        own = typed(name, {key: value for key, value in wanted.parameters if key in known[name]})
        make_detector(name, max_width=wanted.max_width, **own)
        made.append(Detecting(name, own, wanted.max_width))
    for key, _ in wanted.parameters:
        if known and not any(key in names for names in known.values()):
            first = next(iter(known))
            make_detector(first, **dict(wanted.parameters))  # refuses, and says which name is near
    return tuple(made)
