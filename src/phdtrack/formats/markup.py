"""Boxes in JSON and XML: COCO, JSON lines, CVML and CVAT.

COCO JSON is a list of results, or a data set with its images and annotations. Boxes are left, top,
width, height. A result tells its image by ``image_id`` only, which is then the number of the frame.
In a data set the number is, in this order: ``frame_id`` (or ``frame_index``, ``frame_number``) of
the image, the digits at the end of its file name (``img1/000042.jpg``), its ``id``; whichever all
images have. ``track_id`` (or ``instance_id``, ``identity``) is the identity, also where it stands
among an annotation's ``attributes``; ``iscrowd`` or ``ignore`` mark a distractor.

CVML is the XML of CAVIAR's ground truth, in which the truth of PETS 2009 is written too:

    <dataset> <frame number="0"> <objectlist> <object id="1"> <box xc=".." yc=".." w=".." h=".."/>
    ...

Frames count from 0, boxes are given by their centre. Groups have boxes of their own, which are no
objects: they are passed over.

CVAT's XML has tracks, ``<annotations> <track id="1" label="car"> <box frame="0" outside="0"
xtl=".." ytl=".." xbr=".." ybr=".."/>``, or images, ``<image id="0"> <box label="car" …/>``, whose
boxes have no identities. Frames count from 0.

JSON lines are an object a line, whose keys are those that a header may have; ``bbox`` is left, top,
width, height.
"""

from __future__ import annotations

import json
import math
import re
import reprlib
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import Element, load, read_json, read_xml
from phdtrack.formats.checks import Origin, WrongRows
from phdtrack.formats.table import LTWH, Column, Kind, Source, Table, table_of_text
from phdtrack.formats.text import Text, normalise

# The keys of each column in an entry.
_KEYS = {
    Column.CONFIDENCE: ("score",),
    Column.CLASS: ("category_id",),
    Column.DISTRACTOR: ("ignore", "iscrowd"),
    Column.DETECTION: ("detection",),
    Column.CONFIRMED: ("confirmed",),
    Column.IDENTITY: ("track_id", "instance_id", "identity"),
}


class _Entry(NamedTuple):
    """A JSON object, its attributes beside its own values, and its place in the file."""

    values: dict[str, Any]
    where: str

    def number(self, *names: str, default: float | None = None) -> float:
        """What stands under the first of the names that it has, as a number."""
        for name in names:
            if name in self.values:
                return _number(self.values[name], name, self.where)
        if default is not None:
            return default
        came = ", ".join(self.values) or "none"
        raise InputError(
            f"expected a value for {' or '.join(names)}, came keys {came}", where=self.where
        )

    def box(self) -> list[float]:
        """Left, top, width, height."""
        box = self.values.get("bbox")
        if not isinstance(box, list) or len(box) != 4:
            problem = (
                f"expected four numbers for bbox (left, top, width, height), came {_brief(box)}"
            )
            raise InputError(problem, where=self.where)
        return [_number(value, "bbox", self.where) for value in box]


class _Coco(NamedTuple):
    """What a file of COCO says of itself, of its images, of the annotations that are right (called
    ``unit``; the place from 1, the number of the frame), and the names of classes."""

    about: dict[str, Any]
    pictures: list[dict[str, Any]]
    unit: str
    rows: list[tuple[int, float, _Entry]]
    names: dict[int, str]


def _coco(path: Path, content: bytes, left_out: WrongRows | None = None) -> _Coco:
    """What a file says; `InputError` where it is not of COCO's form, or an annotation is wrong and
    none is left out.
    """
    document = read_json(path, content)
    unit = "annotation"
    rows = list[tuple[int, float, _Entry]]()
    if isinstance(document, list):
        document = {"annotations": document}
        unit = "entry"
    if not isinstance(document, dict):
        raise InputError(
            f"expected a list of results or a COCO data set, came {_brief(document)}", where=path
        )
    if "images" in document:
        images = _entries(path, document, "images", "image", "id and file_name")
    else:
        images = []
    given = _list(path, document, "annotations")
    frame_of = _frame_of(path, images)
    for place, one in enumerate(given, start=1):
        try:
            entry = _entry(path, one, unit, place, "image_id and bbox")
            rows.append((place, _frame(entry, frame_of), entry))
        except InputError as error:
            if left_out is None:
                raise
            left_out.take(error, float(place))
    about = document.get("info")
    pictures = [one.values | {"frame": frame_of[one.number("id")]} for one in images]
    return _Coco(
        about if isinstance(about, dict) else {}, pictures, unit, rows, _names(path, document)
    )


