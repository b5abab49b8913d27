"""The cases in a folder or a video, and those of a truth and the file that goes with it.

A folder has the layout of MOTChallenge: ``seqinfo.ini``, optionally ``gt/gt.txt``, and detections
in ``det/det.txt`` or, if there are several sets, ``det_NAME/det.txt``. A single video in it, or
images in ``img1/``, are its pictures. `phdtrack simulate` writes such folders.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.compare.plans import Case, Request
from phdtrack.detect import detector_parameters, make_detector
from phdtrack.detect.convert import check_units, within_frame
from phdtrack.detect.detectors import working_width
from phdtrack.errors import InputError
from phdtrack.formats import Conventions, find_seqinfo, read_detections, read_truth
from phdtrack.run.descriptors import is_file as is_embeddings_file
from phdtrack.run.requests import DEFAULT_APPEARANCE, frame_size
from phdtrack.types import SequenceInfo
from phdtrack.video import open_source

_VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".mpg", ".mpeg", ".webm", ".m4v")
_DEFAULT_DETECTOR = "change"
# Names of files that say nothing about the sequence.
_USUAL_STEMS = ("gt", "det", "truth", "detections", "annotations", "labels")
NO_SETTINGS: Mapping[str, Any] = {}


def existing(word: str) -> Path:
    """The path of a file or folder; `InputError` if there is none, which names the nearest."""
    path = Path(word)
    if not path.exists():
        # Raises an error that names the nearest file.
        open_source(word)
        raise InputError("expected a folder or a video file", where=word)
    return path


def cases_of(
    word: str,
    request: Request,
    parameters: Mapping[str, Any],
    embedding: Mapping[str, Any] = NO_SETTINGS,
) -> list[Case]:
    """The cases of a folder or a video; every file is read once to check it.

    Parameters
    ----------
    word : the folder or video, as the user wrote it.
    request : the whole request.
    parameters, embedding : settings of detectors, and of a network that describes boxes.
    """
    path = existing(word)
    name = path.absolute().name if path.is_dir() else path.stem
    source = word
    sets = dict[str, Path]()
    truth = None
    if request.truth:
        truth = Path(request.truth.replace("{}", name))
    if path.is_dir():
        source = _pictures(path)
        sets = _detection_sets(path)
        annotated = path / "gt" / "gt.txt"
        if truth is None and annotated.is_file():
            truth = annotated
    files = [_detection_file(text, name, sets) for text in request.detections]
    detectors = request.detectors
    if not request.detections and not detectors:
        files = list(sets.items())
        detectors = () if sets else (_DEFAULT_DETECTOR,)
    if detectors and not source:
        raise InputError(
            "there are no pictures for a detector",
            where=word,
            cure="Name detections with --detections, or put one video, or images in img1, into the"
            " folder.",
        )
    info = find_seqinfo(word)
    decoded = None
    if source and (detectors or info is None):
        decoded = _decoded(source, info)
    known = info or decoded
    reading = _reading(request, name, known, alone=not files)
    last = 0
    if truth is not None:
        last = _annotated(truth, reading[0], known)
    size = known or SequenceInfo(0, 0, 0.0)
    case = Case(
        name,
        "",
        size,
        truth,
        source,
        reading=reading,
        labelled=request.labelled,
        appearance=_appearance(request, source),
        embedding=embedding,
    )
    cases = list[Case]()
    for label, file in files:
        info = _info(word, file, known, last, reading[1])
        cases.append(replace(case, detections=label, info=info, file=file))
    if decoded is not None:
        case = replace(case, info=replace(decoded, frames=0, name=name))
        for detector, settings in detector_settings(detectors, parameters).items():
            cases.append(_detected(case, detector, settings, request))
    return cases


def cases_of_pair(
    truth: Path,
    file: Path,
    request: Request,
    parameters: Mapping[str, Any],
    embedding: Mapping[str, Any] = NO_SETTINGS,
) -> list[Case]:
    """The cases of a file of truth and a file of detections, or a video; both are read once to
    check them.

    Parameters
    ----------
    truth, file : annotated objects, and detections or a video of the same sequence.
    request : the whole request.
    parameters, embedding : settings of detectors, and of a network that describes boxes.

    Raises
    ------
    InputError : one of them cannot be read, or size or rate of the frames are unknown.
    """
    if is_video(file):
        alone = replace(request, truth=str(truth))
        return cases_of(str(file), alone, parameters, embedding)
    name = _pair_name(truth, file)
    known = _stated_info(truth, file, request)
    reading = _reading(request, name, known, alone=False)
    last = _annotated(truth, reading[0], known)
    info = _info(str(file), file, known, last, reading[1])
    return [
        Case(
            name,
            file.stem,
            info,
            truth,
            file=file,
            reading=reading,
            labelled=request.labelled,
            appearance=_appearance(request, ""),
        )
    ]


def _pair_name(truth: Path, file: Path) -> str:
    """The name of a sequence: that of its truth, or of the folder if all truths are called alike,
    as in ``street/gt/gt.txt``.
    """
    for path in (truth.absolute(), file.absolute()):
        if path.stem.lower() not in _USUAL_STEMS:
            return path.stem
    folders = (one.name for one in truth.absolute().parents if one.name not in ("", "gt"))
    return next(folders, truth.stem)


def _stated_info(truth: Path, file: Path, request: Request) -> SequenceInfo:
    """Size and rate by the request, or by a ``seqinfo.ini`` near one of the files. Raises
    `InputError` if they are unknown.
    """
    found = find_seqinfo(file) or find_seqinfo(truth)
    info = found or SequenceInfo(0, 0, 0.0)
    if request.frame_size:
        width, height = frame_size(request.frame_size)
        info = replace(info, width=width, height=height)
    if request.fps:
        info = replace(info, fps=request.fps)
    if info.width and info.height and info.fps:
        return info
    raise InputError(
        "size and rate of the frames are unknown",
        where=file,
        cure="Say --frame-size WxH and --fps F, or put a seqinfo.ini beside the file or one folder"
        " up.",
    )


def _appearance(request: Request, source: str) -> str:
    """The appearance that a case has; empty for none. Raises `InputError` if pictures are needed
    and there are none.
    """
    appearance = request.appearance or DEFAULT_APPEARANCE
    if appearance == "none" or not (request.appearance or source):
        return ""
    if is_embeddings_file(appearance) or not source:
        raise InputError(
            "a comparison reads it from pictures",
            where=f"--appearance {appearance}",
            cure="Say colours or onnx:FILE, for sequences with a video or images, or none.",
        )
    return appearance


def _decoded(source: str, info: SequenceInfo | None) -> SequenceInfo:
    """Size and rate of a video; of images the rate in ``info``, as they do not know theirs."""
    video = open_source(source)
    if video.times is None and info is not None:
        return replace(video.info, fps=info.fps)
    return video.info


def _detected(case: Case, detector: str, settings: Mapping[str, Any], request: Request) -> Case:
    """The case with a detector that has these settings."""
    width = working_width(detector, request.max_width, case.info)
    return replace(case, detections=detector, parameters=settings, max_width=width)


def _reading(
    request: Request, name: str, known: SequenceInfo | None, *, alone: bool
) -> tuple[Conventions, Conventions]:
    """How the truth and the detections of a sequence are to be read. A word that stands alone is
    that of the detections, or if the truth is the only file (``alone``), of that.
    """
    size = (known.width, known.height) if known else (0, 0)
    # Of a file with several videos, the one of the sequence's name is read.
    reading = replace(request.reading, sequence=request.reading.sequence or name)
    truth, detections = reading.pair(truth=alone, file=not alone)
    return truth.conventions(size), detections.conventions(size)


def _annotated(path: Path, reading: Conventions, known: SequenceInfo | None) -> int:
    """The last frame of a truth. Raises `InputError` if it cannot be read, or is not in pixels."""
    # What is guessed is reported by the runs.
    truth = read_truth(path, conventions=reading, notices=[])
    if known is not None:
        size = (known.width, known.height)
        sure = np.ones(len(truth))
        check_units(truth.xyxy, sure, size, path, units=reading.units, box=reading.box)
    return int(truth.frame.max(initial=0))


def _pictures(folder: Path) -> str:
    """The folder of images, or the only video, in a folder; empty if there is none."""
    images = folder / "img1"
    if images.is_dir():
        return str(images)
    videos = [file for file in folder.iterdir() if is_video(file)]
    return str(videos[0]) if len(videos) == 1 else ""


def _detection_sets(folder: Path) -> dict[str, Path]:
    """The files of detections in a folder, by the names of the sets."""
    sets = dict[str, Path]()
    for place in sorted(folder.glob("det*")):
        file = place / "det.txt"
        if (place.name == "det" or place.name.startswith("det_")) and file.is_file():
            sets[place.name.removeprefix("det_")] = file
    return sets


def _detection_file(text: str, sequence: str, sets: Mapping[str, Path]) -> tuple[str, Path]:
    """Name and file of one of the sequence's sets, or of ``[NAME=]FILE``."""
    if not is_file(text):
        if text in sets:
            return text, sets[text]
        cure = "Name a file, or use --detectors for a video."
        if sets:
            cure = f"There are {', '.join(sets)}."
        raise InputError(f"there are no detections called {text}", where=sequence, cure=cure)
    label, equals, pattern = text.partition("=")
    # An existing file's name may contain the sign.
    if equals and not Path(text).exists():
        return label, Path(pattern.replace("{}", sequence))
    return Path(text).stem.strip("{}") or "file", Path(text.replace("{}", sequence))


