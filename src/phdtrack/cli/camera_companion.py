"""What goes along with a run whose camera moves: the motion as a file, and how far the camera went."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

from markupsafe import Markup

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.job import Draw
from phdtrack.cli.run_directory import RunDirectory
from phdtrack.formats.warps import WarpsWriter
from phdtrack.report.pages import camera_section
from phdtrack.types import SequenceInfo, Step, Tracks
from phdtrack.video.ego_motion import CameraPath


class CameraCompanion:
    """Writes the motion as it is used, for another run to read, and tells how far the camera went."""

    def __init__(self, kind: str, info: SequenceInfo) -> None:
        self._kind, self._path = kind, CameraPath(info.width, info.height)
        self._first = True
        self._file: WarpsWriter | None = None

    @contextmanager
    def open(self, directory: RunDirectory) -> Iterator[None]:
        """The file, open while the run lasts."""
        with WarpsWriter(directory.file(rundir.CAMERA_MOTION)) as file:
            self._file = file
            yield

    def take(self, step: Step, intensity: object) -> None:
        """Take down one motion; before the first frame there is none."""
        if not self._first:
            self._path.add(step.warp)
            if self._file is not None and len(step.warp):
                self._file.append(step.number, step.warp)
        self._first = False

    def flush(self, rows: Tracks) -> None:
        """The camera has not moved since."""

    def finish(self, tracks: Tracks) -> None:
        """Tracks lie in the pixels of their own frames."""

    def drawing(self, directory: RunDirectory, *, pictures: bool) -> AbstractContextManager[Draw]:
        """There is no video of it."""
        return nullcontext(lambda number, picture: None)

    def section(self) -> Markup:
        """How far the camera went, in words."""
        return camera_section(self.sentences())

    def sentences(self) -> tuple[str, ...]:
        """How far the camera went, and how often that is not known."""
        return (self._path.sentence(),)

    def document(self) -> dict[str, object]:
        """The same for programs."""
        return {"camera_motion": {"kind": self._kind} | self._path.document()}
