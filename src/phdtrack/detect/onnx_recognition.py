"""Recognises the layout of a network's outputs, by their shapes and values and by metadata.

The values are those for a uniformly grey picture. They tell apart layouts that share a shape:

* Columns of class scores lie between 0 and 1. Body points are in pixels, and numbers of masks are
  of both signs, so that they are no scores.
* Right is never left of left: boxes that break this are centres and sizes. Boxes of every cell of
  the input that keep it are corners: centres and sizes all over a picture would break it.
* Three boxes for each cell of the input mean a YOLO with anchors, one means a later one.
* Logarithms of sizes are negative where boxes are still relative to cells, as in a YOLOX.
* A class that wins nearly everywhere in a grey picture means "no object".

A layout that is named overrides the values, and values override metadata that do not fit them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from phdtrack.detect.onnx_layouts import (
    USUAL_COLUMNS,
    Array,
    ClassScores,
    Layout,
    cell_anchors,
    cells,
    end_to_end,
    grid,
    queries,
    separate,
)

# Networks with more rows than this leave overlapping boxes in.
_MAX_FINAL_ROWS = 1000
# Share of grey rows in which a class must win to be read as "no object".
_NO_OBJECT_SHARE = 0.9
# Coordinates in shares of the input may reach a little over 1.
MAX_SHARE = 2.0
# Scores of quantised networks may leave 0 to 1 by this much.
SCORE_TOLERANCE = 0.01
# Of boxes read as corners, so many have right and bottom behind left and top if they are corners;
# of boxes in shares nearly all.
_ORDERED_SHARE = 0.5
_ORDERED_SHARE_OF_SHARES = 0.95
# Of the boxes of every cell nearly all have area if they are corners.
_ORDERED_SHARE_OF_ALL = 0.95
# Sides of the cells of usual networks in pixels.
_USUAL_SIDES = (8, 16, 32)
_SIDES = (_USUAL_SIDES, (8, 16, 32, 64), (16, 32))
# Sums of probabilities of all classes differ from 1 by no more than this.
_SUM_TOLERANCE = 0.02
_COCO_CLASSES = 80
# What networks with the same outputs need where they differ.
_DETR_INPUTS = (
    "RT-DETR and D-FINE take this. Deformable DETR, Conditional DETR, DINO, LW-DETR and DEIMv2 need"
    " detector.pixels=imagenet; all but the last two detector.stretch=false."
)
_PADDLE_INPUTS = (
    "PP-YOLOE+ and RT-DETR take this. PP-YOLOE and PicoDet need detector.pixels=imagenet."
)
_MMDETECTION_INPUTS = (
    "Most of its networks take this. RTMDet needs detector.bgr=true, YOLOX detector.pixels=bytes"
    " and detector.bgr=true."
)
_SSD_INPUTS = (
    "That these are its pixels is a guess: MobileNet-SSD needs detector.pixels=signed, others"
    " detector.pixels=bytes, both often detector.bgr=true."
)
# Medians over all boxes of a grey picture, of what can be no score and of scores.
_LARGE_SCORE = 0.25
_SMALL_SCORE = 0.1
# Columns (image, left, top, right, bottom, class, score), (image, class, score, left, top, right,
# bottom), and (class, score, left, top, right, bottom).
_YOLOV7_COLUMNS = (1, 2, 3, 4, 6, 5)
_SSD_COLUMNS = (3, 4, 5, 6, 2, 1)
_PADDLE_COLUMNS = (2, 3, 4, 5, 1, 0)


class Probe(NamedTuple):
    """A network's outputs for a uniformly grey picture, and what is known of the network.

    Attributes
    ----------
    outputs : by name, with the axis for pictures.
    width, height : of the picture in pixels.
    fixed : True if the network takes no other size.
    layout : one of `onnx_layouts.LAYOUTS` if the user chose it, else empty.
    names : number of class names in the metadata.
    task, head : of the metadata; empty without them.
    channels_last : True if colours are the last axis of the input.
    sized : True if the network is given the size of the picture that boxes refer to.
    """

    outputs: Mapping[str, Array]
    width: int
    height: int
    fixed: bool
    layout: str
    names: int
    task: str
    head: str
    channels_last: bool
    sized: bool = False

    @property
    def is_rtdetr(self) -> bool:
        """True if user or metadata name an RT-DETR."""
        return self.layout == "rtdetr" or _has(self.head, "rt-?detr")

    def shape(self, place: int) -> str:
        """Name and shape of an output, for the user."""
        name, array = [*self.outputs.items()][place]
        return f"{name} {array.shape}"


def recognise(probe: Probe) -> Layout | None:
    """The layout of a network; None if it is not recognised."""
    if probe.task in ("obb", "classify"):
        return None
    place = _main_output(probe)
    found = None
    if place >= 0:
        found = _of_final_rows(probe, place)
        if found is None and not _is_rotated(probe, place):
            found = _of_grid(probe, place)
    if found is None and not probe.layout:
        found = _of_all_pictures(probe) or _of_several(probe)
    return found


def _main_output(probe: Probe) -> int:
    """The index of the output that has boxes, scores and classes; -1 if there is none.

    A YOLO v9 that was not converted has two of one shape, the auxiliary and the main one.
    """
    arrays = [*probe.outputs.values()]
    tables = [k for k, array in enumerate(arrays) if array.ndim == 3]
    alike = len({arrays[k].shape for k in tables}) == 1
    if not alike or not len(arrays[tables[0]]) or min(array.ndim for array in arrays) < 3:
        return -1
    return tables[-1]


def obstacle(probe: Probe) -> str:
    """The reason why outputs are not recognised, with the cure; empty if it is not known."""
    arrays = [*probe.outputs.values()]
    if any(array.dtype.kind == "f" and np.isnan(array).any() for array in arrays):
        return "Some outputs are no numbers: float16 may be too small. Export it with float32."
    if any(array.ndim == 5 for array in arrays) or sum(array.ndim == 4 for array in arrays) > 1:
        return "These are heads before their boxes are decoded: export the network with decoding."
    place = _main_output(probe)
    if place < 0 or min(arrays[place].shape[1:]) <= 4:
        return ""
    rotated = probe.task == "obb" or _is_rotated(probe, place)
    form = _form(probe, arrays[place])
    rows = arrays[place]
    if not form.upright:
        rows = rows.swapaxes(1, 2)
    rows = rows.reshape(-1, rows.shape[2])
    good = _are_scores(rows[:, 4:])
    if rotated or _ends_with_angle(probe, rows, 5 if form.objectness else 4):
        return "Rotated boxes are not supported."
    if not good.any():
        return "No numbers after the box are between 0 and 1: export the scores with their sigmoid."
    if form.objectness and (rows[:, 2:4] < 0).any():
        return "Sizes are negative: export the boxes decoded (YOLOX: --decode_in_inference)."
    return ""


def _of_all_pictures(probe: Probe) -> Layout | None:
    """The layout of a network with the boxes of all pictures in one output of 6 or 7 columns, and
    perhaps their number in another one; None for others.
    """
    arrays = [*probe.outputs.values()]
    tables = [k for k, array in enumerate(arrays) if array.ndim > 1]
    if len(tables) != 1 or len(arrays) > 2:
        return None
    place = tables[0]
    shape = arrays[place].shape
    guessed = False
    stretch = False
    doubt = ""
    if len(shape) == 2 and shape[1] == 7:
        columns = _YOLOV7_COLUMNS
        name = "YOLO v7 with suppression inside (image, corners, class, score)"
    elif len(shape) == 4 and shape[:2] == (1, 1) and shape[3] == 7:
        columns = _SSD_COLUMNS
        name = "SSD (image, class, score, corners)"
        stretch = True
        doubt = _SSD_INPUTS
    elif len(shape) == 2 and shape[1] == 6:
        rows = arrays[place]
        ends = not (rows[:, 5] % 1).any() and bool(_are_scores(rows[:, 4:5]).all())
        starts = not (rows[:, 0] % 1).any() and bool(_are_scores(rows[:, 1:2]).all())
        columns = USUAL_COLUMNS
        name = "final boxes (left, top, right, bottom, score, class)"
        if starts and (not ends or len(arrays) == 2):
            columns = _PADDLE_COLUMNS
            name = "PaddleDetection (class, score, corners)"
            stretch = True
            doubt = _PADDLE_INPUTS
        guessed = starts == ends
    else:
        return None
    decode = partial(end_to_end, place, columns, False)
    return Layout(
        decode,
        probe.names,
        False,
        False,
        name=name,
        evidence=f"the shape {probe.shape(place)}",
        guessed=guessed,
        stretch=stretch,
        input_doubt=doubt,
    )


def _of_final_rows(probe: Probe, place: int) -> Layout | None:
    """The layout of a network with rows of box, score, class, and perhaps masks or body points;
    None for others.
    """
    array = [*probe.outputs.values()][place]
    wide = array.shape[2]
    if wide < 6 or probe.layout.startswith("yolo"):
        return None
    rows = array.reshape(-1, wide)
    if probe.layout != "end2end" and not _are_final(probe, rows, array.shape[1]):
        return None
    centred = probe.is_rtdetr
    guessed = False
    evidence = f"the shape {probe.shape(place)} and whole numbers as classes"
    boxes = rows[rows[:, :4].any(axis=1), :4]
    if probe.layout:
        evidence = f"detector.layout={probe.layout}"
    elif centred:
        evidence = f"{probe.shape(place)} and {probe.head!r} in the metadata"
    elif len(boxes):
        ordered = float((boxes[:, 2:] >= boxes[:, :2]).all(axis=1).mean())
        shares = float(np.abs(boxes).max()) <= MAX_SHARE
        centred = ordered < (_ORDERED_SHARE_OF_SHARES if shares else _ORDERED_SHARE)
        guessed = shares and ordered >= _ORDERED_SHARE
        evidence += f"; as corners {ordered:.0%} of its boxes have left before right"
    else:
        guessed = not probe.names and not probe.task
    name = "final boxes (left, top, right, bottom, score, class)"
    overlapping = not probe.layout and array.shape[1] > _MAX_FINAL_ROWS
    if centred:
        name = "RT-DETR (centre, size, score, class)"
    elif overlapping:
        name = "boxes before suppression (left, top, right, bottom, score, class)"
        guessed = True
    return Layout(
        partial(end_to_end, place, USUAL_COLUMNS, centred),
        probe.names,
        overlapping,
        name=name,
        evidence=evidence,
        guessed=guessed,
        stretch=centred,
    )


def _are_final(probe: Probe, rows: Array, high: int) -> bool:
    """Return True if each row has a box, a score, a class, and perhaps masks or body points."""
    wide = rows.shape[1]
    if (rows[:, 5] % 1).any():
        return False
    if high > _MAX_FINAL_ROWS:
        # A score of exactly 0 or 1 in every row is a whole number, too, but not behind corners.
        scores = bool(_are_scores(rows[:, 4:5]).all())
        return wide == 6 and scores and _ordered_share(rows[:, :4]) >= _ORDERED_SHARE_OF_ALL
    # Scores of 0 and 1 are whole numbers, too.
    usual = _cell_count(probe, _USUAL_SIDES)
    if high in (usual, 3 * usual):
        return False
    if wide == 6:
        return True
    if wide >= high:
        return False
    if probe.task in ("segment", "pose"):
        return True
    if wide == 7 or (probe.names and wide - probe.names in (4, 5)):
        return False
    # Without any number there is nothing to see.
    return bool(rows.any() and _are_scores(rows[:, 4:5]).all())


def _is_rotated(probe: Probe, place: int) -> bool:
    """Return True if one number more follows the class in final rows, an angle."""
    array = [*probe.outputs.values()][place]
    high, wide = array.shape[1:]
    if wide != 7 or high > _MAX_FINAL_ROWS or probe.layout or _boxes_per_cell(probe, high):
        return False
    rows = array.reshape(-1, 7)
    return bool(rows[:, :4].any() and not (rows[:, 5] % 1).any())


class _Form(NamedTuple):
    """How a table of boxes and scores lies in an output.

    Attributes
    ----------
    upright : True if a row is a box; False: a column.
    objectness : True if the fifth number of a box is the probability of an object.
    name, evidence, guessed : as `Layout` has them.
    """

    upright: bool
    objectness: bool
    name: str
    evidence: str
    guessed: bool = False


_V5 = "YOLO v5 and v7 (centre, size, objectness, scores)"
_V6 = "YOLO v6 (centre, size, objectness 1, scores)"
_V8 = "YOLO v8 and later (centre, size, scores)"
_YOLOX = "YOLOX (centre, size, objectness, scores)"
_RTDETR = "RT-DETR (centre, size, scores)"
_CORNERS = "corners and scores of all classes (left, top, right, bottom, scores)"


def _of_grid(probe: Probe, place: int) -> Layout | None:
    """The layout of a network with a table of boxes and scores of all classes; None for others."""
    array = [*probe.outputs.values()][place]
    form = _form_with_corners(probe, array, _form(probe, array))
    rows = array if form.upright else array.swapaxes(1, 2)
    high, wide = rows.shape[1:]
    first = 5 if form.objectness else 4
    if wide <= first:
        return None
    rows = rows.reshape(-1, wide)
    columns = _score_columns(probe, rows, first)
    if columns is None:
        if not probe.layout:
            return None
        columns = (first, first + (probe.names or wide - first))
    classes = max(columns[1] - columns[0], 1)
    name = form.name
    if columns != (first, wide):
        name += f", {wide - first - columns[1] + columns[0]} further numbers of each box left out"
    layout = Layout(
        partial(grid, place, form.upright, form.objectness, form.name != _CORNERS, columns),
        classes,
        form.name != _RTDETR,
        name=name,
        evidence=form.evidence,
        guessed=form.guessed,
        stretch=form.name == _RTDETR,
    )
    if form.name == _YOLOX:
        layout = layout._replace(pixels="bytes", bgr=True)
    if not form.objectness or not (rows[:, 2:4] < 0).any():
        return layout
    # Negative sizes are logarithms: the boxes are relative to cells of the input.
    if form.name != _YOLOX or _boxes_per_cell(probe, high) != 1 or not probe.fixed:
        return None
    sides = next(one for one in _SIDES if _cell_count(probe, one) == high)
    anchors = cell_anchors(probe.width, probe.height, sides)
    return layout._replace(
        decode=partial(cells, place, anchors, columns),
        evidence=f"{form.evidence} and logarithms of sizes",
        guessed=False,
    )


def _form(probe: Probe, array: Array) -> _Form:
    """How a table of boxes and scores lies in a (B, H, W) output."""
    high, wide = array.shape[1:]
    names = probe.names
    if probe.layout:
        return _chosen_form(probe, high, wide)
    shape = f"the shape {array.shape}"
    if names and wide == 4 + names and high != 4 + names:
        name = _V8 if high > _MAX_FINAL_ROWS else _RTDETR
        return _Form(True, False, name, f"{shape} and {names} names of classes")
    flat = high < wide
    if names and probe.task not in ("segment", "pose"):
        flat = high == 4 + names or (flat and wide != 5 + names)
    if flat:
        return _Form(False, False, _V8, shape)
    per_cell = _boxes_per_cell(probe, high)
    if per_cell == 3:
        return _Form(True, True, _V5, f"{shape}, three boxes for each cell")
    if names and wide == 5 + names and per_cell != 1:
        return _Form(True, True, _V5, f"{shape} and {names} names of classes")
    if probe.is_rtdetr:
        return _Form(True, False, _RTDETR, f"{shape} and {probe.head!r} in the metadata")
    if per_cell == 1 and wide > 5:
        return _form_of_one_per_cell(array, names, shape)
    boxes = array[..., :4]
    shares = boxes.any() and float(boxes.min()) >= 0 and float(boxes.max()) <= 1
    if not names and high <= _MAX_FINAL_ROWS and shares:
        return _Form(True, False, _RTDETR, f"{shape} and boxes in shares of the input", True)
    return _Form(True, True, _V5, shape, True)


def _form_with_corners(probe: Probe, array: Array, form: _Form) -> _Form:
    """The form of a table that looks like ``form``, by its boxes: corners for those of SSD, RTMDet,
    PicoDet and others, which have the shape of a YOLO's.
    """
    rows = array if form.upright else array.swapaxes(1, 2)
    if probe.layout or rows.shape[2] <= 4 or not _have_corners(probe, rows[..., :4]):
        return form
    ordered = _ordered_share(rows[..., :4].reshape(-1, 4))
    evidence = f"{form.evidence}; as corners {ordered:.0%} of its boxes have left before right"
    return _Form(form.upright, False, _CORNERS, evidence, True)


def _have_corners(probe: Probe, boxes: Array) -> bool:
    """Return True if boxes (B, N, 4) from all over the picture are corners: right is never left of
    left and, with a box for each cell, the middles of the corners are nearer to the cells.
    """
    count = boxes.shape[1]
    if not len(boxes) or not _is_dense(probe, count):
        return False
    ordered = _ordered_share(boxes.reshape(-1, 4))
    if _boxes_per_cell(probe, count) != 1:
        return ordered >= _ORDERED_SHARE_OF_ALL
    sides = next(one for one in _SIDES if _cell_count(probe, one) == count)
    cell = cell_anchors(probe.width, probe.height, sides)
    places = (cell[:, :2] + 0.5) * cell[:, 2:]
    first = boxes[0].astype(np.float64)
    if np.abs(first).max() <= MAX_SHARE:
        first = first * [probe.width, probe.height, probe.width, probe.height]
    as_centres = np.median(np.abs(first[:, :2] - places) / cell[:, 2:])
    as_corners = np.median(np.abs((first[:, :2] + first[:, 2:]) / 2 - places) / cell[:, 2:])
    return bool(ordered >= _ORDERED_SHARE and as_corners < as_centres)


def _is_dense(probe: Probe, count: int) -> bool:
    """Return True if so many boxes come from all over the picture, several for an object."""
    return count > _MAX_FINAL_ROWS or _boxes_per_cell(probe, count) > 0


def _ordered_share(boxes: Array) -> float:
    """The share of boxes (N, 4) that have area if they are corners; 0 without boxes."""
    if not len(boxes):
        return 0.0
    return float((boxes[:, 2:] > boxes[:, :2]).all(axis=1).mean())


def _chosen_form(probe: Probe, high: int, wide: int) -> _Form:
    """How a table of boxes and scores lies in an output, in the layout that the user chose."""
    evidence = f"detector.layout={probe.layout}"
    if probe.layout == "rtdetr":
        return _Form(True, False, _RTDETR, evidence)
    if probe.layout == "yolox":
        return _Form(True, True, _YOLOX, evidence)
    if probe.layout == "yolov5":
        return _Form(True, True, _V5, evidence)
    upright = high > _MAX_FINAL_ROWS > wide
    if not upright and probe.names:
        upright = wide == 4 + probe.names and high != 4 + probe.names
    return _Form(upright, False, _V8, evidence)


def _form_of_one_per_cell(array: Array, names: int, shape: str) -> _Form:
    """How a table with one row for each cell lies in an output."""
    shape += ", one box for each cell"
    if (np.abs(array[..., 4] - 1) <= SCORE_TOLERANCE).all():
        return _Form(True, True, _V6, f"{shape}, objectness always 1")
    if not names and array.shape[2] == 4 + _COCO_CLASSES:
        return _Form(True, False, _V8, f"{shape}, {_COCO_CLASSES} scores", True)
    return _Form(True, True, _YOLOX, shape, True)


def _score_columns(probe: Probe, rows: Array, first: int) -> tuple[int, int] | None:
    """The first column of class scores and the one after the last; None if there are none.

    Parameters
    ----------
    probe : of the network.
    rows : (N, K) boxes, scores and what else there is.
    first : column that may have a score.
    """
    wide = rows.shape[1]
    good = _are_scores(rows)
    if not good[4:first].all() or _ends_with_angle(probe, rows, first):
        return None
    more = wide - first - probe.names
    if probe.names and more >= 0 and good[first : first + probe.names].all():
        masks_or_points = probe.task in ("segment", "pose") or more in (0, *_masks(probe))
        if masks_or_points or not good[first:].all():
            return first, first + probe.names
    for masks in _masks(probe):
        last = wide - masks
        if last > first and good[first:last].all():
            return first, last
    leading = int(np.argmin([*good[first:], False]))
    rest = wide - first - leading
    # A body point has two or three numbers.
    if leading and (rest % 2 == 0 or rest % 3 == 0):
        return first, first + leading
    if leading or first == 4:
        return None
    return _columns_behind_points(good)


def _ends_with_angle(probe: Probe, rows: Array, first: int) -> bool:
    """Return True if the last column is an angle: it is outside 0 to 1, or has large numbers in a
    grey picture, where scores are small.
    """
    count = rows.shape[1] - first
    if count < 2 or probe.names == count or first == 5 or not len(rows):
        return False
    good = _are_scores(rows[:, first:])
    usual = np.median(rows[:, first:], axis=0)
    return bool(
        good[:-1].all()
        and (not good[-1] or (usual[-1] > _LARGE_SCORE and usual[:-1].max() < _SMALL_SCORE))
    )


def _columns_behind_points(good: Array) -> tuple[int, int] | None:
    """The columns of class scores behind those of face or body points, which begin at the sixth;
    None if there are none.

    Parameters
    ----------
    good : (K,) True for columns with numbers between 0 and 1.
    """
    wide = len(good)
    last = int(np.flatnonzero(~good)[-1])
    if last >= 7 and good[7 : last + 1 : 3].all():
        # Every third number says how visible a point is.
        last += 1
    points = last + 1 - 5
    if last < wide and points > 1 and (points % 2 == 0 or points % 3 == 0):
        return last + 1, wide
    return None


def _masks(probe: Probe) -> tuple[int, ...]:
    """How many masks there may be that others are made of, the smaller number first; empty without
    such an output.
    """
    pictures = [array for array in probe.outputs.values() if array.ndim == 4]
    if len(pictures) != 1:
        return ()
    shape = pictures[0].shape
    return tuple(sorted({int(shape[1]), int(shape[3])} - {0}))


def _are_scores(rows: Array) -> Array:
    """(K,) True for columns with nothing but numbers between 0 and 1."""
    inside = (rows >= -SCORE_TOLERANCE) & (rows <= 1 + SCORE_TOLERANCE)
    return np.asarray(inside.all(axis=0))


def _boxes_per_cell(probe: Probe, count: int) -> int:
    """1 or 3 if a network has so many boxes for each cell of its input, else 0."""
    for sides in _SIDES:
        total = _cell_count(probe, sides)
        if count in (total, 3 * total):
            return count // total
    return 0


def _cell_count(probe: Probe, sides: tuple[int, ...]) -> int:
    """The number of cells of an input, for cells of these sides in pixels."""
    return sum(-(-probe.width // side) * -(-probe.height // side) for side in sides)


def _of_several(probe: Probe) -> Layout | None:
    """The layout of a network with boxes, scores and classes in separate outputs; None for
    others.
    """
    outputs = probe.outputs
    boxes, width = _box_output(outputs)
    if not boxes or (outputs[boxes].ndim == 3 and not len(outputs[boxes])):
        return None
    place = {name: k for k, name in enumerate(outputs)}
    shape = outputs[boxes].shape
    batched = outputs[boxes].ndim == 3
    lists = _lists(outputs, shape[:-1])
    labels = [
        name for name in lists if outputs[name].dtype.kind in "iu" or _has(name, "label|class")
    ]
    if labels:
        # Scores may have an axis of length 1.
        lists += _lists(outputs, (*shape[:-1], 1))
    evidence = f"the outputs {', '.join(probe.shape(k) for k in range(len(outputs)))}"
    if width == 5 and len(lists) == len(labels) == 1:
        places = (place[boxes], place[boxes], place[labels[0]])
        name = "MMDetection (corners with score; label)"
        decode = partial(separate, places, [0, 1, 2, 3], False)
        return Layout(
            decode,
            0,
            False,
            batched,
            "imagenet",
            name=name,
            evidence=evidence,
            input_doubt=_MMDETECTION_INPUTS,
        )
    if width == 4 and len(lists) - len(labels) == 1 and len(labels) <= 1:
        scores = next(name for name in lists if name not in labels)
        label_place = place[labels[0]] if labels else -1
        listed = _of_lists(probe, boxes, (place[boxes], place[scores], label_place))
        return listed._replace(batched=batched, evidence=f"{evidence}{listed.evidence}")
    if width == 5 or _has(boxes, "detection_boxes"):
        return None
    tables = [
        name
        for name, one in outputs.items()
        if one.ndim == len(shape) and one.shape[:-1] == shape[:-1] and name != boxes
    ]
    if len(tables) != 1:
        tables = [name for name in tables if _has(name, "logit|label|class|score|conf|prob")]
    if len(tables) != 1 or not outputs[boxes].size or not outputs[tables[0]].size:
        return None
    found = _of_queries(probe, boxes, tables[0])
    if found is None:
        return None
    return found._replace(batched=batched, evidence=f"{evidence}; {found.evidence}")


def _lists(outputs: Mapping[str, Array], shape: tuple[int, ...]) -> list[str]:
    """The names of outputs of this shape that may be scores or labels of boxes."""
    return [
        name
        for name, one in outputs.items()
        if one.shape == shape and not _has(name, "num|anchor|indices")
    ]


def _of_lists(probe: Probe, boxes: str, places: tuple[int, int, int]) -> Layout:
    """The layout of a network with an output ``boxes`` and a score and a label for each of them, at
    these ``places``.
    """
    corners = probe.outputs[boxes].reshape(-1, 4)
    corners = corners[corners.any(axis=1)]
    order = [0, 1, 2, 3]
    name = "boxes, scores and labels (left, top, right, bottom)"
    evidence = ""
    if probe.channels_last or _has(boxes, "detection_boxes"):
        order = [1, 0, 3, 2]
        name = "TensorFlow's boxes, scores and classes (top, left, bottom, right)"
    inverted = (corners[:, 2:] < corners[:, :2]).any(axis=1)
    centred = len(corners) > 0 and float(inverted.mean()) > 1 - _ORDERED_SHARE
    if centred:
        name = "boxes, scores and labels (centre, size)"
        evidence = f"; as corners {inverted.mean():.0%} of its boxes have right left of left"
    return Layout(
        partial(separate, places, order, centred),
        0,
        _is_dense(probe, probe.outputs[boxes].shape[-2]),
        name=name,
        evidence=evidence,
        guessed=centred,
        stretch=probe.sized,
    )


def _box_output(outputs: Mapping[str, Array]) -> tuple[str, int]:
    """The name of the output with boxes, and its number of columns; empty and 0 without one."""
    for width in (4, 5):
        names = [
            name
            for name, one in outputs.items()
            if one.ndim in (2, 3) and one.shape[-1] == width and not _has(name, "raw")
        ]
        for name in names:
            if len(names) == 1 or _has(name, "box|dets"):
                return name, width
    return "", 0


def _of_queries(probe: Probe, boxes: str, table: str) -> Layout | None:
    """The layout of a network with outputs ``boxes`` and ``table``, the scores of all classes; None
    if nothing says whether the boxes are corners.
    """
    names = [*probe.outputs]
    places = (names.index(boxes), names.index(table))
    corners = probe.outputs[boxes].reshape(-1, 4)
    many = _is_dense(probe, probe.outputs[boxes].shape[-2])
    ordered = float((corners[:, 2:] >= corners[:, :2]).all(axis=1).mean())
    scores, evidence = _class_scores(probe.outputs[table])
    classes = probe.outputs[table].shape[-1]
    if scores.background == classes - 1:
        classes -= 1
    are_corners = _have_corners(probe, corners.reshape(-1, probe.outputs[boxes].shape[-2], 4))
    named = _has(boxes, "pred_boxes|dets") and not are_corners
    if named or ordered < (_ORDERED_SHARE if many else 1):
        found = Layout(
            partial(queries, places, scores, True),
            classes,
            many,
            name="DETR (centre, size; scores of all classes)",
            evidence=evidence,
        )
        if scores.background is not None:
            return found._replace(pixels="imagenet")
        if _has(boxes, "dets"):
            return found._replace(pixels="imagenet", stretch=True)
        return found._replace(stretch=True, input_doubt=_DETR_INPUTS)
    if not _ordered_share(corners) > _ORDERED_SHARE:
        return None
    name = "SSD or YOLO-NAS (corners; scores of all classes)"
    decode = partial(queries, places, scores, False)
    return Layout(decode, classes, many, name=name, evidence=evidence, guessed=True)


def _class_scores(table: Array) -> tuple[ClassScores, str]:
    """How the scores of all classes are read, and why, given those for a grey picture.

    A grey picture shows no object: the last or the first class, if it wins nearly everywhere, means
    "no object".
    """
    table = table.astype(np.float64).reshape(-1, table.shape[-1])
    logits = bool(table.min() < -SCORE_TOLERANCE or table.max() > 1 + SCORE_TOLERANCE)
    last = table.shape[1] - 1
    exclusive = bool((np.abs(table.sum(axis=1) - 1) <= _SUM_TOLERANCE).all())
    winners = table.argmax(axis=1)
    background = None
    for column in (last, 0):
        wins = float((winners == column).mean()) > _NO_OBJECT_SHARE
        if wins and last and (exclusive or (logits and np.median(table[:, column]) > 0)):
            background = column
            break
    if logits:
        function = "sigmoid" if background is None else "softmax"
        evidence = f"scores from {table.min():.2g} to {table.max():.2g} are read by {function}"
    else:
        function = ""
        evidence = "scores are between 0 and 1"
    if background is not None:
        evidence += f", class {background} means no object"
    return ClassScores(function, background), evidence


def _has(name: str, words: str) -> bool:
    """Return True if one of the ``words``, separated by ``|``, is part of a name."""
    return re.search(words, name.lower()) is not None
