"""The meaning of a network's outputs, and how boxes, scores and classes are read from them.

`onnx_recognition` finds the layout of a network.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
# Maps the outputs for one picture to boxes (N, 4), scores (N,) and classes (N,).
Decode = Callable[[Sequence[Array]], tuple[Array, Array, Array]]
LAYOUTS = ("yolov5", "yolov8", "yolox", "end2end", "rtdetr")
# Columns of left, top, right, bottom, score, class in the rows of most end-to-end networks.
USUAL_COLUMNS = (0, 1, 2, 3, 4, 5)
# Of the size of a box in cells: more is cut off.
_LARGEST_LOGARITHM = 20.0


class Layout(NamedTuple):
    """The meaning of a network's outputs.

    Attributes
    ----------
    decode : how boxes, scores and classes are read.
    classes : number of classes; 0 if unknown.
    overlapping : True if an object has several boxes.
    batched : True if the outputs have an axis for pictures.
    pixels : the usual scale of the input of such networks.
    bgr : True if such networks usually take blue before red.
    stretch : True if such networks are trained on pictures stretched to their input.
    name : of the layout, for the user.
    evidence : why it was recognised, for the user.
    guessed : True if the evidence also fits another layout.
    shares : True if boxes are in shares of the input, False if they are in pixels; None if that
        is seen only in the boxes of a frame.
    input_doubt : a sentence for the user if networks with such outputs differ in the input that
        they take; empty if they do not.
    """

    decode: Decode
    classes: int
    overlapping: bool
    batched: bool = True
    pixels: str = "unit"
    bgr: bool = False
    name: str = ""
    evidence: str = ""
    guessed: bool = False
    shares: bool | None = None
    stretch: bool = False
    input_doubt: str = ""


def unbatched() -> Layout:
    """The layout that passes all outputs on unchanged."""
    return Layout(partial(end_to_end, 0, USUAL_COLUMNS, False), 0, False, False)


def of_picture(outputs: Sequence[Array], index: int) -> list[Array]:
    """The outputs for one picture of a batch; those without an axis for pictures as they are."""
    return [array[index] if array.ndim and len(array) > index else array for array in outputs]


def end_to_end(
    place: int, columns: tuple[int, ...], centred: bool, outputs: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Decode rows of final boxes.

    Parameters
    ----------
    place : index of the output.
    columns : of the four numbers of the box, the score and the class.
    centred : True: the box is centre and size; False: left, top, right, bottom.
    outputs : of the network for one picture.
    """
    rows = outputs[place].astype(np.float32)
    rows = rows.reshape(-1, rows.shape[-1])
    boxes = rows[:, list(columns[:4])]
    if centred:
        boxes = _corners(boxes)
    return boxes, rows[:, columns[4]], rows[:, columns[5]]


def grid(
    place: int,
    upright: bool,
    objectness: bool,
    centred: bool,
    columns: tuple[int, int],
    outputs: Sequence[Array],
) -> tuple[Array, Array, Array]:
    """Decode rows of a box, objectness and scores.

    Parameters
    ----------
    place : index of the output.
    upright : False: rows and columns are exchanged.
    objectness : True if the fifth column is the probability of an object.
    centred : True: the box is centre and size; False: left, top, right, bottom.
    columns : the first column with scores, and the one after the last. None: there is one class.
    outputs : of the network for one picture.
    """
    rows = outputs[place] if upright else outputs[place].T
    rows = rows.astype(np.float32, copy=False)
    score, label = _largest(rows, objectness, columns)
    boxes = rows[:, :4]
    if centred:
        boxes = _corners(boxes)
    return boxes, score, label


