"""Boxes in XML: CVML and CVAT.

CVML is the format of CAVIAR's ground truth, in which the truth of PETS 2009 is written too:

    <dataset> <frame number="0"> <objectlist> <object id="1"> <box xc=".." yc=".." w=".." h=".."/>
    ...

Frames count from 0, boxes are given by their centre. Groups have boxes of their own, which are
skipped.

CVAT has tracks, ``<annotations> <track id="1" label="car"> <box frame="0" outside="0" xtl=".."
ytl=".." xbr=".." ybr=".."/>``, or images, ``<image id="0"> <box label="car" …/>``, whose boxes have
no identities. Frames count from 0.
"""

from __future__ import annotations

from collections.abc import Mapping

from phdtrack.errors import InputError
from phdtrack.files import Element, read_xml
from phdtrack.formats.table import Source, Table, table_of_text
from phdtrack.formats.text import as_cell, text_of_rows


def table_of_xml(source: Source) -> Table:
    """The boxes of the objects in a CVML or CVAT document. Raises `InputError` if it is neither, or
    a box is malformed.
    """
    elements = read_xml(source.path, source.content)
    root = elements[0]
    if source.conventions.first_frame is None:
        source = source._replace(first=0)
    readers = {"annotations": _cvat_row, "dataset": _cvml_row}
    if root.name not in readers:
        raise InputError(
            "expected CVML or CVAT, whose outermost element is <dataset> or <annotations>, got"
            f" <{root.name}>",
            where=root.where,
        )
    rows = list[dict[str, str]]()
    lines = list[int]()
    for element in elements:
        if element.name == "box":
            row = readers[root.name](element)
            if row:
                rows.append(row)
                lines.append(element.line)
    return table_of_text(source, text_of_rows(source.path, rows, lines))


def cvat_box(box: Element) -> tuple[Element, float, tuple[float, ...]]:
    """The track of a CVAT box, or the box itself if it has none; its frame from 0; its corners."""
    around = _around(box)
    if "image" in around:
        frame = around["image"].number("id")
    else:
        frame = box.number("frame")
    return around.get("track", box), frame, tuple(map(box.number, ("xtl", "ytl", "xbr", "ybr")))


def _cvat_row(box: Element) -> dict[str, str]:
    """The cells of a CVAT box; empty if the object is outside of the image."""
    if box.attributes.get("outside") == "1":
        return {}
    if not _around(box).keys() & {"track", "image"}:
        raise _misplaced(box, "<track> or <image>")
    track, frame, corners = cvat_box(box)
    names = ("frame", "left", "top", "right", "bottom")
    row = dict(zip(names, map(repr, (frame, *corners)), strict=True))
    if track is not box:
        row["id"] = repr(track.number("id"))
    row["class"] = as_cell(track.attributes.get("label", ""))
    return row


def _cvml_row(box: Element) -> dict[str, str]:
    """The cells of a CVML box; empty if it is the box of a group."""
    around = _around(box)
    if "group" in around:
        return {}
    if not around.keys() >= {"frame", "object"}:
        raise _misplaced(box, "<frame> and <object>")
    keys = (("cx", "xc"), ("cy", "yc"), ("width", "w"), ("height", "h"))
    row = {name: repr(box.number(key)) for name, key in keys}
    row["frame"] = repr(around["frame"].number("number"))
    row["id"] = repr(around["object"].number("id"))
    return row


def _around(box: Element) -> Mapping[str, Element]:
    """The elements around a box by their names."""
    return {element.name: element for element in box.around}


def _misplaced(box: Element, parents: str) -> InputError:
    return InputError(f"expected <box> inside of {parents}, got one outside", where=box.where)
