"""Boxes in XML: CVML, CVAT and UA-DETRAC.

CVML is the format of CAVIAR's ground truth, in which the truth of PETS 2009 is written too:

    <dataset> <frame number="0"> <objectlist> <object id="1"> <box xc=".." yc=".." w=".." h=".."/>
    ...

Frames count from 0, boxes are given by their centre. Groups have boxes of their own, which are
skipped.

CVAT has tracks, ``<annotations> <track id="1" label="car"> <box frame="0" outside="0" xtl=".."
ytl=".." xbr=".." ybr=".."/>``, or images, ``<image id="0"> <box label="car" …/>``, whose boxes have
no identities. Frames count from 0. Rotated boxes, polygons, ellipses, masks and cuboids are read as
the upright boxes around them. CVAT interpolates between keyframes, and writes the boxes between
them; if a file has none between two keyframes of a track, they are interpolated here.

UA-DETRAC has frames from 1, and regions to ignore that hold in all of them:

    <sequence> <ignored_region> <box left=".." top=".." width=".." height=".."/> </ignored_region>
    <frame num="1"> <target_list> <target id="1"> <box …/> <attribute vehicle_type="car"/> …
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from phdtrack.errors import InputError
from phdtrack.files import Element, read_xml
from phdtrack.formats.hulls import Shapes, hull, rotated_hull
from phdtrack.formats.table import Kind, Source, Table, table_of_text
from phdtrack.formats.text import as_cell, text_of_rows

CVAT_SHAPES = ("box", "polygon", "ellipse", "mask", "cuboid")
# CVAT's other shapes, which are no areas.
_OTHER_SHAPES = ("polyline", "points", "skeleton")
_CORNERS = ("left", "top", "right", "bottom")
# Frames between two keyframes, and boxes between all of them, at most.
_LONGEST_GAP = 10_000
MOST_BETWEEN = 1_000_000
_CUBOID = ("tl1", "bl1", "tr1", "br1", "tl2", "bl2", "tr2", "br2")


class _Format(NamedTuple):
    """A format: its name for ``--format``, its first frame, and the function that makes rows."""

    name: str
    first: int
    rows: Callable[[Source, list[Element]], tuple[list[dict[str, str]], list[int]]]


def table_of_xml(source: Source) -> Table:
    """The boxes of the objects in a CVML, CVAT or UA-DETRAC document. Raises `InputError` if it is
    none of them, or a box is malformed.
    """
    elements = read_xml(source.path, source.content)
    root = elements[0]
    formats = {
        "annotations": _Format("cvat", 0, _cvat_rows),
        "dataset": _Format("cvml", 0, _cvml_rows),
        "sequence": _Format("detrac", 1, _detrac_rows),
    }
    if root.name not in formats:
        raise InputError(
            "expected CVML or CVAT, whose outermost element is <dataset> or <annotations>, got"
            f" <{root.name}>",
            where=root.where,
            cure="UA-DETRAC, with <sequence>, is read, too.",
        )
    found = formats[root.name]
    if source.conventions.format not in ("", found.name):
        raise InputError(
            f"expected the format {source.conventions.format}, got {found.name}",
            where=root.where,
            cure="Leave out --format, or in Python format.",
        )
    if source.conventions.first_frame is None:
        source = source._replace(first=found.first)
    rows, lines = found.rows(source, elements)
    return table_of_text(source, text_of_rows(source.path, rows, lines))


def cvat_box(box: Element) -> tuple[Element, float, tuple[float, ...]]:
    """The track of a CVAT shape, or the shape itself if it has none; its frame from 0; the corners
    of the upright box around it.
    """
    around = _around(box)
    if "image" in around:
        frame = around["image"].number("id")
    else:
        frame = box.number("frame")
    return around.get("track", box), frame, _cvat_corners(box)


def _cvat_rows(source: Source, elements: list[Element]) -> tuple[list[dict[str, str]], list[int]]:
    """The rows of a CVAT document, and their lines. Shapes that are no boxes are reported."""
    rows = list[dict[str, str]]()
    lines = list[int]()
    shapes = Shapes()
    filled = 0
    before: Element | None = None
    for element in elements:
        outside = element.attributes.get("outside") == "1"
        if element.name in CVAT_SHAPES:
            between = _interpolated(before, element)
            filled += len(between)
            if filled > MOST_BETWEEN:
                raise InputError(
                    f"expected at most {MOST_BETWEEN:,} boxes between keyframes, got more",
                    where=element.where,
                    cure="Export all boxes, or correct the frames.",
                )
            rows += between
            lines += [element.line] * len(between)
            before = element
        if outside or any(around.name == "skeleton" for around in element.around):
            continue
        if element.name in _OTHER_SHAPES:
            shapes.left_out[element.name] += 1
        if element.name in CVAT_SHAPES:
            rows.append(_cvat_row(element))
            lines.append(element.line)
            if element.name != "box":
                shapes.read[element.name] += 1
            elif _rotation(element):
                shapes.read["rotated box"] += 1
    for sentence in shapes.sentences():
        source.report(sentence)
    if filled:
        source.report(f"{filled} boxes between keyframes are interpolated, as CVAT does")
    return rows, lines


def _interpolated(before: Element | None, after: Element) -> list[dict[str, str]]:
    """The rows between two keyframes of a track that follow each other in the file; none if the
    object is outside in one of them.
    """
    if before is None or "track" not in _around(after):
        return []
    if _around(before).get("track") is not _around(after)["track"]:
        return []
    for shape in (before, after):
        attributes = shape.attributes
        if attributes.get("keyframe") != "1" or attributes.get("outside") == "1":
            return []
    _, first, start = cvat_box(before)
    _, last, end = cvat_box(after)
    if not (first.is_integer() and last.is_integer() and 1 < last - first <= _LONGEST_GAP):
        return []
    rows = list[dict[str, str]]()
    for frame in range(int(first) + 1, int(last)):
        share = (frame - first) / (last - first)
        corners = [(1 - share) * a + share * b for a, b in zip(start, end, strict=True)]
        row = _cvat_row(after)
        row["frame"] = repr(float(frame))
        row |= dict(zip(_CORNERS, map(repr, corners), strict=True))
        rows.append(row)
    return rows


def _cvat_row(box: Element) -> dict[str, str]:
    """The cells of a CVAT shape."""
    if not _around(box).keys() & {"track", "image"}:
        raise _misplaced(box, "<track> or <image>")
    track, frame, corners = cvat_box(box)
    row = {"frame": repr(frame)} | dict(zip(_CORNERS, map(repr, corners), strict=True))
    if track is not box:
        row["id"] = repr(track.number("id"))
    row["class"] = as_cell(track.attributes.get("label", ""))
    return row


def _cvat_corners(shape: Element) -> tuple[float, ...]:
    """Left, top, right, bottom of the upright box around a CVAT shape."""
    if shape.name == "polygon":
        return _polygon_hull(shape)
    if shape.name == "cuboid":
        xs = [shape.number(f"x{corner}") for corner in _CUBOID]
        ys = [shape.number(f"y{corner}") for corner in _CUBOID]
        return hull(xs, ys)
    if shape.name == "mask":
        left, top, width, height = map(shape.number, ("left", "top", "width", "height"))
        return left, top, left + width, top + height
    if shape.name == "ellipse":
        x, y, across, down = map(shape.number, ("cx", "cy", "rx", "ry"))
        return rotated_hull(x - across, y - down, x + across, y + down, _rotation(shape))
    left, top, right, bottom = map(shape.number, ("xtl", "ytl", "xbr", "ybr"))
    return rotated_hull(left, top, right, bottom, _rotation(shape))


def _rotation(shape: Element) -> float:
    """Degrees by which a CVAT shape is rotated."""
    if shape.attributes.get("rotation", "") == "":
        return 0.0
    return shape.number("rotation")


def _polygon_hull(shape: Element) -> tuple[float, float, float, float]:
    """The upright box around ``points="x,y;x,y;…"``."""
    text = shape.attributes.get("points", "")
    try:
        points = [tuple(map(float, pair.split(","))) for pair in text.split(";")]
    except ValueError:
        points = []
    if not points or any(len(point) != 2 for point in points):
        raise InputError(
            f"expected points as x,y;x,y for <{shape.name}>, got '{text[:40]}'", where=shape.where
        )
    return hull([point[0] for point in points], [point[1] for point in points])


def _cvml_rows(source: Source, elements: list[Element]) -> tuple[list[dict[str, str]], list[int]]:
    """The rows of a CVML document without the boxes of groups, and their lines."""
    boxes = [
        element for element in elements if element.name == "box" and "group" not in _around(element)
    ]
    return [_cvml_row(box) for box in boxes], [box.line for box in boxes]


def _cvml_row(box: Element) -> dict[str, str]:
    """The cells of a CVML box."""
    around = _around(box)
    if not around.keys() >= {"frame", "object"}:
        raise _misplaced(box, "<frame> and <object>")
    keys = (("cx", "xc"), ("cy", "yc"), ("width", "w"), ("height", "h"))
    row = {name: repr(box.number(key)) for name, key in keys}
    row["frame"] = repr(around["frame"].number("number"))
    row["id"] = repr(around["object"].number("id"))
    return row


def _detrac_rows(source: Source, elements: list[Element]) -> tuple[list[dict[str, str]], list[int]]:
    """The rows of a UA-DETRAC document, and their lines; regions, of frame 0, for truth only."""
    words = {
        id(element.around[-1]): element.attributes["vehicle_type"]
        for element in elements
        if "vehicle_type" in element.attributes and element.around
    }
    rows = list[dict[str, str]]()
    lines = list[int]()
    for box in elements:
        around = _around(box)
        region = "ignored_region" in around
        if box.name != "box" or (region and source.kind is not Kind.TRUTH):
            continue
        if not region and not around.keys() >= {"frame", "target"}:
            raise _misplaced(box, "<frame> and <target>")
        row = {name: repr(box.number(name)) for name in ("left", "top", "width", "height")}
        row["frame"] = "0"
        row["id"] = "-1"
        row["class"] = "ignored"
        row["region"] = str(int(region))
        if not region:
            row["frame"] = repr(around["frame"].number("num"))
            row["id"] = repr(around["target"].number("id"))
            row["class"] = as_cell(words.get(id(around["target"]), "")) or "vehicle"
        rows.append(row)
        lines.append(box.line)
    return rows, lines


def _around(box: Element) -> Mapping[str, Element]:
    """The elements around a box by their names."""
    return {element.name: element for element in box.around}


def _misplaced(box: Element, parents: str) -> InputError:
    return InputError(f"expected <box> inside of {parents}, got one outside", where=box.where)