def table_of_coco(source: Source) -> Table:
    """The boxes in COCO JSON; `InputError` where it is not of COCO's form, or truth and tracks have
    no identities.
    """
    found = _coco(source.path, source.content, source.left_out)
    boxes = np.array([entry.box() for _, _, entry in found.rows], np.float64).reshape(-1, 4)
    values = dict(zip(LTWH, boxes.T, strict=True))
    values[Column.FRAME] = np.array([frame for _, frame, _ in found.rows], np.float64)
    for column, keys in _KEYS.items():
        if column is not Column.IDENTITY or source.kind is not Kind.DETECTIONS:
            numbers = [entry.number(*keys, default=column.default) for _, _, entry in found.rows]
            values[column] = np.array(numbers, np.float64)
    origin = Origin(
        source.path, found.unit, np.array([place for place, _, _ in found.rows], np.int64)
    )
    return Table(origin, source.first, values, np.zeros((len(found.rows), 0)), found.names)


class Annotated(NamedTuple):
    """A file of COCO or CVAT with all that it says: of itself, of each picture and of each box, by
    the names it has.

    Of pictures and boxes ``frame`` is the number of the frame, from 1, and of boxes ``xyxy`` the
    corners and ``label`` the name of the class.
    """

    about: dict[str, Any]
    pictures: list[dict[str, Any]]
    boxes: list[dict[str, Any]]


def read_annotated(path: Path) -> Annotated:
    """All that a file of COCO or CVAT says. Raises `InputError` where it is none of these, or
    broken.
    """
    content = load(path)
    if (start := content.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]) not in (b"<", b"{", b"["):
        raise InputError(f"expected COCO (JSON) or CVAT (XML), came {_brief(content)}", where=path)
    about, pictures, boxes = (_cvat_values if start == b"<" else _coco_values)(path, content)
    # Some programs call the first picture 0 in COCO, too.
    if start == b"<":
        first = 0
    else:
        first = min((one["frame"] for one in [*pictures, *boxes]), default=1)
    for one in [*pictures, *boxes]:
        number = one["frame"] + (first < 1)
        if not (number.is_integer() and 1 <= number < 2**53):
            raise InputError(
                f"expected whole numbers of frames, from 0 or 1, came {one['frame']:.15g}",
                where=path,
            )
        one["frame"] = int(number)
    for one in boxes:
        left, top, right, bottom = one["xyxy"]
        if not (abs(left + top + right + bottom) < math.inf and right > left and bottom > top):
            problem = (
                "expected a box of some width and height, came left, top, right, bottom"
                f" {one['xyxy']}"
            )
            raise InputError(problem, where=f"{path}, frame {one['frame']}")
    return Annotated(about, pictures, boxes)


def _coco_values(path: Path, content: bytes) -> Annotated:
    """What a file of COCO says; frames are as it counts them."""
    found = _coco(path, content)
    names = {float(key): name for key, name in found.names.items()}
    boxes = list[dict[str, Any]]()
    for _, frame, entry in found.rows:
        left, top, width, height = entry.box()
        label = names.get(entry.number("category_id", default=-1.0), "")
        boxes.append(
            entry.values
            | {
                "frame": frame,
                "xyxy": (left, top, left + width, top + height),
                "label": label,
            }
        )
    return Annotated(found.about, found.pictures, boxes)


