"""From what a user names to a plan: folders as MOTChallenge lays them out, and videos, with their detections.

A folder has ``seqinfo.ini``, maybe ``gt/gt.txt``, and detections in ``det/det.txt`` or, where there are several sets,
``det_NAME/det.txt``. One video in it, or images in ``img1/``, are its pictures. `phdtrack simulate` writes such folders.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from phdtrack import config
from phdtrack.compare.plans import Case, DetectionFile, DetectorRun, Plan, SequenceFiles, SettingsSource, methods
from phdtrack.detect import DETECTORS, detector_names, detector_parameters, make_detector, typed
from phdtrack.detect.convert import within_frame
from phdtrack.errors import InputError
from phdtrack.formats import find_seqinfo, read_detections, read_truth
from phdtrack.types import SequenceInfo
from phdtrack.video import open_source

VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".mpg", ".mpeg", ".webm", ".m4v")
DEFAULT_DETECTOR = "change"


@dataclass(frozen=True, slots=True)
class DetectionChoice:
    """Which detections to compare on; empty: whatever a sequence has. ``{}`` in a file's name stands for the sequence's
    name.

    Attributes
    ----------
    detections : names of sets that the folders have, or files.
    detectors : by name.
    max_width : to which frames are shrunk for them, pixels; 0: not at all.
    truth : a file of annotated objects.
    """

    detections: tuple[str, ...] = ()
    detectors: tuple[str, ...] = ()
    max_width: int = 0
    truth: str = ""


_ANY_DETECTIONS, _DEFAULTS = DetectionChoice(), SettingsSource()


def plan(
    sequences: Sequence[str],
    *,
    filters: Sequence[str] = (),
    detections: DetectionChoice = _ANY_DETECTIONS,
    clutter: Sequence[float] = (0.0,),
    seeds: int = 5,
    variants: Sequence[str] = (),
    settings: SettingsSource = _DEFAULTS,
    iou: float = 0.5,
) -> Plan:
    """What `phdtrack compare` compares; every input has been opened and every setting checked.

    Parameters
    ----------
    sequences : folders as MOTChallenge lays them out, or videos.
    filters : by the names of configuration; the others are compared to the first.
    detections : which sets, files or detectors.
    clutter : rates of added clutter, boxes per frame.
    seeds : how many, from 1.
    variants : ``NAME=section.name=value,…``, each a further method.
    settings : preset, file and single settings.
    iou : overlap from which boxes match.

    Returns
    -------
    The plan.

    Raises
    ------
    InputError : anything that cannot be read, or that does not go together.
    """
    chosen = methods(filters, variants, settings)
    of_detectors = [text for text in settings.sets if text.strip().startswith("detector.")]
    parameters = config.load(settings.file, of_detectors).detector
    found = _cases(sequences, detections, parameters)
    for case in found:
        for method in chosen:
            config.build(method.settings, case.info)
    return Plan(found, chosen, tuple(clutter), tuple(range(1, seeds + 1)), iou)


def _cases(words: Sequence[str], choice: DetectionChoice, parameters: Mapping[str, Any]) -> tuple[Case, ...]:
    """The cases of all sequences, every file of them read once to see that it can be."""
    if not words:
        raise InputError("nothing to compare on", where="SEQUENCE", cure="Name folders of sequences, or videos.")
    for option, names in (("--detections", choice.detections), ("--truth", (choice.truth,))):
        for name in names:
            if len(words) > 1 and _is_file(name) and "{}" not in name:
                cure = "Write {} where the name of the sequence stands in the names of the files."
                raise InputError(f"{name} cannot belong to {len(words)} sequences", where=option, cure=cure)
    detectors = _detectors(choice.detectors, choice.max_width, parameters)
    return tuple(case for word in words for case in _cases_of(word, choice, detectors, parameters))


def _cases_of(
    word: str, choice: DetectionChoice, detectors: tuple[DetectorRun, ...], parameters: Mapping[str, Any]
) -> list[Case]:
    files, sets = _opened(word, choice.truth)
    given = [_detection_file(name, files, sets) for name in choice.detections]
    if not choice.detections and not detectors:
        given = [DetectionFile(name, file) for name, file in sets.items()]
        detectors = () if given else _detectors((DEFAULT_DETECTOR,), choice.max_width, parameters)
    if detectors and not files.source:
        cure = "Name detections with --detections, or put one video, or images in img1, into the folder."
        raise InputError("there are no pictures for a detector to look at", where=word, cure=cure)
    last = 0 if files.truth is None else int(read_truth(files.truth).frame.max(initial=0))
    known = find_seqinfo(word)
    pictures = open_source(files.source).info if files.source and (detectors or known is None) else None
    found = [Case(files, file, _info(word, file, known or pictures, last)) for file in given]
    if pictures is not None:
        info = replace(pictures, frames=0, name=files.name)
        found += [Case(files, detector, info) for detector in detectors]
    return found


def _opened(word: str, truth: str) -> tuple[SequenceFiles, dict[str, Path]]:
    """The sequence, and its sets of detections by name."""
    path = Path(word)
    if not path.exists():
        open_source(word)  # says which name is near
        raise InputError("expected a folder or a video file", where=word)
    name = path.absolute().name if path.is_dir() else path.stem
    named = Path(truth.replace("{}", name)) if truth else None
    if not path.is_dir():
        return SequenceFiles(name, named, word), {}
    annotated = path / "gt" / "gt.txt"
    if named is None and annotated.is_file():
        named = annotated
    folders = [folder for folder in sorted(path.glob("det*")) if folder.name == "det" or folder.name.startswith("det_")]
    sets = {folder.name.removeprefix("det_"): folder / "det.txt" for folder in folders if (folder / "det.txt").is_file()}
    videos = [file for file in path.iterdir() if file.suffix.lower() in VIDEOS]
    pictures = [path / "img1"] if (path / "img1").is_dir() else videos
    return SequenceFiles(name, named, str(pictures[0]) if len(pictures) == 1 else ""), sets


def _detection_file(name: str, files: SequenceFiles, sets: dict[str, Path]) -> DetectionFile:
    """One of the sequence's sets, or ``[NAME=]FILE``."""
    if not _is_file(name):
        if name not in sets:
            cure = f"There are {', '.join(sets)}." if sets else "Name a file, or say --detectors for a video."
            raise InputError(f"there are no detections called {name}", where=files.name, cure=cure)
        return DetectionFile(name, sets[name])
    label, equals, pattern = name.partition("=")
    if equals and not Path(name).exists():  # a file of that very name may have the sign in it
        return DetectionFile(label, Path(pattern.replace("{}", files.name)))
    file = Path((pattern if equals else name).replace("{}", files.name))
    return DetectionFile(Path(name).stem.strip("{}") or "file", file)


