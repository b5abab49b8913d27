"""Export of tracks to the formats of other tools.

MOTChallenge's ten columns, KITTI's eighteen, CSV with a header, Parquet, JSON lines, COCO and CVAT.
`read_tracks` reads all of these again.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from phdtrack.errors import InputError, did_you_mean, needed
from phdtrack.files import AnyPath, whole, write_text
from phdtrack.formats.class_words import word_of_class
from phdtrack.formats.write import ltwh
from phdtrack.types import F8, SequenceInfo, Tracks

EXPORTS = {
    "motchallenge": ".txt",
    "csv": ".csv",
    "parquet": ".parquet",
    "jsonl": ".jsonl",
    "coco": ".json",
    "cvat": ".xml",
    "kitti": ".txt",
}
"""The formats of `export_tracks`, and the usual suffixes of their files."""

# The first format of a suffix is the one that it stands for: KITTI's has to be named.
_BY_SUFFIX = {suffix: kind for kind, suffix in reversed(EXPORTS.items())}


def export_tracks(
    path: AnyPath,
    tracks: Tracks,
    kind: str = "",
    names: Mapping[int, str] | None = None,
    info: SequenceInfo | None = None,
) -> None:
    """Write tracks in a format of other tools; replaces an existing file. `read_tracks` reads it.

    Frames count from 0 in KITTI and CVAT, from 1 elsewhere. Numbers have seven significant digits.
    MOTChallenge has no classes, CVAT no confidence. CSV, Parquet, JSON lines and COCO have the
    detection that each row used, and whether the row is confirmed.

    Parameters
    ----------
    path : the file.
    tracks : the rows to write, sorted by frame.
    kind : one of `EXPORTS`; empty: the one of the file's suffix, of ``.txt`` MOTChallenge.
    names : the names of the classes by number.
    info : the sequence, for COCO and CVAT.

    Raises
    ------
    InputError : an unknown format or suffix, a file that cannot be written, or no pyarrow, which
        Parquet needs.
    """
    path = Path(path)
    kind = kind or _kind_of(path)
    info = info or SequenceInfo(0, 0, 0.0)
    if info.frames:
        info = replace(info, frames=max(info.frames, int(tracks.frame.max(initial=0))))
    words = {
        k: re.sub(r'[^\S ]|[,;"]', "_", (names or {}).get(k, word_of_class(k)))
        for k in np.unique(tracks.class_id).tolist()
    }
    columns = _columns(tracks, words if names else {})
    rows = list(zip(*columns.values(), strict=True))
    match kind:
        case "motchallenge":
            lines = [",".join(map(str, (*row[:7], -1, -1, -1))) for row in rows]
        case "csv":
            lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
        case "jsonl":
            objects = [dict(zip(columns, row, strict=True)) for row in rows]
            lines = [json.dumps(values, ensure_ascii=False) for values in objects]
        case "coco":
            lines = [json.dumps(_coco(columns, tracks, words, info), ensure_ascii=False)]
        case "cvat":
            lines = _cvat(tracks, words, info)
        case "kitti":
            lines = _kitti(columns, tracks, words)
        case "parquet":
            arrow = needed("pyarrow")
            parquet = needed("pyarrow.parquet")
            # Arrow opens files of names in UTF-8 only.
            with whole(path) as part, part.open("wb") as content:
                parquet.write_table(arrow.table(columns), content, compression="zstd")
            return
        case _:
            raise InputError(
                f"there is no format {kind!r}", where=path, cure=did_you_mean(kind, EXPORTS)
            )
    write_text(path, "".join(f"{line}\n" for line in lines))


def _kind_of(path: Path) -> str:
    """The format that a suffix stands for. Raises `InputError` if it stands for none."""
    suffix = path.suffix.lower()
    if suffix not in _BY_SUFFIX:
        known = ", ".join(f"{one} ({kind})" for one, kind in sorted(_BY_SUFFIX.items()))
        raise InputError(
            f"expected a suffix that stands for a format, got {suffix or 'none'}",
            where=path,
            cure=f"Use {known}, or name the format: kind={next(iter(EXPORTS))!r}.",
        )
    return _BY_SUFFIX[suffix]


def _columns(tracks: Tracks, words: Mapping[int, str]) -> dict[str, list[Any]]:
    """The columns of CSV, by name; numbers that are not whole have seven significant digits. The
    class is a word if there are ``words``.
    """
    left, top, width, height = (_seven_digits(column) for column in ltwh(tracks.xyxy).T)
    label = tracks.class_id.tolist()
    return {
        "frame": tracks.frame.tolist(),
        "identity": tracks.identity.tolist(),
        "left": left,
        "top": top,
        "width": width,
        "height": height,
        "confidence": _seven_digits(tracks.confidence),
        "detection": tracks.detection.tolist(),
        "confirmed": tracks.confirmed.astype(int).tolist(),
        "class": [words[k] for k in label] if words else label,
    }


def _seven_digits(values: F8) -> list[float]:
    return [float(f"{value:.7g}") for value in values.tolist()]


def _kitti(columns: Mapping[str, list[Any]], tracks: Tracks, words: Mapping[int, str]) -> list[str]:
    """The lines of a KITTI label file."""
    lines = []
    for number, identity, label, box, confidence in zip(
        columns["frame"],
        columns["identity"],
        tracks.class_id.tolist(),
        tracks.xyxy.tolist(),
        columns["confidence"],
        strict=True,
    ):
        name = words[label].replace(" ", "_")
        corners = " ".join(f"{value:.7g}" for value in box)
        lines.append(
            f"{number - 1} {identity} {name} -1 -1 -10 {corners} -1 -1 -1 -1000 -1000 -1000 -10"
            f" {confidence}"
        )
    return lines


def _coco(
    columns: Mapping[str, list[Any]], tracks: Tracks, words: Mapping[int, str], info: SequenceInfo
) -> dict[str, Any]:
    """A COCO data set: an image for each frame of the sequence, an annotation for each row."""
    frames = range(1, info.frames + 1) if info.frames else np.unique(tracks.frame).tolist()
    size = {"width": info.width, "height": info.height} if info.width else {}
    annotations = []
    for k, label in enumerate(tracks.class_id.tolist()):
        row = {name: column[k] for name, column in columns.items()}
        annotations.append(
            {
                "id": k + 1,
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
        )
    return {
        "images": [
            {"id": number, "file_name": f"{number:06d}.jpg", "frame_id": number, **size}
            for number in frames
        ],
        "annotations": annotations,
        "categories": [{"id": number, "name": name} for number, name in words.items()],
    }


def _cvat(tracks: Tracks, words: Mapping[int, str], info: SequenceInfo) -> list[str]:
    """The lines of a CVAT document ("for video 1.1"): a track for each identity and class, with a
    box marked as outside in the frame after each gap begins.
    """
    labels = "".join(f"<label><name>{escape(word)}</name></label>" for word in words.values())
    size = ""
    if info.width:
        size = (
            f"<original_size><width>{info.width}</width><height>{info.height}</height>"
            "</original_size>"
        )
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        "<annotations>",
        f"<version>1.1</version><meta><task><size>{info.frames}</size><mode>interpolation</mode>"
        f"<labels>{labels}</labels>{size}</task></meta>",
    ]
    corners = " ".join(f'{name}="{{:.7g}}"' for name in ("xtl", "ytl", "xbr", "ybr"))
    box = f'<box frame="{{}}" keyframe="1" outside="{{}}" occluded="0" {corners} z_order="0"/>'
    keys = set(zip(tracks.identity.tolist(), tracks.class_id.tolist(), strict=True))
    for identity, label in sorted(keys):
        track = tracks.select((tracks.identity == identity) & (tracks.class_id == label))
        lines.append(f'<track id="{identity}" label={quoteattr(words[label])} source="auto">')
        frames = track.frame.tolist()
        for number, following, xyxy in zip(
            frames, [*frames[1:], 0], track.xyxy.tolist(), strict=True
        ):
            lines.append(box.format(number - 1, 0, *xyxy))
            if following != number + 1 and number != info.frames:
                lines.append(box.format(number, 1, *xyxy))
        lines.append("</track>")
    return [*lines, "</annotations>"]
