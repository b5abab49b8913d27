"""The meaning of a network's outputs, recognised by shape and metadata.

* (1, 4 + C, N) or (1, N, 5 + C), YOLO: centre, size, possibly objectness, scores of C classes.
  Overlapping boxes are removed.
* (1, N, 6), end to end: left, top, right, bottom, score, class.
* Boxes (N, 4) or (1, N, 4) with separate scores and labels: corners as in torchvision and RT-DETR,
  top before left as in TensorFlow's ``detection_boxes``.
* Centred boxes with scores (1, N, C) of all classes, as in DETR, RT-DETR and RF-DETR: the largest
  after the sigmoid, or after the softmax if the last class is "no object".

The values for a uniformly grey picture tell apart layouts that share a shape.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
# Maps the outputs for one picture to boxes (N, 4), scores (N,) and classes (N,).
Decode = Callable[[Sequence[Array]], tuple[Array, Array, Array]]
LAYOUTS = ("yolov5", "yolov8", "end2end")
# Networks with more rows than this leave overlapping boxes in.
_MAX_FINAL_ROWS = 1000
# Share of grey rows in which the last class must win to be read as "no object".
_NO_OBJECT_SHARE = 0.9


class Layout(NamedTuple):
    """The meaning of a network's outputs.

    Attributes
    ----------
    decode : how boxes, scores and classes are read.
    classes : number of classes; 0 if unknown.
    overlapping : True if an object has several boxes.
    batched : True if the outputs have an axis for pictures.
    pixels : the usual scale of the input of such networks.
    """

    decode: Decode
    classes: int
    overlapping: bool
    batched: bool = True
    pixels: str = "unit"


def unbatched() -> Layout:
    """The layout that passes all outputs on unchanged."""
    return Layout(partial(end_to_end, 0), 0, False, False)


def recognise(
    outputs: Mapping[str, Array], layout: str, names: int, task: str, channels_last: bool
) -> Layout | None:
    """The layout of a network; None if it is not recognised.

    Parameters
    ----------
    outputs : its outputs for a uniformly grey picture, by name.
    layout : one of `LAYOUTS` if the user chose it, else empty.
    names : number of class names in the metadata.
    task : of the metadata; empty without one.
    channels_last : True if colours are the last axis of the input.
    """
    if task in ("obb", "classify"):
        return None
    found = _of_one([*outputs.values()], layout, names, task)
    if found is None and not layout:
        return _of_several(outputs, channels_last)
    return found


def _of_one(outputs: Sequence[Array], layout: str, names: int, task: str) -> Layout | None:
    """The layout of a network with everything in one output of three axes; None for others."""
    main = [k for k, output in enumerate(outputs) if output.ndim == 3]
    if len(main) != 1 or any(output.ndim < 3 for output in outputs):
        return None
    place = main[0]
    high, wide = outputs[place].shape[1:]
    # Masks and body points follow the scores. The sixth number of a row is a class, or the score of
    # one.
    more = task in ("segment", "pose")
    ended = (
        (wide == 6 or (more and 6 < wide < high))
        and high <= _MAX_FINAL_ROWS
        and not (outputs[place][..., 5] % 1).any()
    )
    if layout == "end2end" or (ended and not layout):
        if wide < 6:
            return None
        return Layout(partial(end_to_end, place), names, False)
    if names and not layout and wide == 4 + names and high != 4 + names:
        # Queries of an RT-DETR, or the cells of a YOLO.
        return Layout(partial(grid, place, True, 0, names), names, high > _MAX_FINAL_ROWS)
    flat = high < wide
    if names and not more:
        flat = high == 4 + names or (flat and wide != 5 + names)
    if layout == "yolov8" or (flat and not layout):
        if high <= 4:
            return None
        classes = names if more and names else high - 4
        return Layout(partial(grid, place, False, 0, classes), classes, True)
    # Negative sizes are logarithms: the boxes are not decoded.
    if wide <= 5 or (outputs[place][..., 2:4] < 0).any():
        return None
    return Layout(partial(grid, place, True, 1, wide - 5), wide - 5, True)


def _of_several(outputs: Mapping[str, Array], channels_last: bool) -> Layout | None:
    """The layout of a network with boxes, scores and classes in separate outputs; None for
    others.
    """
    fours = [name for name, one in outputs.items() if one.ndim in (2, 3) and one.shape[-1] == 4]
    boxes = next((name for name in fours if len(fours) == 1 or _has(name, "box")), "")
    if not boxes:
        return None
    place = {name: k for k, name in enumerate(outputs)}
    shape = outputs[boxes].shape
    batched = outputs[boxes].ndim == 3
    lists = [
        name for name, one in outputs.items() if one.shape == shape[:-1] and not _has(name, "num")
    ]
    labels = [
        name for name in lists if outputs[name].dtype.kind in "iu" or _has(name, "label|class")
    ]
    if len(lists) - len(labels) == 1 and len(labels) <= 1:
        order = [0, 1, 2, 3]
        if channels_last or _has(boxes, "detection_boxes"):
            order = [1, 0, 3, 2]
        scores = next(name for name in lists if name not in labels)
        label_place = place[labels[0]] if labels else -1
        places = (place[boxes], place[scores], label_place)
        return Layout(partial(separate, places, order), 0, False, batched)
    tables = [
        name
        for name, one in outputs.items()
        if one.ndim == len(shape) and one.shape[:-1] == shape[:-1] and name != boxes
    ]
    if len(tables) != 1:
        tables = [name for name in tables if _has(name, "logit|label|class|score|conf|prob")]
    if len(tables) != 1 or not outputs[boxes].size:
        return None
    corners = outputs[boxes].reshape(-1, 4)
    if not _has(boxes, "pred_boxes|dets") and (corners[:, 2:] >= corners[:, :2]).all():
        return None
    return _of_queries(outputs[tables[0]], boxes, (place[boxes], place[tables[0]]), batched)


def _of_queries(scores: Array, boxes: str, places: tuple[int, int], batched: bool) -> Layout:
    """The layout of a network with centred ``boxes``, given its ``scores`` of all classes for a
    grey picture.
    """
    table = scores.astype(np.float64)
    logits = bool(table.min() < 0 or table.max() > 1)
    last = table.shape[-1] - 1
    # A grey picture shows no object: a last class that wins nearly everywhere means "no object".
    no_object = bool(
        logits
        and (table.argmax(axis=-1) == last).mean() > _NO_OBJECT_SHARE
        and np.median(table[..., last]) > 0
    )
    pixels = "imagenet" if no_object or _has(boxes, "dets") else "unit"
    decode = partial(queries, places, logits, no_object)
    return Layout(decode, last + (not no_object), False, batched, pixels)


def _has(name: str, words: str) -> bool:
    """Return True if one of the ``words``, separated by ``|``, is part of a name."""
    return re.search(words, name.lower()) is not None


def end_to_end(place: int, outputs: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Decode rows of left, top, right, bottom, score, class."""
    rows = outputs[place].astype(np.float32)
    return rows[:, :4], rows[:, 4], rows[:, 5]


