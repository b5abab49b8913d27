"""Segments of a long video: where it is cut, and how their tracks become those of the video.

Neighbours have frames in common, half of them before the border and half behind it: so each has
begun early enough when its rows are taken, and the track of an object that is hidden at the border
goes on in both. Who is who is decided in these frames, and the rows of each frame are taken from
one segment.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phdtrack.arrays import iou
from phdtrack.files import load, read_json
from phdtrack.formats.write import Lines
from phdtrack.metrics.matching import above, assign
from phdtrack.run import directory as rundir
from phdtrack.run.video import finish_document
from phdtrack.types import F8, I8

# Boxes of one object overlap so much, and do so in as large a share of the frames in which two
# tracks are both.
_SAME = 0.5
_SHARE = 0.5
# What of the run of the first segment holds for the video.
_KEPT = ("title", "versions", "seed", "source", "configuration")


class Segment(NamedTuple):
    """The frames ``first`` … ``last`` (0: the end) are tracked, and rows taken from ``begin`` up to
    the next one's.
    """

    first: int
    last: int
    begin: int


def cut(frames: int, length: float, overlap: float) -> list[Segment]:
    """The segments of a video, as even as can be: about ``length`` frames each, and ``overlap``
    that two have in common.
    """
    count = max(1, round(frames / length))
    half = math.ceil(overlap / 2)
    begins = [1 + k * frames // count for k in range(count)]
    ends = [begin - 1 + half for begin in begins[1:]] + [0]
    return [
        Segment(max(1, begin - half), end, begin) for begin, end in zip(begins, ends, strict=True)
    ]


class _Rows(NamedTuple):
    """The rows of a segment's tracks.csv: their frames (M,), identities (M,), classes, boxes (M,
    4), and all as text.
    """

    frame: I8
    identity: I8
    label: list[str]
    xyxy: F8
    text: list[list[str]]

    @classmethod
    def read(cls, path: Path | None) -> _Rows:
        """The rows of a file, which has no header; none without one."""
        if path:
            text = [line.split(",") for line in load(path).decode().splitlines()]
        else:
            text = []
        numbers = np.array([row[:6] for row in text], np.float64).reshape(-1, 6)
        frame = numbers[:, 0].astype(np.int64)
        identity = numbers[:, 1].astype(np.int64)
        ltwh = numbers[:, 2:]
        return cls(
            frame,
            identity,
            [",".join(row[12:]) for row in text],
            ltwh + np.pad(ltwh[:, :2], ((0, 0), (2, 0))),
            text,
        )


def same(before: _Rows, after: _Rows, since: int, begin: int) -> dict[int, int]:
    """Which identity of the segment ``before`` an identity ``after`` is.

    They are compared in the frames that both segments have, and matched one to one so that the
    overlaps of the boxes of pairs have the largest sum. Only those count of which rows are taken:
    before the border from frame ``since`` on, and from ``begin`` on after it.
    """
    taken = (before.frame >= since) & (before.frame < begin), after.frame >= begin
    ids = [
        np.unique(rows.identity[mask]) for rows, mask in zip((before, after), taken, strict=True)
    ]
    total, often, both = np.zeros((3, len(ids[0]), len(ids[1])))
    for number in np.intersect1d(before.frame, after.frame).tolist():
        places = list[I8]()
        boxes = list[F8]()
        for rows, known in zip((before, after), ids, strict=True):
            here = np.flatnonzero((rows.frame == number) & np.isin(rows.identity, known))
            places.append(np.searchsorted(known, rows.identity[here]))
            boxes.append(rows.xyxy[here])
        overlap = above(iou(*boxes), _SAME)
        place = np.ix_(*places)
        total[place] += overlap
        often[place] += overlap > 0
        both[place] += 1
    kinds = [dict(zip(rows.identity.tolist(), rows.label, strict=True)) for rows in (before, after)]
    labels = [
        np.array([kind[one] for one in known.tolist()], np.str_)
        for kind, known in zip(kinds, ids, strict=True)
    ]
    possible = (often >= _SHARE * both) & (labels[0][:, None] == labels[1])
    a, b = assign(np.where(possible, total, 0.0))
    return dict(zip(ids[1][b].tolist(), ids[0][a].tolist(), strict=True))


def join(parts: Sequence[tuple[Segment, Path]], directory: rundir.RunDirectory) -> dict[str, Any]:
    """Write tracks.csv, states.csv, detections.csv and run.json of a video from those of its
    segments, and return the last.

    Identities are numbered in the order in which they appear. Raises `InputError` where a file
    cannot be read or written.
    """
    runs = [read_json(run := folder / rundir.RUN, load(run)) for _, folder in parts]
    before = _Rows.read(None)
    names = dict[int, int]()
    since = 1
    rows = 0
    used = 0
    begun = set[str]()
    with ExitStack() as files:
        names_of = (rundir.TRACKS, rundir.STATES, rundir.DETECTIONS)
        written = {name: files.enter_context(Lines(directory.file(name))) for name in names_of}
        for (part, folder), end in zip(
            parts, [part.begin for part, _ in parts[1:]] + [math.inf], strict=True
        ):
            after = _Rows.read(folder / rundir.TRACKS)
            names = {b: names[a] for b, a in same(before, after, since, part.begin).items()}
            mine = np.flatnonzero((after.frame >= part.begin) & (after.frame < end))
            for one in after.identity[mine].tolist():
                used += one not in names
                names.setdefault(one, used)
            found = sorted(
                (int(after.frame[row]), names[int(after.identity[row])], row)
                for row in mine.tolist()
            )
            lines = [",".join([str(k), str(name), *after.text[row][2:]]) for k, name, row in found]
            written[rundir.TRACKS].write("%s", np.array(lines, np.str_))
            for name in names_of[1:]:
                lines = list(_within(folder / name, part.begin, end, header=name not in begun))
                written[name].write("%s", np.array(lines, np.str_))
                begun |= {name} if lines else set()
            before = after
            since = part.begin
            rows = rows + len(mine)
    last = max(
        part.first - 1 + run["frames"] if run["frames"] else 0
        for (part, _), run in zip(parts, runs, strict=True)
    )
    document = {name: runs[0][name] for name in _KEPT}
    document |= {"complete": True, "frames": last, "tracks": used, "track_rows": rows}
    document["input"] = {
        name: value for name, value in runs[0]["input"].items() if name != "frames"
    }
    document["seconds"] = sum(run["seconds"] for run in runs)
    document["warnings"] = list(
        dict.fromkeys(warning for run in runs for warning in run["warnings"])
    )
    document["segments"] = [{**part._asdict(), "directory": str(folder)} for part, folder in parts]
    return finish_document(document, directory)


def _within(path: Path, begin: int, end: float, *, header: bool) -> Iterator[str]:
    """The lines of a file of which the frame is one of these, and where it is wanted the header."""
    for line in load(path).decode().splitlines():
        number = line.partition(",")[0]
        if (begin <= int(number) < end) if number.isdecimal() else header:
            yield line
