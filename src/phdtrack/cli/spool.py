"""A second look at frames that come only once: those of a camera, or of a stream on the network."""

from __future__ import annotations

import tempfile
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from phdtrack.types import Frame, SequenceInfo

if TYPE_CHECKING:
    from phdtrack.cli.inputs import Inputs
    from phdtrack.video import VideoSource

FINE = 16
"""Quality of the copy: hardly distinguishable, because it is encoded once more when it is drawn on."""


@contextmanager
def rereadable(inputs: Inputs, wanted: bool) -> Iterator[VideoSource]:
    """The frames of ``inputs``, to be gone through twice where that is ``wanted``; a copy lives as long as this does."""
    if inputs.again or not wanted:
        yield inputs.source
        return
    with tempfile.TemporaryDirectory(prefix="phdtrack-") as folder:
        yield Spool(inputs.source, Path(folder) / "frames.mp4")


class Spool:
    """The first time the frames of ``source``, copied into ``path`` on the way; from then on those of the copy."""

    def __init__(self, source: VideoSource, path: Path) -> None:
        self._source, self._path = source, path
        self._numbers: list[int] = []
        self._times: list[float] = []
        self._first: Generator[Frame, None, None] | None = None

    @property
    def info(self) -> SequenceInfo:
        """Of the source."""
        return self._source.info

    @property
    def note(self) -> str:
        """Of the source."""
        return self._source.note

    @property
    def problem(self) -> str:
        """Of the source."""
        return self._source.problem

    def __iter__(self) -> Iterator[Frame]:
        if self._first is None:
            self._first = self._copying()
            return self._first
        # Whoever went through it the first time may have stopped half-way: only closing completes the copy.
        self._first.close()
        return self._copied()

    def _copying(self) -> Generator[Frame, None, None]:
        from phdtrack.video import VideoWriter

        info = self.info
        with VideoWriter(self._path, info.width, info.height, info.fps, quality=FINE) as copy:
            for frame in self._source:
                copy.write(frame.image)
                self._numbers.append(frame.number)
                self._times.append(frame.time)
                yield frame

    def _copied(self) -> Iterator[Frame]:
        from phdtrack.video import open_source

        high, wide = self.info.height, self.info.width
        for number, time, frame in zip(self._numbers, self._times, open_source(self._path), strict=False):
            # The copy of an odd size is padded by a row or a column.
            yield Frame(number, time, frame.image[:high, :wide])
