"""The motion of a camera as text: a matrix for each frame.

    frame,g11,g12,g13,g21,g22,g23,g31,g32,g33

One line per frame, with this header or without; the last three may be left out (affine maps). Row k takes pixels of frame
k − 1 to pixels of frame k, both as (x, y, 1) from the upper left corner of the picture; frames count from 1. Frames without
a line, the first among them, are frames in which the camera stood still.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.formats.rows import Rule, enforce, repeated
from phdtrack.formats.text import Text, numbers, scan
from phdtrack.formats.write import Lines
from phdtrack.models.warp import after, as_warp
from phdtrack.types import F8, I8

_NAMES = ("frame", *(f"g{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)))
_AFFINE = 7


@dataclass(frozen=True, slots=True, eq=False)
class Warps:
    """``frame`` (K,) from 1, ascending, and the ``matrix`` (K, 3, 3) that leads to each from the one before."""

    frame: I8
    matrix: F8

    def between(self, before: int, number: int) -> F8:
        """(3, 3) from the pixels of frame ``before`` to those of the later frame ``number``."""
        first, last = np.searchsorted(self.frame, [before + 1, number + 1])
        return after(list(self.matrix[first:last]))


def read_warps(path: AnyPath) -> Warps:
    """Read such a file.

    Raises
    ------
    InputError : the file cannot be read; a line has other than 7 or 10 numbers; a frame number is none or comes twice; a
        matrix is no motion of a camera.
    """
    text = scan(Path(path), load(path))
    columns = _columns(text)
    values = numbers(text, columns, _NAMES[: len(columns)])
    cure = "Frames count from 1; the matrix of frame 2 leads there from frame 1."
    wrong = ~((values[:, 0] >= 1) & (values[:, 0] % 1 == 0))
    enforce(text.origin, Rule(wrong, "expected a frame number from 1, came {:g}", values[:, 0], cure))
    order = np.argsort(values[:, 0], kind="stable")
    frame = values[order, 0].astype(np.int64)
    enforce(text.origin, Rule(repeated(values[:, 0]) >= 0, "frame {:.0f} comes twice", values[:, 0]))
    matrix = [as_warp(values[k, 1:].reshape(-1, 3), text.origin.at(int(k))) for k in order]
    return Warps(frame, np.array(matrix).reshape(-1, 3, 3))


def _columns(text: Text) -> list[int]:
    """Where frame, g11, g12, … stand."""
    if text.header:
        found = [name for name in _NAMES if name in text.header]
        if found not in (list(_NAMES), list(_NAMES[:_AFFINE])):
            wanted = f"expected the columns {', '.join(_NAMES)}, the last three optional"
            raise InputError(f"{wanted}, came {', '.join(text.header)}", where=text.origin.path)
        return [text.header.index(name) for name in found]
    if len(text) and text.width not in (len(_NAMES), _AFFINE):
        raise InputError(
            f"expected {_AFFINE} or {len(_NAMES)} numbers, came {text.width}",
            where=text.origin.at(0),
            cure=f"The columns are {','.join(_NAMES)}; the last three may be left out.",
        )
    return list(range(text.width or _AFFINE))


class WarpsWriter(Lines):
    """Such a file, frame by frame. Raises `InputError` where it cannot be written."""

    def __init__(self, path: AnyPath) -> None:
        super().__init__(path)
        self.write(",".join(_NAMES))

    def append(self, frame: int, warp: F8) -> None:
        """Write the matrix (3, 3) that leads to frame ``frame``."""
        self.write("%d" + ",%.12g" * 9, np.array([frame]), warp.reshape(1, 9))
