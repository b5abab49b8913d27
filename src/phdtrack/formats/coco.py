"""COCO JSON: a list of results, or a data set with images and annotations.

Boxes are left, top, width, height. A result has only the ``image_id``, which is then the number of
the frame. In a data set the number is, in this order: ``frame_id`` (or ``frame_index``,
``frame_number``) of the image, the digits at the end of its file name (``img1/000042.jpg``), its
``id``; the first that all images have. ``track_id`` (or ``instance_id``, ``identity``) is the
identity, also among an annotation's ``attributes``; ``iscrowd`` or ``ignore`` mark a distractor.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import read_json
from phdtrack.formats.checks import MalformedRows, Origin
from phdtrack.formats.json_entry import Entry, brief, entry_of
from phdtrack.formats.table import LTWH, Column, Kind, Source, Table

# The keys of each column in an annotation.
_KEYS = {
    Column.CONFIDENCE: ("score",),
    Column.CLASS: ("category_id",),
    Column.DISTRACTOR: ("ignore", "iscrowd"),
    Column.DETECTION: ("detection",),
    Column.CONFIRMED: ("confirmed",),
    Column.IDENTITY: ("track_id", "instance_id", "identity"),
}


class CocoBox(NamedTuple):
    """An annotation: its place in the list, from 1, and the number of its frame."""

    place: int
    frame: float
    entry: Entry


class CocoFile(NamedTuple):
    """A COCO file: its ``info``, its images with the number of their ``frame``, its valid boxes,
    which messages call ``unit``, and the names of its categories.
    """

    info: dict[str, Any]
    images: list[dict[str, Any]]
    unit: str
    boxes: list[CocoBox]
    names: dict[int, str]


def read_coco(path: Path, content: bytes, left_out: MalformedRows | None = None) -> CocoFile:
    """Parse a COCO file. Raises `InputError` if it does not have COCO's form; malformed annotations
    are added to ``left_out``, or are errors without it.

    Parameters
    ----------
    path : the file, for messages.
    content : its bytes.
    left_out : receives malformed annotations; None: they are errors.
    """
    document = read_json(path, content)
    unit = "annotation"
    if isinstance(document, list):
        document = {"annotations": document}
        unit = "entry"
    if not isinstance(document, dict):
        raise InputError(
            f"expected a list of results or a COCO data set, got {brief(document)}", where=path
        )
    images = []
    if "images" in document:
        images = _entries(path, document, "images", "image", "id and file_name")
    frame_of = _frame_of(path, images)
    boxes = list[CocoBox]()
    for place, annotation in enumerate(_list(path, document, "annotations"), start=1):
        try:
            entry = entry_of(annotation, f"{path}, {unit} {place}", "image_id and bbox")
            boxes.append(CocoBox(place, _frame(entry, frame_of), entry))
        except InputError as error:
            if left_out is None:
                raise
            left_out.add(error, float(place))
    info = document.get("info")
    return CocoFile(
        info if isinstance(info, dict) else {},
        [image.values | {"frame": frame_of[image.number("id")]} for image in images],
        unit,
        boxes,
        _names(path, document),
    )


def table_of_coco(source: Source) -> Table:
    """The boxes in COCO JSON. Raises `InputError` if it does not have COCO's form, or if truth or
    tracks have no identities.
    """
    coco = read_coco(source.path, source.content, source.left_out)
    entries = [box.entry for box in coco.boxes]
    ltwh = np.array([entry.box() for entry in entries], np.float64).reshape(-1, 4)
    values = dict(zip(LTWH, ltwh.T, strict=True))
    values[Column.FRAME] = np.array([box.frame for box in coco.boxes], np.float64)
    for column, keys in _KEYS.items():
        if column is not Column.IDENTITY or source.kind is not Kind.DETECTIONS:
            numbers = [entry.number(*keys, default=column.default) for entry in entries]
            values[column] = np.array(numbers, np.float64)
    place = np.array([box.place for box in coco.boxes], np.int64)
    origin = Origin(source.path, coco.unit, place)
    return Table(origin, source.first, values, np.zeros((len(entries), 0)), coco.names)


def _names(path: Path, document: dict[str, Any]) -> dict[int, str]:
    """The names of a data set's categories by their id."""
    if not document.get("categories"):
        return {}
    names = dict[int, str]()
    for category in _entries(path, document, "categories", "category", "id and name"):
        number = category.number("id")
        if not number.is_integer():
            raise InputError(
                f"expected a whole number for id, got {number:g}", where=category.where
            )
        names[int(number)] = str(category.values.get("name", category.values["id"]))
    return names


def _entries(path: Path, document: dict[str, Any], key: str, unit: str, keys: str) -> list[Entry]:
    """The objects in the list under ``key``."""
    return [
        entry_of(value, f"{path}, {unit} {place}", keys)
        for place, value in enumerate(_list(path, document, key), start=1)
    ]


def _list(path: Path, document: dict[str, Any], key: str) -> list[Any]:
    if isinstance(document.get(key), list):
        return list(document[key])
    got = f"keys {', '.join(document)}"
    if key in document:
        got = f"{key} = {brief(document[key])}"
    raise InputError(f"expected a COCO data set with a list of {key}, got {got}", where=path)


def _frame(entry: Entry, frame_of: dict[float, float]) -> float:
    """The number of an annotation's frame. Raises `InputError` if it has no box, a value is not a
    number, or its image is unknown.
    """
    entry.box()
    for column, keys in _KEYS.items():
        entry.number(*keys, default=0.0 if column is Column.IDENTITY else column.default)
    image = entry.number("image_id")
    if frame_of and image not in frame_of:
        raise InputError(
            f"expected the id of one of the images, got image_id {image:.15g}", where=entry.where
        )
    return frame_of.get(image, image)


def _frame_of(path: Path, images: list[Entry]) -> dict[float, float]:
    """The frame number of each image, by the image's id."""
    all_values = [image.values for image in images]
    videos = {
        values["video_id"] for values in all_values if isinstance(values.get("video_id"), int | str)
    }
    if len(videos) > 1:
        raise InputError(
            f"expected one video, got {len(videos)}", where=path, cure="Split the file by video_id."
        )
    ids = [image.number("id") for image in images]
    frames = ids
    digits = [
        match.group()
        for values in all_values
        if (match := re.search(r"[0-9]+$", _stem(values.get("file_name", ""))))
    ]
    if len(digits) == len(set(map(int, digits))) == len(images):
        frames = [float(word) for word in digits]
    for name in ("frame_number", "frame_index", "frame_id"):
        if all(name in values for values in all_values):
            frames = [image.number(name) for image in images]
    return dict(zip(ids, frames, strict=True))


def _stem(file_name: object) -> str:
    """A file name without folders (of either system) and ending."""
    return PurePosixPath(str(file_name).replace("\\", "/")).stem