def _cvat_values(path: Path, content: bytes) -> Annotated:
    """What a file of CVAT says; frames count from 0."""
    elements = read_xml(path, content)
    if elements[0].name != "annotations":
        problem = (
            f"expected CVAT, whose outermost element is <annotations>, came <{elements[0].name}>"
        )
        raise InputError(problem, where=elements[0].where)
    more: dict[int, dict[str, Any]] = {id(element): {} for element in elements}
    for one in elements[1:]:
        if one.name == "attribute":
            more[id(one.around[-1])][one.attributes.get("name", "")] = "".join(one.text)
    about = dict[str, Any]()
    pictures = list[dict[str, Any]]()
    boxes = list[dict[str, Any]]()
    for one in elements:
        if one.name == "phdtrack":
            about |= one.attributes
        elif one.name == "image":
            pictures.append({**one.attributes, "frame": one.number("id")})
        elif one.name == "tag" and any(element.name == "image" for element in one.around):
            pictures[-1] |= more[id(one)]
        elif one.name == "box" and one.attributes.get("outside") != "1":
            track, frame, corners = _cvat_box(one)
            label = track.attributes.get("label", "")
            boxes.append(
                {
                    **more[id(track)],
                    **more[id(one)],
                    "frame": frame,
                    "xyxy": corners,
                    "label": label,
                }
            )
    return Annotated(about, pictures, boxes)


def _cvat_box(box: Element) -> tuple[Element, float, tuple[float, ...]]:
    """The track of a box of CVAT, or itself where it has none, its frame from 0, and its
    corners.
    """
    around = {element.name: element for element in box.around}
    if "image" in around:
        frame = around["image"].number("id")
    else:
        frame = box.number("frame")
    return around.get("track", box), frame, tuple(map(box.number, ("xtl", "ytl", "xbr", "ybr")))


def _names(path: Path, document: dict[str, Any]) -> dict[int, str]:
    """What a data set calls its categories."""
    if not document.get("categories"):
        return {}
    names = dict[int, str]()
    for one in _entries(path, document, "categories", "category", "id and name"):
        if not (number := one.number("id")).is_integer():
            raise InputError(f"expected a whole number for id, came {number:g}", where=one.where)
        names[int(number)] = str(one.values.get("name", one.values["id"]))
    return names


def rows_of_json(source: Source) -> Text | None:
    """JSON lines as a table with a header; None where the first line is no object that has a
    frame.
    """
    try:
        first = json.loads(source.content.lstrip().partition(b"\n")[0])
    except (ValueError, RecursionError):
        return None
    if not isinstance(first, dict) or not {normalise(key) for key in first} & {*Column.FRAME.names}:
        return None
    rows = list[dict[str, str]]()
    numbers = list[int]()
    for number, line in enumerate(source.content.split(b"\n"), start=1):
        if not line.strip():
            continue
        try:
            value = read_json(source.path, line)
            entry = _entry(source.path, value, "line", number, "frame and a box")
            if "bbox" in entry.values:
                entry.values.update(
                    zip(("left", "top", "width", "height"), entry.box(), strict=True)
                )
        except InputError as error:
            where = InputError(
                error.problem, where=f"{source.path}, line {number}", cure=error.cure
            )
            if source.left_out is None:
                raise where from None
            source.left_out.take(where, float(number))
            continue
        rows.append({normalise(key): _cell(one) for key, one in entry.values.items()})
        numbers.append(number)
    return _text(source.path, rows, numbers)


def _text(path: Path, rows: list[dict[str, str]], numbers: list[int]) -> Text:
    """Rows by the names of columns as a table in text; what a row does not have is empty."""
    header = [*dict.fromkeys(name for row in rows for name in row)]
    lines = [",".join(row.get(name, "") for name in header) for row in rows]
    return Text(
        Origin(path, "line", np.array(numbers, np.int64)), lines, ",", len(header), tuple(header)
    )


def _cell(value: object) -> str:
    """A value of JSON as a cell of a table."""
    if value is None:
        text = ""
    else:
        text = str(int(value) if isinstance(value, bool) else value)
    return re.sub(r'[^\S ]|[,"]', "_", text.strip())


