"""Writing tracks, detections, states and truth as text.

A writer is open while a sequence runs and hands every frame to the operating system at once: what
was computed is not lost when the program ends before its time. The functions `write_tracks`,
`write_detections` and `write_truth` write a whole sequence. All but the states are MOTChallenge
files without a header, which every tool of the field reads:

* tracks: ``frame,id,left,top,width,height,confidence,x,y,z,detection,confirmed``; x and y metres on
  the ground and z 0, or all three −1 where the place is not known; a 13th column has the class
  where there are classes;
* detections: ``frame,-1,left,top,width,height,confidence,-1,-1,-1,class`` and the 10 values of the
  covariance where there is one (see `phdtrack.formats.table`);
* truth: ``frame,id,left,top,width,height,flag,class,visibility``, distractors with flag 0 and class
  8, as in MOT16.

`export_tracks` writes tracks as other tools have them: MOTChallenge's ten columns, KITTI's
eighteen, CSV with a header, Parquet, JSON lines, COCO, CVAT. `read_tracks` reads all of these. A
Rerun recording is for its viewer only.

States have a header: ``frame,time,weight,detection,left,top,width,height,s0,s1,…``. Frames count
from 1, times are seconds, boxes pixels of the video, state components as the model has them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Self
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from phdtrack.errors import InputError, did_you_mean, needed
from phdtrack.files import AnyPath, cannot_write, part_of, publish, whole, write_text
from phdtrack.types import (
    F8,
    I8,
    Bool,
    Detections,
    DetectionTable,
    SequenceInfo,
    Step,
    Tracks,
    Truth,
)

# Seven digits: a thousandth of a pixel in the largest pictures, and boxes in other units do not
# collapse.
_BOX = "%.7g,%.7g,%.7g,%.7g"
_TRACK = f"%d,%d,{_BOX},%.7g,%.7g,%.7g,%d,%d,%d"
# Detections go into filters again: what a detector gives as 32-bit floats comes back as the same
# floats.
_DETECTION = "%d,-1,%.10g,%.10g,%.10g,%.10g,%.10g,-1,-1,-1,%s"
_TRUTH = f"%d,%d,{_BOX},%d,%d,1"
_PEDESTRIAN = 1
_DISTRACTOR = 8


class Lines:
    """A text file that is written line by line, and has its name when it is closed; until then it
    ends in ``.part``.

    ``close`` may be called twice. A file that could not be written to its end is cut after the last
    whole block and keeps the name with ``.part``; so it does where a ``with`` block is left by an
    error. `InputError` where it cannot be written.
    """

    def __init__(self, path: AnyPath) -> None:
        self.path = Path(path)
        self._whole = True
        self._end = 0
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = part_of(self.path).open("wb", buffering=0)
        except OSError as error:
            raise cannot_write(self.path, error) from None

    def write(self, pattern: str, *columns: F8 | I8 | Bool | NDArray[np.str_]) -> None:
        """One line for each row of the columns, which may be (M,) or (M, k); all of them reach the
        operating system.
        """
        width = pattern.count("%")
        values = [
            column.tolist()
            for block in columns
            for column in (block.T if block.ndim == 2 else block[None])
        ]
        if width:
            text = "".join([pattern % row + "\n" for row in zip(*values, strict=True)])
        else:
            text = f"{pattern}\n"
        if not text or not self._whole:
            return
        data = memoryview(text.encode("utf-8"))
        try:
            written = 0
            while written < len(data):
                written += self._file.write(data[written:])
            self._end += written
        except OSError as error:
            self._whole = False
            with suppress(OSError):
                self._file.truncate(self._end)
            raise cannot_write(self.path, error) from None

    def close(self) -> None:
        """Close the file and give it its name; nothing is left to write."""
        if self._file.closed:
            return
        self._file.close()
        if self._whole:
            try:
                publish(self.path)
            except OSError as error:
                raise cannot_write(self.path, error) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._whole = self._whole and kind is None
        self.close()


class _Classed(Lines):
    """A file with classes by name; numbers stand for classes without one."""

    def __init__(self, path: AnyPath, names: Mapping[int, str] | None = None) -> None:
        super().__init__(path)
        self._names = names

    def labels(self, class_id: I8) -> NDArray[np.str_]:
        """(N,) what the file calls the classes."""
        known = self._names or {}
        words = {
            one: re.sub(r'[^\S ]|[,;"]', "_", known.get(one, str(one)))
            for one in np.unique(class_id).tolist()
        }
        return np.array([words[one] for one in class_id.tolist()], np.str_)


class TracksWriter(_Classed):
    """``tracks.csv``, frame by frame; with classes where their ``names`` are given, which may be
    empty.
    """

    def append(self, tracks: Tracks, place: F8 | None = None) -> None:
        """Write the rows as they come, of one frame or many; ``place`` (2, M) on the ground, NaN
        where not known.
        """
        if place is None:
            place = np.full((2, len(tracks)), np.nan)
        else:
            place = place
        known = np.isfinite(place).all(axis=0)
        if self._names is None:
            classes = []
        else:
            classes = [self.labels(tracks.class_id)]
        self.write(
            _TRACK + ",%s" * len(classes),
            tracks.frame,
            tracks.identity,
            _ltwh(tracks.xyxy),
            tracks.confidence,
            np.where(known, place, -1.0).T,
            np.where(known, 0, -1),
            tracks.detection,
            tracks.confirmed,
            *classes,
        )


class DetectionsWriter(_Classed):
    """``detections.csv``, frame by frame. A frame that was not observed leaves no trace, as an
    empty one.
    """

    def append(self, frame: int | I8, detections: Detections) -> None:
        """Write the detections of frame ``frame``, from 1, or of many frames (N,). All have
        covariances, or none has.
        """
        number = np.broadcast_to(frame, len(detections))
        label = self.labels(detections.class_id)
        columns: list[F8 | I8 | NDArray[np.str_]] = [
            number,
            _ltwh(detections.xyxy),
            detections.confidence,
            label,
        ]
        if detections.covariance is None:
            self.write(_DETECTION, *columns)
        else:
            i, j = np.triu_indices(4)
            self.write(_DETECTION + ",%.10g" * 10, *columns, detections.covariance[:, i, j])


class StatesWriter(Lines):
    """``states.csv``, frame by frame: what was extracted before it had identities. The header comes
    with the first frame.
    """

    _header = ""

    def append(self, step: Step) -> None:
        """Write the states of a frame."""
        dim, n = step.estimates.state.shape
        estimates = step.estimates
        if not self._header:
            self._header = ",".join(
                [
                    "frame,time,weight,detection,left,top,width,height",
                    *(f"s{i}" for i in range(dim)),
                ]
            )
            self.write(self._header)
        self.write(
            f"%d,%.6f,%.7g,%d,{_BOX}" + ",%.9g" * dim,
            np.full(n, step.number),
            np.full(n, step.time),
            estimates.weight,
            estimates.detection,
            _ltwh(estimates.xyxy),
            estimates.state.T,
        )


def write_tracks(path: AnyPath, tracks: Tracks, names: Mapping[int, str] | None = None) -> None:
    """Write the tracks of a sequence, with classes where there are names or any is not 0; an
    existing file is replaced.

    Raises `InputError` where it cannot be written.

    Parameters
    ----------
    path, tracks : the file, and what is written.
    names : of the classes.
    """
    with TracksWriter(path, names or ({} if tracks.class_id.any() else None)) as writer:
        writer.append(tracks)


def write_detections(path: AnyPath, table: DetectionTable) -> None:
    """Write the detections of a sequence; an existing file is replaced. `InputError` where it
    cannot be written.
    """
    with DetectionsWriter(path, table.names) as writer:
        writer.append(table.frame, table.detections)


def write_truth(path: AnyPath, truth: Truth) -> None:
    """Write truth as MOT16 has it: scored rows as pedestrians with flag 1, distractors with flag 0.

    Raises `InputError` where there are regions or a least height, for which the format has no
    place.
    """
    if len(truth.regions) or truth.least_height:
        raise InputError(
            "MOTChallenge truth has no regions to ignore and no least height", where=Path(path)
        )
    label = np.where(truth.distractor, _DISTRACTOR, _PEDESTRIAN)
    with Lines(path) as file:
        file.write(_TRUTH, truth.frame, truth.identity, _ltwh(truth.xyxy), ~truth.distractor, label)


EXPORTS = {
    "motchallenge": ".txt",
    "csv": ".csv",
    "parquet": ".parquet",
    "jsonl": ".jsonl",
    "coco": ".json",
    "cvat": ".xml",
    "kitti": ".txt",
    "rerun": ".rrd",
}
"""The formats of `export_tracks`, and what names of such files end in."""
# Seconds of a track that its trail in a Rerun recording shows.
_TRAIL = 2.0


def export_tracks(
    path: AnyPath,
    tracks: Tracks,
    kind: str,
    names: Mapping[int, str] | None = None,
    info: SequenceInfo | None = None,
) -> None:
    """Write tracks in a format of other tools; an existing file is replaced.

    Frames count from 0 in KITTI and CVAT, from 1 elsewhere. MOTChallenge has no classes, CVAT no
    confidence; which detection a row used, and whether it is confirmed, are in CSV, Parquet, JSON
    lines and COCO. Raises `InputError` where it cannot be written, there is no such format, or
    pyarrow or rerun-sdk is missing for its format.

    Parameters
    ----------
    path, tracks : the file, and what is written, sorted by frame.
    kind : one of `EXPORTS`.
    names : of the classes.
    info : of the sequence, for COCO, CVAT and Rerun.
    """
    path = Path(path)
    info = info or SequenceInfo(0, 0, 0.0)
    if info.frames:
        info = replace(info, frames=max(info.frames, int(tracks.frame.max(initial=0))))
    else:
        info = info
    classes = np.unique(tracks.class_id).tolist()
    words = {
        k: re.sub(r'[^\S ]|[,;"]', "_", (names or {}).get(k, f"class_{k}" if k else "object"))
        for k in classes
    }
    boxes = [
        [float(f"{value:.7g}") for value in column] for column in _ltwh(tracks.xyxy).T.tolist()
    ]
    columns: dict[str, list[Any]] = {
        "frame": tracks.frame.tolist(),
        "identity": tracks.identity.tolist(),
    }
    columns |= dict(zip(("left", "top", "width", "height"), boxes, strict=True))
    columns["confidence"] = [float(f"{value:.7g}") for value in tracks.confidence.tolist()]
    columns |= {
        "detection": tracks.detection.tolist(),
        "confirmed": tracks.confirmed.astype(int).tolist(),
    }
    columns["class"] = (
        [words[k] for k in tracks.class_id.tolist()] if names else tracks.class_id.tolist()
    )
    rows = list(zip(*columns.values(), strict=True))
    match kind:
        case "motchallenge":
            lines = [",".join(map(str, (*row[:7], -1, -1, -1))) for row in rows]
        case "csv":
            lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
        case "jsonl":
            lines = [
                json.dumps(dict(zip(columns, row, strict=True)), ensure_ascii=False) for row in rows
            ]
        case "coco":
            lines = [json.dumps(_coco(columns, tracks, words, info), ensure_ascii=False)]
        case "cvat":
            lines = _cvat(tracks, words, info)
        case "kitti":
            types = [words[k].replace(" ", "_") for k in tracks.class_id.tolist()]
            corners = [" ".join(f"{value:.7g}" for value in box) for box in tracks.xyxy.tolist()]
            lines = [
                f"{row[0] - 1} {row[1]} {name} -1 -1 -10 {box} -1 -1 -1 -1000 -1000 -1000 -10"
                f" {row[6]}"
                for row, name, box in zip(rows, types, corners, strict=True)
            ]
        case "parquet":
            arrow, parquet = (needed(name) for name in ("pyarrow", "pyarrow.parquet"))
            with whole(path) as part:
                parquet.write_table(arrow.table(columns), part, compression="zstd")
            return
        case "rerun":
            _rerun(path, tracks, words, info)
            return
        case _:
            raise InputError(
                f"there is no format {kind!r}", where="--to", cure=did_you_mean(kind, EXPORTS)
            )
    write_text(path, "".join(f"{line}\n" for line in lines))


def _coco(
    columns: Mapping[str, list[Any]], tracks: Tracks, words: Mapping[int, str], info: SequenceInfo
) -> dict[str, Any]:
    """A COCO data set: an image for each frame of the sequence, an annotation for each row."""
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    if info.frames:
        frames = range(1, info.frames + 1)
    else:
        frames = np.unique(tracks.frame).tolist()
    if info.width:
        size = {"width": info.width, "height": info.height}
    else:
        size = {}
    return {
        "images": [
            {"id": number, "file_name": f"{number:06d}.jpg", "frame_id": number, **size}
            for number in frames
        ],
        "annotations": [
            {
                "id": k,
                "image_id": row["frame"],
                "track_id": row["identity"],
                "category_id": label,
                "bbox": [row["left"], row["top"], row["width"], row["height"]],
                "area": row["width"] * row["height"],
                "iscrowd": 0,
                "score": row["confidence"],
                "detection": row["detection"],
                "confirmed": row["confirmed"],
            }
            for k, (row, label) in enumerate(
                zip(rows, tracks.class_id.tolist(), strict=True), start=1
            )
        ],
        "categories": [{"id": number, "name": name} for number, name in words.items()],
    }


def _cvat(tracks: Tracks, words: Mapping[int, str], info: SequenceInfo) -> list[str]:
    """The lines of a CVAT document ("for video 1.1"): a track for each identity and class; a box
    outside at its end.
    """
    labels = "".join(f"<label><name>{escape(word)}</name></label>" for word in words.values())
    if info.width:
        size = f"<original_size><width>{info.width}</width><height>{info.height}</height></original_size>"
    else:
        size = ""
    task = f"<task><size>{info.frames}</size><mode>interpolation</mode><labels>{labels}</labels>{size}</task>"
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        "<annotations>",
        f"<version>1.1</version><meta>{task}</meta>",
    ]
    corners = " ".join(f'{name}="{{:.7g}}"' for name in ("xtl", "ytl", "xbr", "ybr"))
    box = f'<box frame="{{}}" keyframe="1" outside="{{}}" occluded="0" {corners} z_order="0"/>'
    for identity, label in sorted(
        set(zip(tracks.identity.tolist(), tracks.class_id.tolist(), strict=True))
    ):
        mine = tracks.select((tracks.identity == identity) & (tracks.class_id == label))
        lines.append(f'<track id="{identity}" label={quoteattr(words[label])} source="auto">')
        numbers = mine.frame.tolist()
        for number, after, place in zip(
            numbers, [*numbers[1:], 0], mine.xyxy.tolist(), strict=True
        ):
            lines.append(box.format(number - 1, 0, *place))
            if after != number + 1 and number != info.frames:
                lines.append(box.format(number, 1, *place))
        lines.append("</track>")
    return [*lines, "</annotations>"]


def _rerun(path: Path, tracks: Tracks, words: Mapping[int, str], info: SequenceInfo) -> None:
    """Write a recording: of each identity the box, called by it and its class, and the way of its
    foot point in the last two seconds. There are the timelines ``frame``, and where the rate is
    known ``time``, seconds since the first frame."""
    rr = needed("rerun")
    fps = info.fps or 25.0
    with whole(path) as part:
        recording = rr.RecordingStream("phdtrack")
        try:
            recording.save(part)
        except (OSError, RuntimeError) as error:
            raise InputError(f"the file cannot be written ({error})", where=path) from None

        def send(entity: str, number: I8, columns: Any) -> None:
            index = [rr.TimeColumn("frame", sequence=number)]
            index += [rr.TimeColumn("time", duration=(number - 1) / fps)] if info.fps else []
            rr.send_columns(entity, index, columns, recording=recording)

        for identity in np.unique(tracks.identity).tolist():
            mine = tracks.select(tracks.identity == identity)
            number = mine.frame
            box = mine.xyxy
            entity = f"tracks/{identity}"
            foot = np.stack([box[:, [0, 2]].mean(axis=1), box[:, 3]], axis=1)
            begin = np.searchsorted(number, number - round(_TRAIL * fps))
            trail = [foot[first : last + 1] for last, first in enumerate(begin.tolist())]
            label = [f"{identity} {words[k]}" for k in mine.class_id.tolist()]
            color = np.full(len(mine), identity % 65536)
            size = {
                "half_sizes": (box[:, 2:] - box[:, :2]) / 2,
                "centers": (box[:, :2] + box[:, 2:]) / 2,
            }
            send(entity, number, rr.Boxes2D.columns(**size, labels=label, class_ids=color))
            send(f"{entity}/trail", number, rr.LineStrips2D.columns(strips=trail, class_ids=color))
            # Nothing is shown where it is not seen.
            ended = number[np.diff(number, append=number[-1:] + 2) > 1] + 1
            for each in (entity, f"{entity}/trail"):
                send(each, ended, rr.Clear.columns(is_recursive=np.zeros(len(ended), np.bool_)))
        recording.disconnect()


def _ltwh(xyxy: F8) -> F8:
    """(M, 4) left, top, width, height of the boxes."""
    return np.hstack([xyxy[:, :2], xyxy[:, 2:] - xyxy[:, :2]])
