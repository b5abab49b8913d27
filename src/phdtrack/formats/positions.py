"""Positions on the ground, as the ETH and UCY pedestrian data have them in ``obsmat.txt``.

Frame, identity, x, z, y, vx, vz, vy; metres and metres per second, z upwards. Frames are numbers of a video that was
annotated every so many frames; they are kept as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.files import AnyPath
from phdtrack.formats.checks import Rule, enforce, repeated, whole
from phdtrack.formats.text import read_columns
from phdtrack.types import F8, I8, Bool

_COLUMNS = ("frame", "identity", "x", "z", "y", "vx", "vz", "vy")
_PLANE = [_COLUMNS.index(name) for name in ("x", "y", "vx", "vy")]


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
    origin, values = read_columns(path, _COLUMNS, (len(_COLUMNS),))
    bad: Bool = np.logical_not(np.isfinite(values).all(axis=1))
    again = repeated(values[:, 1], values[:, 0]) >= 0
    enforce(
        origin,
        Rule(bad, "expected finite numbers, came one that is not", values),
        whole(values[:, 0], "frame"),
        whole(values[:, 1], "identity"),
        Rule(again, "expected each identity at most once in a frame, came one twice", values),
    )
    values = values[np.lexsort((values[:, 1], values[:, 0]))]
    frame, identity = values[:, :2].T.astype(np.int64)
    return Positions(frame, identity, np.ascontiguousarray(values[:, _PLANE].T))
