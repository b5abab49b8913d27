"""What the associator remembers of every frame, as a record that grows without copying all of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from phdtrack.associate.window import Links
from phdtrack.types import F8, I8, Estimates

CHUNK = 256


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One frame: its number, its model time, its states (vertices ``first``, ``first`` + 1, …), and the links made final.

    ``final`` are the links (between global vertex numbers) that this frame made unchangeable. ``spare``
    (m, S) are the measurements that no state rested on, ``spare_index`` (S,) which of the frame's they are.
    """

    number: int
    time: float
    first: int
    estimates: Estimates
    final: Links
    spare: F8
    spare_index: I8


@dataclass(frozen=True, slots=True)
class History:
    """All moments so far, in chunks, so that adding one copies a few hundred references at most."""

    full: tuple[tuple[Moment, ...], ...] = ()
    recent: tuple[Moment, ...] = ()

    def append(self, moment: Moment) -> History:
        """A history with one more moment."""
        recent = (*self.recent, moment)
        return History((*self.full, recent), ()) if len(recent) == CHUNK else History(self.full, recent)

    def __len__(self) -> int:
        return CHUNK * len(self.full) + len(self.recent)

    def __getitem__(self, index: int) -> Moment:
        chunk, place = divmod(index, CHUNK)
        return self.full[chunk][place] if chunk < len(self.full) else self.recent[place]

    def __iter__(self) -> Iterator[Moment]:
        for chunk in self.full:
            yield from chunk
        yield from self.recent
