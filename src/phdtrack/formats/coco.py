"""COCO JSON: a list of results, or a data set with its images and annotations. Boxes are left, top, width, height.

A result tells its image by ``image_id`` alone, which is then the number of the frame. In a data set the number is, in this
order: ``frame_id`` (or ``frame_index``, ``frame_number``) of the image, the digits at the end of its file name
(``img1/000042.jpg``), its ``id``; whichever all images have. ``track_id`` (or ``instance_id``, ``identity``) is the
identity, also where it stands among an annotation's ``attributes``; ``iscrowd`` or ``ignore`` mark a distractor.
"""

from __future__ import annotations

import json
import re
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.formats.columns import Kind
from phdtrack.formats.rows import Rows
from phdtrack.formats.text import Origin
from phdtrack.types import F8

Entry = dict[str, Any]  # a JSON object, as the standard library gives it

_FRAME = ("frame_id", "frame_index", "frame_number")
_IDENTITY = ("track_id", "instance_id", "identity")


def rows_of_coco(path: Path, content: bytes, kind: Kind, first: int) -> Rows:
    """The boxes in COCO JSON; ``first`` is the number that the file gives the first frame.

    Parameters
    ----------
    path : the file, for messages.
    content : its bytes.
    kind : what it is read as.
    first : the number that the file gives the first frame.

    Raises
    ------
    InputError : the content is not JSON, or not of COCO's form, or (truth and tracks) has no identities.
    """
    document = _parse(path, content)
    if isinstance(document, dict):
        entries, unit = _list(path, document, "annotations"), "annotation"
        images = _list(path, document, "images") if "images" in document else []
    else:
        entries, unit, images = document, "entry", []
    origin = Origin(path, unit, np.arange(1, len(entries) + 1))
    for i, entry in enumerate(entries):
        if not isinstance(entry, dict):
            raise InputError(f"expected an object with image_id and bbox, came {_brief(entry)}", where=origin.at(i))
    image = [_number(_one(e, ("image_id",), origin.at(i)), "image_id", origin.at(i)) for i, e in enumerate(entries)]
    box = np.array([_box(e, origin.at(i)) for i, e in enumerate(entries)]).reshape(-1, 4)
    return Rows(
        origin,
        _frames(path, images, image, origin),
        np.hstack([box[:, :2], box[:, :2] + box[:, 2:]]),
        first,
        identity=None if kind is Kind.DETECTIONS else _column([_flat(e) for e in entries], _IDENTITY, origin),
        confidence=_column(entries, ("score",), origin, default=1.0),
        class_id=_column(entries, ("category_id",), origin, default=0.0),
        distractor=_column(entries, ("ignore", "iscrowd"), origin, default=0.0),
    )


def _parse(path: Path, content: bytes) -> list[Any] | Entry:
    try:
        document = json.loads(content)
    except UnicodeDecodeError:
        raise InputError("expected UTF-8 text, came other bytes", where=path) from None
    except json.JSONDecodeError as error:
        where = f"{path}, line {error.lineno}"
        raise InputError(f"expected JSON, which breaks here: {error.msg}", where=where, cure="Is it complete?") from None
    except RecursionError:
        raise InputError("expected COCO JSON, came brackets nested without end", where=path) from None
    if isinstance(document, list | dict):
        return document
    raise InputError(f"expected a list of results or a COCO data set, came {_brief(document)}", where=path)


def _list(path: Path, document: Entry, key: str) -> list[Any]:
    entries = document.get(key)
    if isinstance(entries, list):
        return entries
    came = f"keys {', '.join(document)}" if key not in document else f"{key} = {_brief(entries)}"
    raise InputError(f"expected a COCO data set with a list of {key}, came {came}", where=path)


def _frames(path: Path, images: list[Any], image: list[float], origin: Origin) -> F8:
    """(M,) the frame number of each annotation, from the images if there are any."""
    if not images:
        return np.array(image, dtype=np.float64)
    places = [f"{path}, image {i}" for i in range(1, len(images) + 1)]
    for entry, where in zip(images, places, strict=True):
        if not isinstance(entry, dict):
            raise InputError(f"expected an object with id and file_name, came {_brief(entry)}", where=where)
    videos = {entry["video_id"] for entry in images if isinstance(entry.get("video_id"), int | str)}
    if len(videos) > 1:
        raise InputError(f"expected one video, came {len(videos)}", where=path, cure="Split the file by video_id.")
    ids = [_number(_one(e, ("id",), w), "id", w) for e, w in zip(images, places, strict=True)]
    number = dict(zip(ids, _image_numbers(images, ids, places), strict=True))
    for i, key in enumerate(image):
        if key not in number:
            raise InputError(f"expected the id of one of the images, came image_id {key:.15g}", where=origin.at(i))
    return np.array([number[key] for key in image], dtype=np.float64)


def _image_numbers(images: list[Entry], ids: list[float], places: list[str]) -> list[float]:
    """The frame number of each image."""
    for name in _FRAME:
        if all(name in entry for entry in images):
            return [_number(entry[name], name, where) for entry, where in zip(images, places, strict=True)]
    stems = [PurePosixPath(str(entry.get("file_name", "")).replace("\\", "/")).stem for entry in images]
    digits = [match.group() for stem in stems if (match := re.search(r"[0-9]+$", stem))]
    if len(digits) == len(images) and len(set(map(int, digits))) == len(images):
        return [float(word) for word in digits]
    return ids


def _column(entries: list[Entry], names: tuple[str, ...], origin: Origin, *, default: float | None = None) -> F8:
    """(M,) a value of every entry, by the first of ``names`` that it has."""
    values = []
    for i, entry in enumerate(entries):
        if default is not None and not any(name in entry for name in names):
            values.append(default)
        else:
            values.append(_number(_one(entry, names, origin.at(i)), names[0], origin.at(i)))
    return np.array(values, dtype=np.float64)


def _flat(entry: Entry) -> Entry:
    """The entry with its attributes beside its own values, which come first."""
    attributes = entry.get("attributes")
    return {**attributes, **entry} if isinstance(attributes, dict) else entry


def _one(entry: Entry, names: tuple[str, ...], where: str) -> object:
    for name in names:
        if name in entry:
            return entry[name]
    raise InputError(f"expected a value for {' or '.join(names)}, came keys {', '.join(entry) or 'none'}", where=where)


def _box(entry: Entry, where: str) -> list[float]:
    box = _one(entry, ("bbox",), where)
    if not isinstance(box, list) or len(box) != 4:
        raise InputError(f"expected four numbers for bbox (left, top, width, height), came {_brief(box)}", where=where)
    return [_number(value, "bbox", where) for value in box]


def _number(value: object, name: str, where: str) -> float:
    """A number, or digits in quotes: some programs write image ids as text."""
    if isinstance(value, str) and value.isdecimal():
        return float(value)
    if isinstance(value, int | float):
        try:
            return float(value)
        except OverflowError:
            pass
    raise InputError(f"expected a number for {name}, came {_brief(value)}", where=where)


def _brief(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
