"""The two files of `phdtrack evaluate`: read, checked against each other, and cut to the frames
that are scored."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phdtrack.arrays import intersection
from phdtrack.conventions import ALL, BOXES
from phdtrack.detect.convert import check_units
from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.formats import (
    Conventions,
    find_seqinfo,
    ignoring,
    read_tracks,
    read_tracks_named,
    read_truth,
    read_truth_by_class,
)
from phdtrack.metrics.agreement import other_reading
from phdtrack.metrics.labelled import in_frames, keyframe_doubt, regularly_labelled
from phdtrack.types import F8, I8, LAST_FRAME, Tracks, Truth

# The word for the frames in which the truth has rows.
_OF_TRUTH = "truth"
NO_TRUTH = Truth(*(np.zeros(0, np.int64),) * 2, np.zeros((0, 4)), np.zeros(0, np.bool_))
NO_TRACK = "the file holds no track"
_MAX_LISTED = 10_000_000


@dataclass(frozen=True, slots=True)
class ScoringRequest:
    """The files to score, and how.

    Attributes
    ----------
    truth, tracks : the files.
    reading : the conventions of the truth, and of the tracks.
    ignore : file of what does not count.
    kitti : type of objects in KITTI files.
    frames : number of frames; 0: that of seqinfo.ini, or the last with a box.
    labelled : frames that are scored, as 1,11,21-30, a file of such numbers, ``truth`` for those
        with objects, or ``all``; empty: by evidence.
    """

    truth: Path
    tracks: Path
    reading: tuple[Conventions, Conventions] = (Conventions(), Conventions())
    ignore: Path | None = None
    kitti: str = ""
    frames: int = 0
    labelled: str = ""


@dataclass(frozen=True, slots=True)
class ScoredFiles:
    """Truth and tracks to score, the number of frames, and sentences about doubts.

    ``labelled`` are the numbers in the files of the frames that are scored; empty for all.
    """

    truth: Truth
    tracks: Tracks
    frames: int
    notices: list[str]
    labelled: I8


@dataclass(frozen=True, slots=True)
class ScoredClasses:
    """Truth and tracks to score of each class by its name, the number of frames, and sentences
    about doubts.
    """

    classes: Mapping[str, tuple[Truth, Tracks]]
    frames: int
    notices: Sequence[str]


def read_scored(request: ScoringRequest) -> ScoredFiles:
    """Read truth and tracks. Raises `InputError` if one is missing or malformed, or its boxes
    cannot be in pixels.
    """
    notices = list[str]()
    of_truth, of_tracks = request.reading
    truth = read_truth(request.truth, kitti=request.kitti, conventions=of_truth, notices=notices)
    tracks = read_tracks(
        request.tracks, kitti=request.kitti, conventions=of_tracks, notices=notices
    )
    _check(request, truth, tracks, notices)
    if request.ignore is not None:
        truth = _counted(truth, tracks, request.ignore, notices)
    labelled = _labelled(request, truth, tracks, notices)
    if len(labelled):
        truth, tracks = in_frames(truth, tracks, labelled)
        return ScoredFiles(truth, tracks, len(labelled), notices, labelled)
    frames = _last_frame(request, truth, tracks, notices)
    return ScoredFiles(truth, tracks, frames, notices, labelled)


def read_scored_by_class(request: ScoringRequest) -> ScoredClasses:
    """Read the truth and the tracks of each class, checked as by `read_scored`. Raises `InputError`
    as that, and if the truth has no classes.
    """
    notices = list[str]()
    of_truth, of_tracks = request.reading
    annotated = read_truth_by_class(request.truth, conventions=of_truth, notices=notices)
    tracks, names = read_tracks_named(request.tracks, conventions=of_tracks, notices=notices)
    every = _joined(annotated.values())
    _check(request, every, tracks, notices)
    label = np.array(
        [names.get(one, str(one)).lower() for one in tracks.class_id.tolist()], np.str_
    )
    words = {one: one for one in label.tolist()} | {
        name.lower(): name for name in (*names.values(), *annotated)
    }
    classes = dict[str, tuple[Truth, Tracks]]()
    untouched = list[str]()
    for word, name in words.items():
        truth = _joined(one for key, one in annotated.items() if key.lower() == word)
        own = tracks.select(label == word)
        if request.ignore is not None:
            truth = _counted(truth, own, request.ignore, untouched)
        if len(own) or len(truth):
            classes[name] = (truth, own)
    if len(untouched) == len(words):
        # No class has a box that the list touches.
        notices += untouched[:1]
    labelled = _labelled(request, every, tracks, notices)
    if len(labelled):
        classes = {name: in_frames(*files, labelled) for name, files in classes.items()}
        return ScoredClasses(classes, len(labelled), tuple(dict.fromkeys(notices)))
    frames = _last_frame(request, every, tracks, notices)
    return ScoredClasses(classes, frames, tuple(dict.fromkeys(notices)))


def _joined(parts: Iterable[Truth]) -> Truth:
    """The rows and regions of all parts."""
    every = [NO_TRUTH, *parts]
    return Truth(
        np.concatenate([one.frame for one in every]),
        np.concatenate([one.identity for one in every]),
        np.concatenate([one.xyxy for one in every]),
        np.concatenate([one.distractor for one in every]),
        np.concatenate([one.regions for one in every]),
        max(one.least_height for one in every),
    )


def _check(request: ScoringRequest, truth: Truth, tracks: Tracks, notices: list[str]) -> None:
    """Report files that are empty, or would agree better if they were read otherwise. Raises
    `InputError` for boxes that cannot be in pixels.
    """
    _check_boxes(request, truth, tracks)
    if not len(truth):
        notices.append(f"{request.truth}: the truth holds no object")
    if not len(tracks):
        notices.append(f"{request.tracks}: {NO_TRACK}")
    notices += filter(None, [other_reading(truth, tracks)])


def _counted(truth: Truth, tracks: Tracks, ignore: Path, notices: list[str]) -> Truth:
    """The truth with the regions and objects of a list that do not count; reports a list that
    touches no box.

    Parameters
    ----------
    truth, tracks : annotated objects, and the tracks to score.
    ignore : the list.
    notices : receives the sentence.
    """
    no_rows = Truth(truth.frame[:0], truth.identity[:0], truth.xyxy[:0], truth.distractor[:0])
    listed = ignoring(no_rows, ignore)
    places = np.vstack([np.column_stack([listed.frame, listed.xyxy]), listed.regions])
    frame = np.concatenate([truth.frame, tracks.frame])
    xyxy = np.vstack([truth.xyxy, tracks.xyxy])
    if not len(places):
        notices.append(f"{ignore}: the list is empty")
    elif not _touch(places, frame, xyxy):
        notices.append(
            f"{ignore}: none of the {len(places)} rows touches a box of its frame: are they in"
            " pixels, and do their frames count from 1?"
        )
    return ignoring(truth, ignore)


def _touch(places: F8, frame: I8, xyxy: F8) -> bool:
    """True if one of the places (R, 5), frame (0: all) and box, overlaps a box of its frame."""
    order = np.argsort(frame, kind="stable")
    frame = frame[order]
    xyxy = xyxy[order]
    for number in np.unique(places[:, 0]):
        begin, end = (0, len(frame))
        if number:
            begin, end = np.searchsorted(frame, [number, number + 1])
        boxes = places[places[:, 0] == number, 1:]
        if any((intersection(xyxy[begin:end], box[None]) > 0).any() for box in boxes):
            return True
    return False


def _check_boxes(request: ScoringRequest, truth: Truth, tracks: Tracks) -> None:
    """Raise `InputError` if the boxes of a file cannot be in pixels of the frames, whose size may
    be known only as that of the other file's boxes.
    """
    size = request.reading[0].frame_size
    if not min(size):
        info = find_seqinfo(request.truth)
        size = (info.width, info.height) if info else (0, 0)
    sides = (
        (truth.xyxy, tracks.xyxy, request.truth, request.reading[0]),
        (tracks.xyxy, truth.xyxy, request.tracks, request.reading[1]),
    )
    for xyxy, others, path, stated in sides:
        box = stated.box
        extent = size
        if not min(size) and len(others):
            extent = _extent(others)
            # Where a frame ends is not known well enough for other doubts than of shares.
            box = BOXES[0]
        check_units(xyxy, np.ones(len(xyxy)), extent, path, units=stated.units, box=box)


def _extent(xyxy: F8) -> tuple[int, int]:
    """The width and height, pixels, of a frame that holds the boxes (M, 4)."""
    right, bottom = np.clip(xyxy[:, 2:].max(axis=0), 0, LAST_FRAME).tolist()
    return int(right), int(bottom)


def _last_frame(request: ScoringRequest, truth: Truth, tracks: Tracks, notices: list[str]) -> int:
    """The number of frames: the user's, that of seqinfo.ini, or the last with a box. Reports rows
    after the end.

    Parameters
    ----------
    request : the files, and the number that the user gives.
    truth, tracks : annotated objects, and the tracks to score.
    notices : receives the sentence.
    """
    annotated = int(truth.frame.max(initial=0))
    info = find_seqinfo(request.truth)
    known = request.frames or (info.frames if info else 0)
    if not request.frames and 0 < known < annotated:
        notices.append(
            f"{request.truth}: objects up to frame {annotated}, and seqinfo.ini has {known} frames"
        )
    end = request.frames or max(annotated, known)
    after = int((tracks.frame > (end if known else annotated)).sum())
    where = f"{request.tracks}: {after} of {len(tracks)} rows lie after frame"
    if known and after:
        notices.append(f"{where} {end}, the end of the sequence, and do not count")
    elif after and annotated:
        notices.append(
            f"{where} {annotated}, the last with an object, and count as false: --frames"
            f" {annotated} leaves them out"
        )
    if known:
        return end
    return max(annotated, int(tracks.frame.max(initial=0)))


def _labelled(request: ScoringRequest, truth: Truth, tracks: Tracks, notices: list[str]) -> I8:
    """The frames that are scored; empty for all."""
    if request.frames and not request.labelled:
        return np.zeros(0, np.int64)
    return labelled_frames(request.labelled, truth, tracks, request.truth, notices)


def labelled_frames(
    listed: str, truth: Truth, tracks: Tracks | None, path: AnyPath, notices: list[str]
) -> I8:
    """The numbers of the frames that are scored, ascending; empty for all. Raises `InputError` for
    a list that is none.

    Parameters
    ----------
    listed : as `ScoringRequest.labelled`.
    truth, tracks : annotated objects, and the tracks to score; None: the truth alone decides.
    path : of the truth, for sentences.
    notices : receives what was decided by evidence, or is in doubt.
    """
    if listed == ALL:
        return np.zeros(0, np.int64)
    if listed == _OF_TRUTH:
        return np.unique(truth.frame)
    if listed:
        return frame_numbers(listed)
    found = regularly_labelled(truth, tracks)
    if len(found):
        notices.append(
            f"{path}: objects are annotated in one of {found[1] - found[0]} frames, and only these"
            f" {len(found)} frames are scored: --labelled all scores all"
        )
    elif tracks is not None and (sentence := keyframe_doubt(truth, tracks)):
        notices.append(sentence)
    return found


def check_listed(listed: str) -> None:
    """Raise `InputError` for a list of frames that is none, before there are tracks.

    Parameters
    ----------
    listed : as `ScoringRequest.labelled`.
    """
    if listed not in ("", ALL, _OF_TRUTH):
        frame_numbers(listed)


def frame_numbers(text: str) -> I8:
    """Ascending frame numbers from text as ``1,11,21-30``, or from a file of such numbers. Raises
    `InputError` for other text.
    """
    where = "--labelled"
    if not re.fullmatch(r"[\d\s,;-]+", text):
        where = text
        text = load(Path(text)).decode("utf-8", "replace")
    numbers = list[int]()
    for word in re.split(r"[\s,;]+", text.strip()):
        match = re.fullmatch(r"(\d{1,11})(?:-(\d{1,11}))?", word)
        first = int(match[1]) if match else 0
        last = int(match[2] or first) if match else 0
        if not 1 <= first <= last <= LAST_FRAME or len(numbers) + last - first > _MAX_LISTED:
            raise InputError(
                f"expected frame numbers from 1 as 1,11,21-30, got {word[:40]!r}", where=where
            )
        numbers += range(first, last + 1)
    return np.unique(np.array(numbers, np.int64))
