"""Positions on the ground, and annotated groups, as the ETH and UCY pedestrian data have them.

``obsmat.txt``: frame, identity, x, z, y, vx, vz, vy; metres and metres per second, z upwards. Frames are numbers of a video
that was annotated every so many frames; they are kept as they are.
``groups.txt``: the identities of one group a line, for the whole sequence.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.formats.rows import Rule, enforce, repeated, whole
from phdtrack.formats.text import numbers, scan
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
    text = scan(Path(path), load(path))
    if len(text) and text.width != len(_COLUMNS):
        raise InputError(
            f"expected {len(_COLUMNS)} columns ({' '.join(_COLUMNS)}), came {text.width}",
            where=text.origin.at(0),
            cure="Positions are read as in the obsmat.txt of the ETH and UCY data.",
        )
    values = numbers(text, range(len(_COLUMNS)), _COLUMNS)
    bad: Bool = np.logical_not(np.isfinite(values).all(axis=1))
    infinite = Rule(bad, "expected finite numbers, came one that is not", values)
    enforce(text.origin, infinite, whole(values[:, 0], "frame"), whole(values[:, 1], "identity"))
    order = np.lexsort((values[:, 1], values[:, 0]))
    frame, identity = values[order, :2].T.astype(np.int64)
    again = repeated(values[:, 1], values[:, 0]) >= 0
    enforce(text.origin, Rule(again, "expected each identity at most once in a frame, came one twice", values))
    return Positions(frame, identity, np.ascontiguousarray(values[order][:, _PLANE].T))


def read_groups(path: AnyPath) -> tuple[tuple[int, ...], ...]:
    """The groups of a ``groups.txt``: identities, one group a line, separated by blanks.

    Lines that share people, directly or by a chain of lines, are one group. Groups are in the order of their first line,
    identities ascend.

    Raises
    ------
    InputError : the file is missing, or an identity is no whole number.
    """
    text = scan(Path(path), load(path))
    found: list[set[int]] = []
    for row in range(len(text)):
        cells = [cell for cell in text.cells(row) if cell]
        wrong = next((cell for cell in cells if not cell.lstrip("-").isdigit()), None)
        if wrong is not None:
            raise InputError(f"expected identities, came '{wrong[:40]}'", where=text.origin.at(row))
        line = {int(cell) for cell in cells}
        linked = [group for group in found if group & line] or [set()]
        linked[0].update(line, *linked[1:])
        found = [group for group in found if not group & line or group is linked[0]]
        if linked[0] not in found:
            found.append(linked[0])
    return tuple(tuple(sorted(group)) for group in found)
