"""COCO JSON: a list of results, or a data set with its images and annotations. Boxes are left, top, width, height.

A result tells its image by ``image_id`` only, which is then the number of the frame. In a data set the number is, in this
order: ``frame_id`` (or ``frame_index``, ``frame_number``) of the image, the digits at the end of its file name
(``img1/000042.jpg``), its ``id``; whichever all images have. ``track_id`` (or ``instance_id``, ``identity``) is the
identity, also where it stands among an annotation's ``attributes``; ``iscrowd`` or ``ignore`` mark a distractor.
"""

from __future__ import annotations

import json
import re
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from phdtrack.errors import InputError
from phdtrack.formats.rows import Kind, Origin, Rows, Source
from phdtrack.types import F8

_FRAME = ("frame_id", "frame_index", "frame_number")


class _Entry(NamedTuple):
    """A JSON object, its attributes beside its own values, and its place in the file."""

    values: dict[str, Any]
    where: str

    def value(self, *names: str) -> object:
        """What stands under the first of the names that it has."""
        for name in names:
            if name in self.values:
                return self.values[name]
        came = ", ".join(self.values) or "none"
        raise InputError(f"expected a value for {' or '.join(names)}, came keys {came}", where=self.where)

    def number(self, *names: str, default: float | None = None) -> float:
        """The same as a number."""
        if default is not None and not any(name in self.values for name in names):
            return default
        return _number(self.value(*names), names[0], self.where)

    def corners(self) -> list[float]:
        """Left, top, right, bottom."""
        box = self.value("bbox")
        if not isinstance(box, list) or len(box) != 4:
            problem = f"expected four numbers for bbox (left, top, width, height), came {_brief(box)}"
            raise InputError(problem, where=self.where)
        left, top, width, height = (_number(value, "bbox", self.where) for value in box)
        return [left, top, left + width, top + height]


def rows_of_coco(source: Source) -> Rows:
    """The boxes in COCO JSON.

    Raises
    ------
    InputError : the content is not JSON, or not of COCO's form, or (truth and tracks) has no identities.
    """
    path, document = source.path, _parse(source.path, source.content)
    if isinstance(document, dict):
        unit, images = "annotation", list[_Entry]()
        if "images" in document:
            images = _entries(path, _list(path, document, "images"), "image", "id and file_name")
        entries = _entries(path, _list(path, document, "annotations"), unit, "image_id and bbox")
    elif isinstance(document, list):
        unit, images = "entry", []
        entries = _entries(path, document, unit, "image_id and bbox")
    else:
        raise InputError(f"expected a list of results or a COCO data set, came {_brief(document)}", where=path)
    image = [entry.number("image_id") for entry in entries]

    def column(*names: str, default: float | None = None) -> F8:
        return np.array([entry.number(*names, default=default) for entry in entries], np.float64)

    return Rows(
        Origin(path, unit, np.arange(1, len(entries) + 1)),
        _frames(path, images, image, entries) if images else np.array(image, np.float64),
        np.array([entry.corners() for entry in entries]).reshape(-1, 4),
        source.first,
        identity=None if source.kind is Kind.DETECTIONS else column("track_id", "instance_id", "identity"),
        confidence=column("score", default=1.0),
        class_id=column("category_id", default=0.0),
        distractor=column("ignore", "iscrowd", default=0.0),
    )


def _parse(path: Path, content: bytes) -> object:
    try:
        return json.loads(content)
    except UnicodeDecodeError:
        raise InputError("expected UTF-8 text, came other bytes", where=path) from None
    except json.JSONDecodeError as error:
        where = f"{path}, line {error.lineno}"
        raise InputError(f"expected JSON, which breaks here: {error.msg}", where=where, cure="Is it complete?") from None
    except RecursionError:
        raise InputError("expected COCO JSON, came brackets nested without end", where=path) from None


def _list(path: Path, document: dict[str, Any], key: str) -> list[Any]:
    if isinstance(document.get(key), list):
        return list(document[key])
    came = f"{key} = {_brief(document[key])}" if key in document else f"keys {', '.join(document)}"
    raise InputError(f"expected a COCO data set with a list of {key}, came {came}", where=path)


def _entries(path: Path, objects: list[Any], unit: str, keys: str) -> list[_Entry]:
    entries = []
    for i, values in enumerate(objects, start=1):
        where = f"{path}, {unit} {i}"
        if not isinstance(values, dict):
            raise InputError(f"expected an object with {keys}, came {_brief(values)}", where=where)
        more = values.get("attributes")
        entries.append(_Entry({**more, **values} if isinstance(more, dict) else values, where))
    return entries


def _frames(path: Path, images: list[_Entry], image: list[float], entries: list[_Entry]) -> F8:
    """(M,) the frame number of each annotation, by its image."""
    videos = {entry.values["video_id"] for entry in images if isinstance(entry.values.get("video_id"), int | str)}
    if len(videos) > 1:
        raise InputError(f"expected one video, came {len(videos)}", where=path, cure="Split the file by video_id.")
    ids = [entry.number("id") for entry in images]
    number = dict(zip(ids, _image_numbers(images, ids), strict=True))
    for key, entry in zip(image, entries, strict=True):
        if key not in number:
            raise InputError(f"expected the id of one of the images, came image_id {key:.15g}", where=entry.where)
    return np.array([number[key] for key in image], np.float64)


def _image_numbers(images: list[_Entry], ids: list[float]) -> list[float]:
    """The frame number of each image."""
    for name in _FRAME:
        if all(name in entry.values for entry in images):
            return [entry.number(name) for entry in images]
    stems = [PurePosixPath(str(entry.values.get("file_name", "")).replace("\\", "/")).stem for entry in images]
    digits = [match.group() for stem in stems if (match := re.search(r"[0-9]+$", stem))]
    distinct = len(digits) == len(set(map(int, digits))) == len(images)
    return [float(word) for word in digits] if distinct else ids


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