def cells(
    place: int, anchors: Array, columns: tuple[int, int], outputs: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Decode rows of a YOLOX relative to cells: offset of the centre in cells, logarithm of the
    size in cells, objectness and scores.

    Parameters
    ----------
    place : index of the output.
    anchors : (N, 3) left and top of each cell in cells, and its side in pixels, as `cell_anchors`
        returns them.
    columns : the first column with scores, and the one after the last.
    outputs : of the network for one picture.
    """
    rows = outputs[place].astype(np.float32)
    side = anchors[:, 2:]
    centre = (rows[:, :2] + anchors[:, :2]) * side
    size = np.exp(np.minimum(rows[:, 2:4], _LARGEST_LOGARITHM)) * side
    score, label = _largest(rows, True, columns)
    return _corners(np.hstack([centre, size])), score, label


def cell_anchors(width: int, height: int, sides: Sequence[int]) -> Array:
    """The cells of an input, row by row for each side.

    Parameters
    ----------
    width, height : of the input in pixels.
    sides : of the cells in pixels.

    Returns
    -------
    anchors : (N, 3) left and top in cells, side in pixels.
    """
    levels = []
    for side in sides:
        top, left = np.mgrid[0 : -(-height // side), 0 : -(-width // side)]
        levels.append(np.stack([left, top, np.full_like(left, side)], axis=-1).reshape(-1, 3))
    return np.concatenate(levels).astype(np.float32)


def separate(
    places: tuple[int, int, int], order: list[int], centred: bool, outputs: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Decode boxes, scores, and labels if there are any.

    Parameters
    ----------
    places : indices of these outputs; that of labels is −1 without labels.
    order : of left, top, right and bottom in a box.
    centred : True: the box is centre and size; False: left, top, right, bottom.
    outputs : of the network for one picture. Scores and labels may have an axis of length 1 behind
        that of the boxes.
    """
    boxes, score = (outputs[place].astype(np.float32) for place in places[:2])
    label: Array = np.zeros(len(boxes), np.int64)
    if places[2] >= 0:
        label = outputs[places[2]].reshape(len(boxes))
    if places[1] == places[0]:
        # The fifth number of a box is its score.
        score = boxes[:, 4]
    boxes = boxes[:, order]
    if centred:
        boxes = _corners(boxes)
    return boxes, score.reshape(len(boxes)), label


class ClassScores(NamedTuple):
    """How the scores of all classes of a box are read.

    Attributes
    ----------
    function : sigmoid or softmax, to be applied; empty: these are probabilities.
    background : the column that means "no object"; None without such a column.
    """

    function: str = ""
    background: int | None = None

    def probabilities(self, table: Array) -> Array:
        """(N, C) the probability of each class; 0 in the column of the background."""
        table = table.astype(np.float64)
        if self.function:
            # Imported here because it takes long.
            from scipy.special import expit, softmax

            table = softmax(table, axis=1) if self.function == "softmax" else expit(table)
        if self.background is not None:
            table[:, self.background] = 0.0
        return table


def queries(
    places: tuple[int, int], scores: ClassScores, centred: bool, outputs: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Decode boxes and scores of all classes.

    Parameters
    ----------
    places : indices of the outputs with boxes and scores.
    scores : how these are read.
    centred : True: a box is centre and size; False: left, top, right, bottom.
    outputs : of the network for one picture.
    """
    boxes = outputs[places[0]].astype(np.float64)
    table = scores.probabilities(outputs[places[1]])
    if centred:
        boxes = _corners(boxes)
    return boxes, table.max(axis=1), table.argmax(axis=1)


def _largest(rows: Array, objectness: bool, columns: tuple[int, int]) -> tuple[Array, Array]:
    """(N,) the largest score of each row, times its objectness if there is one, and its class."""
    table = rows[:, columns[0] : columns[1]]
    if table.shape[1] == 0:
        return rows[:, 4], np.zeros(len(rows), np.int64)
    label = table.argmax(axis=1)
    score = table[np.arange(len(rows)), label]
    if objectness:
        score = score * rows[:, 4]
    return score, label


def _corners(centred: Array) -> Array:
    """(N, 4) left, top, right, bottom of boxes given by centre and size."""
    half = centred[:, 2:] / 2
    return np.hstack([centred[:, :2] - half, centred[:, :2] + half])