def grid(
    place: int, upright: bool, objectness: int, classes: int, outputs: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Decode rows of centre, size, objectness and scores.

    Parameters
    ----------
    place : index of the output.
    upright : False: rows and columns are exchanged.
    objectness : 1 if there is such a column, else 0.
    classes : number of columns with scores.
    outputs : of the network for one picture.
    """
    rows = outputs[place] if upright else outputs[place].T
    rows = rows.astype(np.float32, copy=False)
    table = rows[:, 4 + objectness : 4 + objectness + classes]
    label = table.argmax(axis=1)
    score = table[np.arange(len(rows)), label] * (rows[:, 4] if objectness else 1)
    return _corners(rows[:, :4]), score, label


def separate(
    places: tuple[int, int, int], order: list[int], outputs: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Decode boxes, scores, and labels if there are any.

    Parameters
    ----------
    places : indices of these outputs; that of labels is −1 without labels.
    order : of left, top, right and bottom in a box.
    outputs : of the network for one picture.
    """
    boxes, score = (outputs[place].astype(np.float32) for place in places[:2])
    label: Array = np.zeros(len(score), np.int64)
    if places[2] >= 0:
        label = outputs[places[2]]
    return boxes[:, order], score, label


def queries(
    places: tuple[int, int], logits: bool, no_object: bool, outputs: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Decode centred boxes and scores of all classes.

    Parameters
    ----------
    places : indices of the outputs with boxes and scores.
    logits : True if the scores are not yet probabilities.
    no_object : True if the last class means "no object".
    outputs : of the network for one picture.
    """
    boxes, table = (outputs[place].astype(np.float64) for place in places)
    if logits:
        # Imported here because it takes long.
        from scipy.special import expit, softmax

        if no_object:
            table = softmax(table, axis=1)[:, :-1]
        else:
            table = expit(table)
    return _corners(boxes), table.max(axis=1), table.argmax(axis=1)


def _corners(centred: Array) -> Array:
    """(N, 4) left, top, right, bottom of boxes given by centre and size."""
    half = centred[:, 2:] / 2
    return np.hstack([centred[:, :2] - half, centred[:, :2] + half])