def table_of_xml(source: Source) -> Table:
    """The boxes of the objects in a CVML or CVAT document; `InputError` where it is none.

    Those of CVAT that are outside are no boxes.
    """
    elements = read_xml(source.path, source.content)
    rows = list[dict[str, str]]()
    lines = list[int]()
    cvat = elements[0].name == "annotations"
    if not cvat and elements[0].name != "dataset":
        came = f"<{elements[0].name}>"
        problem = (
            "expected CVML or CVAT, whose outermost element is <dataset> or <annotations>, came"
            f" {came}"
        )
        raise InputError(problem, where=elements[0].where)
    for box in elements:
        around = {element.name: element for element in box.around}
        if box.name != "box" or (
            box.attributes.get("outside") == "1" if cvat else "group" in around
        ):
            continue
        if not (
            around.keys() & {"track", "image"} if cvat else around.keys() >= {"frame", "object"}
        ):
            if cvat:
                place = "<track> or <image>"
            else:
                place = "<frame> and <object>"
            raise InputError(f"expected <box> inside of {place}, came one outside", where=box.where)
        if cvat:
            track, frame, corners = _cvat_box(box)
            row = dict(
                zip(("frame", "left", "top", "right", "bottom"), (frame, *corners), strict=True)
            )
            row |= {"id": track.number("id")} if track is not box else {}
            more = {"class": _cell(track.attributes.get("label", ""))}
        else:
            row = {
                name: box.number(key)
                for name, key in (("cx", "xc"), ("cy", "yc"), ("width", "w"), ("height", "h"))
            }
            row = row | {
                "frame": around["frame"].number("number"),
                "id": around["object"].number("id"),
            }
            more = {}
        rows.append({name: repr(value) for name, value in row.items()} | more)
        lines.append(box.line)
    return table_of_text(source, _text(source.path, rows, lines))


def _list(path: Path, document: dict[str, Any], key: str) -> list[Any]:
    if isinstance(document.get(key), list):
        return list(document[key])
    if key in document:
        came = f"{key} = {_brief(document[key])}"
    else:
        came = f"keys {', '.join(document)}"
    raise InputError(f"expected a COCO data set with a list of {key}, came {came}", where=path)


def _entries(path: Path, document: dict[str, Any], key: str, unit: str, keys: str) -> list[_Entry]:
    return [
        _entry(path, values, unit, i, keys)
        for i, values in enumerate(_list(path, document, key), start=1)
    ]


def _entry(path: Path, values: Any, unit: str, number: int, keys: str) -> _Entry:
    where = f"{path}, {unit} {number}"
    if not isinstance(values, dict):
        raise InputError(f"expected an object with {keys}, came {_brief(values)}", where=where)
    more = values.get("attributes")
    return _Entry({**more, **values} if isinstance(more, dict) else values, where)


def _frame(entry: _Entry, frame_of: dict[float, float]) -> float:
    """The number of an entry's frame. `InputError` where it has no box, a value that is no number,
    or another image.
    """
    entry.box()
    for column, keys in _KEYS.items():
        entry.number(*keys, default=column.default if column is not Column.IDENTITY else 0.0)
    key = entry.number("image_id")
    if frame_of and key not in frame_of:
        raise InputError(
            f"expected the id of one of the images, came image_id {key:.15g}", where=entry.where
        )
    return frame_of.get(key, key)


def _frame_of(path: Path, images: list[_Entry]) -> dict[float, float]:
    """The frame number of each image, by its id."""
    videos = {
        entry.values["video_id"]
        for entry in images
        if isinstance(entry.values.get("video_id"), int | str)
    }
    if len(videos) > 1:
        raise InputError(
            f"expected one video, came {len(videos)}",
            where=path,
            cure="Split the file by video_id.",
        )
    frame = ids = [entry.number("id") for entry in images]
    stems = [
        PurePosixPath(str(entry.values.get("file_name", "")).replace("\\", "/")).stem
        for entry in images
    ]
    digits = [match.group() for stem in stems if (match := re.search(r"[0-9]+$", stem))]
    if len(digits) == len(set(map(int, digits))) == len(images):
        frame = [float(word) for word in digits]
    for name in ("frame_number", "frame_index", "frame_id"):
        if all(name in entry.values for entry in images):
            frame = [entry.number(name) for entry in images]
    return dict(zip(ids, frame, strict=True))


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
    text = reprlib.repr(value)
    if len(text) <= 40:
        return text
    return f"{text[:37]}..."
