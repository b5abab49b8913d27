"""Masks, keypoints and anything else that a detector says of its boxes, given back by row.

The filter does not see it. A row knows the index of its detection, by which it finds its entries.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phdtrack.errors import InputError
from phdtrack.row_data import Columns, gathered, stacked
from phdtrack.types import Tracks

# The attributes of a result of Ultralytics, or of supervision's detections, that have an entry a
# box, by the name that it gets here. The numbers of ``masks`` and ``keypoints`` are their ``data``.
_OWN = {"masks": "masks", "keypoints": "keypoints", "mask": "mask", "xywhr": "xywhr"}


def as_box_data(values: object, n: int, where: str) -> dict[str, NDArray[Any]]:
    """Columns with an entry for each of n boxes.

    Parameters
    ----------
    values : a mapping from names to arrays, tensors or lists; or an object of supervision, whose
        ``data`` and ``mask`` are taken; or a result of Ultralytics, of which ``masks``,
        ``keypoints`` and the ``xywhr`` of oriented boxes are.
    n : number of boxes.
    where : begins error messages.

    Raises
    ------
    InputError : neither, a name that is no text, or another number of entries.
    """
    if not isinstance(values, Mapping):
        values = _of_object(values, where)
    columns = dict[str, NDArray[Any]]()
    for name, column in values.items():
        if not isinstance(name, str):
            raise InputError(
                f"expected names that are texts, got {name!r}", where=f"{where}, update(data=…)"
            )
        columns[name] = _column(column, n, f"{where}, update(data=…), {name!r}")
    return columns


def _of_object(holder: object, where: str) -> dict[str, Any]:
    """The data of boxes in an object of supervision or a result of Ultralytics."""
    result = holder[0] if isinstance(holder, list | tuple) and len(holder) == 1 else holder
    parts = [result, getattr(result, "obb", None)]
    if all(getattr(result, name, None) is None for name in ("boxes", "obb", "xyxy")):
        raise InputError(
            f"expected a mapping from names to arrays, got {type(holder).__name__}",
            where=f"{where}, update(data=…)",
            cure='Give data={"masks": masks}, or an object of supervision or Ultralytics.',
        )
    own = dict[str, Any]()
    inner = getattr(result, "data", None)
    if isinstance(inner, Mapping):
        own.update(inner)
    for name, attribute in _OWN.items():
        for part in parts:
            found = getattr(part, attribute, None)
            if found is not None:
                # The ``data`` of an array is its memory, that of a tensor the tensor.
                own[name] = (
                    found if isinstance(found, np.ndarray) else getattr(found, "data", found)
                )
    return own


def _column(values: Any, n: int, where: str) -> NDArray[Any]:
    """(n, …) an array of the entries."""
    expected = f"expected one entry for each of {n} boxes"
    detach = getattr(values, "detach", None)
    if detach is not None:
        values = detach().cpu()
    if isinstance(values, list | tuple):
        column = _of_list(values)
    else:
        column = np.asarray(values)
    if not column.ndim:
        raise InputError(f"{expected}, got {type(values).__name__}", where=where)
    if len(column) != n:
        raise InputError(f"{expected}, got {len(column)}", where=where)
    return column


def _of_list(values: Sequence[Any]) -> NDArray[Any]:
    """An array of numbers or texts; of Python objects if one is neither.

    Lists of arrays, as polygons, stay lists of arrays even where all have the same shape.
    """
    if all(isinstance(entry, int | float | str | np.number | np.bool_) for entry in values):
        return np.asarray(values)
    column = np.empty(len(values), np.object_)
    for k, entry in enumerate(values):
        column[k] = entry
    return column


class BoxDataBuffer:
    """The data of the boxes of the last frames, until their rows are given.

    Parameters
    ----------
    delay : observed frames by which rows lag.
    """

    def __init__(self, delay: int) -> None:
        self._delay = delay
        self._frames: deque[tuple[int, Columns]] = deque(maxlen=delay + 1)
        # A column without entries of each name so far: a frame without boxes has no masks.
        self._known = dict[str, NDArray[Any]]()

    def add(self, number: int, columns: Columns, count: int) -> None:
        """Keep what is known of the boxes of an observed frame.

        Parameters
        ----------
        number : of the frame.
        columns : by name; an entry for each box.
        count : number of boxes.
        """
        for name, column in columns.items():
            if count or name not in self._known:
                self._known[name] = column[:0].copy()
        if not self._known:
            return
        held = dict(columns) if count else {}
        if self._delay:
            # A loop may fill the same array again before the rows are due.
            held = {name: column.copy() for name, column in held.items()}
        self._frames.append((number, held))

    def attached(self, rows: Tracks) -> Tracks:
        """The rows with the data of the detection that each rests on."""
        if not self._known or not len(rows):
            return rows
        held = dict(self._frames)
        parts = list[Columns]()
        order = list[NDArray[np.int64]]()
        for number in np.unique(rows.frame).tolist():
            here = np.flatnonzero(rows.frame == number)
            order.append(here)
            parts.append(self._of_frame(held.get(number, {}), rows.detection[here]))
        place = np.argsort(np.concatenate(order))
        columns = stacked(parts, [len(here) for here in order])
        return replace(rows, data={name: column[place] for name, column in columns.items()})

    def _of_frame(self, columns: Columns, index: NDArray[np.int64]) -> Columns:
        """The entries of a frame's columns at an index, of every name so far."""
        nothing = np.full(len(index), -1)
        return {
            name: gathered(columns.get(name, like), index if name in columns else nothing)
            for name, like in self._known.items()
        }
