"""Positions of people on the ground, in metres: ``obsmat.txt`` of ETH and UCY, and CSV.

``obsmat.txt`` has eight numbers a line without a header: frame, identity, x, z, y, vx, vz, vy, z
upwards. A CSV has ``frame,id,x,y`` and may have ``vx,vy``, in metres per second; without a header
the columns are in this order.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.formats.checks import (
    Rule,
    after_last_frame,
    earlier_duplicate,
    enforce,
    whole_number,
)
from phdtrack.formats.text import Text, numbers, scan
from phdtrack.types import F8, I8

# The columns of obsmat.txt, and of a CSV.
_OBSMAT = ("frame", "id", "x", "z", "y", "vx", "vz", "vy")
_PLACES = ("frame", "id", "x", "y")
_VELOCITIES = ("vx", "vy")


@dataclass(frozen=True, slots=True, eq=False)
class KnownPositions:
    """People on the ground, sorted by frame, then identity.

    ``frame`` (M,), ``identity`` (M,), and ``state`` (4, M): px, py in metres, vx, vy in metres per
    second, NaN if the file has no velocities.
    """

    frame: I8
    identity: I8
    state: F8

    def __len__(self) -> int:
        return len(self.frame)

    def at(self, number: int) -> KnownPositions:
        """The people of a frame.

        Parameters
        ----------
        number : of the frame.
        """
        lo, hi = np.searchsorted(self.frame, [number, number + 1])
        return KnownPositions(self.frame[lo:hi], self.identity[lo:hi], self.state[:, lo:hi])


def read_positions(path: AnyPath) -> KnownPositions:
    """Read the positions of people.

    Raises `InputError` if the file is missing or has other columns, a value is not a number, or a
    person is twice in a frame; the message names the line.

    Parameters
    ----------
    path : the file, as this module describes it.

    Returns
    -------
    The people; empty for an empty file.
    """
    text = scan(Path(path), load(path))
    columns = _columns(text, Path(path))
    values = dict(zip(columns.values(), numbers(text, columns).T, strict=True))
    frame, identity, x, y = (values[name] for name in _PLACES)
    unknown = np.full(len(frame), np.nan)
    state = np.stack([x, y, *(values.get(name, unknown) for name in _VELOCITIES)])
    before = earlier_duplicate(frame, identity)
    enforce(
        text.origin,
        whole_number(frame, "frame", low=0),
        after_last_frame(frame),
        whole_number(identity, "id"),
        Rule(
            ~np.isfinite(state[:2]).all(axis=0),
            "expected a place in metres, got {}, {}",
            state[:2].T,
        ),
        Rule(
            before >= 0,
            "person {:.0f} is twice in frame {:.0f}",
            np.stack([identity, frame], axis=1),
            "Remove one of the rows.",
        ),
    )
    order = np.lexsort((identity, frame))
    return KnownPositions(
        frame[order].astype(np.int64), identity[order].astype(np.int64), state[:, order]
    )


def _columns(text: Text, path: Path) -> dict[int, str]:
    """The columns to read, by their position in a line."""
    if text.header:
        found = {name: k for k, name in enumerate(text.header)}
        if not set(_PLACES) - set(found):
            return {found[name]: name for name in (*_PLACES, *_VELOCITIES) if name in found}
        got = ", ".join(text.header)
    else:
        every = {8: _OBSMAT, 6: _PLACES + _VELOCITIES, 4: _PLACES, 0: _PLACES}
        if text.width in every:
            wanted = every[text.width]
            return {k: name for k, name in enumerate(wanted) if name in (*_PLACES, *_VELOCITIES)}
        got = f"{text.width} numbers a line"
    raise InputError(
        f"expected positions in metres, got {got}",
        where=str(text.origin.at(0)) if len(text) else path,
        cure="Give a CSV frame,id,x,y with or without vx,vy, or the obsmat.txt of ETH and UCY.",
    )
