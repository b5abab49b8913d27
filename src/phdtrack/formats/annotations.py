"""All content of a COCO or CVAT file, for tools that read more than boxes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

from phdtrack.errors import InputError
from phdtrack.files import load, read_xml
from phdtrack.formats.coco import read_coco
from phdtrack.formats.json_entry import brief
from phdtrack.formats.read import first_characters
from phdtrack.formats.xml_boxes import CVAT_SHAPES, cvat_box


class AnnotationFile(NamedTuple):
    """The content of a COCO or CVAT file: of the file itself, of each picture and of each box, by
    the names in the file.

    Pictures and boxes have the number of their ``frame``, from 1; boxes also have their corners
    ``xyxy`` and the name of their class as ``label``.
    """

    about: dict[str, Any]
    pictures: list[dict[str, Any]]
    boxes: list[dict[str, Any]]


def read_annotated(path: Path, sequence: str = "") -> AnnotationFile:
    """Read all content of a COCO or CVAT file. Raises `InputError` if it is neither, or is
    malformed.

    Parameters
    ----------
    path : the file.
    sequence : the video to read of a COCO file with several.
    """
    content = load(path)
    start = first_characters(content)[:1]
    if start == b"<":
        file = _read_cvat(path, content)
        first = 0
    elif start in (b"{", b"["):
        file = _read_coco(path, content, sequence)
        # Some programs number COCO's images from 0.
        first = min((item["frame"] for item in [*file.pictures, *file.boxes]), default=1)
    else:
        raise InputError(f"expected COCO (JSON) or CVAT (XML), got {brief(content)}", where=path)
    for item in [*file.pictures, *file.boxes]:
        number = item["frame"] + (first < 1)
        if not (number.is_integer() and 1 <= number < 2**53):
            raise InputError(
                f"expected whole frame numbers from 0 or 1, got {item['frame']:.15g}", where=path
            )
        item["frame"] = int(number)
    for box in file.boxes:
        left, top, right, bottom = box["xyxy"]
        if not (abs(left + top + right + bottom) < math.inf and right > left and bottom > top):
            raise InputError(
                "expected a box with a width and a height above 0, got left, top, right, bottom"
                f" {box['xyxy']}",
                where=f"{path}, frame {box['frame']}",
            )
    return file


def _read_coco(path: Path, content: bytes, sequence: str) -> AnnotationFile:
    """The content of a COCO file, with frames as the file numbers them."""
    coco = read_coco(path, content, sequence=sequence)
    names = {float(key): name for key, name in coco.names.items()}
    boxes = list[dict[str, Any]]()
    for _, frame, entry, ltwh in coco.boxes:
        left, top, width, height = ltwh
        values = dict(entry.values)
        values["frame"] = frame
        values["xyxy"] = (left, top, left + width, top + height)
        values["label"] = names.get(entry.number("category_id", default=-1.0), "")
        boxes.append(values)
    return AnnotationFile(coco.info, coco.images, boxes)


def _read_cvat(path: Path, content: bytes) -> AnnotationFile:
    """The content of a CVAT file, with frames from 0."""
    elements = read_xml(path, content)
    if elements[0].name != "annotations":
        raise InputError(
            f"expected CVAT, whose outermost element is <annotations>, got <{elements[0].name}>",
            where=elements[0].where,
        )
    # The named attributes of each element.
    more: dict[int, dict[str, Any]] = {id(element): {} for element in elements}
    for element in elements[1:]:
        if element.name == "attribute":
            name = element.attributes.get("name", "")
            more[id(element.around[-1])][name] = "".join(element.text)
    about = dict[str, Any]()
    pictures = list[dict[str, Any]]()
    boxes = list[dict[str, Any]]()
    for element in elements:
        if element.name == "phdtrack":
            about |= element.attributes
        elif element.name == "image":
            pictures.append({**element.attributes, "frame": element.number("id")})
        elif element.name == "tag" and any(around.name == "image" for around in element.around):
            pictures[-1] |= more[id(element)]
        elif element.name in CVAT_SHAPES and element.attributes.get("outside") != "1":
            track, frame, corners = cvat_box(element)
            values = more[id(track)] | more[id(element)]
            values["frame"] = frame
            values["xyxy"] = corners
            values["label"] = track.attributes.get("label", "")
            boxes.append(values)
    return AnnotationFile(about, pictures, boxes)
