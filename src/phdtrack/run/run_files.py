"""The files that grow while a run goes on: detections, states, online rows, and of sources without
an end the corrected rows and the video.
"""

from __future__ import annotations

from contextlib import ExitStack

from phdtrack.files import return_memory
from phdtrack.final_rows import FinalTracks
from phdtrack.formats import DetectionsWriter, StatesWriter, TracksWriter
from phdtrack.formats.embeddings import EmbeddingsWriter
from phdtrack.run import directory as rundir
from phdtrack.run.annotated_video import LiveVideo
from phdtrack.run.loop import TrackedFrame
from phdtrack.run.running import Progress, Run
from phdtrack.types import Tracks


class RunFiles:
    """Writes every frame at once, and hands it on to the observers.

    Parameters
    ----------
    run, progress : of which the files are; errors that occur when a file is closed are noted in
        ``progress``.
    files : closes the files.
    """

    def __init__(self, run: Run, progress: Progress, files: ExitStack) -> None:
        self._run = run
        self._progress = progress
        directory = run.directory
        self._detections = DetectionsWriter(directory.file(rundir.DETECTIONS), run.names)
        self._embeddings: EmbeddingsWriter | None = None
        descriptors = run.inputs.descriptors
        if descriptors.name:
            file = directory.file(rundir.EMBEDDINGS)
            self._embeddings = EmbeddingsWriter(file, descriptors.dtype)
        self._states = StatesWriter(directory.file(rundir.STATES))
        self._online = TracksWriter(directory.file(rundir.ONLINE), run.names)
        # Corrected tracks of a source that may never end go to disk when they are final, and the
        # past is forgotten.
        self._corrected: TracksWriter | None = None
        self._final: FinalTracks | None = None
        self._video: LiveVideo | None = None
        if not run.inputs.again:
            self._corrected = TracksWriter(directory.file(rundir.TRACKS), run.names)
            self._final = FinalTracks(progress.tracker)
            if run.options.video and run.inputs.pictures:
                self._video = LiveVideo(run)
        writers = (
            self._detections,
            self._embeddings,
            self._states,
            self._online,
            self._corrected,
            self._video,
        )
        for writer in writers:
            # An error at closing must not take with it what was computed.
            files.enter_context(progress.writing())
            if writer is not None:
                files.enter_context(writer)
        for observer in run.observers:
            files.enter_context(progress.writing())
            observer.open(directory, files)

    def take(self, tracked: TrackedFrame) -> None:
        """Write a frame."""
        found = tracked.detected.detections
        self._detections.append(tracked.step.number, found)
        if self._embeddings is not None:
            self._embeddings.append(found.embeddings, len(found))
        self._states.append(tracked.step)
        self._append(self._online, tracked.rows)
        for observer in self._run.observers:
            observer.take(tracked)
        if self._video:
            self._video.take(tracked)
        if self._final and len(final := self._final.due()):
            self._take_final(final)
            # What smoothing has freed, or the heap grows for days.
            return_memory()

    def flush(self) -> None:
        """Write the online rows that were held back."""
        held = self._progress.tracker.flush()
        self._append(self._online, held)
        if self._video:
            self._video.flush(held)

    def rest(self) -> None:
        """Write all corrected rows that are not written yet."""
        if self._final:
            self._take_final(self._final.rest())

    def _take_final(self, rows: Tracks) -> None:
        """Write corrected rows, count them, and keep them if an observer needs those of the whole
        run.
        """
        if self._corrected:
            self._append(self._corrected, rows)
        self._progress.recorder.count(rows)
        self._progress.judge(rows)
        if any(observer.all_tracks for observer in self._run.observers):
            self._progress.final.append(rows)

    def _append(self, writer: TracksWriter, rows: Tracks) -> None:
        writer.append(rows, self._run.places(rows.xyxy))
