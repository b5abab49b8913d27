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
from phdtrack.formats.text import Origin, numbers, scan
from phdtrack.types import F8, I8, Bool

_COLUMNS = ("frame", "identity", "x", "z", "y", "vx", "vz", "vy")
# x, y, vx, vy among the columns.
_PLANE = [2, 4, 5, 7]


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
        """The people of frame ``number``; none where nobody was there."""
        lo, hi = np.searchsorted(self.frame, [number, number + 1])
        return Positions(self.frame[lo:hi], self.identity[lo:hi], self.state[:, lo:hi])


def read_positions(path: AnyPath) -> Positions:
    """The people of an ``obsmat.txt``: eight numbers a line.

    Raises
    ------
    InputError : the file is missing, a line is malformed, a number is not finite, or somebody is twice in one frame.
    """
    path = Path(path)
    text = scan(path, load(path))
    if len(text) and text.width != len(_COLUMNS):
        raise InputError(
            f"expected {len(_COLUMNS)} columns ({' '.join(_COLUMNS)}), came {text.width}",
            where=text.origin.at(0),
            cure="Positions are read as in the obsmat.txt of the ETH and UCY data.",
        )
    values = numbers(text, range(len(_COLUMNS)), _COLUMNS)
    _refuse(np.logical_not(np.isfinite(values).all(1)), "expected finite numbers, came one that is not", text.origin)
    for column in (0, 1):
        odd: Bool = np.not_equal(values[:, column] % 1, 0)
        _refuse(odd, f"expected a whole number for the {_COLUMNS[column]}", text.origin)
    order = np.lexsort((values[:, 1], values[:, 0]))
    frame, identity = values[order, 0].astype(np.int64), values[order, 1].astype(np.int64)
    twice = np.zeros(len(order), np.bool_)
    twice[order[1:]] = (np.diff(frame) == 0) & (np.diff(identity) == 0)
    _refuse(twice, "expected everybody at most once in a frame, came somebody twice", text.origin)
    return Positions(frame, identity, np.ascontiguousarray(values[order][:, _PLANE].T))


def read_groups(path: AnyPath) -> tuple[tuple[int, ...], ...]:
    """The groups of a ``groups.txt``: identities, one group a line, separated by blanks.

    Annotated lines may share people, who then hold them together: a group is everybody who is linked by a chain of lines.
    Groups are in the order of their first line, identities ascend.

    Raises
    ------
    InputError : the file is missing, or an identity is no whole number.
    """
    path = Path(path)
    text = scan(path, load(path))
    found: list[set[int]] = []
    for row in range(len(text)):
        cells = [cell for cell in text.cells(row) if cell]
        wrong = next((cell for cell in cells if not cell.lstrip("-").isdigit()), None)
        if wrong is not None:
            raise InputError(f"expected identities, came '{wrong[:40]}'", where=text.origin.at(row))
        line = {int(cell) for cell in cells}
        linked = [group for group in found if group & line]
        if not linked:
            found.append(line)
            continue
        linked[0].update(line, *linked[1:])
        found = [group for group in found if not any(group is other for other in linked[1:])]
    return tuple(tuple(sorted(group)) for group in found)


def _refuse(wrong: Bool, sentence: str, origin: Origin) -> None:
    """Raise `InputError` with the line of the first row that is ``wrong`` (M,), if any is."""
    if wrong.any():
        raise InputError(sentence, where=origin.at(int(np.flatnonzero(wrong)[0])))
