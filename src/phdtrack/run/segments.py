"""Segments of a long video: where it is cut, and how their tracks become those of the video.

Neighbours overlap, half of it before the border and half after: so each has begun early enough when
its rows are used, and the track of an object that is hidden at the border continues in both.
Identities are matched in the overlap, and the rows of each frame are those of one segment.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.arrays import iou
from phdtrack.clock import Clock
from phdtrack.files import load, read_json
from phdtrack.formats.embeddings import EmbeddingsWriter, open_embeddings
from phdtrack.formats.write import Lines
from phdtrack.metrics.matching import above, assign
from phdtrack.report.doubtful_tracks import DoubtfulTracks
from phdtrack.run import directory as rundir
from phdtrack.run.run_report import finish_document
from phdtrack.types import F8, I8

# Boxes of one object have at least this IoU, in at least this share of the frames that two tracks
# have in common.
_SAME = 0.5
_SHARE = 0.5
# Rounding of times must not move a border by a frame.
_ROUNDING = 1e-6
_EACH_A_SECOND = Clock.constant(1.0)
# Parts of the first segment's run.json that hold for the video.
_KEPT = ("title", "versions", "seed", "source", "configuration")

# Lists of run.json with an entry for each identity that was given back or exchanged.
_IDENTITY_LISTS = ("identities_given_back", "identities_exchanged")
# Means in the appearance of run.json, and the numbers of what they are of.
_WEIGHTED_BY = {
    "seconds_apart": "pairs_of_one_object",
    "told_apart": "pairs_of_two_objects",
    "nats_of_taken_detections": "taken_detections",
    "nats_of_refused_neighbours": "refused_neighbours",
    "weight": "pairs_of_one_object",
}


class Segment(NamedTuple):
    """A part of a video: the frames ``first`` … ``last`` (0: the end) are tracked, and their rows
    are used from ``begin`` up to that of the next segment.
    """

    first: int
    last: int
    begin: int


def cut(frames: int, length: float, overlap: float, clock: Clock = _EACH_A_SECOND) -> list[Segment]:
    """The segments of a video, of equal duration as far as possible.

    Parameters
    ----------
    frames : of the video.
    length, overlap : about how many seconds a segment has, and two have in common.
    clock : the times of the frames; without it, a frame is a second.
    """
    seconds = clock.passed(range(1, frames + 1))
    count = max(1, round(seconds / length))
    zero = clock.time(1)
    numbers = [clock.number_at(zero + k * seconds / count) for k in range(count)]
    begins = [math.floor(number + _ROUNDING) for number in numbers]
    starts = [clock.number_at(clock.time(begin) - overlap / 2) for begin in begins]
    stops = [clock.number_at(clock.time(begin) + overlap / 2) for begin in begins[1:]]
    ends = [math.ceil(stop - _ROUNDING) - 1 for stop in stops] + [0]
    return [
        Segment(max(1, math.floor(start + _ROUNDING)), end, begin)
        for start, end, begin in zip(starts, ends, begins, strict=True)
    ]


class _Rows(NamedTuple):
    """The rows of a segment's tracks.csv: frames (M,), identities (M,), classes, boxes (M, 4), and
    all as text.
    """

    frame: I8
    identity: I8
    label: list[str]
    xyxy: F8
    text: list[list[str]]

    @classmethod
    def read(cls, path: Path | None) -> _Rows:
        """The rows of a file, which has no header; none without a file."""
        text = list[list[str]]()
        if path:
            text = [line.split(",") for line in load(path).decode().splitlines()]
        numbers = np.array([row[:6] for row in text], np.float64).reshape(-1, 6)
        ltwh = numbers[:, 2:]
        return cls(
            numbers[:, 0].astype(np.int64),
            numbers[:, 1].astype(np.int64),
            [",".join(row[12:]) for row in text],
            ltwh + np.pad(ltwh[:, :2], ((0, 0), (2, 0))),
            text,
        )

    def labels(self, identities: I8) -> NDArray[np.str_]:
        """The class of each identity."""
        known = dict(zip(self.identity.tolist(), self.label, strict=True))
        return np.array([known[one] for one in identities.tolist()], np.str_)


def same(before: _Rows, after: _Rows, since: int, begin: int) -> dict[int, int]:
    """By identity of the segment ``after`` that of the segment ``before``.

    They are compared in the frames that both segments have, and matched one to one so that the sum
    of the overlaps of their boxes is largest.

    Parameters
    ----------
    before, after : rows of both segments.
    since, begin : only rows that are used count: of ``before`` those from frame ``since`` up to the
        border, of ``after`` those from the border ``begin`` on.
    """
    used_before = (before.frame >= since) & (before.frame < begin)
    old = np.unique(before.identity[used_before])
    new = np.unique(after.identity[after.frame >= begin])
    total, often, both = np.zeros((3, len(old), len(new)))
    for number in np.intersect1d(before.frame, after.frame).tolist():
        rows_old = np.flatnonzero((before.frame == number) & np.isin(before.identity, old))
        rows_new = np.flatnonzero((after.frame == number) & np.isin(after.identity, new))
        overlap = above(iou(before.xyxy[rows_old], after.xyxy[rows_new]), _SAME)
        pairs = np.ix_(
            np.searchsorted(old, before.identity[rows_old]),
            np.searchsorted(new, after.identity[rows_new]),
        )
        total[pairs] += overlap
        often[pairs] += overlap > 0
        both[pairs] += 1
    same_class = before.labels(old)[:, None] == after.labels(new)
    possible = (often >= _SHARE * both) & same_class
    a, b = assign(np.where(possible, total, 0.0))
    return dict(zip(new[b].tolist(), old[a].tolist(), strict=True))


def join(parts: Sequence[tuple[Segment, Path]], directory: rundir.RunDirectory) -> dict[str, Any]:
    """Write tracks.csv, states.csv, detections.csv, detections.npy if they have one, and run.json
    of a video from those of its segments, and return the last.

    Identities are numbered in the order in which they appear. Raises `InputError` if a file cannot
    be read or written.
    """
    runs = [read_json(run := folder / rundir.RUN, load(run)) for _, folder in parts]
    before = _Rows.read(None)
    identities = dict[int, int]()
    since = 1
    rows = 0
    used = 0
    begun = set[str]()
    ends = [part.begin for part, _ in parts[1:]] + [math.inf]
    names = (rundir.TRACKS, rundir.STATES, rundir.DETECTIONS)
    with ExitStack() as files:
        written = {name: files.enter_context(Lines(directory.file(name))) for name in names}
        for (part, folder), end in zip(parts, ends, strict=True):
            after = _Rows.read(folder / rundir.TRACKS)
            matches = same(before, after, since, part.begin)
            identities = {new: identities[old] for new, old in matches.items()}
            own = np.flatnonzero((after.frame >= part.begin) & (after.frame < end)).tolist()
            for one in after.identity[own].tolist():
                used += one not in identities
                identities.setdefault(one, used)
            lines = _renamed(after, own, identities)
            written[rundir.TRACKS].write("%s", np.array(lines, np.str_))
            for name in names[1:]:
                lines = list(_within(folder / name, part.begin, end, header=name not in begun))
                written[name].write("%s", np.array(lines, np.str_))
                if lines:
                    begun.add(name)
            before = after
            since = part.begin
            rows += len(own)
    _join_embeddings(parts, ends, directory)
    document = _document(parts, runs) | {"tracks": used, "track_rows": rows}
    document |= _appearance([run.get("appearance") for run in runs])
    for name in _IDENTITY_LISTS:
        if "appearance" in document:
            document[name] = _numbered(parts, ends, [run.get(name, []) for run in runs])
    return finish_document(document, directory)


def _join_embeddings(
    parts: Sequence[tuple[Segment, Path]], ends: Sequence[float], directory: rundir.RunDirectory
) -> None:
    """Write detections.npy of a video from those of its segments, up to ``ends``; nothing if a
    segment has none.
    """
    if not all((folder / rundir.EMBEDDINGS).exists() for _, folder in parts):
        return
    writer: EmbeddingsWriter | None = None
    with ExitStack() as files:
        for (part, folder), end in zip(parts, ends, strict=True):
            file = folder / rundir.DETECTIONS
            frames = [int(line.partition(",")[0]) for line in load(file).decode().splitlines()]
            frame = np.array(frames, np.int64)
            rows = np.flatnonzero((frame >= part.begin) & (frame < end))
            kept = open_embeddings(folder / rundir.EMBEDDINGS, len(frame), file)
            if writer is None:
                joined = EmbeddingsWriter(directory.file(rundir.EMBEDDINGS), kept.dtype)
                writer = files.enter_context(joined)
            writer.append(np.asarray(kept[rows], np.float32), len(rows))


def _renamed(rows: _Rows, own: Sequence[int], identities: Mapping[int, int]) -> list[str]:
    """Lines of tracks.csv with other identities, by frame and identity."""
    order = sorted((int(rows.frame[row]), identities[int(rows.identity[row])], row) for row in own)
    return [",".join([str(frame), str(one), *rows.text[row][2:]]) for frame, one, row in order]


def _document(
    parts: Sequence[tuple[Segment, Path]], runs: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """The run.json of the video except its tracks."""
    last = max(
        part.first - 1 + run["frames"] if run["frames"] else 0
        for (part, _), run in zip(parts, runs, strict=True)
    )
    warnings = [warning for run in runs for warning in run["warnings"]]
    return {
        **{name: runs[0][name] for name in _KEPT},
        "complete": True,
        "frames": last,
        "input": {name: value for name, value in runs[0]["input"].items() if name != "frames"},
        "seconds": sum(run["seconds"] for run in runs),
        "warnings": list(dict.fromkeys(warnings)),
        "doubtful_boxes": _doubtful([run.get("doubtful_boxes") for run in runs]),
        "segments": [{**part._asdict(), "directory": str(folder)} for part, folder in parts],
    }


def _appearance(parts: Sequence[Any]) -> dict[str, Any]:
    """The worth of appearance in all segments that have it, each number weighted by what it is the
    mean of; nothing if none has it.
    """
    known = [part for part in parts if part is not None]
    if not known:
        return {}
    pooled = {
        name: sum(part[name] for part in known)
        for name in known[0]
        if name in _WEIGHTED_BY.values()
    }
    for name, count in _WEIGHTED_BY.items():
        those = [part for part in known if part[name] is not None and part[count]]
        total = sum(part[count] for part in those)
        mean = sum(part[count] * part[name] for part in those) / total if total else None
        pooled[name] = mean
    return {"appearance": {name: pooled.get(name, value) for name, value in known[0].items()}}


def _numbered(
    parts: Sequence[tuple[Segment, Path]], ends: Sequence[float], lists: Sequence[Any]
) -> list[dict[str, Any]]:
    """The entries of lists of all segments whose ``frame`` is of the segment, with its number from
    1: an identity is that of its own online rows.
    """
    return [
        {**each, "segment": number}
        for number, ((part, _), end, entries) in enumerate(zip(parts, ends, lists, strict=True), 1)
        for each in entries
        if part.begin <= each["frame"] < end
    ]


def _doubtful(parts: Sequence[Any]) -> Any:
    """The doubtful boxes of all segments, each weighted by its boxes; None if one is not judged."""
    if None in parts:
        return None
    judged = [DoubtfulTracks(**part) for part in parts]
    return DoubtfulTracks.pooled(judged)


def _within(path: Path, begin: int, end: float, *, header: bool) -> Iterator[str]:
    """The lines of a file of the frames ``begin`` … ``end`` − 1, and if wanted its header."""
    for line in load(path).decode().splitlines():
        number = line.partition(",")[0]
        wanted = begin <= int(number) < end if number.isdecimal() else header
        if wanted:
            yield line