def _is_file(name: str) -> bool:
    """Whether ``--detections`` means a file and not a set that sequences have."""
    return "=" in name or "/" in name or "{}" in name or bool(Path(name).suffix)


def _info(word: str, file: DetectionFile, known: SequenceInfo | None, last: int) -> SequenceInfo:
    """Size, rate and length: up to the last frame of what is known, detected or annotated."""
    table = read_detections(file.file)
    if known is None:
        cure = "Put a seqinfo.ini into the folder, with frameRate, imWidth, imHeight under [Sequence]."
        raise InputError("size and rate of the frames are not known", where=word, cure=cure)
    info = replace(known, frames=max(known.frames, table.last, last))
    if not info.frames:
        raise InputError("the number of frames is not known", where=word, cure="Say seqLength in seqinfo.ini.")
    within_frame(table, info, file.file)
    return info


def _detectors(names: Sequence[str], max_width: int, parameters: Mapping[str, Any]) -> tuple[DetectorRun, ...]:
    """The detectors, each with those of the settings that it has."""
    for name in names:
        if name in DETECTORS and name not in dict(detector_names()):
            cure = "For detections in a file say --detections."
            raise InputError(f"{name} does not look at a video", where="--detectors", cure=cure)
    known = {name: {entry.name for entry in detector_parameters(name)} for name in names}
    made = []
    for name in names:
        values = typed(name, {key: value for key, value in parameters.items() if key in known[name]})
        make_detector(name, max_width=max_width, **values)
        made.append(DetectorRun(name, values, max_width))
    for key in parameters:
        if known and not any(key in entries for entries in known.values()):
            make_detector(names[0], **parameters)  # raises, and says which name is near
    return tuple(made)
