"""Camera motion as a file, one matrix per frame:

    frame,g11,g12,g13,g21,g22,g23,g31,g32,g33

with or without this header; affine maps may omit the last three columns. Row k maps pixels of frame
k − 1 to pixels of frame k, both as (x, y, 1) from the upper left corner of the image. Frames count
from 1. In frames without a line, such as the first, the camera stands still.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.files import AnyPath
from phdtrack.formats.checks import (
    Rule,
    after_last_frame,
    earlier_duplicate,
    enforce,
    whole_number,
)
from phdtrack.formats.text import read_columns
from phdtrack.formats.write import Lines
from phdtrack.models.warp import after, as_warp
from phdtrack.types import F8, I8

_COLUMNS = ("frame", *(f"g{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Warps:
    """The motion of a camera: ``frame`` (K,) from 1, ascending, and ``matrix`` (K, 3, 3), which
    maps pixels of the previous frame to pixels of that frame.
    """

    frame: I8
    matrix: F8

    def between(self, before: int, number: int) -> F8:
        """(3, 3) map from pixels of frame ``before`` to pixels of the later frame ``number``."""
        first, last = np.searchsorted(self.frame, [before + 1, number + 1])
        return after(list(self.matrix[first:last]))


def read_warps(path: AnyPath) -> Warps:
    """Read the motion of a camera.

    Raises `InputError` if the file cannot be read, a line has other than 7 or 10 numbers, a frame
    number is invalid or repeated, or a matrix cannot be the motion of a camera.

    Parameters
    ----------
    path : a row per frame, ``frame,g11,g12,g13,g21,g22,g23[,g31,g32,g33]``.

    Returns
    -------
    The maps by frame, from pixels of the frame before to pixels of this one.
    """
    origin, values = read_columns(path, _COLUMNS, (7, 10))
    number = values[:, 0]
    cure = "Frames count from 1; the matrix of frame 2 maps pixels of frame 1 to frame 2."
    enforce(
        origin,
        whole_number(number, "frame number", low=1, cure=cure),
        after_last_frame(number),
        Rule(earlier_duplicate(number) >= 0, "frame {:.0f} is given twice", number),
    )
    order = np.argsort(number, kind="stable")
    matrix = [as_warp(values[k, 1:].reshape(-1, 3), origin.at(int(k))) for k in order]
    return Warps(number[order].astype(np.int64), np.array(matrix).reshape(-1, 3, 3))


class WarpsWriter(Lines):
    """Writes the motion of a camera frame by frame. Raises `InputError` if the file cannot be
    written.

    Parameters
    ----------
    path : the file; an existing one is replaced.
    """

    def __init__(self, path: AnyPath) -> None:
        super().__init__(path)
        self.write(",".join(_COLUMNS))

    def append(self, frame: int, warp: F8) -> None:
        """Write the matrix (3, 3) that maps pixels of the previous frame to frame ``frame``.

        Parameters
        ----------
        frame : number of the frame, from 1.
        warp : (3, 3) homography, pixels.
        """
        self.write("%d" + ",%.12g" * 9, np.array([frame]), warp.reshape(1, 9))
