"""The motion of a camera, a matrix for each frame:

    frame,g11,g12,g13,g21,g22,g23,g31,g32,g33

with this header or without; the last three may be left out (affine maps). Row k takes pixels of
frame k − 1 to pixels of frame k, both as (x, y, 1) from the upper left corner of the picture;
frames count from 1. Frames without a line, the first among them, are frames in which the camera
stood still.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.files import AnyPath
from phdtrack.formats.checks import Rule, enforce, far, repeated, whole
from phdtrack.formats.text import read_columns
from phdtrack.formats.write import Lines
from phdtrack.models.warp import after, as_warp
from phdtrack.types import F8, I8

_WARP = ("frame", *(f"g{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Warps:
    """``frame`` (K,) from 1, ascending, and the ``matrix`` (K, 3, 3) that leads to each from the
    one before.
    """

    frame: I8
    matrix: F8

    def between(self, before: int, number: int) -> F8:
        """(3, 3) from the pixels of frame ``before`` to those of the later frame ``number``."""
        first, last = np.searchsorted(self.frame, [before + 1, number + 1])
        return after(list(self.matrix[first:last]))


def read_warps(path: AnyPath) -> Warps:
    """The motion of a camera in a file.

    Raises `InputError` where the file cannot be read, a line has other than 7 or 10 numbers, a
    frame number is none or comes twice, or a matrix is no motion of a camera.
    """
    origin, values = read_columns(path, _WARP, (7, 10))
    number = values[:, 0]
    cure = "Frames count from 1; the matrix of frame 2 leads there from frame 1."
    twice = Rule(repeated(number) >= 0, "frame {:.0f} comes twice", number)
    enforce(origin, whole(number, "frame number", low=1, cure=cure), far(number), twice)
    order = np.argsort(number, kind="stable")
    matrix = [as_warp(values[k, 1:].reshape(-1, 3), origin.at(int(k))) for k in order]
    return Warps(number[order].astype(np.int64), np.array(matrix).reshape(-1, 3, 3))


class WarpsWriter(Lines):
    """Writes the motion of a camera, frame by frame. Raises `InputError` where it cannot be
    written.
    """

    def __init__(self, path: AnyPath) -> None:
        super().__init__(path)
        self.write(",".join(_WARP))

    def append(self, frame: int, warp: F8) -> None:
        """Write the matrix (3, 3) that leads to frame ``frame``."""
        self.write("%d" + ",%.12g" * 9, np.array([frame]), warp.reshape(1, 9))