def is_video(path: Path) -> bool:
    """Return True if the file is a video, by its name."""
    return path.suffix.lower() in _VIDEOS


def is_sequence(folder: Path) -> bool:
    """Return True if the folder is a sequence: it has a description, truth, detections, images or
    one video.
    """
    described = (folder / "seqinfo.ini").is_file() or (folder / "gt").is_dir()
    return described or bool(_detection_sets(folder)) or bool(_pictures(folder))


def is_file(name: str) -> bool:
    """Return True if ``--detections`` names a file, not a set of a sequence."""
    return "=" in name or "/" in name or "{}" in name or bool(Path(name).suffix)


def _info(
    word: str, file: Path, known: SequenceInfo | None, last: int, reading: Conventions
) -> SequenceInfo:
    """Size, rate and length, up to the last frame that is known, detected or annotated."""
    # What is guessed is reported by the runs.
    table = read_detections(file, conventions=reading, notices=[])
    if known is None:
        raise InputError(
            "size and rate of the frames are unknown",
            where=word,
            cure="Put a seqinfo.ini with frameRate, imWidth and imHeight under [Sequence] into the"
            " folder.",
        )
    info = replace(known, frames=max(known.frames, table.last, last))
    if not info.frames:
        raise InputError(
            "the number of frames is unknown", where=word, cure="Set seqLength in seqinfo.ini."
        )
    within_frame(table, info, file, units=reading.units, box=reading.box)
    return info


def detector_settings(
    names: Sequence[str], parameters: Mapping[str, Any]
) -> dict[str, Mapping[str, Any]]:
    """The parameters that each detector has, by its name. Raises `InputError` for unknown ones."""
    out: dict[str, Mapping[str, Any]] = {}
    for name in names:
        if name == "file":
            raise InputError(
                "file is no detector",
                where="--detectors",
                cure="Use --detections for detections in a file.",
            )
        known = detector_parameters(name)
        out[name] = {key: value for key, value in parameters.items() if key in known}
        make_detector(name, **out[name])
    used = {key for settings in out.values() for key in settings}
    if names and parameters.keys() - used:
        # Raises an error that names the nearest parameter.
        make_detector(names[0], **parameters)
    return out
