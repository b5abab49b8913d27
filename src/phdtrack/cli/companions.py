"""Several companions of a run as one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from markupsafe import Markup

from phdtrack.cli.job import Companion, Draw
from phdtrack.cli.run_directory import RunDirectory
from phdtrack.types import Image, Step, Tracks


def together(parts: Sequence[Companion]) -> Companion | None:
    """All of them; the one itself where there is one, None where there is none."""
    return Companions(tuple(parts)) if len(parts) > 1 else parts[0] if parts else None


@dataclass(frozen=True, slots=True)
class Companions:
    """Each does what it does alone, in order."""

    parts: tuple[Companion, ...]

    @contextmanager
    def open(self, directory: RunDirectory) -> Iterator[None]:
        """The files of all, open while the run lasts."""
        with ExitStack() as files:
            for part in self.parts:
                files.enter_context(part.open(directory))
            yield

    def take(self, step: Step, intensity: object) -> None:
        """All take in a step."""
        for part in self.parts:
            part.take(step, intensity)

    def flush(self, rows: Tracks) -> None:
        """All take in what was held back."""
        for part in self.parts:
            part.flush(rows)

    def finish(self, tracks: Tracks) -> None:
        """All take in the corrected tracks."""
        for part in self.parts:
            part.finish(tracks)

    @contextmanager
    def drawing(self, directory: RunDirectory, *, pictures: bool) -> Iterator[Draw]:
        """The videos of all."""
        with ExitStack() as files:
            draws = [files.enter_context(part.drawing(directory, pictures=pictures)) for part in self.parts]

            def draw(number: int, picture: Image) -> None:
                for one in draws:
                    one(number, picture)

            yield draw

    def section(self) -> Markup:
        """What each tells, one after the other."""
        return Markup("\n").join(part.section() for part in self.parts)

    def sentences(self) -> tuple[str, ...]:
        """The same in a few words."""
        return tuple(sentence for part in self.parts for sentence in part.sentences())

    def document(self) -> dict[str, object]:
        """The same for programs."""
        return {key: value for part in self.parts for key, value in part.document().items()}
