"""Tables of known columns: the motion of a camera, and positions on the ground.

**Motion of a camera**, a matrix for each frame:

    frame,g11,g12,g13,g21,g22,g23,g31,g32,g33

with this header or without; the last three may be left out (affine maps). Row k takes pixels of frame k − 1 to pixels of
frame k, both as (x, y, 1) from the upper left corner of the picture; frames count from 1. Frames without a line, the first
among them, are frames in which the camera stood still.

**Positions** as the ETH and UCY pedestrian data have them in ``obsmat.txt``: frame, identity, x, z, y, vx, vz, vy; metres
and metres per second, z upwards. Frames are numbers of a video that was annotated every so many frames; they are kept as
they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.files import AnyPath
from phdtrack.formats.checks import Rule, enforce, far, repeated, whole
from phdtrack.formats.text import read_columns
from phdtrack.formats.write import Lines
from phdtrack.models.warp import after, as_warp
from phdtrack.types import F8, I8, Bool

_WARP = ("frame", *(f"g{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)))
_POSITION = ("frame", "identity", "x", "z", "y", "vx", "vz", "vy")
_PLANE = [_POSITION.index(name) for name in ("x", "y", "vx", "vy")]


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
    """The motion of a camera in a file.

    Raises
    ------
    InputError : the file cannot be read; a line has other than 7 or 10 numbers; a frame number is none or comes twice; a
        matrix is no motion of a camera.
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
    """Writes the motion of a camera, frame by frame. Raises `InputError` where it cannot be written."""

    def __init__(self, path: AnyPath) -> None:
        super().__init__(path)
        self.write(",".join(_WARP))

    def append(self, frame: int, warp: F8) -> None:
        """Write the matrix (3, 3) that leads to frame ``frame``."""
        self.write("%d" + ",%.12g" * 9, np.array([frame]), warp.reshape(1, 9))


@dataclass(frozen=True, slots=True, eq=False)
class Positions:
    """People on the ground, sorted by frame, then identity.

    ``frame`` (M,), ``identity`` (M,), and ``state`` (4, M): px, py in metres, vx, vy in metres per second.
    """

    frame: I8
    identity: I8
    state: F8

    def __len__(self) -> int:
        return len(self.frame)

    def at(self, number: int) -> Positions:
        """The people of frame ``number``."""
        lo, hi = np.searchsorted(self.frame, [number, number + 1])
        return Positions(self.frame[lo:hi], self.identity[lo:hi], self.state[:, lo:hi])


def read_positions(path: AnyPath) -> Positions:
    """The people of an ``obsmat.txt``: eight numbers a line.

    Raises
    ------
    InputError : the file is missing, a line is malformed, a number is not finite, or an identity is twice in one frame.
    """
    origin, values = read_columns(path, _POSITION, (len(_POSITION),))
    bad: Bool = np.logical_not(np.isfinite(values).all(axis=1))
    again = repeated(values[:, 1], values[:, 0]) >= 0
    enforce(
        origin,
        Rule(bad, "expected finite numbers, came one that is not", values),
        whole(values[:, 0], "frame"),
        far(np.abs(values[:, 0])),
        whole(values[:, 1], "identity"),
        Rule(again, "expected each identity at most once in a frame, came one twice", values),
    )
    values = values[np.lexsort((values[:, 1], values[:, 0]))]
    frame, identity = values[:, :2].T.astype(np.int64)
    return Positions(frame, identity, np.ascontiguousarray(values[:, _PLANE].T))
