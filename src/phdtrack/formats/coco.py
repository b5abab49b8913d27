"""COCO JSON: a list of results, or a data set with images and annotations.

Boxes are left, top, width, height. A result has only the ``image_id``, which is then the number of
the frame; `coco_images.py` numbers the images of a data set. ``track_id`` (or ``instance_id``,
``identity``) is the identity, also among an annotation's ``attributes``; ``iscrowd`` or ``ignore``
mark a distractor. Boxes with a ``rotation`` in degrees, and polygons without a box, are read as the
upright boxes around them. Scalabel, the JSON of BDD100K, is read in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import read_json
from phdtrack.formats.checks import MalformedRows, Origin
from phdtrack.formats.coco_images import ImageFrames, frames_of_images
from phdtrack.formats.hulls import Shapes, hull, rotated_hull
from phdtrack.formats.json_entry import Entry, brief, entry_of
from phdtrack.formats.scalabel import coco_of_scalabel, is_scalabel
from phdtrack.formats.table import LTWH, Column, Kind, Source, Table

# Rotations are smaller than this, in degrees.
_MAX_DEGREES = 1e6
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
    """An annotation: its place in the list, from 1, the number of its frame, and the upright box
    ``ltwh`` (left, top, width, height)."""

    place: int
    frame: float
    entry: Entry
    ltwh: tuple[float, ...]


class CocoFile(NamedTuple):
    """A COCO file: its ``info``, its images with the number of their ``frame``, its valid boxes,
    which messages call ``unit``, the names of its categories, the number of its ``first`` frame,
    sentences about guesses, and how many annotations it has, invalid ones and those of other videos
    included.
    """

    info: dict[str, Any]
    images: list[dict[str, Any]]
    unit: str
    boxes: list[CocoBox]
    names: dict[int, str]
    first: int
    notices: tuple[str, ...]
    annotations: int = 0


def read_coco(
    path: Path, content: bytes, left_out: MalformedRows | None = None, sequence: str = ""
) -> CocoFile:
    """Parse a COCO file. Raises `InputError` if it does not have COCO's form; malformed annotations
    are added to ``left_out``, or are errors without it.

    Parameters
    ----------
    path : the file, for messages.
    content : its bytes.
    left_out : receives malformed annotations; None: they are errors.
    sequence : the video to read if the file has several; ``all`` for all.
    """
    document = read_json(path, content)
    unit = "annotation"
    if is_scalabel(document):
        document = coco_of_scalabel(path, document)
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
    frames = frames_of_images(path, images, _video_names(document), sequence)
    boxes = list[CocoBox]()
    shapes = Shapes()
    annotations = _list(path, document, "annotations")
    for place, annotation in enumerate(annotations, start=1):
        try:
            entry = entry_of(annotation, f"{path}, {unit} {place}", "image_id and bbox")
            ltwh = _upright_box(entry, shapes)
            frame = _frame(entry, frames)
            if frame is not None:
                boxes.append(CocoBox(place, frame, entry, ltwh))
        except InputError as error:
            if left_out is None:
                raise
            left_out.add(error, float(place))
    first = frames.first
    if not images and boxes:
        first = int(min(box.frame for box in boxes) != 0)
    info = document.get("info")
    return CocoFile(
        info if isinstance(info, dict) else {},
        [
            image.values | {"frame": frames.frame[image.number("id")]}
            for image in images
            if image.number("id") in frames.frame
        ],
        unit,
        boxes,
        _names(path, document),
        first,
        (*frames.notices, *shapes.sentences()),
        len(annotations),
    )


def table_of_coco(source: Source) -> Table:
    """The boxes in COCO JSON. Raises `InputError` if it does not have COCO's form, or if truth or
    tracks have no identities.
    """
    coco = read_coco(source.path, source.content, source.left_out, source.conventions.sequence)
    for sentence in coco.notices:
        source.report(sentence)
    entries = [box.entry for box in coco.boxes]
    ltwh = np.array([box.ltwh for box in coco.boxes], np.float64).reshape(-1, 4)
    values = dict(zip(LTWH, ltwh.T, strict=True))
    values[Column.FRAME] = np.array([box.frame for box in coco.boxes], np.float64)
    for column, keys in _KEYS.items():
        if column is not Column.IDENTITY or source.kind is not Kind.DETECTIONS:
            numbers = [entry.number(*keys, default=column.default) for entry in entries]
            values[column] = np.array(numbers, np.float64)
    place = np.array([box.place for box in coco.boxes], np.int64)
    origin = Origin(source.path, coco.unit, place, place - 1, coco.annotations)
    first = source.first if source.conventions.first_frame is not None else coco.first
    return Table(origin, first, values, np.zeros((len(entries), 0)), coco.names)


def _video_names(document: dict[str, Any]) -> Mapping[object, str]:
    """The names of the videos by their id."""
    videos = document.get("videos")
    if not isinstance(videos, list):
        return {}
    return {
        one["id"]: str(one.get("name", one["id"]))
        for one in videos
        if isinstance(one, dict) and isinstance(one.get("id"), int | str)
    }


def _upright_box(entry: Entry, shapes: Shapes) -> tuple[float, ...]:
    """Left, top, width, height of an annotation; those of the upright box around a rotated one, or
    around a polygon without a box.
    """
    polygon = _polygon(entry.values.get("segmentation"))
    if not entry.values.get("bbox") and polygon:
        shapes.read["polygon"] += 1
        left, top, right, bottom = hull(polygon[::2], polygon[1::2])
        return left, top, right - left, bottom - top
    left, top, width, height = entry.box()
    degrees = _degrees(entry.values.get("rotation"))
    if not degrees:
        return left, top, width, height
    shapes.read["rotated box"] += 1
    corners = rotated_hull(left, top, left + width, top + height, degrees)
    return corners[0], corners[1], corners[2] - corners[0], corners[3] - corners[1]


def _degrees(value: object) -> float:
    """A rotation as a number, or as its digits in quotes; 0 for anything else."""
    if not isinstance(value, int | float | str):
        return 0.0
    try:
        degrees = float(value)
    except (ValueError, OverflowError):
        return 0.0
    return degrees if abs(degrees) < _MAX_DEGREES else 0.0


def _polygon(segmentation: object) -> list[float]:
    """The numbers x, y, … of all polygons of a segmentation; empty if it has none."""
    if not isinstance(segmentation, list):
        return []
    numbers = list[float]()
    for part in segmentation:
        if not isinstance(part, list) or len(part) % 2:
            return []
        if not all(isinstance(one, int | float) and abs(one) < math.inf for one in part):
            return []
        numbers += map(float, part)
    return numbers


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


def _frame(entry: Entry, frames: ImageFrames) -> float | None:
    """The number of an annotation's frame; None if it is of another video. Raises `InputError` if a
    value is not a number, or its image is unknown.
    """
    for column, keys in _KEYS.items():
        entry.number(*keys, default=0.0 if column is Column.IDENTITY else column.default)
    image = entry.number("image_id")
    if image in frames.others:
        return None
    if frames.frame and image not in frames.frame:
        raise InputError(
            f"expected the id of one of the images, got image_id {image:.15g}", where=entry.where
        )
    return frames.frame.get(image, image)
